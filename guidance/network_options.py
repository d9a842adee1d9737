"""Options that every command which joins a zenoh network has."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Connect = Annotated[
    list[str] | None, typer.Option(metavar="LOCATOR", help="Where to connect to (repeatable).")
]
Listen = Annotated[list[str] | None, typer.Option(metavar="LOCATOR", help="Where to listen (repeatable).")]
ZenohFile = Annotated[
    Path | None,
    typer.Option(
        "--config", "-c", metavar="FILE", help="A zenoh configuration (json5) in place of the others."
    ),
]
