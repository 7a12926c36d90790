"""Standard streams that end the command if they cannot be written."""

from __future__ import annotations

import codecs
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import IO, TypeVar

from tactile_toolkit.errors import StorageError

T = TypeVar("T")

# 128 plus the number of SIGPIPE, as shells report it for `cat` or `grep` if the reader has ended.
_EXIT_CLOSED_PIPE = 141
# Replacements of characters that an encoding lacks, such as the code page of a console; others are escaped.
_IN_ASCII = str.maketrans(
    {"─": "-", "━": "#", "…": "...", "µ": "u", "\N{MULTIPLICATION SIGN}": "x", "²": "^2", "³": "^3"}
    | {"°": " deg", "±": "+-", "→": "->", "\N{EN DASH}": "-", "\N{EM DASH}": "-", "\N{MINUS SIGN}": "-"}
)


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
            raise SystemExit(StorageError.exit_code) from error
