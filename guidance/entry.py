"""How every command ends: its exit status, and one line on stderr where something is wrong.

0 it is done, 1 it did not work out, 2 wrong usage or configuration, 130 after Ctrl-C, 141 if whoever read its
output went away.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn, cast

import typer

from guidance.journal import tell
from guidance.records import Level

if TYPE_CHECKING:
    from guidance.replacing import Fill

DONE: Final = 0
FAILED: Final = 1
WRONG: Final = 2
#: 128 + SIGINT and 128 + SIGPIPE, as a shell says of what these signals end.
INTERRUPTED: Final = 130
UNREAD: Final = 141

#: What is wrong with options and arguments; typer brings click along under various names.
_UsageError: Final = cast(type[Exception], typer.BadParameter.__bases__[0])


def complain(program: str, text: object) -> None:
    """One line on stderr: what is wrong, and what to do."""
    tell(Level.ERROR, program, text)


def refused(program: str, text: object) -> typer.Exit:
    """To be raised where usage or configuration is wrong."""
    complain(program, text)
    return typer.Exit(WRONG)


def failed(program: str, text: object) -> typer.Exit:
    """To be raised where it did not work out."""
    complain(program, text)
    return typer.Exit(FAILED)


@contextmanager
def output_file(program: str, path: Path) -> Iterator[Fill]:
    """What fills the file: see `replacing`, whose errors become exits. A log in its place is wrong usage;
    what cannot be written has failed."""
    from guidance.replacing import LogInTheWayError, replacing

    with ExitStack() as files:
        try:
            fill = files.enter_context(replacing(path))
        except LogInTheWayError as error:
            raise refused(program, error) from None
        except ValueError as error:
            raise failed(program, error) from None

        def filled(write: Callable[[Path], object]) -> None:
            try:
                fill(write)
            except OSError as error:
                raise failed(program, error) from None

        yield filled


def enter(app: typer.Typer, program: str) -> NoReturn:
    """Run the command that the process was started with, and end the process."""
    try:
        status = app(standalone_mode=False, prog_name=program)
        sys.stdout.flush()
    except _UsageError as error:
        _tell_usage(program, error)
        status = WRONG
    except typer.Abort:
        status = INTERRUPTED
    except OSError as error:
        status = _of_system(program, error)
    except SystemExit as leaving:  # typer ends the process for a pipe that nobody reads
        if not isinstance(leaving.__context__, BrokenPipeError):
            raise
        status = _of_system(program, leaving.__context__)
    sys.exit(status if isinstance(status, int) else DONE)


def _tell_usage(program: str, error: Exception) -> None:
    message = getattr(error, "format_message", error.__str__)()
    if message.startswith("Usage:"):  # there were no arguments at all, and this is the help
        sys.stderr.write(message + "\n")
    elif message:
        path = getattr(getattr(error, "ctx", None), "command_path", program)
        complain(program, f"{message.rstrip('.')}; see {path} --help")


def _of_system(program: str, error: OSError) -> int:
    """Such as a full disk under stdout."""
    if not isinstance(error, BrokenPipeError):
        complain(program, error)
    try:
        sys.stdout.flush()
    except OSError:  # and once more when the interpreter ends, unless it goes elsewhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return UNREAD if isinstance(error, BrokenPipeError) else FAILED
