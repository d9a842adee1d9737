"""The manners of every command: help, exit status, JSON, pipes, Ctrl-C, completion."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pytest
import typer
import typer.main
from typer.core import TyperGroup

from guidance import cli as guidance_cli
from guidance import completion
from guidance.entry import enter
from guidance.mavlink.profiles import PROFILES
from sitl import cli as sitl_cli
from sitl.fuzzing.run import DOORS
from tests.helpers import DEMO
from tests.page_words import every_key

PAGE: Final = (Path(__file__).parents[1] / "docs" / "command-line.md").read_text(encoding="utf-8")
PROGRAMS: Final = {"guidance": guidance_cli, "sitl": sitl_cli}
PATIENCE_S: Final = 50.0
#: What has no result of its own, but runs until it is told to end.
SERVERS: Final = {"guidance run", "guidance foxglove", "guidance dashboard", "sitl vehicle"}


def found(name: str, group: Any) -> Iterator[tuple[str, Any]]:
    """Every command below, by its whole name."""
    for verb, command in group.commands.items():
        yield f"{name} {verb}", command
        if isinstance(command, TyperGroup):
            yield from found(f"{name} {verb}", command)


COMMANDS: Final = {
    name: command
    for program, module in PROGRAMS.items()
    for name, command in found(program, typer.main.get_command(module.app))
}
EACH: Final = pytest.mark.parametrize("name", COMMANDS)


def call(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: str
) -> tuple[int, str, str]:
    """The program's own entry point, in this process: exit status, stdout, stderr."""
    monkeypatch.setattr(sys, "argv", list(words))
    with pytest.raises(SystemExit) as ended:
        PROGRAMS[words[0]].main()
    assert isinstance(ended.value.code, int)
    said = capsys.readouterr()
    return ended.value.code, said.out, said.err


@EACH
def test_help_teaches_by_examples_and_names_the_exit_status(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--help", "-h"):
        status, out, err = call(monkeypatch, capsys, *name.split(), option)
        assert (status, err) == (0, "")
        text = " ".join(out.split())
        assert f"Usage: {name} " in text
        assert re.search(r"Exit status \d+ ", text)
        assert re.search(rf"Examples?: {name}( |$)", text), text


@EACH
def test_a_wrong_option_is_one_line_on_stderr_that_says_where_to_look(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = call(monkeypatch, capsys, *name.split(), "--nosuchoption")
    assert (status, out) == (2, "")
    assert err.startswith(f"{name.split()[0]}: No such option: --nosuchoption")
    assert err.endswith(f"; see {name} --help\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_wrong_command_is_refused_and_none_is_told_what_there_is(
    program: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = call(monkeypatch, capsys, program, "nosuch")
    assert (status, out, err) == (2, "", f"{program}: No such command 'nosuch'; see {program} --help\n")
    status, out, err = call(monkeypatch, capsys, program)
    assert (status, out) == (2, "")
    assert err.startswith(f"Usage: {program} ")


@EACH
def test_what_has_a_result_gives_it_as_json_too(name: str) -> None:
    options = {option for parameter in COMMANDS[name].params for option in parameter.opts}
    assert ("--json" in options) is (name not in SERVERS)


@EACH
def test_the_page_knows_every_command(name: str) -> None:
    assert f"| `{name}` |" in PAGE


def test_every_status_is_on_the_page() -> None:
    told = set(re.findall(r"^\| (\d+) \|", PAGE, re.MULTILINE))
    assert told == {"0", "1", "2", "130", "141"}


def a_command(raised: BaseException | None, returned: object = None) -> typer.Typer:
    app = typer.Typer()

    @app.command()
    def only() -> object:
        if raised is not None:
            raise raised
        return returned

    return app


@pytest.mark.parametrize(
    ("raised", "status", "says"),
    [
        (None, 0, ""),
        (typer.Exit(0), 0, ""),
        (typer.Exit(1), 1, ""),
        (KeyboardInterrupt(), 130, ""),
        (typer.Abort(), 130, ""),
        (typer.BadParameter("it is wrong."), 2, "program: Invalid value: it is wrong; see program --help\n"),
        (OSError(28, "No space left on device"), 1, "program: [Errno 28] No space left on device\n"),
        (BrokenPipeError(32, "Broken pipe"), 141, ""),
    ],
)
def test_every_end_has_its_status_and_its_line(
    raised: BaseException | None,
    status: int,
    says: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["program"])
    with pytest.raises(SystemExit) as ended:
        enter(a_command(raised), "program")
    assert ended.value.code == status
    assert capsys.readouterr().err == says


def started(name: str, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    program, *verb = name.split()
    command = [sys.executable, "-m", program, *verb, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.Popen(command, text=True, start_new_session=True, **pipes)


def test_a_reader_that_goes_away_ends_it_quietly() -> None:
    """As in a pipe to head."""
    ways = {
        ("guidance watch", ("--no-multicast",)): 0,
        ("guidance run", ("--help",)): 141,
        ("sitl faults", ("--list",)): 141,
        ("sitl paper", ("--figure", "1", "--step", "0.1", "--json")): 141,
    }
    reader, pipe = os.pipe()
    os.close(reader)
    running = [
        (started(name, *arguments, stdout=pipe), name, status) for (name, arguments), status in ways.items()
    ]
    os.close(pipe)
    for process, name, status in running:
        with process:
            assert process.stderr is not None
            assert process.stderr.read() == "", name
            assert process.wait(PATIENCE_S) == status, name


def interrupted(process: subprocess.Popen[str], after: str) -> tuple[int, str]:
    """Ctrl-C reaches the whole group of a terminal; the status, and what was said."""
    assert process.stderr is not None
    said = ""
    while after not in said:
        line = process.stderr.readline()
        assert line, said
        said += line
    os.killpg(process.pid, signal.SIGINT)
    said += process.communicate(timeout=PATIENCE_S)[1]
    return process.returncode, said


def test_ctrl_c_ends_what_waits_with_130_and_no_trace(tmp_path: Path) -> None:
    quiet = f'log.directory="{tmp_path}"'
    listening = ("--set", "link.connection=udpin://127.0.0.1:0", "--set", quiet)
    with started("guidance check", "-c", str(DEMO), "--seconds", "50", *listening) as process:
        assert interrupted(process, "looking for at most 50 s") == (
            130,
            "guidance check: looking for at most 50 s\n",
        )


WORKING: Final = """
import sys, time
from sitl.workers import workers
def work(number):
    sys.stderr.write("working\\n")
    time.sleep(300.0)
try:
    with workers(2) as pool:
        for job in [pool.submit(work, number) for number in range(9)]:
            job.result()
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_ctrl_c_ends_the_processes_that_share_the_work() -> None:
    command = [sys.executable, "-c", WORKING]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert interrupted(process, "working")[0] == 130


def completed(words: Sequence[str], incomplete: str, program: str = "guidance") -> list[str]:
    """As fish asks, and bash where nothing is split."""
    whole = " ".join([program, *words, incomplete])
    environment = {
        **os.environ,
        f"_{program.upper()}_COMPLETE": "complete_bash",
        "COMP_WORDS": whole,
        "COMP_CWORD": str(len(words) + 1),
    }
    outcome = subprocess.run(
        [sys.executable, "-m", program], env=environment, capture_output=True, text=True, check=True
    )
    return outcome.stdout.split()


def test_the_shell_completes_commands_options_and_values() -> None:
    assert sorted(completed([], "re")) == ["replay", "report"]
    assert completed(["replay", "--set"], "law.k") == ["law.k="]
    assert completed(["run"], "--co") == ["--config"]
    assert completed(["run", "--set"], "law.rho") == ["law.rho2_per_s=", "law.rho3_per_s="]
    assert completed(["command", "uuv-1"], "h") == ["hold"]
    assert completed(["command", "uuv-1", "allocate"], "roll") == ["roll-pitch", "roll-yaw"]
    assert completed(["vehicle", "--firmware"], "px4-r", "sitl") == ["px4-rover"]
    assert completed(["fuzz", "--door"], "", "sitl") == list(DOORS)


def test_settings_complete_to_keys_and_to_the_words_that_they_take() -> None:
    known = completion.keys()
    assert known.keys() == every_key().keys() - {"law.error_function"}  # a table, by itself
    assert completion.setting("vehicle.prof") == ["vehicle.profile="]
    assert completion.setting("vehicle.profile=") == [f"vehicle.profile={name}" for name in PROFILES]
    assert completion.setting("trajectory.name=h") == ["trajectory.name=helix"]
    assert completion.setting("law.error_function.name=b") == [
        "law.error_function.name=bounded",
        "law.error_function.name=bounded-apart",
    ]
    assert completion.setting("zenoh.commands=") == ["zenoh.commands=true", "zenoh.commands=false"]
    assert completion.setting("law.k=") == completion.setting("nosuch.key=") == []
    assert completion.trajectory("l") == ["line", "lemniscate"]


@pytest.mark.parametrize("words", [["report"], ["replay"], ["replay", "--config"], ["run", "--config"]])
def test_files_are_left_to_the_shell(words: list[str], tmp_path: Path) -> None:
    """It completes files, and knows what a directory is, where the program offers nothing."""
    (tmp_path / "flight.mcap").write_bytes(b"")
    assert completed(words, f"{tmp_path}/") == []


@pytest.mark.parametrize("verb", [["report"], ["replay"], ["replay", "--set", "law.k=1"]])
def test_what_is_no_log_is_one_line_for_person_and_journal(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hostile = tmp_path / "a\x1b[2J\nb.mcap"
    status, out, err = call(monkeypatch, capsys, "guidance", *verb, str(hostile))
    assert (status, out) == (2, "")
    assert err.startswith("guidance: ")
    assert err.count("\n") == 1
    assert "\x1b" not in err


@pytest.mark.parametrize("arguments", ["fuzz --inputs 20 --json", "faults --only reboot --json"])
def test_json_alone_is_on_stdout_and_words_are_on_stderr(arguments: str) -> None:
    with started("sitl", *arguments.split()) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    json.loads(out)
    assert process.returncode == 0, err
    assert "\x1b" not in err
