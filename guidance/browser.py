"""A page opened in the browser of this screen."""

from __future__ import annotations

import sys
import threading
import webbrowser
from collections.abc import Callable, Mapping


def open_page(url: str, environment: Mapping[str, str], say: Callable[[str], None]) -> None:
    """In a browser of this screen; without a screen a text browser would take the terminal.

    It returns at once: some browsers come back only when they are closed, and what serves the page may be the
    caller. `say` is told what is wrong, if need be in a thread.
    """
    if sys.platform == "linux" and not (environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")):
        say("--open: there is no display here; open the page in any browser that reaches this machine")
    else:
        threading.Thread(target=_browse, args=(url, say), name="browser", daemon=True).start()


def _browse(url: str, say: Callable[[str], None]) -> None:
    try:
        found = webbrowser.open(url)
    except webbrowser.Error:  # BROWSER names what is not there
        found = False
    if not found:
        say("--open: no browser found; open the page by hand")
