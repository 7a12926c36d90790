"""Where words go: data on stdout, talk on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cli.options import Json, Quiet
from tactile_toolkit.printable import printable, printable_json

if TYPE_CHECKING:
    from rich.table import Table


BYTES = "bytes"
"""A unit of progress: counts are sizes."""

_PLAIN_INTERVAL_S = 5.0
"""Where no terminal is, lines stay: a job of a day writes some 17,000 of them, 1 MB of log."""
_SPANS_S = (("s", 1), ("min", 60))
_SENTENCE = 24
"""Cells of a table that are longer may be folded between words."""


@dataclass(frozen=True, slots=True)
class Sink:
    """What a command prints with; a command that takes one has the options ``--json`` and ``--quiet``.

    ``--json`` stands for one document on stdout and no tables, ``--quiet`` for no progress and no tables.
    """

    as_json: Json = False
    quiet: Quiet = False

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
        if self.as_json or self.quiet:
            return
        if not rows:
            sys.stdout.write(f"{printable(title)}\n" if title else "")
            return
        from rich.console import Console
        from rich.text import Text

        console = Console(file=sys.stdout)
        # Piped into a file, a table keeps its columns instead of being folded at 80 characters.
        console.width = console.width if console.is_terminal else 160
        header = [printable(name) for name in header]
        texts = [[f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in row] for row in rows]
        cells = [[printable(text, keep="\n") for text in row] for row in texts]
        widths = _widths(header, cells, console.width - 3 * len(header) + 1)
        # Rendered here and written as all else is: rich has an exit of its own for a closed pipe.
        with console.capture() as written:
            if title:
                console.print(Text(printable(title)))  # as Text: rich obeys marks, such as [/b0]
            if widths is None:
                console.print(_records(header, cells))
            else:
                right = [isinstance(sample, (int, float)) for sample in rows[0]]
                console.print(_grid(header, cells, widths, right))
        sys.stdout.write(written.get())

    @contextmanager
    def progress(self, what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
        """Show progress: a bar on a terminal, a line every few seconds elsewhere.

        Yields
        ------
        callable
            Takes the number of items done so far and the number in all.
        """
        if self.quiet:
            yield lambda _done, _total: None
        elif sys.stderr.isatty():
            with _bar(what, unit) as update:
                yield update
        else:
            yield _plain_lines(self.info, what, unit)


def _widths(header: Sequence[str], rows: Sequence[Sequence[str]], room: int) -> list[int] | None:
    """Return the widths of columns that break no word and no short cell; None where there is no room."""
    columns = [[name, *column] for name, column in zip(header, zip(*rows, strict=True), strict=True)]
    widths = [max(map(len, column)) for column in columns]
    least = [
        max(len(part) for cell in column for part in _unbroken(cell, cell is column[0])) for column in columns
    ]
    if sum(least) > room:
        return None
    # The column with the most to give, one character at a time, so that several long ones end alike.
    while sum(widths) > room:
        widest = max(range(len(widths)), key=lambda index: widths[index] - least[index])
        widths[widest] -= 1
    return widths


def _unbroken(cell: str, is_header: bool) -> list[str]:
    """Return the parts of a cell that stay on one line: all of it, or the words of a header or a sentence."""
    return cell.split() or [""] if is_header or len(cell) > _SENTENCE else [cell]


def _grid(
    header: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[int], right: Sequence[bool]
) -> Table:
    """Lay out rows below their header."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name, width, is_number in zip(header, widths, right, strict=True):
        table.add_column(Text(name), justify="right" if is_number else "left", width=width)
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def _records(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Lay out rows under one another, where a terminal is too narrow for their columns."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for row in rows:
        table.add_row()
        for name, cell in zip(header, row, strict=True):
            table.add_row(Text(f"  {name}" if name != header[0] else name), Text(cell))
    table.add_row()
    return table


@contextmanager
def _bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    from rich import progress
    from rich.console import Console

    start_s = time.monotonic()
    state = progress.TextColumn("{task.fields[state]}", markup=False)
    columns = (progress.TextColumn("{task.description}", markup=False), progress.BarColumn(), state)
    with progress.Progress(*columns, console=Console(file=sys.stderr)) as bar:
        task = bar.add_task(printable(what), total=None, state="")

        def update(done: int, total: int) -> None:
            text = _state(done, total, unit, time.monotonic() - start_s)
            bar.update(task, completed=done, total=total, state=text)

        yield update


def _plain_lines(info: Callable[[str], None], what: str, unit: str) -> Callable[[int, int], None]:
    start_s = last_s = time.monotonic()

    def update(done: int, total: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        # The last one always: a log that ends at 80 % looks like work that was stopped.
        if done and (done == total or now_s - last_s >= _PLAIN_INTERVAL_S):
            last_s = now_s
            info(f"{what}: {_state(done, total, unit, now_s - start_s)}")

    return update


def _state(done: int, total: int, unit: str, elapsed_s: float) -> str:
    """Write how far work is: counts, and once some is done the rate over all the time, and the time left."""
    # Shards come in bursts: the rate of the last seconds would jump.
    amount = bytes_text if unit == BYTES else "{:,}".format
    count = f"{amount(done)} of {amount(total)}"
    if not done:
        return count
    left = duration_text(elapsed_s / done * (total - done))
    return f"{count}, {rate_text(done, elapsed_s, unit)}, {left} left"


def rate_text(done: int, elapsed_s: float, unit: str) -> str:
    """Write how fast it goes, in numbers that can be read: ``"12 digits/s"``, ``"3.0 pictures/min"``."""
    rate = done / elapsed_s if elapsed_s > 0 else 0.0
    if not rate or unit == BYTES:
        return f"{bytes_text(rate)}/s" if rate else ""
    each, rate = next(
        ((each, rate * seconds) for each, seconds in _SPANS_S if rate * seconds >= 1), ("h", rate * 3600)
    )
    # Two digits are enough: from 9.95 on a decimal would make three of them.
    return f"{rate:,.0f} {unit}/{each}" if rate >= 9.95 else f"{rate:.1f} {unit}/{each}"


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
