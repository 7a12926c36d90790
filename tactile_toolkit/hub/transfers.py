"""Files that are fetched side by side, and what of them has arrived."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from tactile_toolkit.errors import HubError

__all__ = ["ProgressBar", "Transfers"]

_FILES_AT_ONCE = 8  # as many as the Hub's own client fetches at once
_STOP_WITHIN_S = 2.0

T = TypeVar("T")
R = TypeVar("R")


class _StoppedError(Exception):
    """Another file failed, or the user does not want to wait."""


@dataclass
class Transfers:
    """Files that are fetched side by side: they are counted together, and one that fails stops the others.

    ``on_bytes`` is told the number of bytes each time some have arrived, negative when some were thrown away;
    ``on_wait``, in a sentence, why there is a wait. Both are called by one thread at a time.
    """

    on_bytes: Callable[[int], None] = lambda _: None
    on_wait: Callable[[str], None] = lambda _: None
    _stopped: threading.Event = field(default_factory=threading.Event, init=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, init=False)

    def each(self, action: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Call a function for each item, several at once; the first failure is raised, Ctrl-C ends all."""
        waiting = deque(enumerate(items))
        results: dict[int, R] = {}
        failures: list[BaseException] = []

        def work() -> None:
            while not self._stopped.is_set():
                try:
                    index, item = waiting.popleft()
                except IndexError:
                    return
                try:
                    results[index] = action(item)
                except BaseException as error:
                    failures.append(error)
                    self._stopped.set()

        # Daemons, not an executor, whose threads the interpreter waits for: a stalled connection is given up
        # only after a minute, and nobody wants to wait for it after Ctrl-C.
        count = min(_FILES_AT_ONCE, len(items))
        threads = [threading.Thread(target=work, daemon=True) for _ in range(count)]
        for thread in threads:
            thread.start()
        try:
            for thread in threads:
                while thread.is_alive() and not self._stopped.is_set():
                    # In short steps, to see when another thread has failed.
                    thread.join(0.1)
        finally:
            if len(results) < len(items):
                self._stopped.set()
            deadline_s = time.monotonic() + _STOP_WITHIN_S
            for thread in threads:
                thread.join(max(0.0, deadline_s - time.monotonic()))
        if failures:
            raise failures[0]
        return [results[index] for index in range(len(items))]

    def count(self, size_bytes: int) -> None:
        """Pass on that bytes have arrived; in a transfer that is to stop, this is where it stops."""
        if self._stopped.is_set() and size_bytes > 0:
            raise _StoppedError
        with self._lock:
            self.on_bytes(size_bytes)

    def say(self, text: str) -> None:
        """Pass on why there is a wait."""
        with self._lock:
            self.on_wait(text)


class ProgressBar:
    """What the client takes for a class of progress bars, and for a bar: it passes on what arrives of a file.

    The client asks for no end of it: more than the size that was stated is refused before it is written.
    """

    def __init__(self, transfers: Transfers, path: str, size_bytes: int) -> None:
        self._transfers, self._path, self._size_bytes = transfers, path, size_bytes
        self._arrived_bytes = 0

    def __call__(self, **_: Any) -> ProgressBar:
        """Be the bar that the client makes of its class."""
        return self

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def update(self, size_bytes: float | None = 1) -> None:
        """Count what is about to be written; HubError where that is more than the file has."""
        self._arrived_bytes += int(size_bytes or 0)
        if self._arrived_bytes > self._size_bytes:
            message = (
                f"the Hub sends more of {self._path!r} than the {self._size_bytes:,} bytes that it states; "
                "nothing of it was kept; next: try again later, or ask its owner to upload it again"
            )
            raise HubError(message)
        self._transfers.count(int(size_bytes or 0))

    def take_back(self) -> None:
        """Count what has arrived as thrown away."""
        self._transfers.count(-self._arrived_bytes)
        self._arrived_bytes = 0

    # Asked for by name (huggingface_hub 2.4).
    def update_transfer(self, size_bytes: float | None = 1) -> None:
        """Pass over what is received of a file in compressed pieces; `update` counts what is written."""

    def set_postfix_str(self, *_: Any, **__: Any) -> None:
        """Do nothing; the client calls it."""

    set_transfer_postfix_str = set_postfix_str
    total: int | None = None

    def close(self) -> None:
        """Do nothing; the client calls it."""
