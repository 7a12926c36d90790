"""Errors of clients of stores: their messages, and when calls are retried."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tactile_toolkit.errors import RemoteError
from tactile_toolkit.store import remote
from tactile_toolkit.store.remote import ASKED_WAIT_S, CallFailure, ask_store, with_retry

WAITS_S = (1.0, 2.0, 4.0)


@pytest.fixture
def slept(monkeypatch):
    """The waits in seconds, on a clock that only waiting advances."""
    found: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: 1e6 + sum(found), sleep=found.append)
    monkeypatch.setattr(remote, "time", clock)
    return found


def fails(times, error=OSError):
    """An action that fails some times, and then returns the number of calls."""
    begun = []

    def action():
        begun.append(1)
        if len(begun) <= times:
            raise error(f"attempt {len(begun)}")
        return len(begun)

    return action


def transient(error, asked_wait_s=0.0):
    return CallFailure(RemoteError(f"the store said {error}"), True, asked_wait_s)


@pytest.mark.parametrize("times", range(4))
def test_a_transient_failure_is_tried_again_after_each_wait(slept, times):
    messages = []
    assert with_retry(fails(times), transient, WAITS_S, on_wait=messages.append) == times + 1
    assert slept == list(WAITS_S[:times])
    assert messages == [
        f"the store said attempt {number}; trying again in {wait:g} s"
        for number, wait in enumerate(WAITS_S[:times], start=1)
    ]


def test_after_the_last_wait_the_last_failure_is_raised_without_its_cause(slept):
    with pytest.raises(RemoteError, match="the store said attempt 4") as raised:
        with_retry(fails(9), transient, WAITS_S)
    assert slept == list(WAITS_S)
    assert (raised.value.__cause__, raised.value.__suppress_context__) == (None, True)


def test_permanent_failures_and_other_exceptions_are_raised_at_once(slept):
    with pytest.raises(RemoteError, match="attempt 1"):
        with_retry(fails(1), lambda error: CallFailure(RemoteError(str(error)), False), WAITS_S)
    with pytest.raises(KeyError, match="attempt 1"):
        with_retry(fails(1, KeyError), lambda _: None, WAITS_S)
    assert slept == []


@pytest.mark.parametrize(("patience_s", "waited"), [(0.9, 0), (1, 1), (2.9, 1), (3, 2), (6.9, 2), (7, 3)])
def test_no_wait_ends_after_the_patience(slept, patience_s, waited):
    with pytest.raises(RemoteError, match=f"attempt {waited + 1}$"):
        with_retry(fails(9), transient, WAITS_S, patience_s=patience_s)
    assert slept == list(WAITS_S[:waited])


def test_a_wait_that_the_store_asks_for_is_kept_up_to_a_sum(slept):
    asked_s = ASKED_WAIT_S / 2
    with pytest.raises(RemoteError, match="attempt 3"):
        with_retry(fails(9), lambda error: transient(error, asked_s), WAITS_S)
    assert slept == [asked_s, asked_s]
    slept.clear()
    assert with_retry(fails(2), lambda error: transient(error, 1.5), WAITS_S) == 3
    assert slept == [1.5, 2.0]


class RefusedError(Exception):
    """As raised by clients of S3, with the reply of the store."""

    def __init__(self, code):
        super().__init__(f"the store answers {code}")
        self.response = {"Error": {"Code": code}}


class NumberedError(Exception):
    """As raised by clients of other stores, with an HTTP status."""

    __module__ = "gcsfs.retry"

    def __init__(self, code):
        super().__init__("the store says no")
        self.code = code


def caused(error, cause):
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "words", "is_transient"),
    [
        (ConnectionResetError("reset"), r"the store of 's3://b/a' gives no answer \(reset\)", True),
        (TimeoutError(), r"the store of 's3://b/a' gives no answer \(TimeoutError\)", True),
        (caused(OSError("cut"), ConnectionError("x")), r"gives no answer \(cut\)", True),
        (OSError("quota"), "reading 's3://b/a' failed: OSError: quota; finished files stay", False),
        (RefusedError("SlowDown"), "reading 's3://b/a' failed: SlowDown: the store answers SlowDown", True),
        (caused(RefusedError("Odd"), ConnectionError("x")), "reading 's3://b/a' failed: Odd: ", False),
        (RefusedError("503"), "failed: 503: ", True),
        *(
            (RefusedError(code), rf"reading 's3://b/a' is refused \({code}: ", False)
            for code in ("AccessDenied", "InvalidAccessKeyId", "ExpiredToken", "RequestTimeTooSkewed")
        ),
        (RefusedError("InternalError"), "failed: InternalError: ", True),
        (RefusedError("IllegalLocationConstraint"), r"another region \(IllegalLocationConstraint\)", False),
        (caused(RefusedError("AccessDenied"), TimeoutError()), r"is refused \(AccessDenied: ", False),
        (NumberedError(503), "reading 's3://b/a' failed: 503: the store says no; ", True),
        (NumberedError(None), "reading 's3://b/a' failed: NumberedError: the store says no; ", False),
        (RefusedError("PermanentRedirect"), r"lies in another region \(PermanentRedirect\)", False),
    ],
    ids=str,
)
def test_failures_get_their_message_and_retries(slept, error, words, is_transient):
    def raises():
        raise error

    with pytest.raises(RemoteError, match=words):
        ask_store(raises, "reading", "s3://b/a")
    assert bool(slept) == is_transient


def test_of_a_long_answer_the_beginning_of_its_first_line_is_shown(slept):
    def raises():
        raise OSError("".join(map(chr, range(0x4E00, 0x4E00 + 400))) + "\nmore")

    with pytest.raises(RemoteError) as raised:
        ask_store(raises, "reading", "s3://b/a")
    shown = [character for character in str(raised.value) if ord(character) >= 0x4E00]
    assert shown == list(map(chr, range(0x4E00, 0x4E00 + 300)))
    assert "more" not in str(raised.value)


@pytest.mark.parametrize("error", [FileNotFoundError("a"), FileExistsError("a"), RuntimeError("a fault")])
def test_other_exceptions_are_unchanged(slept, error):
    def raises():
        raise error

    with pytest.raises(type(error)) as raised:
        ask_store(raises, "reading", "s3://b/a")
    assert raised.value is error
    assert slept == []
