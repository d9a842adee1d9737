"""Every order in every state: obeyed, or refused with the reason; once, told, and the same in a replay."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from guidance import guard_limits
from guidance.changing import settings, with_setting, with_trajectory
from guidance.commands import (
    Abort,
    Allocate,
    Engage,
    Hold,
    LoadTrajectory,
    Order,
    Resume,
    Scalar,
    Set,
    Shutdown,
    text_of,
    verb_of,
)
from guidance.core import Guide
from guidance.flying.rates import Rates
from guidance.law import Parameters
from guidance.orders import ANSWERS_KEPT, Orders
from guidance.records import Answer, Event, Input, InputKind, Level, Record, Setpoint, Status
from guidance.supervisor import State
from guidance.tracker import Tracker
from guidance.trajectory import Circle
from tests.engagement_bench import PX4, Bench, bench
from tests.helpers import (
    fly_until,
    fly_until_tracking,
    make_config,
    make_flight,
    records_of,
    state_of,
)

CIRCLE = LoadTrajectory(trajectory={"name": "circle", "radius_m": 4})
CIRCLE_HERE = LoadTrajectory(trajectory={"name": "circle", "radius_m": 0.5, "speed_m_s": 0.2})
ENGAGING = {State.STREAMING, State.SWITCHING, State.ARMING}
ALREADY = {
    Engage: ENGAGING | {State.TRACKING},
    Hold: {State.PAUSING, State.HOLDING},
    Resume: ENGAGING | {State.TRACKING},
    Abort: {State.CANCELLING, State.ABORTING, State.ABORTED},
}
OUT_OF_CONTROL = {
    State.DISCONNECTED,
    State.CONNECTED,
    State.WITHHELD,
    State.READY,
    State.HANDED_OVER,
    State.ABORTED,
}


def desk(state: State, *overrides: str) -> tuple[Orders, Tracker, Bench]:
    """Orders to an engagement that is put into a state."""
    config = make_config(*overrides)
    tracker, it = Tracker(config, PX4), bench(PX4)
    it.it.state = state
    return Orders(config, it.it, tracker), tracker, it


def order(orders: Orders, given: Order, now_ns: int = 1) -> Answer:
    """The answer, which the event agrees with."""
    event, answer = orders.carry_out(given, now_ns)
    assert (answer.order, answer.id, answer.source) == (verb_of(given), given.id, given.source)
    if not answer.repeated:
        assert event is not None
        assert event.level is (Level.NOTICE if answer.accepted else Level.WARNING)
        assert event.code.endswith("refused") is not answer.accepted
    assert answer.accepted or answer.reason
    return answer


def law_of(tracker: Tracker) -> Parameters:
    assert isinstance(tracker.handler, Rates)
    return tracker.handler._parameters


@pytest.mark.parametrize("state", State)
def test_gains_limits_and_allocations_are_taken_in_every_state(state: State) -> None:
    orders, tracker, _ = desk(state)
    assert order(orders, Set(key="law.k", value=0.5)).reason == "law.k: 1.0 -> 0.5"
    assert order(orders, Set(key="limits.acceleration_max_m_s2", value=2)).reason == (
        "limits.acceleration_max_m_s2: no limit -> 2.0"
    )
    assert law_of(tracker).gains.k == 0.5
    assert law_of(tracker).limits.acceleration_m_s2 == 2.0
    assert order(orders, Allocate(allocation="roll-yaw")).accepted
    assert tracker.allocation == "roll-yaw"
    refused = order(orders, Set(key="law.k", value=60))
    assert not refused.accepted
    assert "must be below 1 to be stable" in refused.reason
    assert orders.config.law.k == law_of(tracker).gains.k == 0.5  # the old one


@pytest.mark.parametrize("state", State)
def test_a_trajectory_is_loaded_only_out_of_control(state: State) -> None:
    orders, tracker, _ = desk(state)
    answer = order(orders, CIRCLE)
    assert answer.accepted is (state in OUT_OF_CONTROL)
    if answer.accepted:
        assert tracker._trajectory == orders.config.trajectory == Circle(radius_m=4.0)
        assert order(orders, CIRCLE).reason == "already loaded"
    else:
        assert answer.reason == (
            f"a trajectory is loaded only while the service has no control, and it is {state}"
        )
        assert tracker._trajectory == orders.config.trajectory == make_config().trajectory


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("given", [Engage(), Hold(), Resume(), Abort()], ids=verb_of)
def test_a_manoeuvre_is_answered_as_the_supervisor_takes_it(state: State, given: Order) -> None:
    orders, _, it = desk(state)
    answer = order(orders, given)
    same = bench(PX4).it
    same.state = state
    refused = getattr(same, verb_of(given))(1)
    if state in ALREADY[type(given)]:
        assert answer.accepted
        assert answer.reason == f"already {state}"
    else:
        assert answer.accepted is (refused is None)
        assert answer.reason == (refused or "").removeprefix(f"{verb_of(given)} refused: ")
    assert it.state() is state  # what follows, follows from the next look
    assert order(orders, Shutdown()).accepted
    late = order(orders, given)
    assert not late.accepted
    assert "the service is shutting down" in late.reason


def test_one_id_is_obeyed_once_and_answered_the_same() -> None:
    orders, _, _ = desk(State.TRACKING)
    faster = Set(id="7", source="zenoh ada", key="law.k", value=0.5)
    first = order(orders, faster)
    assert order(orders, Set(key="law.k", value=2)).accepted
    event, again = orders.carry_out(faster, 9)
    assert event is None
    assert (again.accepted, again.reason, again.repeated, again.t_ns) == (True, first.reason, True, 9)
    assert orders.config.law.k == 2.0
    # Of somebody else the same id is another order.
    assert not order(orders, Set(id="7", source="zenoh bob", key="law.k", value=0.6)).repeated
    # A refusal is kept as well.
    bad = Set(id="8", key="law.k", value=-1)
    assert order(orders, bad).reason == order(orders, bad).reason
    # Without an id, the same twice is the same already.
    assert order(orders, Set(key="law.k", value=0.6)).reason == "law.k = 0.6 already"


def test_an_id_is_for_one_order_only() -> None:
    """An abort that borrows the id of an engage must not be told that it was accepted."""
    orders, tracker, _ = desk(State.READY)
    assert order(orders, Engage(id="1", source="zenoh ada")).accepted
    event, answer = orders.carry_out(Abort(id="1", source="zenoh ada"), 2)
    assert event is not None
    assert event.code == "abort_refused"
    assert (answer.order, answer.accepted, answer.repeated) == ("abort", False, False)
    assert answer.reason == "id 1 was another order's (engage): give each order its own"
    assert order(orders, Engage(id="1", source="zenoh ada")).repeated  # which keeps it
    assert order(orders, Set(id="2", key="law.k", value=0.5)).accepted
    assert not order(orders, Set(id="2", key="law.k", value=0.6)).accepted
    assert law_of(tracker).gains.k == 0.5


def test_so_many_answers_are_kept_and_no_more() -> None:
    orders, _, _ = desk(State.READY)
    for number in range(3 * ANSWERS_KEPT):
        order(orders, Set(id=str(number), key="law.k", value=0.5))
    assert len(orders._answers) == ANSWERS_KEPT
    assert order(orders, Set(id=str(3 * ANSWERS_KEPT - 1), key="law.k", value=0.5)).repeated


def test_limits_leave_the_allocation_that_is_flown_its_rates() -> None:
    orders, _, _ = desk(State.TRACKING)
    order(orders, Allocate(allocation="roll-yaw"))
    answer = order(orders, Set(key="limits.roll_rate_max_rad_s", value=0))
    assert answer.reason == "limits.roll_rate_max_rad_s = 0 leaves roll-yaw without that rate"


@pytest.mark.parametrize(
    "text", ["", "engage", "{}", '{"order": "fly"}', "[" * 5000, '{"order": "set", "key": 1}']
)
def test_an_input_that_is_no_order_is_answered_and_harms_nothing(text: str) -> None:
    guide = Guide(make_config())
    guide.handle(Input(t_ns=1, seq=0, kind=InputKind.COMMAND, text=text))
    told = [record for record in guide.records() if isinstance(record, Answer | Event)]
    assert [type(record) for record in told] == [Event, Answer]
    assert isinstance(told[1], Answer)
    assert not told[1].accepted
    assert told[1].reason.startswith("not an order: ")


def test_status_is_told_at_once_after_an_order() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(0.35)
    now_ns = flight.now_ns
    flight.guide.command(Allocate(allocation="roll-yaw"), now_ns)
    flight.run(0.021)
    assert records_of(flight, Status, now_ns)[0].allocation == "roll-yaw"


def test_an_order_is_a_text_that_a_log_can_hold() -> None:
    assert text_of(Set(key="law.k", value=0.5)) == '{"order":"set","key":"law.k","value":0.5}'


def test_the_guards_go_by_what_is_set_and_loaded() -> None:
    """A limit that is raised is no limit of the old height, and a loaded trajectory is held to the fence."""
    flight = make_flight("limits.speed_max_m_s=1")
    fly_until_tracking(flight)
    flight.run(2.0)
    set_ns = flight.now_ns
    flight.guide.command(Set(key="limits.speed_max_m_s", value=5), set_ns)
    flight.run(3.0)
    assert state_of(flight) is State.TRACKING, flight.guide.engagement.reason
    assert max(s.speed_m_s for s in records_of(flight, Setpoint, set_ns)) > 2.0

    fence = "guards.fence_ned_m=[[-50, -50], [-50, 50], [50, 50], [50, -50]]"
    flight = make_flight("supervisor.engage=pilot", "flight.origin=engage", fence)
    fly_until(flight, State.READY)
    far: dict[str, Scalar] = {"name": "circle", "radius_m": 70}
    flight.guide.command(LoadTrajectory(trajectory=far), flight.now_ns)
    fly_until(flight, State.CONNECTED)
    assert flight.guide.engagement.reason.startswith("fence")


def test_a_trajectory_loaded_and_engaged_in_one_breath_is_held_to_the_fence() -> None:
    """The guards look ahead every 0.5 s before a flight; engaging takes less."""
    fence = "guards.fence_ned_m=[[-50, -50], [-50, 50], [50, 50], [50, -50]]"
    where = ("supervisor.engage=pilot", "supervisor.arm=true", "flight.origin=engage")
    flight = make_flight(*where, fence, "guards.fence_plan_s=120")
    out: dict[str, Scalar] = {"name": "line", "speed_m_s": 0.9}  # from x = -10 m: outside after 67 s
    for attempt in range(12):
        fly_until(flight, State.READY)
        flight.run(0.05 * attempt)
        flight.guide.command(LoadTrajectory(trajectory=out), flight.now_ns)
        flight.guide.command(Engage(), flight.now_ns)
        assert not flight.run(2.0, until=lambda: state_of(flight) is State.STREAMING)
        assert flight.guide.engagement.reason.startswith("fence: the trajectory leaves")
        flight.guide.command(Abort(), flight.now_ns)
        flight.guide.command(CIRCLE_HERE, flight.now_ns)


def test_no_setpoint_is_ever_outside_the_limits_of_its_instant() -> None:
    """Whatever is set in flight, in whatever order; refused values change nothing."""
    dice = random.Random(7)
    flight = make_flight("limits.acceleration_max_m_s2=2", "limits.yaw_acceleration_max_rad_s2=20")
    outside: list[object] = []

    def judge(record: Record) -> None:
        flight.records.append(record)
        if isinstance(record, Setpoint):
            limits = flight.guide.config.limits
            rates = (limits.roll_rate_max_rad_s, limits.pitch_rate_max_rad_s, limits.yaw_rate_max_rad_s)
            turns = zip(record.body_rates_frd_rad_s, rates, strict=True)
            slow = limits.speed_min_m_s <= record.speed_m_s <= limits.speed_max_m_s
            if not slow or any(abs(rate) > most for rate, most in turns):
                outside.append((record, limits))

    flight.on_record = judge
    fly_until_tracking(flight)
    keys = [key for key in settings(flight.guide.config) if key != "limits.keep_direction"]
    for _ in range(150):
        value = dice.choice([dice.uniform(-6.0, 6.0), dice.uniform(0.2, 6.0), dice.uniform(0.0, 0.3)])
        flight.guide.command(Set(key=dice.choice(keys), value=value), flight.now_ns)
        flight.run(0.1)
    taken = [answer.accepted for answer in records_of(flight, Answer)]
    assert 40 < sum(taken) < 140
    assert len(records_of(flight, Setpoint)) > 500
    assert outside == []


PAGE = Path(__file__).parent.parent / "docs" / "orders.md"


SPOKEN: dict[str, Order] = {
    "engage": Engage(), "hold": Hold(), "resume": Resume(), "abort": Abort(), "load a trajectory": CIRCLE,
    "set a gain or limit": Set(key="law.k", value=0.5), "allocate": Allocate(allocation="roll-yaw"),
    "shut down": Shutdown(),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOKEN)
def test_the_page_says_in_which_states_each_is_accepted(name: str) -> None:
    """And whether it is so already there."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    (line,) = [line for line in lines if line.startswith(f"| {name} | `")]
    fresh: set[str] = set()
    already: set[str] = set()
    for state in State:
        answer = order(desk(state)[0], SPOKEN[name])
        if answer.accepted:
            (already if answer.reason.startswith("already") else fresh).add(state)
    said, _, said_already = line.rpartition(" | ")[2].removesuffix(" |").partition("; already so: ")
    assert said == "every state" if len(fresh) == len(State) else set(said.split(", ")) == fresh
    assert set(filter(None, said_already.split(", "))) == already


def test_a_gain_set_in_flight_does_not_plan_the_flight_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is decided on the control path, and 600 s against a fence of 100 corners take 50 ms."""
    fence = "guards.fence_ned_m=[[-50, -50], [-50, 50], [50, 50], [50, -50]]"
    config = make_config("flight.origin=ekf", fence)
    asked: list[object] = []
    monkeypatch.setattr(guard_limits, "leaves_after_s", lambda *found: asked.append(found))
    assert with_setting(config, "law.k", 0.5).law.k == 0.5
    assert asked == []
    with_trajectory(config, CIRCLE_HERE.trajectory)
    assert len(asked) == 1  # another flight
