"""Standard streams that end the command when they take no more."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from tactile_toolkit.errors import (
    StorageError,
)

# 128 and the number of SIGPIPE: what a shell reports of `cat`, `grep` and others whose reader left.
_EXIT_CLOSED_PIPE = 141


class _Output:
    """A standard stream that ends the command when it takes no more: a closed pipe quietly, as other tools.

    Caught here, because click would end with another exit code, and because the same errors of a file, or of
    a connection to the Hub, mean something else.
    """

    def __init__(self, stream: Any) -> None:
        # Python has none where the caller closed it.
        self._stream = stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        return int(self._taken(self._stream.write, text))

    def flush(self) -> None:
        self._taken(self._stream.flush)

    def _taken(self, act: Callable[..., Any], *arguments: str) -> Any:
        try:
            return act(*arguments)
        except OSError as error:
            # What is left in the buffer must go somewhere when Python ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if isinstance(error, BrokenPipeError):
                raise SystemExit(_EXIT_CLOSED_PIPE) from error
            with suppress(SystemExit):  # of a stderr that takes no more either
                sys.stderr.write(
                    f"error: the output cannot be written: {error.strerror}; next: redirect it to "
                    "another place\n"
                )
            raise SystemExit(StorageError.exit_code) from error
