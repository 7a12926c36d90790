"""Progress of long work on stderr: a bar on a terminal, a line every few seconds elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tactile_toolkit import wording

# Without a terminal, each line is kept: a job of one day writes about 17,000 of them, 1 MB of log.
_LINE_INTERVAL_S = 5.0
_BAR_INTERVAL_S = 0.1
_BAR = 24


@contextmanager
def shown_progress(what: str, unit: str, quiet_s: float = 0.0) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of some work, and nothing if it ends within ``quiet_s`` seconds.

    Yields
    ------
    callable
        Takes the number of finished items and the total number.
    """
    start_s = time.monotonic()
    last_s = None
    is_bar = sys.stderr.isatty()
    interval_s = _BAR_INTERVAL_S if is_bar else _LINE_INTERVAL_S

    def update(done: int, total: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        is_due = now_s - (last_s or start_s) >= interval_s
        # The last update is always shown: a log that ends at 80 % looks like interrupted work.
        if not done or (done < total and not is_due) or now_s - start_s < quiet_s:
            return
        last_s = now_s
        state = wording.printable(f"{what}: {_state(done, total, unit, now_s - start_s)}")
        if is_bar:
            bar = f"{'━' * (_BAR * done // total):<{_BAR}} {state}"
            sys.stderr.write(f"\r{bar[: shutil.get_terminal_size().columns - 1]}\x1b[K")
        else:
            sys.stderr.write(f"{state}\n")
        sys.stderr.flush()

    try:
        yield update
    finally:
        if is_bar and last_s is not None:
            sys.stderr.write("\n")


def _state(done: int, total: int, unit: str, elapsed_s: float) -> str:
    """Return the progress as text: counts, the mean rate, and the time left."""
    # Shards come in bursts: the rate of the last seconds would jump.
    amount: Callable[[int], str] = "{:,}".format
    if unit == wording.BYTES:
        amount = wording.bytes_text
    left = wording.duration_text(elapsed_s / done * (total - done))
    return f"{amount(done)} of {amount(total)}, {wording.rate_text(done, elapsed_s, unit)}, {left} left"
