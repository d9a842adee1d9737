"""That a report's pictures can be read: ticks, titles, legends, marks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure
from msgspec.structs import replace

from guidance.records import Event
from guidance.report import looks, plots
from guidance.report.charts import plan_chart, timeline_chart
from guidance.report.flight import read_flight
from guidance.report.judged import judged
from guidance.report.panels import Shown
from guidance.report.paths import paths_of
from guidance.report.timeline import Bar, Timeline, kinds_of
from tests.flight_asset import ASSET
from tests.hand_made_flight import ZERO_NS, flown, log_of
from tests.helpers import make_config


def shown(*labels: str) -> list[Shown]:
    flight = read_flight(ASSET)
    figures = [judged(flight, stretch) for stretch in flight.stretches]
    return [Shown(label, flight, figures) for label in labels]


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Figure]:
    """The figures of two logs, drawn."""
    drawn: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda self, path, **_: drawn.__setitem__(path.name, self))
        plots.write(shown("one", "two"), tmp_path_factory.mktemp("png"))
    return {name.split(".")[1]: figure for name, figure in drawn.items()}


def test_logarithmic_ticks_are_numbers(images: dict[str, Figure]) -> None:
    for name in ("error", "timing"):
        images[name].canvas.draw()
        ticks = [tick.get_text() for axis in images[name].axes for tick in axis.get_yticklabels()]
        assert ticks
        assert not [tick for tick in ticks if "$" in tick or "{" in tick]


def test_every_image_has_a_title_and_each_name_once(images: dict[str, Figure]) -> None:
    for name, figure in images.items():
        assert figure.get_suptitle(), name
        for legend in figure.legends:
            names = [text.get_text() for text in legend.get_texts()]
            assert len(set(names)) == len(names), name
    for name in ("plan", "space"):
        (legend,) = images[name].legends
        assert {text.get_text() for text in legend.get_texts()} >= {
            "reference", "start", "path one", "path two", "fence",
        }  # fmt: skip
    assert images["plan"].axes[0].get_aspect() == 1.0


def test_the_plan_of_several_logs_names_what_looks_the_same_once() -> None:
    traces = plan_chart(paths_of(shown("one", "two")), None)["data"]
    named = [trace["name"] for trace in traces if trace.get("showlegend", True)]
    assert [name for name in named if not name.startswith("events")] == [
        "reference", "path one", "start", "path two",
    ]  # fmt: skip


def test_states_of_one_colour_are_one_entry() -> None:
    lines = [
        Timeline("a", [Bar("ready", "", -1.0, 0.0), Bar("tracking", "", 0.0, 9.0)], []),
        Timeline("b", [Bar("switching", "", -1.0, 0.0), Bar("tracking", "", 0.0, 9.0)], []),
    ]
    assert kinds_of(lines) == {looks.OTHER_STATE: "ready, switching", looks.shade("tracking"): "tracking"}
    bars = [trace for trace in timeline_chart(lines)["data"] if trace["type"] == "bar"]
    assert [bar["name"] for bar in bars if bar["showlegend"]] == ["ready, switching", "tracking"]
    assert [bar["text"] for bar in bars] == [["ready: "], ["tracking: "], ["switching: "], ["tracking: "]]


def test_marks_of_one_kind_leave_the_path_to_be_seen(tmp_path: Path) -> None:
    """Twenty times a second for ten seconds, and once something else."""
    records = flown(10.0, lambda _: (0.0, 0.1, 0.0))
    (event,) = (one for one in records if isinstance(one, Event))
    for n in range(200):
        records.append(replace(event, t_ns=ZERO_NS + n * 50_000_000))
    records.append(replace(event, t_ns=ZERO_NS + 5_050_000_000, code="other", text="other"))
    flight = read_flight(log_of(tmp_path, make_config(), records))
    (path,) = paths_of([Shown("a", flight, [])])
    assert 15 <= len(path.marks) <= 22
    assert [mark.text for mark in path.marks].count("other") == 1
    assert len(flight.events) == 202
