"""What ``starstruck`` says while it is tried whether the fullest scene has room."""

from __future__ import annotations

import time
from collections.abc import Callable

from cli.output import Sink

__all__ = ["tells_of_failures"]

_INTERVAL_S = 2.0


def tells_of_failures(sink: Sink) -> Callable[[int, int], None]:
    """Return a function that is told of each layout that failed, and says so every few seconds."""
    last_s = time.monotonic()

    def tell(failed: int, allowed: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if now_s - last_s >= _INTERVAL_S:
            last_s = now_s
            sink.talk(f"trying whether the fullest scene has room: {failed:,} of {allowed:,} layouts failed")

    return tell
