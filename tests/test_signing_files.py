"""The key is read only where nobody else can, and the signing clock outlives the process and its battery."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path
from typing import Final

import pytest

from guidance.config import ConfigError
from guidance.mavlink.signing import TIMESTAMP_MAX, Signing, SigningClock, wall_timestamp
from guidance.signing_files import RESERVE, SET_ANEW, ClockKeeper, clock_path, open_signing, read_key
from tests.helpers import make_config

KEY: Final = bytes(range(32))
TODAY_NS: Final = 1_790_000_000_000_000_000
TODAY: Final = wall_timestamp(TODAY_NS)
STREAMS: Final = ((1, 1, 0, TODAY),)


def key_file(directory: Path, content: bytes = KEY, mode: int = 0o600) -> Path:
    path = directory / "signing.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


# The key -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\r\n", b" " + KEY.hex().encode() + b"\n"],
)
def test_a_key_is_32_bytes_or_64_hex_digits(content: bytes, tmp_path: Path) -> None:
    assert read_key(key_file(tmp_path, content)) == KEY


@pytest.mark.parametrize(
    "content",
    [b"", KEY[:-1], KEY + b"\n", KEY.hex().encode()[:-1], b"g" * 64, b"\xff" * 64, KEY * 5],
    ids=["empty", "31", "33", "63 digits", "no hex", "no text", "160"],
)
def test_another_length_is_refused(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"must hold 32 bytes or 64 hex digits.*openssl rand -hex 32"):
        read_key(key_file(tmp_path, content))


@pytest.mark.parametrize("content", [bytes(32), b"0" * 64])
def test_a_key_of_zeros_is_no_key(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="zeros means no signing"):
        read_key(key_file(tmp_path, content))


def test_only_the_owner_may_read_or_write_it(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    for mode in range(0o400, 0o1000):
        path.chmod(mode)
        if mode & 0o077:
            with pytest.raises(ConfigError, match=f"signing.key.*mode {mode:o}.*chmod 600 {path}"):
                read_key(path)
        else:
            assert read_key(path) == KEY


def test_a_credential_of_systemd_may_show_permissions_of_a_group(tmp_path: Path) -> None:
    path = key_file(tmp_path, mode=0o440)
    assert read_key(path, {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == KEY
    for elsewhere in (str(tmp_path / "other"), ""):
        with pytest.raises(ConfigError, match="chmod 600"):
            read_key(path, {"CREDENTIALS_DIRECTORY": elsewhere})
    path.chmod(0o444)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_key(path, {"CREDENTIALS_DIRECTORY": str(tmp_path)})


@pytest.mark.parametrize(("owner", "taken"), [(0, True), (1000, True), (1001, False)])
def test_it_belongs_to_us_or_to_root(
    owner: int, taken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = key_file(tmp_path)
    found = os.stat(path)
    owned = os.stat_result((*found[:4], owner, *found[5:]))
    monkeypatch.setattr("guidance.signing_files.os.fstat", lambda descriptor: owned)
    monkeypatch.setattr("guidance.signing_files.os.geteuid", lambda: 1000)
    if taken:
        assert read_key(path) == KEY
    else:
        with pytest.raises(ConfigError, match=r"belongs to user 1001.*chown 1000"):
            read_key(path)


@pytest.mark.parametrize("kind", ["fifo", "directory", "device", "missing", "nul"])
def test_what_is_no_file_is_refused_and_not_waited_for(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "key"
    if kind == "fifo":
        os.mkfifo(path, 0o600)
    elif kind == "directory":
        path.mkdir(0o700)
    elif kind == "device":
        path = Path("/dev/zero")
    elif kind == "nul":
        path = Path("a\0b")
    with pytest.raises(ConfigError, match=r"link\.signing_key_file = .*(regular file|cannot be read)"):
        read_key(path)


def test_without_a_key_nothing_is_signed_or_kept() -> None:
    assert open_signing(make_config()) is None


# The clock ---------------------------------------------------------------------------------------------


def keeper(path: Path, clock: SigningClock | None = None) -> ClockKeeper:
    signing = Signing(KEY, 0)
    if clock is not None:
        signing.set(clock, 0)
    return ClockKeeper(signing, path)


def test_it_is_kept_whole_and_for_us_alone(tmp_path: Path) -> None:
    path = tmp_path / "state" / "guidance" / "signing-uuv-1.json"
    kept = keeper(path, SigningClock(TODAY, STREAMS))
    kept.close(5.0)
    assert not kept.problem
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert keeper(path).begin(TODAY_NS + 1_000_000_000) == SigningClock(TODAY + 100_000, STREAMS)


@pytest.mark.parametrize("wall_ns", [0, -5, TODAY_NS - 86_400_000_000_000])
def test_a_clock_without_a_battery_goes_on_where_it_was(wall_ns: int, tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    keeper(path, SigningClock(TODAY, STREAMS)).close(5.0)
    assert keeper(path).begin(wall_ns) == SigningClock(TODAY + RESERVE, STREAMS)


def test_the_first_time_it_is_the_wall_clocks(tmp_path: Path) -> None:
    first = keeper(tmp_path / "none.json")
    assert first.begin(TODAY_NS) == SigningClock(TODAY)
    assert first.begin(0) == SigningClock(0)
    assert not first.problem


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff",
        b"[]",
        b"[" * 9000,
        b'{"timestamp": -1}',
        b'{"timestamp": 281474976710656}',
        b'{"timestamp": 1, "streams": [[1, 1, 0, -1]]}',
        b'{"timestamp": 1, "streams": [[1]]}',
    ],
)
def test_a_damaged_file_is_told_and_replaced(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    path.write_bytes(content)
    damaged = keeper(path)
    clock = damaged.begin(TODAY_NS)
    assert clock == SigningClock(TODAY)
    assert "clock.json cannot be used" in damaged.problem
    damaged.signing.set(clock, 0)
    damaged.close(5.0)
    assert keeper(path).begin(0).timestamp == TODAY + RESERVE


def test_a_timestamp_at_its_end_stays_there(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    keeper(path, SigningClock(TIMESTAMP_MAX)).close(5.0)
    assert keeper(path).begin(0).timestamp == TIMESTAMP_MAX


def test_a_wall_clock_that_is_set_later_is_followed_and_only_forward() -> None:
    running = keeper(Path("unused"), SigningClock(TODAY))
    step_ns = (SET_ANEW + 1) * 10_000
    assert running.set_anew(TODAY_NS + step_ns) == SigningClock(TODAY + SET_ANEW + 1)
    for offset_ns in (-10 * step_ns, 0, step_ns - 10_000):
        assert running.set_anew(TODAY_NS + offset_ns) is None


def test_a_directory_that_cannot_be_written_is_told_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    stuck = keeper(tmp_path / "file" / "clock.json", SigningClock(TODAY))
    stuck.close(5.0)
    assert "cannot be written" in stuck.problem


def test_a_disk_that_hangs_holds_up_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    released, syncing = threading.Event(), threading.Event()

    def hang(descriptor: int) -> None:
        syncing.set()
        released.wait(20.0)

    monkeypatch.setattr("guidance.signing_files.os.fsync", hang)
    hanging = keeper(tmp_path / "clock.json", SigningClock(TODAY))
    hanging.keep()
    assert syncing.wait(20.0)
    threads = threading.active_count()
    for timestamp in range(TODAY + 1, TODAY + 10):
        hanging.signing.set(SigningClock(timestamp), 0)
        hanging.keep()
    hanging.close(0.01)
    assert threading.active_count() == threads
    released.set()
    hanging.close(20.0)
    assert keeper(tmp_path / "clock.json").begin(0).timestamp == TODAY + 9 + RESERVE


@pytest.mark.parametrize(
    ("environ", "path"),
    [
        ({"STATE_DIRECTORY": "/var/lib/guidance/a"}, "/var/lib/guidance/a/signing-uuv-1.json"),
        ({"STATE_DIRECTORY": "/a:/b", "XDG_STATE_HOME": "/c"}, "/a/signing-uuv-1.json"),
        ({"XDG_STATE_HOME": "/c"}, "/c/guidance/signing-uuv-1.json"),
    ],
)
def test_the_state_directory_is_systemds_or_the_users(environ: dict[str, str], path: str) -> None:
    assert clock_path("uuv-1", environ) == Path(path)


def test_else_it_is_in_the_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/u")
    for environ in ({}, {"XDG_STATE_HOME": "relative"}):
        assert clock_path("x", environ) == Path("/home/u/.local/state/guidance/signing-x.json")
