"""Printed output: results on stdout, messages and progress on stderr, on any console and into any pipe."""

from __future__ import annotations

import codecs
import json
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import IO, TypeVar

from tactile_toolkit import checked_fields, errors, run, wording
from tactile_toolkit.value_types import JsonValue

T = TypeVar("T")
_GAP = "  "

# 128 plus the number of SIGPIPE, as shells report it for `cat` or `grep` if the reader has ended.
_EXIT_CLOSED_PIPE = 141

# Replacements of characters that an encoding lacks, such as the code page of a console; others are escaped.
_IN_ASCII = str.maketrans(
    {"─": "-", "━": "#", "…": "...", "µ": "u", "\N{MULTIPLICATION SIGN}": "x", "²": "^2", "³": "^3"}
    | {"°": " deg", "±": "+-", "→": "->", "\N{EN DASH}": "-", "\N{EM DASH}": "-", "\N{MINUS SIGN}": "-"}
)


@dataclass(frozen=True, slots=True)
class Sink:
    """Prints the output of a command; a command with such a parameter has ``--json`` and ``--quiet``.

    ``--json`` prints one document on stdout and no tables, ``--quiet`` neither progress nor tables.
    """

    as_json: bool = checked_fields.switch(
        False, name="--json", panel="General", help="Print one JSON document on stdout."
    )
    quiet: bool = checked_fields.switch(
        False, name="--quiet -q", panel="General", help="Print neither progress nor tables, only errors."
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
    def progress(
        self, what: str, unit: str, *, keeps_parts: bool = False
    ) -> Iterator[Callable[[int, int], None]]:
        """Show progress unless ``--quiet`` was given; see :func:`tactile_toolkit.run.shown_progress`.

        ``keeps_parts`` is whether the same command continues if the work is interrupted.
        """
        quiet_s = 0.0
        if self.quiet:
            quiet_s = math.inf
        try:
            with run.shown_progress(what, unit, quiet_s) as update:
                yield update
        except KeyboardInterrupt as error:
            if not keeps_parts:
                raise
            kept = "interrupted; finished parts are kept, and the same command continues from them"
            raise KeyboardInterrupt(kept) from error


def _encodable(document: str) -> str:
    """Return a JSON document with its own escapes of what the encoding of stdout lacks."""
    try:
        document.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        return json.dumps(json.loads(document), indent=2)
    return document


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "-"
    if isinstance(value, int):
        return f"{value:,}"
    return str(value)


def _aligned(row: Sequence[str], widths: Sequence[int], is_number: Sequence[bool]) -> str:
    cells = zip(row, is_number, widths, strict=True)
    aligned = (cell.rjust(width) if right else cell.ljust(width) for cell, right, width in cells)
    return _GAP.join(aligned).rstrip()


def _in_ascii(error: UnicodeError) -> tuple[str | bytes, int]:
    """Return the replacement for characters that a stream cannot encode, and the index at which to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(_IN_ASCII)
    return text.encode("ascii", "backslashreplace").decode(), error.end


codecs.register_error("tactile_toolkit.ascii", _in_ascii)


class Output:
    """A standard stream that ends the command if it cannot be written; a closed pipe ends it quietly.

    Errors are caught here because click would use another exit code, and because the same errors of a file
    or of a connection to the Hub mean something else.
    """

    def __init__(self, stream: IO[str] | None) -> None:
        # Python's stream is None if the caller closed it.
        self._stream = stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
        if hasattr(self._stream, "reconfigure"):  # not of streams that take text in memory
            self._stream.reconfigure(errors="tactile_toolkit.ascii")

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text."""
        return self._end_on_error(self._stream.write, text)

    def flush(self) -> None:
        """Write what is buffered."""
        self._end_on_error(self._stream.flush)

    def _end_on_error(self, act: Callable[..., T], *arguments: str) -> T:
        try:
            return act(*arguments)
        except OSError as error:
            # Python flushes the rest of the buffer at its end, which must not fail again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if isinstance(error, BrokenPipeError):
                raise SystemExit(_EXIT_CLOSED_PIPE) from error
            with suppress(SystemExit):  # if stderr cannot be written either
                sys.stderr.write(
                    f"error: the output cannot be written: {error.strerror}; next: redirect it to "
                    "another place\n"
                )
            raise SystemExit(errors.InputError.exit_code) from error
