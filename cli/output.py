"""Printed output: results on stdout, messages and progress on stderr."""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import zip_longest

from tactile_toolkit import checked_fields, errors, wording
from tactile_toolkit.json_types import JsonValue
from tactile_toolkit.progress import shown_progress

_GAP = "  "
_ANSWERS = {True: "yes", False: "-"}
# Alignment of a column by whether it holds numbers.
_SIDES = {True: ">", False: "<"}


@dataclass(frozen=True, slots=True)
class Sink:
    """Prints the output of a command; a command with such a parameter has ``--json`` and ``--quiet``.

    ``--json`` prints one document on stdout and no tables, ``--quiet`` neither progress nor tables.
    """

    as_json: bool = checked_fields.switch(False, name="--json", help="Print one JSON document on stdout.")
    quiet: bool = checked_fields.switch(
        False, name="--quiet -q", help="Print neither progress nor tables, only errors."
    )

    def document(self, content: JsonValue) -> None:
        """Print the JSON document of the command, if ``--json`` was given."""
        if self.as_json:
            sys.stdout.write(_encodable(wording.printable_json(content)) + "\n")

    def line(self, text: str = "") -> None:
        """Print a line of the result."""
        if not (self.as_json or self.quiet):
            sys.stdout.write(wording.printable(text, keep="\n") + "\n")

    def info(self, text: str) -> None:
        """Print a message on stderr, unless ``--quiet`` was given."""
        if not self.quiet:
            self.warn(text)

    def warn(self, text: str) -> None:
        """Print a message on stderr even with ``--quiet``, such as the name of a damaged file."""
        # It may quote a source, and with it an address that holds a secret.
        sys.stderr.write(errors.redact(wording.printable(text, keep="\n")) + "\n")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], title: str = "") -> None:
        """Print a table of the result."""
        if title:
            self.line(title)
        if not rows:
            return
        is_number = [isinstance(cell, (int, float)) and not isinstance(cell, bool) for cell in rows[0]]
        cells = [[wording.printable(_cell(cell)).rstrip() for cell in row] for row in rows]
        # In a file or pipe, a table keeps its columns, however wide it is.
        width = sys.maxsize
        if sys.stdout.isatty():
            width = shutil.get_terminal_size().columns
        # A table that is too wide gets headings of one word per line, or else one line per cell.
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
                label = name.rjust(len(name) + 2 * (name != header[0]))
                self.line(textwrap.fill(f"{label:<{wide}} {cell}", width, subsequent_indent=" " * (wide + 1)))

    @contextmanager
    def progress(self, what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
        """Show progress unless ``--quiet`` was given; see :func:`tactile_toolkit.progress.shown_progress`."""
        quiet_s = 0.0
        if self.quiet:
            quiet_s = math.inf
        with shown_progress(what, unit, quiet_s) as update:
            yield update


def _encodable(document: str) -> str:
    """Return a JSON document with its own escapes of what the encoding of stdout lacks."""
    try:
        document.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        return json.dumps(json.loads(document), indent=2)
    return document


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return _ANSWERS[value]
    if isinstance(value, int):
        return f"{value:,}"
    return str(value)


def _aligned(row: Sequence[str], widths: Sequence[int], is_number: Sequence[bool]) -> str:
    cells = zip(row, map(_SIDES.__getitem__, is_number), widths, strict=True)
    return _GAP.join(f"{cell:{side}{width}}" for cell, side, width in cells).rstrip()
