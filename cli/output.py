"""Where words go: data on stdout, messages on stderr."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from tactile_toolkit.checked_fields import switch
from tactile_toolkit.wording import printable, printable_json

BYTES = "bytes"
"""A unit of progress: counts are sizes."""

# Where no terminal is, lines stay: a job of a day writes some 17,000 of them, 1 MB of log.
_LINE_INTERVAL_S = 5.0
_BAR_INTERVAL_S = 0.1
_BAR = 24
_GAP = "  "


@dataclass(frozen=True, slots=True)
class Sink:
    """What a command prints with; a command that takes one has the options ``--json`` and ``--quiet``.

    ``--json`` stands for one document on stdout and no tables, ``--quiet`` for no progress and no tables.
    """

    as_json: bool = switch(False, name="--json", help="Print one JSON document on stdout.")
    quiet: bool = switch(False, name="--quiet -q", help="Print neither progress nor tables, only errors.")

    def document(self, content: Any) -> None:
        """Print the JSON document of the command, when one was asked for."""
        if self.as_json:
            sys.stdout.write(printable_json(content) + "\n")

    def line(self, text: str = "") -> None:
        """Print a line of the result."""
        if not (self.as_json or self.quiet):
            sys.stdout.write(printable(text, keep="\n") + "\n")

    def info(self, text: str) -> None:
        """Say something on stderr."""
        if not self.quiet:
            self.warn(text)

    def warn(self, text: str) -> None:
        """Say something on stderr to those too who want to hear nothing else, such as what is damaged."""
        sys.stderr.write(printable(text, keep="\n") + "\n")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], title: str = "") -> None:
        """Print a table of the result."""
        if title:
            self.line(title)
        if not rows:
            return
        is_number = [isinstance(cell, (int, float)) and not isinstance(cell, bool) for cell in rows[0]]
        cells = [[printable(_cell(cell)).rstrip() for cell in row] for row in rows]
        # Piped into a file, a table keeps its columns, however wide.
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize
        # The words of a header stand under one another before the columns do.
        for above in ([header], list(zip_longest(*map(str.split, header), fillvalue=""))):
            widths = [max(map(len, column)) for column in zip(*above, *cells, strict=True)]
            if sum(widths) + len(_GAP) * (len(widths) - 1) <= width:
                rule = _GAP.join("─" * wide for wide in widths)
                body = [_aligned(row, widths, is_number) for row in cells]
                self.line("\n".join([*(_aligned(row, widths, is_number) for row in above), rule, *body]))
                return
        wide = max(map(len, header)) + 2
        for row in cells:
            for name, cell in zip(header, row, strict=True):
                label = f"  {name}" if name != header[0] else name
                self.line(textwrap.fill(f"{label:<{wide}} {cell}", width, subsequent_indent=" " * (wide + 1)))

    @contextmanager
    def progress(self, what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
        """Show progress: a bar on a terminal, a line every few seconds elsewhere.

        Yields
        ------
        callable
            Takes the number of items done so far and the number in all.
        """
        start_s = last_s = time.monotonic()
        is_bar = sys.stderr.isatty()
        interval_s = _BAR_INTERVAL_S if is_bar else _LINE_INTERVAL_S

        def update(done: int, total: int) -> None:
            nonlocal last_s
            now_s = time.monotonic()
            # The last one always: a log that ends at 80 % looks like work that was stopped.
            if self.quiet or not done or (done < total and now_s - last_s < interval_s):
                return
            last_s = now_s
            state = f"{what}: {_state(done, total, unit, now_s - start_s)}"
            if is_bar:
                bar = f"{'━' * (_BAR * done // total):<{_BAR}} {state}"
                sys.stderr.write(f"\r{bar[: shutil.get_terminal_size().columns - 1]}\x1b[K")
                sys.stderr.flush()
            else:
                self.info(state)

        try:
            yield update
        finally:
            if is_bar and last_s > start_s:
                sys.stderr.write("\n")


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "-"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _aligned(row: Sequence[str], widths: Sequence[int], is_number: Sequence[bool]) -> str:
    cells = [
        cell.rjust(width) if right else cell.ljust(width)
        for cell, width, right in zip(row, widths, is_number, strict=True)
    ]
    return _GAP.join(cells).rstrip()


def _state(done: int, total: int, unit: str, elapsed_s: float) -> str:
    """Write how far work is: counts, the rate over all the time, and the time left."""
    # Shards come in bursts: the rate of the last seconds would jump.
    amount = bytes_text if unit == BYTES else "{:,}".format
    left = duration_text(elapsed_s / done * (total - done))
    return f"{amount(done)} of {amount(total)}, {rate_text(done, elapsed_s, unit)}, {left} left"


def rate_text(done: int, elapsed_s: float, unit: str) -> str:
    """Write how fast it goes, in numbers that can be read: ``"12 digits/s"``, ``"3.0 pictures/min"``."""
    rate, per = done / max(elapsed_s, 1e-9), "s"
    if unit == BYTES:
        return f"{bytes_text(rate)}/s"
    for longer in ("min", "h"):
        if rate < 1:
            rate, per = 60 * rate, longer
    # Two digits are enough: from 9.95 on a decimal would make three of them.
    return f"{rate:,.0f} {unit}/{per}" if rate >= 9.95 else f"{rate:.1f} {unit}/{per}"


def bytes_text(size: float) -> str:
    """Write a size for people: ``"12.3 MB"``."""
    if size < 999.5:
        return f"{size:.0f} B"
    for unit in ("kB", "MB"):
        size /= 1000
        if size < 999.95:  # what would round to 1000.0 is one of the next unit
            return f"{size:.1f} {unit}"
    return f"{size / 1000:.1f} GB"


def duration_text(seconds: float) -> str:
    """Write a duration for people: ``"1 min 20 s"``."""
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def flat_lines(values: Any, path: str = "") -> list[str]:
    """Lay out nested values as lines of dotted names, in words."""
    if isinstance(values, dict) and values:
        inner = values.items()
    elif isinstance(values, list) and any(isinstance(value, (dict, list)) for value in values):
        inner = dict(enumerate(values, 1)).items()
    else:
        return [f"{path} = {_in_words(values)}"]
    return [line for key, value in inner for line in flat_lines(value, f"{path}.{key}".lstrip("."))]


def _in_words(value: Any) -> str:
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, list):
        return ", ".join(map(_in_words, value))
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
