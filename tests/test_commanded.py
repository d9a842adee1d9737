"""What a setpoint commands, by what its profile asks for, and where two configurations ask otherwise."""

from __future__ import annotations

from dataclasses import replace
from math import degrees
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import CliRunner

from guidance.cli import app
from guidance.commanded import channels_of
from guidance.commands import Engage
from guidance.config import load, profile_of
from guidance.mavlink.setpoints import Demand, outgoing
from guidance.records import Setpoint
from guidance.report.comparison import drawn
from guidance.report.flight import read_flight
from guidance.report.panels import controls
from guidance.se3 import Vec3, from_euler
from guidance.supervisor import State
from guidance.what_if import Comparison, compare, other_configuration
from sitl.lockstep import SECOND, Lockstep
from sitl.logbook import LogBook
from sitl.scenarios import airplane, copter, px4_rover
from sitl.scenarios.flight import Task, configuration
from sitl.vehicle import Vehicle, VehicleOptions
from tests.flight_asset import ASSET
from tests.helpers import fly_until
from tests.test_report_page import read_page

DEPLOY = Path(__file__).parents[1] / "deploy"


def flown_by(task: Task, directory: Path, *settings: str) -> Path:
    """The log of three seconds of a scenario."""
    config = configuration(replace(task, settings=(*task.settings, *settings)))
    with LogBook(config, directory) as book:
        vehicle = Vehicle(VehicleOptions(**task.vehicle, noise=task.noise), boot_ns=SECOND)
        flight = Lockstep(config, vehicle, start_ns=SECOND, on_record=book.add)
        fly_until(flight, State.READY, 30.0)
        flight.guide.command(Engage(), flight.now_ns)
        flight.run(4.0)
    return book.path


def compared(path: Path, *settings: str) -> Comparison:
    return compare(path, lambda logged: other_configuration(logged, None, settings))


@pytest.mark.parametrize(
    ("profile", "output", "channels"),
    [
        ("px4-uuv", (), ["roll rate", "pitch rate", "yaw rate", "speed", "thrust"]),
        ("ardupilot-rover", (), ["yaw rate", "speed", "thrust"]),
        ("px4-rover", (), ["velocity north", "velocity east"]),
        ("ardupilot-plane", (), ["bank", "pitch", "thrust"]),
        ("px4-plane", ("airplane.output=rates",), ["roll rate", "pitch rate", "yaw rate", "thrust"]),
        ("px4-copter", ("copter.output=rates",), ["roll rate", "pitch rate", "yaw rate", "thrust"]),
        (
            "ardupilot-copter",
            (),
            ["velocity north", "velocity east", "velocity down", "yaw rate about down"],
        ),
    ],
)
def test_the_channels_are_what_is_sent(profile: str, output: tuple[str, ...], channels: list[str]) -> None:
    """And nothing else is: all other fields of a setpoint stay at their defaults."""
    asked = profile_of(load(DEPLOY / f"{profile}.toml", output))
    found = channels_of(asked)
    assert [channel.name for channel in found] == channels
    attitude = from_euler(0.2, 0.1, 0.3)
    demand = Demand(Vec3(0.1, 0.2, 0.3), 1.0, attitude, 0.4, Vec3(1.0, 2.0, 3.0), 0.5)
    sent = outgoing(asked, demand, 5.0)
    setpoint = Setpoint(
        t_ns=0,
        seq=0,
        neutral=False,
        body_rates_frd_rad_s=sent.body_rates_frd_rad_s,
        speed_m_s=sent.speed_m_s,
        demanded_body_rates_frd_rad_s=(0.0, 0.0, 0.0),
        demanded_speed_m_s=0.0,
        thrust=sent.thrust,
        saturated=False,
        singular=False,
        attitude_wxyz=sent.attitude_wxyz,
        velocity_ned_m_s=sent.velocity_ned_m_s,
    )
    assert all(channel.of(setpoint) != 0.0 for channel in found)
    values = {channel.name: channel.of(setpoint) for channel in found}
    wanted = {
        "roll rate": 0.1,
        "yaw rate": 0.3,
        "yaw rate about down": 0.5,
        "velocity down": 3.0,
        "speed": 1.0,
    }
    wanted |= {"bank": degrees(0.2), "pitch": degrees(0.1)}
    for name in values.keys() & wanted.keys():
        assert values[name] == pytest.approx(wanted[name]), name


def test_what_is_asked_otherwise_is_not_compared_but_said(tmp_path: Path) -> None:
    """A circle of an airplane: by roll and pitch, and what it would have been told by body rates."""
    row = next(row for row in airplane.rows() if row.task.profile == "px4-plane")
    log = flown_by(row.task, tmp_path)
    found = compared(log, "airplane.output=rates")
    assert len(found.t_ns) > 50
    assert [one.channel for one in found.differences] == ["thrust"]
    words = (
        "flown was asked for roll, pitch and throttle, the other asks for body rates and throttle: "
        "only thrust can be compared"
    )
    assert found.asked_otherwise == found.as_json()["asked_otherwise"] == words
    output = tmp_path / "x.html"
    arguments = ["replay", str(log), "--set", "airplane.output=rates", "--report", str(output)]
    outcome = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert outcome.exit_code == 0, outcome.stderr
    assert words in outcome.stdout
    page = read_page(output)[1]
    assert words[1:] in page.text
    assert {line["yaxis"] for line in page.json["charts"]["comparison"]["data"]} == {"y"}
    assert compared(log, "law.k=0.5").asked_otherwise == ""


def test_where_nothing_is_asked_alike_there_is_no_difference() -> None:
    """As of a copter by velocity and by rates."""
    by_velocity, by_rates = (
        load(DEPLOY / "px4-copter.toml", (f"copter.output={output}",)) for output in ("velocity", "rates")
    )
    none = compared(ASSET)._replace(flown=by_velocity, other=by_rates, commands=())
    assert none.asked_otherwise.endswith("no channel can be compared")
    assert none.differences == ()
    assert none.as_json()["differences"] == []
    text, sections = drawn(none, read_flight(ASSET), "it")
    assert "no channel can be compared" in text
    assert sections == []


# What the report shows -----------------------------------------------------------------------------------

DEMANDED, SENT, MEASURED = "demanded", "sent", "measured"
RATES = ["roll rate", "pitch rate", "yaw rate"]
VELOCITY = ["velocity north", "velocity east", "velocity down"]


@pytest.mark.parametrize(
    ("scenario", "settings", "sent", "unsent"),
    [
        (copter, ("copter.output=rates",), [*RATES, "thrust"], VELOCITY),
        (copter, (), [*VELOCITY, "yaw rate"], []),
        (airplane, ("airplane.output=rates",), [*RATES, "throttle"], ["bank", "pitch", "true airspeed"]),
        (airplane, (), ["bank", "pitch", "throttle"], ["true airspeed"]),
        (px4_rover, (), VELOCITY[:2], ["yaw rate", "forward speed"]),
    ],
    ids=["copter by rates", "copter", "airplane by rates", "airplane", "rover by velocity"],
)
def test_sent_is_shown_where_it_is_sent(
    scenario: ModuleType, settings: tuple[str, ...], sent: list[str], unsent: list[str], tmp_path: Path
) -> None:
    task = next(row.task for row in scenario.rows() if row.task.profile.startswith("px4"))
    panels = {
        panel.title.partition(" (")[0]: {line.role: line for line in panel.lines}
        for panel in controls(read_flight(flown_by(task, tmp_path, *settings)))
    }
    assert list(panels) == [*sent, *unsent]
    for title, lines in panels.items():
        assert (SENT in lines) == (title in sent), title
        assert MEASURED in lines or title in ("thrust", "throttle"), title
        if title in sent:
            assert lines[SENT].y.any(), f"{title} sent is zero all the time"
    if settings == ("copter.output=rates",):  # it leans as its velocity needs
        assert [title for title in RATES if DEMANDED in panels[title]] == ["yaw rate"]
