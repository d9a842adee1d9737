"""The report's page and images, and what it says of what is no flight."""

from __future__ import annotations

import base64
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image
from matplotlib.figure import Figure
from mcap.writer import Writer
from pymavlink.dialects.v20 import all as dialect
from typer.testing import CliRunner

from guidance.cli import app
from guidance.config import load, profile_of
from guidance.mavlink.codec import PacketWriter
from guidance.mavlink.profiles import Handling
from guidance.records import Input, InputKind
from guidance.report import plots
from guidance.report.columns import Floats
from guidance.report.flight import Flight, read_flight
from guidance.report.judged import GROUPS, Figures, judged, shown
from guidance.report.page import _json
from guidance.report.panels import Shown, sections_of
from guidance.report.paths import box_of, fence_outline
from guidance.report.reading import labels_of
from tests.flight_asset import ASSET
from tests.hand_made_flight import flown, log_of, status, with_session
from tests.helpers import make_config

#: 1 m off for two seconds, then 3 cm ahead, 4 cm right and 12 cm above: 13 cm.
OFF_S = 2.0
SECONDS = 14.0


def track(t_s: float) -> tuple[float, float, float]:
    return (-1.0, 0.0, 0.0) if t_s < OFF_S - 1e-9 else (0.03, 0.04, 0.12)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    records = flown(SECONDS, track, saturated=lambda t_s: 4.0 <= t_s < 7.5)
    return log_of(tmp_path_factory.mktemp("logs"), make_config(), records)


def call(*arguments: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr; anything but an orderly exit is raised."""
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    return result.exit_code, result.stdout, result.stderr


# The page ------------------------------------------------------------------------------------------------


class _Page(HTMLParser):
    """What a page would fetch, its JSON, the cells of its figures, and whether every element is closed."""

    VOID = frozenset({"meta", "br", "hr", "img", "link", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.wanted: list[str] = []
        self.json: dict[str, Any] = {}
        self.cells: list[tuple[str, str]] = []
        self.policy = ""
        self.text = ""
        self.open: list[str] = []
        self._script = ""
        self._key = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.wanted += [
            value or ""
            for key, value in attrs
            if key in ("src", "href", "data", "action", "poster", "srcset")
        ]
        if tag not in self.VOID:
            self.open.append(tag)
        if found.get("http-equiv") == "Content-Security-Policy":
            self.policy = found["content"] or ""
        self._script = (found.get("id") or "-") if tag == "script" else ""
        self._key = found.get("data-key") or ""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        self._script = self._key = ""

    def handle_data(self, data: str) -> None:
        if self._script in ("json", "charts"):
            self.json[self._script] = json.loads(data)
        elif self._key:
            self.cells.append((self._key, data))
        elif not self._script:
            self.text += data


def read_page(path: Path) -> tuple[str, _Page]:
    text = path.read_text(encoding="utf-8")
    page = _Page()
    page.feed(text)
    page.close()
    assert page.open == []
    return text, page


@pytest.fixture(scope="module")
def reported(log: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The page of the flight made by hand, and what `--json` printed."""
    output = tmp_path_factory.mktemp("page") / "flight.html"
    status, out, err = call("report", str(log), "-o", str(output), "--json", "--converged", "0.2")
    assert status == 0, err
    assert str(output) in err
    return output, json.loads(out)


def test_the_page_asks_no_one_for_anything(reported: tuple[Path, dict[str, Any]]) -> None:
    text, page = read_page(reported[0])
    assert page.wanted == []
    assert page.policy.startswith("default-src 'none'")
    assert "http" not in page.policy
    assert text.count("plotly.js v") == 1
    ours = re.sub(r"<script>/\*\*.*?</script>", "", text, flags=re.DOTALL)
    assert len(ours) < 1_000_000
    assert not re.search(r"https?://|//cdn|@import|url\(", ours)
    assert "showSendToCloud: false" in ours


def test_the_pages_figures_are_those_of_the_json(reported: tuple[Path, dict[str, Any]]) -> None:
    output, printed = reported
    _, page = read_page(output)
    assert page.json["json"] == printed
    (one,) = printed["logs"][0]["flights"]
    assert one["converged_s"] == pytest.approx(OFF_S)
    rows = {row.key: row for members in GROUPS.values() for row in members}
    assert len(page.cells) > 25
    for key, cell in page.cells:
        assert cell == shown(one[key], rows[key])
    assert dict(page.cells)["settled_cross_rms_m"] == "0.04"
    assert dict(page.cells)["attitude_age_median_s"] == "40"
    assert set(rows) == set(Figures.__struct_fields__)


def test_what_is_drawn_is_what_was_flown(reported: tuple[Path, dict[str, Any]]) -> None:
    _, page = read_page(reported[0])
    charts = page.json["charts"]
    assert set(charts) == {"plan", "space", "error", "controls", "saturation", "timeline", "timing"}
    norm, along, cross, vertical = (unpacked(line["y"]) for line in charts["error"]["data"])
    assert (norm[0], along[0], cross[-1], vertical[-1]) == pytest.approx((1.0, -1.0, 0.04, 0.12), abs=1e-6)
    yaw = {line["name"]: unpacked(line["y"]) for line in charts["controls"]["data"] if line["yaxis"] == "y3"}
    assert {name: float(y[0]) for name, y in yaw.items()} == pytest.approx(
        {"demanded": 0.25, "sent": 0.2, "measured": 0.3}, abs=1e-6
    )
    plan = {trace["name"]: trace for trace in charts["plan"]["data"]}
    assert unpacked(plan["reference"]["x"])[-1] == pytest.approx(2.0 * SECONDS)
    assert plan["events"]["text"] == ["1.00 s: &lt;b&gt;so &amp; so&lt;/b&gt;"]
    for name, chart in charts.items():
        for key, axis in chart["layout"].items():
            if re.fullmatch(r"[xy]axis\d*", key) and axis.get("title") and name != "timeline":
                assert re.search(r", |thrust", axis["title"]["text"]), f"{name}.{key} has no unit"


def unpacked(packed: dict[str, str]) -> Floats:
    return np.frombuffer(base64.b64decode(packed["bdata"]), dtype="<f4").astype(np.float64)


def test_words_of_a_log_are_words_on_the_page(reported: tuple[Path, dict[str, Any]]) -> None:
    text, page = read_page(reported[0])
    assert "<b>so" not in text
    assert "<b>so & so</b>" in page.text


def test_the_box_holds_all_and_is_neither_flat_nor_filled_by_noise() -> None:
    level = np.array([[-10.0, 0.0, 2.0], [10.0, 40.0, 2.2]])
    box = box_of([level], None)
    for (low, high), least, most in zip(box.ranges, level.min(axis=0), level.max(axis=0), strict=True):
        assert low < least < most < high
    assert box.ranges[2][1] - box.ranges[2][0] > 4.0
    assert box.sides == pytest.approx([0.5, 1.0, 0.25])
    fenced = box_of([level], np.array([[-100.0, -100.0], [100.0, 100.0]]))
    assert fenced.ranges[0][0] < -100.0 < 100.0 < fenced.ranges[1][1]


def fenced(tmp_path: Path, *settings: str, packet: bytes = b"") -> Flight:
    """A flight by hand whose log has this packet among its inputs."""
    came = Input(t_ns=1, seq=0, kind=InputKind.DATAGRAM, data=packet)
    return read_flight(log_of(tmp_path, make_config(*settings), [came, *flown(2.0, track)]))


def origin_at(latitude: int, longitude: int, system: int = 1, component: int = 1) -> bytes:
    message = dialect.MAVLink_gps_global_origin_message(latitude, longitude, 50_000)
    return PacketWriter(system, component).pack(message)


PLACES = ((47.0, 8.0), (47.001, 8.0), (47.001, 8.001), (47.0, 8.001))


def test_a_fence_on_earth_stands_where_the_log_says_that_the_local_frame_is(tmp_path: Path) -> None:
    setting = f"guards.fence_deg={[list(place) for place in PLACES]}"
    profile = profile_of(make_config())
    outline = fence_outline(fenced(tmp_path, setting, packet=origin_at(470_000_000, 80_000_000)))
    assert outline is not None
    wanted = [profile.project((*place, 50.0), (47.0, 8.0, 50.0))[:2] for place in PLACES]
    assert outline == pytest.approx(np.array([*wanted, wanted[0]])[:, ::-1])
    for unknown in (b"", origin_at(0, 0), origin_at(470_000_000, 80_000_000, system=9)):
        assert fence_outline(fenced(tmp_path, setting, packet=unknown)) is None


def test_the_fence_is_on_every_picture_of_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    square = "guards.fence_ned_m=[[-40.0,-40.0],[40.0,-40.0],[40.0,40.0],[-40.0,40.0]]"
    flight = fenced(tmp_path, square)
    shown_ = [Shown("a", flight, [judged(flight, one) for one in flight.stretches])]
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: drawn.__setitem__(path.name, self))
    plots.write(shown_, tmp_path / "png")
    for name in ("plan", "space"):
        axes = next(figure for path, figure in drawn.items() if name in path).axes[0]
        assert "fence" in [line.get_label() for line in axes.lines], name
        assert axes.get_xlim()[0] < -40.0 < 40.0 < axes.get_xlim()[1]


def test_json_ends_no_script() -> None:
    hostile = {"a": "</script><script>alert(1)</script><!--"}
    assert "<" not in _json(hostile)
    assert json.loads(_json(hostile)) == hostile


def test_several_logs_stand_side_by_side(log: Path, tmp_path: Path) -> None:
    other = log_of(tmp_path, make_config("law.k=0.5"), flown(9.0, lambda _: (0.0, 0.05, 0.0)))
    output, png = tmp_path / "two.html", tmp_path / "png"
    status, out, err = call("report", str(log), str(other), "-o", str(output), "--png", str(png), "--json")
    assert status == 0, err
    _, page = read_page(output)
    first, second = (one["flights"][0] for one in json.loads(out)["logs"])
    assert (first["converged_s"], second["converged_s"]) == (None, 0.0)
    cells = [cell for key, cell in page.cells if key == "all_rms_m"]
    assert cells == [f"{first['all_rms_m']:.4g}", f"{second['all_rms_m']:.4g}"]
    assert {"controls-1", "controls-2", "error"} <= set(page.json["charts"])
    assert len(page.json["charts"]["error"]["data"]) == 8
    assert "law.k" in page.text.partition("What differs between the logs")[2].partition("Not at its")[0]
    assert page.text.count("A demo") > 2
    for name in ("plan", "space", "error", "controls-1", "controls-2", "saturation", "timeline", "timing"):
        pixels = image.imread(png / f"{name}.png")
        assert min(pixels.shape[:2]) > 200
        assert pixels.std() > 0.01


def test_labels_are_short() -> None:
    flight = read_flight(ASSET)
    named = [flight._replace(path=Path(name)) for name in ("monday.mcap", "tuesday.mcap")]
    assert labels_of([flight]) == ["rover-1"]
    assert labels_of(named) == ["monday", "tuesday"]
    assert labels_of([named[0], named[0]]) == ["A rover-1", "B rover-1"]
    assert labels_of([named[0]._replace(path=Path("x" * 40)), named[1]]) == ["A rover-1", "B rover-1"]


@pytest.mark.parametrize(
    ("profile", "panels"),
    [
        ("px4-uuv", ["roll rate", "pitch rate", "yaw rate", "forward speed", "thrust"]),
        ("ardupilot-rover", ["yaw rate", "forward speed", "thrust"]),
        ("px4-plane", ["bank", "pitch", "throttle", "true airspeed"]),
        ("ardupilot-copter", ["velocity north", "velocity east", "velocity down", "yaw rate"]),
    ],
)
def test_each_class_of_vehicles_has_its_own_controls(log: Path, profile: str, panels: list[str]) -> None:
    flight = read_flight(log)
    config = load(Path(__file__).parents[1] / "deploy" / f"{profile}.toml")
    handling = {"px4-uuv": Handling.RATES, "ardupilot-rover": Handling.GROUND, "px4-plane": Handling.AIRPLANE}
    other = flight._replace(config=config, handling=handling.get(profile, Handling.VELOCITY))
    sections = sections_of([Shown("it", other, [judged(other, other.stretches[0])])])
    controls = next(section for section in sections if section.key == "controls")
    assert [panel.title.partition(" (")[0] for panel in controls.panels] == panels


# What is no flight, or not all of it -------------------------------------------------------------------


def test_a_log_that_was_cut_is_reported_on_and_marked(log: Path, tmp_path: Path) -> None:
    cut, output = tmp_path / "cut.mcap", tmp_path / "cut.html"
    cut.write_bytes(ASSET.read_bytes()[:180_000])
    status, out, err = call("report", str(cut), "-o", str(output), "--json")
    assert status == 0, err
    assert "incomplete" in err
    assert "interrupted" in json.loads(out)["logs"][0]["incomplete"]
    assert "Incomplete:" in read_page(output)[1].text
    assert json.loads(out)["logs"][0]["flights"][0]["setpoints"] > 20


def test_what_is_no_log_is_refused_with_what_it_is(log: Path, tmp_path: Path) -> None:
    empty, text, foreign, hollow = (
        tmp_path / f"{name}.mcap" for name in ("empty", "text", "foreign", "hollow")
    )
    empty.write_bytes(b"")
    text.write_text("no log at all")
    for path, payload in ((foreign, b'{"a":1}'), (hollow, None)):
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            if payload is not None:
                channel = writer.register_channel(
                    "/a", "json", writer.register_schema("a", "jsonschema", b"{}")
                )
                writer.add_message(channel, 0, payload, 0)
            writer.finish()  # type: ignore[no-untyped-call]
    older = with_session(
        log, tmp_path / "older.mcap", schema_version=0, guidance_version="0.0.7", config_json=7
    )
    for path, why in (
        (tmp_path / "none.mcap", "No such file"),
        (empty, "the file is empty"),
        (text, "does not begin as an MCAP file does"),
        (foreign, "does not begin with a session record"),
        (hollow, "does not begin with a session record"),
        (older, "schema version 0, not 1: use guidance 0.0.7, which wrote it"),
    ):
        status, out, err = call("report", str(path), "-o", str(tmp_path / "never.html"))
        assert (status, out) == (2, ""), err
        assert why in err
        assert str(path) in err
        assert "Traceback" not in err
    assert not (tmp_path / "never.html").exists()


def test_a_log_without_a_flight_says_how_far_it_came(tmp_path: Path) -> None:
    path = log_of(tmp_path, make_config(), [status("ready", 0, 10, "waits for the pilot")])
    status_, _, err = call("report", str(path), "-o", str(tmp_path / "never.html"))
    assert status_ == 1
    assert "nothing was tracked; its last state was ready (waits for the pilot)" in err


def test_where_nothing_can_be_written_it_says_so(log: Path, tmp_path: Path) -> None:
    status, _, err = call("report", str(log), "-o", str(tmp_path / "missing" / "x.html"))
    assert status == 1
    assert "cannot be written: No such file" in err
    (tmp_path / "file").write_text("")
    status, _, err = call("report", str(log), "-o", str(tmp_path / "x.html"), "--png", str(tmp_path / "file"))
    assert status == 1
    assert "cannot be written" in err
    (tmp_path / "png" / "plan.png").mkdir(parents=True)
    status, _, err = call("report", str(log), "-o", str(tmp_path / "x.html"), "--png", str(tmp_path / "png"))
    assert status == 1
    assert "is a directory, and must be a file" in err


def test_without_its_extra_the_command_says_what_to_install(
    log: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in [name for name in sys.modules if name.startswith(("plotly", "guidance.report."))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    status, _, err = call("report", str(log), "-o", str(tmp_path / "x.html"))
    assert status == 2
    assert "pip install 'se3-guidance[report]'" in err
