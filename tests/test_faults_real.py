"""One fault over real sockets; the others by `sitl faults --real`."""

from __future__ import annotations

import pytest

from sitl.faults import real


@pytest.mark.timeout(120)
def test_a_service_that_is_killed_in_flight_and_started_again_stays_silent() -> None:
    fault = real.TABLE[0]
    assert "killed (-9)" in fault.title
    outcome = real.fly(fault)
    assert outcome.problems == ()
    assert outcome.setpoints > 40
    assert outcome.as_json()["passed"]
    assert real.table([fault], [outcome]).row_count == 1
