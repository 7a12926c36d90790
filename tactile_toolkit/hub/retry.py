"""Asking the Hub again when a failure is of the kind that passes."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import TypeVar

from tactile_toolkit.errors import InputError
from tactile_toolkit.hub.errors import (
    cause_chain,
    failure_of,
    is_connection_failure,
    scrub,
    shown_cause,
    status_of,
)

__all__ = [
    "WAITS_VARIABLE",
    "ask",
    "client_hushed",
    "could_not_ask",
    "default_waits_s",
    "is_passing",
    "wait_before_s",
]

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


WAITS_VARIABLE = "TACTILE_TOOLKIT_HUB_WAITS"
"""Environment variable with the waits between tries, seconds, such as ``1,2,4``; empty means one try."""

_WAITS_S = (1.0, 2.0, 4.0, 8.0, 16.0)
_LONGEST_WAIT_S = 120.0
_PASSING_STATUS = frozenset({408, 425, 429, 500, 502, 503, 504})

T = TypeVar("T")


def default_waits_s() -> tuple[float, ...]:
    """Return the waits between tries, seconds: :data:`WAITS_VARIABLE`, or growing from 1 to 16 s.

    Raises
    ------
    InputError
        The variable holds something else than numbers.
    """
    text = os.environ.get(WAITS_VARIABLE)
    if text is None:
        return _WAITS_S
    try:
        return tuple(max(0.0, float(part)) for part in text.split(",") if part.strip())
    except ValueError as error:
        message = f"{WAITS_VARIABLE} is {text!r}; expected seconds between commas, such as 1,2,4"
        raise InputError(message) from error


def is_passing(error: BaseException) -> bool:
    """Tell whether the same request may succeed a little later.

    So do overload, a server's trouble, and a connection that broke; not so a Hub that could not be reached in
    the first place (no network stays no network for longer than anyone wants to wait), nor any refusal.
    """
    chain = cause_chain(error)
    statuses = [status for status in map(status_of, chain) if status is not None]
    if statuses:
        return statuses[0] in _PASSING_STATUS
    return any(_is_broken_connection(link) for link in chain)


def could_not_ask(error: BaseException) -> bool:
    """Tell whether the Hub gave no answer of its own, so that what it said last still counts."""
    chain = cause_chain(error)
    silent = any(isinstance(link, (ConnectionError, TimeoutError)) for link in chain)
    return silent or any(map(is_connection_failure, chain)) or is_passing(error)


def _is_broken_connection(error: BaseException) -> bool:
    if isinstance(error, (ConnectionResetError, BrokenPipeError, ConnectionAbortedError)):
        return True
    lasting = ("ConnectError", "ConnectTimeout", "LocalProtocolError", "UnsupportedProtocol", "ProxyError")
    return is_connection_failure(error) and type(error).__name__ not in lasting


def wait_before_s(error: BaseException, planned_s: float) -> float:
    """Return how long to wait: as planned, or longer if the Hub asks for it (up to two minutes)."""
    for link in cause_chain(error):
        headers = getattr(getattr(link, "response", None), "headers", None)
        asked = headers.get("Retry-After") if headers is not None else None
        if asked and str(asked).isdigit():
            return min(max(planned_s, float(asked)), _LONGEST_WAIT_S)
    return planned_s


def ask(
    action: Callable[[], T],
    repo_id: str,
    revision: str | None = None,
    doing: str = "reading",
    *,
    waits_s: tuple[float, ...] | None = None,
    look: Callable[[], T | None] | None = None,
    has_moved: Callable[[], bool] = lambda: False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> T:
    """Do something with the Hub; what fails in passing is tried again after growing waits.

    Parameters
    ----------
    action : callable
        What to do; called once or more.
    repo_id, revision, doing
        For messages, as :func:`tactile_toolkit.hub.errors.named_failures` has them.
    waits_s : tuple of float, optional
        Seconds to wait before each further try; default :func:`default_waits_s`.
    look : callable, optional
        Asked before every further try whether the action has had its effect although it failed (a commit
        whose answer was lost); anything but None is then the result.
    has_moved : callable
        Asked after a failure whether the try got somewhere nevertheless; the count of tries then starts anew.
    on_wait : callable
        Told, in a sentence, that and why there is a wait.

    Raises
    ------
    HubError
        It failed for good, or was given up; the message says how often it was tried.
    StorageError, InputError
        As :func:`tactile_toolkit.hub.errors.named_failures`.
    """
    waits = default_waits_s() if waits_s is None else waits_s
    with client_hushed(on_wait):
        return _asked(action, repo_id, revision, doing, waits, look, has_moved, on_wait)


def _asked(
    action: Callable[[], T],
    repo_id: str,
    revision: str | None,
    doing: str,
    waits: tuple[float, ...],
    look: Callable[[], T | None] | None,
    has_moved: Callable[[], bool],
    on_wait: Callable[[str], None],
) -> T:
    tries = 0
    while True:
        tries += 1
        try:
            found = look() if look is not None and tries > 1 else None
            return action() if found is None else found
        except Exception as error:
            tries = 1 if has_moved() else tries
            failure = failure_of(error, repo_id, revision, doing, tries)
            if failure is None:
                raise
            if tries > len(waits) or not is_passing(error):
                raise failure from shown_cause(error)
            wait_s = wait_before_s(error, waits[tries - 1])
            on_wait(f"{_first_part(failure)}; trying again in {wait_s:g} s")
        time.sleep(wait_s)


def _first_part(failure: Exception) -> str:
    return str(failure).partition("; next: ")[0].partition(" (tried ")[0]
