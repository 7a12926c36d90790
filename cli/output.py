"""Where words go: data on stdout, talk on stderr."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from cli.options import Json, Quiet
from tactile_toolkit.wording import counted

__all__ = ["Sink", "bytes_text", "counted", "duration_text", "flat_lines"]

_PLAIN_INTERVAL_S = 5.0


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
            sys.stdout.write(json.dumps(content, indent=2, ensure_ascii=False) + "\n")

    def line(self, text: str = "") -> None:
        """Print a line of the result."""
        if not (self.as_json or self.quiet):
            sys.stdout.write(text + "\n")

    def talk(self, text: str) -> None:
        """Say something on stderr."""
        if not self.quiet:
            sys.stderr.write(text + "\n")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], title: str = "") -> None:
        """Print a table of the result."""
        if self.as_json or self.quiet:
            return
        if not rows:
            sys.stdout.write(f"{title}\n" if title else "")
            return
        from rich import box
        from rich.console import Console
        from rich.table import Table

        table = Table(*header, title=title or None, title_justify="left", box=box.SIMPLE_HEAD)
        for column, sample in zip(table.columns, rows[0] if rows else (), strict=False):
            column.justify = "right" if isinstance(sample, (int, float)) else "left"
        for row in rows:
            table.add_row(*(f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in row))
        console = Console(file=sys.stdout)
        # Piped into a file, a table keeps its columns instead of being folded at 80 characters.
        console.width = console.width if console.is_terminal else 160
        console.print(table)

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
            yield _plain_lines(self.talk, what, unit)


@contextmanager
def _bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.fields[rate]}"),
        progress.TimeRemainingColumn(),
    )
    start_s = time.monotonic()
    with progress.Progress(*columns, console=Console(file=sys.stderr)) as bar:
        task = bar.add_task(what, total=None, rate="")

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, rate=_rate(done, time.monotonic() - start_s, unit))

        yield update


def _plain_lines(talk: Callable[[str], None], what: str, unit: str) -> Callable[[int, int], None]:
    start_s = last_s = time.monotonic()

    def update(done: int, total: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if done == 0 or (done < total and now_s - last_s < _PLAIN_INTERVAL_S):
            return
        last_s = now_s
        elapsed_s = now_s - start_s
        left_s = elapsed_s / done * (total - done)
        talk(f"{what}: {done:,} of {total:,}, {_rate(done, elapsed_s, unit)}, {duration_text(left_s)} left")

    return update


def _rate(done: int, elapsed_s: float, unit: str) -> str:
    return f"{done / elapsed_s:.1f} {unit}/s" if elapsed_s > 0 else ""


def bytes_text(size: float) -> str:
    """Write a size for people: ``"12.3 MB"``."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.0f} B" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000
    return ""


def duration_text(seconds: float) -> str:
    """Write a duration for people: ``"1 min 20 s"``."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def flat_lines(values: Any, path: str = "") -> list[str]:
    """Lay out nested values as lines of dotted names."""
    if isinstance(values, dict) and values:
        return [
            line for key, value in values.items() for line in flat_lines(value, f"{path}.{key}".lstrip("."))
        ]
    return [f"{path} = {values}"]
