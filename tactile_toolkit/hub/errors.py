"""Failures of the Hub as errors of the toolkit, each in a sentence that ends in the next step.

The client raises a dozen kinds of errors, wraps some in others, and has one status for a private repository
and for a missing one. :func:`failure_of` looks through all that: one table maps what failed to its sentence.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from typing import Any

from tactile_toolkit.errors import HubError, InputError, StorageError, ToolkitError

# Tokens of users begin with hf_, those of organisations with api_org_.
_TOKEN = re.compile(r"\b(?:hf|api_org)_[A-Za-z0-9]{6,}")
_HEADER = re.compile(r"(?i)\b(bearer|authorization:?)\s+(?!bearer)[^\s'\"]+")
# Addresses of stores carry what signs them behind the question mark.
_QUERY = re.compile(r"(https?://[^\s'\"<>?]+)\?[^\s'\"<>]+")
# A mirror may ask for a password, which its address holds then.
_LOGIN_OF_ADDRESS = re.compile(r"(https?://)[^\s'\"<>/@]+@")
_HIDDEN = "hf_***"

_MOST_S = 1e9  # for numbers of thousands of digits
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LOGIN = "log in with `hf auth login` (or set HF_TOKEN)"
_AGAIN = "next: check the network, and HF_ENDPOINT if you set it, and run the same command again"
# Raised by what reads an answer that has another form than expected.
_UNREADABLE = (ValueError, TypeError, LookupError, AttributeError, RecursionError)

# By the name of the exception's class or of one that it derives from, by status, or by another key that
# `_keys` gives. In order: the first entry that fits any error of the chain is the most telling.
_SENTENCES = {
    "full": "no space is left on the device{place} while {task}; nothing half-written counts as intact; "
    "next: free some space, or choose another place with --out or HF_HOME, and run it again",
    "PermissionError": "may not write{place} while {task}; next: choose another place with --out or HF_HOME",
    "GatedRepoError": "{subject} is gated; next: accept its terms at {page}{login}",
    "RepositoryNotFoundError": f"{{subject}} was not found, or is private and {{who}} may not see it; next: "
    f"check the name, or {_LOGIN} as someone who may",
    "RevisionNotFoundError": "{subject} has no revision {revision!r}; next: see what it has at {page}",
    "no file": "{subject} has no file {file!r}; next: see what it has at {page}/tree/main",
    "HFValidationError": "{repo_id!r} is not a name of a repository; next: give USER/NAME",
    "LocalTokenNotFoundError": f"{{task}} needs a login, and there is no token here; next: {_LOGIN}",
    "401": "the Hub does not know the token ({source}), it is mistyped, expired or deleted; nothing can be "
    "read with it, not even {subject}; next: log in with `hf auth login --force`, or set another HF_TOKEN",
    "403": "the Hub forbids {task}: {words}; next: use a token of role `write`, and a name of your own",
    "429": "the Hub wants fewer requests (429) while {task}; next: try again {wait}, what arrived is kept",
    "5xx": "the Hub is in trouble while {task}: it answered {status}; next: try again {wait}, what arrived "
    "is kept",
    "4xx": "the Hub refused {task} ({status}): {words}; next: correct what it names",
    "offline": "HF_HUB_OFFLINE forbids {task}{uncached}; next: unset HF_HUB_OFFLINE once",
    "ConnectError": f"the Hub at {{endpoint}} cannot be reached ({{kind}}) while {{task}}{{uncached}}; "
    f"{_AGAIN}",
    "TimeoutError": f"the Hub at {{endpoint}} does not answer in time while {{task}}{{uncached}}; {_AGAIN}",
    "TooLargeError": "{endpoint} does not answer as a Hub does while {task} ({kind}: {words}); next: check "
    "HF_ENDPOINT, and whether the network asks for a login",
    "ConnectionError": "the connection to the Hub broke while {task}; next: run the same command again, it "
    "continues where it stopped",
    "OSError": "{task} failed: {kind}: {words}; next: check the network and run the same command again",
}
_CLASSES = {"full": StorageError, "PermissionError": StorageError, "HFValidationError": InputError}
# Other names of the same: of the HTTP library, of the client, and of Python.
_SAME = {
    "OfflineModeIsEnabled": "offline",
    "TimeoutException": "TimeoutError",
    "UnsupportedProtocol": "ConnectError",
    "ConnectionRefusedError": "ConnectError",
    "RequestError": "ConnectionError",
    "FileMetadataError": "TooLargeError",
    # Of clients before 1.0, by requests.
    "NewConnectionError": "ConnectError",
    "InvalidSchema": "ConnectError",
    "MissingSchema": "ConnectError",
    "Timeout": "TimeoutError",
    "InvalidJSONError": "TooLargeError",
    "RequestException": "ConnectionError",
}


def scrub(text: str) -> str:
    """Return a text without the token in use, without what looks like one, and without signatures."""
    from huggingface_hub import get_token

    token = get_token()
    if token:
        text = text.replace(token, _HIDDEN)
    text = _LOGIN_OF_ADDRESS.sub(r"\1***@", _QUERY.sub(r"\1", text))
    return _HEADER.sub(rf"\1 {_HIDDEN}", _TOKEN.sub(_HIDDEN, text))


def shown_cause(error: Exception) -> Exception | None:
    """Return an error as the cause to show; None when it quotes a token, as the HTTP library can."""
    return error if all(scrub(str(link)) == str(link) for link in cause_chain(error)) else None


def cause_chain(error: BaseException) -> list[BaseException]:
    """Return an error and what it was raised from, outermost first."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:
        chain.append(link)
        link = link.__cause__ or link.__context__
    return chain


def class_names(error: BaseException) -> list[str]:
    """Return the names of an error's class and of those that it derives from.

    By name, as each major release of the client has another HTTP library.
    """
    return [kind.__name__ for kind in type(error).__mro__]


def status_of(error: BaseException) -> int | None:
    """Return the HTTP status that an error carries."""
    status = getattr(getattr(error, "response", None), "status_code", None)
    return int(status) if status is not None else None


def requested_wait_s(error: BaseException) -> float:
    """Return for how long the answer asks to wait that an error carries, seconds; 0 where it does not."""
    for link in cause_chain(error):
        headers = getattr(getattr(link, "response", None), "headers", None)
        if headers is not None:
            return requested_s(headers)
    return 0.0


def requested_s(headers: Any) -> float:
    """Return for how long the head of an answer asks to wait, seconds; 0 where it does not."""
    # Such as "api";r=0;t=55: no requests are left for 55 seconds.
    spent = re.search(r"\br=0\s*;\s*t=(\d+)", str(headers.get("RateLimit", "")))
    text = spent[1] if spent else str(headers.get("Retry-After", "")).strip()
    return min(float(text), _MOST_S) if re.fullmatch("[0-9]+", text) else 0.0


@contextlib.contextmanager
def named_failures(repo_id: str, revision: str | None = None, doing: str = "reading") -> Iterator[None]:
    """Turn every failure of the Hub, the network and its cache into an error of the toolkit.

    ``doing`` says what is done to the repository: ``"reading"``, ``"uploading to"``, ... Raises HubError (not
    allowed, not there, not reached), StorageError (no space, no permission) or InputError (not a name).
    """
    try:
        yield
    except Exception as error:
        failure = failure_of(error, repo_id, revision, doing)
        if failure is None:
            raise
        raise failure from shown_cause(error)


@contextlib.contextmanager
def storage_failure_as_hub_error() -> Iterator[None]:
    """Give a full disk the exit code of HubError: to scripts it is a download that did not end."""
    try:
        yield
    except StorageError as error:
        error.exit_code = HubError.exit_code
        raise


def not_cached(repo_id: str, what: str) -> HubError:
    """Return the error for what is missing in the cache while the Hub cannot be asked."""
    from huggingface_hub import constants

    why = f"the Hub at {constants.ENDPOINT} gives no answer now"
    then = "check the network, and run the same command again"
    if constants.HF_HUB_OFFLINE:
        why, then = "HF_HUB_OFFLINE forbids to fetch it", "unset HF_HUB_OFFLINE once"
    return HubError(f"{what} of Hub data set {repo_id!r} is not in the cache, and {why}; next: {then}")


def failure_of(
    error: Exception,
    repo_id: str,
    revision: str | None = None,
    doing: str = "reading",
    tries: int = 1,
    *,
    is_answer: bool = False,
) -> ToolkitError | None:
    """Return the error for a failure that came after so many tries; None where it is not one of the Hub.

    Where nothing but an answer of the Hub was read (``is_answer``), what cannot be read is not one.
    """
    chain = cause_chain(error)
    if any(isinstance(link, ToolkitError) for link in chain):
        return None
    found = [(key, link) for link in chain for key in _keys(link)]
    if is_answer and isinstance(error, _UNREADABLE):
        found.append(("TooLargeError", error))
    for key, sentence in _SENTENCES.items():
        link = next((link for name, link in found if name == key), None)
        if link is not None:
            text = sentence.format(repo_id=repo_id, revision=revision, **_facts(link, repo_id, doing))
            head, next_step, rest = text.partition("; next: ")
            often = f" (tried {tries} times)" if tries > 1 else ""
            # One by one: what is hidden at the end of the first reaches over its semicolon.
            return _CLASSES.get(key, HubError)(f"{scrub(head)}{often}{next_step}{scrub(rest)}")
    return None


def _keys(error: BaseException) -> Iterator[str]:
    """Yield the keys of the sentences that fit an error."""
    from huggingface_hub import constants

    status, names, number = status_of(error), class_names(error), getattr(error, "errno", None)
    if status is not None:
        yield "LocalTokenNotFoundError" if status == 401 and not _token_source() else str(status)
        yield "5xx" if status >= 500 else "4xx"
        if "EntryNotFoundError" in names:  # without a status: not in the cache
            yield "no file"
    if number in _FULL:
        yield "full"
    if number == errno.EROFS:
        yield "PermissionError"
    if "LocalEntryNotFoundError" in names and constants.HF_HUB_OFFLINE:
        yield "offline"
    for name in names:
        yield _SAME.get(name, name)


def _facts(error: BaseException, repo_id: str, doing: str) -> dict[str, Any]:
    """Return what the sentences are made of."""
    from huggingface_hub import constants

    words = str(getattr(error, "server_message", None) or error).strip().partition("\n")[0]
    address = str(getattr(getattr(error, "response", None), "url", ""))
    filename, wait_s, source = getattr(error, "filename", None), requested_wait_s(error), _token_source()
    return {
        "subject": f"Hub data set {repo_id!r}",
        "task": f"{doing} Hub data set {repo_id!r}",
        "kind": type(error).__name__,
        "words": words[:300],
        "status": status_of(error),
        "page": f"{constants.ENDPOINT}/datasets/{repo_id}",
        "endpoint": constants.ENDPOINT,
        "place": f" ({filename!r})" if filename else "",
        "file": re.sub(r".*/resolve/[^/]+/|[?#].*", "", address),
        "source": source,
        "who": f"the account of your token ({source})" if source else "you, who are not logged in,",
        "login": "" if source else f" and {_LOGIN}",
        "wait": f"in {wait_s:.0f} s" if wait_s else "in some minutes",
        "uncached": ", which is not in the cache as far as asked for" if doing == "reading" else "",
    }


def _token_source() -> str:
    """Return where the token in use comes from; empty without one."""
    from huggingface_hub import get_token

    if not get_token():
        return ""
    return "HF_TOKEN" if os.environ.get("HF_TOKEN") else "stored login"
