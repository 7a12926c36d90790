"""What the Hub's client library writes by itself: kept off the terminal, told once and without addresses.

It writes two lines for each try of each file, with the full address of the store, which on the Hub holds a
signature that lets anybody write there.
"""

from __future__ import annotations

import contextlib
import logging
import re
import threading
from collections.abc import Callable, Iterator
from importlib import import_module

from dataset_store.hub.tokens import scrub

__all__ = ["client_hushed"]

_LIBRARY = "huggingface_hub"
_ADDRESS = re.compile(r"(https?://[^/\s'\"]+)[^\s'\"]*")
_SAID_ANYWAY = ("Retrying in", "Rate limited", "No files have been modified")

Tell = Callable[[str], None]


class _Retold(logging.Handler):
    """Takes the place of the library's own handlers while anybody listens."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._lock = threading.Lock()
        self._listeners: list[Tell] = []
        self._told: set[str] = set()
        self._before: tuple[list[logging.Handler], bool] = ([], True)

    def emit(self, record: logging.LogRecord) -> None:
        """Tell the newest listener what it has not been told."""
        said = (record.getMessage().splitlines() or [""])[0]
        text = _ADDRESS.sub(r"\1", scrub(said))
        listeners = self._listeners[-1:]
        if text in self._told or text.startswith(_SAID_ANYWAY):
            return
        self._told.add(text)
        for tell in listeners:
            tell(f"the Hub's client says: {text}")

    def enter(self, tell: Tell) -> None:
        """Begin to listen."""
        import_module(f"{_LIBRARY}.utils.logging")  # adds its handler when it is imported
        logger = logging.getLogger(_LIBRARY)
        with self._lock:
            if not self._listeners:
                self._before = (logger.handlers[:], logger.propagate)
                logger.handlers[:], logger.propagate = [self], False
            self._listeners.append(tell)

    def leave(self, tell: Tell) -> None:
        """Stop listening; the last one puts the library's handlers back."""
        logger = logging.getLogger(_LIBRARY)
        with self._lock:
            self._listeners.remove(tell)
            if not self._listeners:
                logger.handlers[:], logger.propagate = self._before
                self._told.clear()


_RETOLD = _Retold()


@contextlib.contextmanager
def client_hushed(tell: Tell) -> Iterator[None]:
    """Keep the client library from writing to the terminal; pass on each thing it says, once.

    Parameters
    ----------
    tell : callable
        Told each in a sentence, without tokens and with no more of an address than its host.
    """
    _RETOLD.enter(tell)
    try:
        yield
    finally:
        _RETOLD.leave(tell)
