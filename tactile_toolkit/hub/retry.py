"""Asking the Hub again when a failure is of the kind that passes."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import TypeVar

from tactile_toolkit.errors import InputError
from tactile_toolkit.hub import limits
from tactile_toolkit.hub.errors import (
    cause_chain,
    failure_of,
    is_connection_failure,
    scrub,
    shown_cause,
    status_of,
)
from tactile_toolkit.hub.limits import asked_wait_s, within_limits

__all__ = ["WAITS_VARIABLE", "ask", "default_waits_s", "is_passing", "is_unanswered"]

WAITS_VARIABLE = "TACTILE_TOOLKIT_HUB_WAITS"
"""Environment variable with the waits between tries, seconds, such as ``1,2,4``; empty means one try."""

_WAITS_S = (1.0, 2.0, 4.0, 8.0, 16.0)
# Too slow, too early, too many, and a server in trouble; 501 stays, as what is not offered will not be.
_PASSING_STATUS = frozenset({408, 425, 429, 500, 502, 503, 504})
_LIBRARY = "huggingface_hub"
_ADDRESS = re.compile(r"(https?://[^/\s'\"]+)[^\s'\"]*")
# What we say ourselves, in our own words.
_SAID_BY_US = ("Retrying in", "No files have been modified")

T = TypeVar("T")


class _ClientLog(logging.Handler):
    """Takes the place of the library's own log handlers, and leaves it to them while nobody listens."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._own: list[logging.Handler] = []
        self._listeners: list[Callable[[str], None]] = []
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Tell the newest listener what it has not been told."""
        listeners = self._listeners[-1:]
        if not listeners:
            for handler in self._own:
                handler.handle(record)
            return
        first_line = (record.getMessage().splitlines() or [""])[0]
        text = _ADDRESS.sub(r"\1", scrub(first_line))
        if text not in self._said and not text.startswith(_SAID_BY_US):
            self._said.add(text)
            listeners[0](f"the Hub's client says: {text}")

    @contextlib.contextmanager
    def captured(self, on_message: Callable[[str], None]) -> Iterator[None]:
        """Keep the library from writing to the terminal; each thing it says goes to the callback, once.

        In a sentence, without tokens and with no more of an address than its host. Threads listen side by
        side.
        """
        import_module(f"{_LIBRARY}.utils.logging")  # adds its handler when it is imported
        handlers = logging.getLogger(_LIBRARY).handlers
        if self not in handlers:
            self._own, handlers[:] = handlers[:], [self]
        self._listeners.append(on_message)
        try:
            yield
        finally:
            self._listeners.remove(on_message)
            if not self._listeners:
                self._said.clear()


_CLIENT_LOG = _ClientLog()


def default_waits_s() -> tuple[float, ...]:
    """Return the waits between tries, seconds: :data:`WAITS_VARIABLE`, or growing from 1 to 16 s."""
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
    lasting = ("ConnectError", "ConnectTimeout", "LocalProtocolError", "UnsupportedProtocol", "ProxyError")
    broken = (ConnectionResetError, BrokenPipeError, ConnectionAbortedError)
    return any(
        isinstance(link, broken) or (is_connection_failure(link) and type(link).__name__ not in lasting)
        for link in chain
    )


def is_unanswered(error: BaseException) -> bool:
    """Tell whether the Hub gave no answer of its own, so that what it said last still counts."""
    chain = cause_chain(error)
    silent = any(isinstance(link, (ConnectionError, TimeoutError)) for link in chain)
    return silent or any(map(is_connection_failure, chain)) or is_passing(error)


def ask(
    action: Callable[[], T],
    repo_id: str,
    revision: str | None = None,
    doing: str = "reading",
    *,
    waits_s: tuple[float, ...] | None = None,
    is_question: bool = True,
    may_repeat: Callable[[Exception], bool] = is_passing,
    on_wait: Callable[[str], None] = lambda _: None,
) -> T:
    """Do something with the Hub; what fails in passing is tried again after growing waits.

    The action may have had its effect though it failed, where the answer was lost. ``on_wait`` is told, in a
    sentence, that and why there is a wait; all waits that the Hub asks for are limited together. What
    ``is_question`` (all but sending and fetching files) has limits of its own, see
    :mod:`tactile_toolkit.hub.limits`. Raises what :func:`tactile_toolkit.hub.errors.named_failures` does,
    with the number of tries.
    """
    waits = default_waits_s() if waits_s is None else waits_s
    tries, waited_s = 0, 0.0
    with _CLIENT_LOG.captured(on_wait):
        while True:
            tries += 1
            try:
                return within_limits(action, is_question=is_question)
            except Exception as error:
                failure = failure_of(error, repo_id, revision, doing, tries, is_answer=True)
                if failure is None:
                    raise
                asked_s = _asked_s(error)
                if tries > len(waits) or not may_repeat(error) or waited_s + asked_s > limits.WAIT_S:
                    raise failure from shown_cause(error)
                waited_s += asked_s
                wait_s = max(waits[tries - 1], asked_s)
                what = str(failure).partition("; next: ")[0].partition(" (tried ")[0]
                on_wait(f"{what}; trying again in {wait_s:g} s")
            time.sleep(wait_s)


def _asked_s(error: BaseException) -> float:
    """Return for how long the Hub asks to wait, seconds."""
    for link in cause_chain(error):
        headers = getattr(getattr(link, "response", None), "headers", None)
        if headers is not None:
            return asked_wait_s(headers) or 0.0
    return 0.0
