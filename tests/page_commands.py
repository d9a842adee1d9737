"""Every command on a page: run by a test in test_readme, or not, and why."""

from __future__ import annotations

import shlex

from tests.pages import PAGES, commands_of

#: Each once, though some stand on two pages.
COMMANDS = list(dict.fromkeys(command for page in PAGES for command in commands_of(page)))
INSTALL_AND_FLY = "python3 -m venv .venv && .venv/bin/pip install -q . && .venv/bin/guidance demo"
INSTALL_AND_SEE = (
    "python3 -m venv .venv && .venv/bin/pip install -q '.[dashboard]' && .venv/bin/guidance demo --dashboard"
)
INSTALL_AND_TEST = (
    "python3 -m venv .venv && .venv/bin/pip install -q -e '.[test]' && .venv/bin/python -m pytest -n 2"
)
MAKE_A_KEY = "(umask 077 && openssl rand -hex 32 > signing.key)"
FLOWN = (
    ".venv/bin/sitl vehicle --firmware px4-uuv --to 127.0.0.1:14540",
    ".venv/bin/guidance run --config deploy/px4-uuv.toml --set supervisor.engage=auto "
    "--set supervisor.arm=true",
)


def starting(*beginnings: str) -> list[str]:
    """The commands that begin so."""
    return [command for command in COMMANDS if command.startswith(beginnings)]


DEMOS = starting(".venv/bin/guidance demo")
REPORTS = starting(".venv/bin/guidance report")
COMPARISONS = [c for c in starting(".venv/bin/guidance replay") if " --config " in c or " --set " in c]
REPLAYS = [c for c in starting(".venv/bin/guidance replay") if c not in COMPARISONS]
CHECKS = starting(".venv/bin/guidance check")
TUNES = starting(".venv/bin/guidance tune")
WATCHES = starting(".venv/bin/guidance watch")
PAPER = starting(".venv/bin/sitl paper")
ORDERS = starting(".venv/bin/guidance command")
FOXGLOVE = starting(".venv/bin/guidance foxglove")
DASHBOARDS = starting(".venv/bin/guidance dashboard")
BENCH_CAMPAIGN = ".venv/bin/sitl bench campaign"
CAMPAIGNS = starting(".venv/bin/sitl campaign")
SCENARIOS = starting(".venv/bin/sitl scenarios")
FUZZ = starting(".venv/bin/sitl fuzz")
ON_THE_VEHICLE = starting("sudo ", "systemctl ")
#: What a page has copied, by the copy's name: later commands name that.
COPIED = {copy: original for original, copy in (shlex.split(line)[1:] for line in starting("cp "))}
#: Run in test_readme, in its process or as processes, with less to do where they would take minutes.
RUN = [
    *(*DEMOS, *REPLAYS, *CHECKS, *TUNES, *WATCHES, *PAPER, *ORDERS, *FOXGLOVE, *CAMPAIGNS, *SCENARIOS, *FUZZ),
    *(*DASHBOARDS, *FLOWN, MAKE_A_KEY, ".venv/bin/sitl bench"),
    *(*REPORTS, *COMPARISONS),  # these in test_report_commands
]
#: Not run here: why. Those of our own programs are parsed by them, with the files and keys that they name.
NOT_RUN = {
    INSTALL_AND_FLY: "installs; the demo flies in test_demo, and the line is .ci/run's way to begin",
    INSTALL_AND_SEE: "installs; the demo's page is flown in test_demo_page",
    INSTALL_AND_TEST: "runs these tests; .ci/run ends with this very line",
    ".ci/run": "runs these tests",
    BENCH_CAMPAIGN: "minutes; parts of it in test_bench_campaign",
    ".venv/bin/sitl bench latency": "a minute and MAVSDK; parts of it in test_bench_latency",
    ".venv/bin/sitl bench loop": "minutes; parts of it in test_bench_loop",
    ".venv/bin/sitl bench link": "minutes; parts of it in test_bench_link",
    ".venv/bin/sitl faults": "a minute; each fault is a test of its own in test_faults",
    ".venv/bin/sitl faults --ships": "minutes; every fourth fault of each profile in test_faults_profiles",
    ".venv/bin/sitl faults --real": "minutes; parts of it in test_faults_real",
    **dict.fromkeys(
        starting("cp "), "copied in test_first_flight; in other tests the original stands for it"
    ),
    **dict.fromkeys(ON_THE_VEHICLE, "installs as root; what it copies is copied, the rest held to the unit"),
    **dict.fromkeys(
        [c for c in starting(".venv/bin/sitl vehicle", ".venv/bin/guidance run") if c not in FLOWN],
        "runs until it is ended; pairs fly in test_readme, test_first_flight; options: test_vehicle_process",
    ),
}


def words(command: str) -> list[str]:
    """The arguments after the program; a file that was copied is the one that it was copied from."""
    return [COPIED.get(word, word) for word in shlex.split(command)[1:]]
