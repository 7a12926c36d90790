"""What an answer of the Hub may cost: bytes, time, and the waits that it asks for.

The client library takes whatever comes for as long as it comes. The hooks of its session limit all that goes
through it: questions, downloads, and reading piece by piece.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextvars import ContextVar
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, TypeVar

from tactile_toolkit.errors import HubError
from tactile_toolkit.store.names import problem_of_name

__all__ = ["ANSWER_BYTES", "LEAST_BYTES", "QUESTION_S", "WAIT_S", "asked_wait_s", "within_limits"]

ANSWER_BYTES = 32 << 20
"""Largest answer to a question, unpacked: a listing of more than 100,000 files."""
QUESTION_S = 30.0
"""Longest time for a question to the Hub with its answer, seconds."""
WAIT_S = 120.0
"""Longest time to wait for the Hub, because it asks for it or for the next piece of a file, seconds."""
LEAST_BYTES = 16 << 10
"""What of a file has to arrive in that time: less is as good as nothing."""

_QUESTION, _BEGAN_S = "tactile_toolkit_question", "tactile_toolkit_began_s"
_RANGE = re.compile(r"bytes=(\d+)-(\d+)")
_BUSY = frozenset({408, 425, 429, 500, 502, 503, 504})

T = TypeVar("T")


@dataclass
class _Asking:
    """When the latest request of an action began, and for how long the client may still wait by itself."""

    wait_left_s: float
    began_s: float = field(default_factory=time.monotonic)


_ASKING: ContextVar[_Asking | None] = ContextVar("_ASKING", default=None)


def within_limits(action: Callable[[], T], *, is_question: bool) -> T:
    """Return what an action gets from the Hub; TimeoutError where a question takes too long."""
    _guard_client()
    # Waits within a question are left to the caller, who can give a reason for them.
    asking = _Asking(0.0 if is_question else WAIT_S)
    future: Future[T] = Future()

    def work() -> None:
        token = _ASKING.set(asking)
        try:
            future.set_result(action())
        except BaseException as error:
            future.set_exception(error)
        finally:
            _ASKING.reset(token)

    if not is_question:
        work()
        return future.result()
    # In a thread that can be given up: the client has no limit for a head that arrives byte by byte.
    threading.Thread(target=work, daemon=True).start()
    while not future.done():
        left_s = asking.began_s + QUESTION_S - time.monotonic()
        if left_s <= 0:
            raise TimeoutError
        wait([future], left_s)
    return future.result()


def asked_wait_s(headers: Any) -> float | None:
    """Return for how long the head of an answer asks to wait, seconds; None where it does not."""
    client: Any = import_module("huggingface_hub.utils")  # its names are not exported to type checkers
    try:
        limit = client.parse_ratelimit_headers(headers)
    except ValueError:  # a number of thousands of digits
        return float("inf")
    if limit is not None and limit.remaining == 0:
        return float(limit.reset_in_seconds)
    text = str(headers.get("Retry-After", "")).strip()
    return float(text) if re.fullmatch("[0-9]+", text) else None


def _guard_client() -> None:
    from huggingface_hub import get_session

    hooks = get_session().event_hooks
    if _check_answer not in hooks["response"]:
        hooks["request"].append(_note_request)
        hooks["response"].append(_check_answer)


def _note_request(request: Any) -> None:
    # Where a request is sent on to another address, the client passes its notes on.
    request.extensions.setdefault(_QUESTION, "/api/" in request.url.path.partition("/resolve/")[0])
    request.extensions[_BEGAN_S] = time.monotonic()
    asking = _ASKING.get()
    if asking is not None:
        asking.began_s = request.extensions[_BEGAN_S]


def _check_answer(response: Any) -> None:
    """Limit the body of an answer, and refuse it for its head."""
    if _BEGAN_S not in response.request.extensions:  # asked by another thread before there were limits
        return
    response.iter_raw = _limited(response, response.iter_raw)
    response.iter_bytes = _limited(response, response.iter_bytes)
    _refuse_unsafe_names(response)
    _refuse_long_wait(response)


def _limited(response: Any, pieces: Callable[..., Iterator[bytes]]) -> Callable[..., Iterator[bytes]]:
    """Return the method of an answer that yields its body, within the limits of bytes and time."""
    notes, span = response.request.extensions, _RANGE.fullmatch(response.request.headers.get("Range", ""))
    # Of other files, whoever writes them to the disk knows the size.
    most: float = int(span[2]) - int(span[1]) + 1 if span else float("inf")
    if notes[_QUESTION] or not response.is_success:
        most = ANSWER_BYTES

    def limited(*args: Any, **options: Any) -> Iterator[bytes]:
        arrived = lately = 0
        since_s = time.monotonic()
        for piece in pieces(*args, **options):
            now_s = time.monotonic()
            arrived, lately = arrived + len(piece), lately + len(piece)
            if arrived > most:
                message = (
                    f"{response.request.url.host!r} answers with more than {most:,} bytes where less was "
                    "asked for; nothing of it was kept; next: check HF_ENDPOINT, or try again later"
                )
                raise HubError(message)
            if notes[_QUESTION]:
                is_late = now_s > notes[_BEGAN_S] + QUESTION_S
            elif lately < LEAST_BYTES:
                is_late = now_s > since_s + WAIT_S
            else:
                is_late, lately, since_s = False, 0, now_s
            if is_late:
                raise TimeoutError
            yield piece
            since_s += time.monotonic() - now_s  # the time of the reader does not count

    return limited


def _refuse_unsafe_names(response: Any) -> None:
    """Refuse a head that would lead the client out of its cache: it names files by that."""
    for name in ("etag", "x-linked-etag", "x-repo-commit") if response.request.method == "HEAD" else ():
        value = response.headers.get(name, "").removeprefix("W/").strip('"')
        if value and ("/" in value or problem_of_name(value)):
            message = f"the Hub calls a file {value[:80]!r}, which is not a digest; next: check HF_ENDPOINT"
            raise HubError(message)


def _refuse_long_wait(response: Any) -> None:
    """Raise the client's error where it would wait too long, as the Hub asks for."""
    asked_s = asked_wait_s(response.headers) if response.status_code in _BUSY else None
    if asked_s is None:
        return
    # In one form, which the client can read.
    response.headers.pop("RateLimit", None)
    response.headers["Retry-After"] = f"{min(asked_s, 1e9):.0f}"
    asking = _ASKING.get()
    if asked_s > (WAIT_S if asking is None else asking.wait_left_s):
        client: Any = import_module("huggingface_hub.utils")
        client.hf_raise_for_status(response)
    elif asking is not None:
        asking.wait_left_s -= asked_s
