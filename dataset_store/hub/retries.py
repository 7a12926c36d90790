"""Asking the Hub again when a failure is of the kind that passes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import TypeVar

from dataset_store.errors import InputError
from dataset_store.hub.client_words import client_hushed
from dataset_store.hub.failures import (
    cause_chain,
    failure_of,
    is_connection_failure,
    shown_cause,
    status_of,
)

__all__ = ["WAITS_VARIABLE", "ask", "could_not_ask", "default_waits_s", "is_passing", "wait_before_s"]

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
        For messages, as :func:`dataset_store.hub.failures.named_failures` has them.
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
        As :func:`dataset_store.hub.failures.named_failures`.
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
