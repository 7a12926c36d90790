"""What went wrong with the Hub, in words that say what to do next.

The client libraries raise a dozen kinds of errors, wrap some in others, and tell a private repository from a
missing one by nothing at all. :func:`failure_of` looks through all that and names the failure once.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterable, Iterator

from tactile_toolkit.errors import HubError, InputError, StorageError, ToolkitError

__all__ = [
    "cause_chain",
    "ends_a_download",
    "failure_of",
    "is_connection_failure",
    "is_scrubbed",
    "named_failures",
    "not_cached",
    "scrub",
    "shown_cause",
    "status_of",
    "token_state",
    "whose_token",
]

_TOKEN = re.compile(r"\b(?:hf|api_org)_[A-Za-z0-9]{6,}")
_HEADER = re.compile(r"(?i)\b(bearer|authorization:?)\s+(?!bearer)[^\s'\"]+")
# Addresses of stores carry what signs them behind the question mark.
_QUERY = re.compile(r"(https?://[^\s'\"<>?]+)\?[^\s'\"<>]+")
_HIDDEN = "hf_***"


def token_state() -> str:
    """Return where the token in use comes from (``"HF_TOKEN"`` or ``"stored login"``); empty without one."""
    from huggingface_hub import get_token

    if not get_token():
        return ""
    named = any(os.environ.get(name) for name in ("HF_TOKEN", "HUGGING_FACE_HUB_TOKEN"))
    return "HF_TOKEN" if named else "stored login"


def scrub(text: str) -> str:
    """Return a text without the token in use, without what looks like one, and without signatures."""
    from huggingface_hub import get_token

    token = get_token()
    if token:
        text = text.replace(token, _HIDDEN)
    return _HEADER.sub(rf"\1 {_HIDDEN}", _TOKEN.sub(_HIDDEN, _QUERY.sub(r"\1", text)))


def is_scrubbed(errors: Iterable[BaseException]) -> bool:
    """Tell whether errors can be shown as they are, without a token in any of them."""
    return all(scrub(str(error)) == str(error) for error in errors)


def whose_token() -> tuple[str, str, tuple[str, ...]]:
    """Ask the Hub for name, role and organisations of the token in use; empty when it does not say."""
    from huggingface_hub import HfApi

    try:
        person = HfApi().whoami()
        role = str(person.get("auth", {}).get("accessToken", {}).get("role", ""))
        return str(person["name"]), role, tuple(str(entry["name"]) for entry in person.get("orgs", ()))
    except Exception:
        # Only to word a refusal better: whatever goes wrong here must not hide that refusal.
        return "", "", ()


_NEXT_LOGIN = "log in with `hf auth login` (or set HF_TOKEN)"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)


@contextlib.contextmanager
def named_failures(repo_id: str, revision: str | None = None, doing: str = "reading") -> Iterator[None]:
    """Turn every failure of the Hub, the network and its cache into an error of the toolkit.

    Parameters
    ----------
    repo_id : str
        ``USER/NAME``, for the message.
    revision : str, optional
        Branch, tag or commit that was asked for.
    doing : str
        What is done to the repository: ``"reading"``, ``"uploading to"``, ...

    Raises
    ------
    HubError
        Not logged in, not allowed, not there, not reached, or refused; the message says which and what to do.
    StorageError
        The disk is full or may not be written to.
    InputError
        ``repo_id`` is no name of a repository.
    """
    try:
        yield
    except Exception as error:
        failure = failure_of(error, repo_id, revision, doing)
        if failure is None:
            raise
        raise failure from shown_cause(error)


def failure_of(
    error: Exception, repo_id: str, revision: str | None = None, doing: str = "reading", tries: int = 1
) -> ToolkitError | None:
    """Name a failure; None for an error that has nothing to do with the Hub.

    Parameters
    ----------
    error : Exception
        As it was raised.
    repo_id, revision, doing
        As for :func:`named_failures`.
    tries : int
        How often it was tried before giving up.
    """
    chain = cause_chain(error)
    if any(isinstance(link, ToolkitError) for link in chain):
        return None
    subject = f"Hub data set {repo_id!r}"
    for find in (_storage_failure, _named_failure, _status_failure, _network_failure, _other_failure):
        for link in chain:
            found = find(link, subject, repo_id, revision, doing)
            if found is not None:
                often = f" (tried {tries} times)" if tries > 1 else ""
                head, next_step, rest = str(found).partition("; next: ")
                return type(found)(scrub(f"{head}{often}{next_step}{rest}"))
    return None


@contextlib.contextmanager
def ends_a_download() -> Iterator[None]:
    """Give a disk that takes no more the exit code of a :class:`HubError`.

    To scripts it is the download that did not come to its end, whatever stopped it.
    """
    try:
        yield
    except StorageError as error:
        error.exit_code = HubError.exit_code
        raise


def not_cached(repo_id: str, what: str) -> HubError:
    """Say what is missing in the cache while the Hub cannot be asked."""
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        why, then = "HF_HUB_OFFLINE forbids to fetch it", "unset HF_HUB_OFFLINE once"
    else:
        why = f"the Hub at {constants.ENDPOINT} gives no answer now"
        then = "check the network, and run the same command again"
    return HubError(f"{what} of Hub data set {repo_id!r} is not in the cache, and {why}; next: {then}")


def shown_cause(error: Exception) -> Exception | None:
    """Return an error as the cause to show; None when it quotes a token, as the HTTP library can."""
    return error if is_scrubbed(cause_chain(error)) else None


def cause_chain(error: BaseException) -> list[BaseException]:
    """Return an error and what it was raised from, outermost first."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:
        chain.append(link)
        link = link.__cause__ or link.__context__
    return chain


def status_of(error: BaseException) -> int | None:
    """Return the HTTP status that an error carries."""
    response = getattr(error, "response", None)
    status = getattr(response, "status_code", None)
    return int(status) if status is not None else None


def is_connection_failure(error: BaseException) -> bool:
    """Tell an error of the HTTP library, which is another one in each major release of huggingface_hub."""
    roots = {kind.__module__.partition(".")[0] for kind in type(error).__mro__}
    libraries = {"httpx", "httpx2", "httpcore", "httpcore2", "requests", "urllib3", "aiohttp"}
    return status_of(error) is None and bool(roots & libraries)


def _storage_failure(
    error: BaseException, subject: str, repo_id: str, revision: str | None, doing: str
) -> ToolkitError | None:
    if not isinstance(error, OSError) or status_of(error) is not None:
        return None
    where = f" ({error.filename!r})" if error.filename else ""
    if error.errno in _FULL:
        return StorageError(
            f"no space is left on the device{where} while {doing} {subject}; nothing half-written counts as "
            "whole; next: free some space, or choose another place with --out or HF_HOME, and run it again"
        )
    if error.errno in _FORBIDDEN:
        return StorageError(
            f"may not write{where} while {doing} {subject}: {error.strerror}; next: choose another place "
            "with --out or HF_HOME"
        )
    return None


def _named_failure(
    error: BaseException, subject: str, repo_id: str, revision: str | None, doing: str
) -> ToolkitError | None:
    """Name the errors that the client has a type of its own for."""
    from huggingface_hub import constants, errors

    page = f"{constants.ENDPOINT}/datasets/{repo_id}"
    if isinstance(error, errors.HFValidationError):
        return InputError(f"{repo_id!r} is no name of a repository; next: give USER/NAME")
    if isinstance(error, errors.LocalTokenNotFoundError):
        return HubError(f"{doing} {subject} needs a login, and there is no token here; next: {_NEXT_LOGIN}")
    if isinstance(error, errors.GatedRepoError):
        login = "" if token_state() else f", and {_NEXT_LOGIN}"
        return HubError(f"{subject} is gated; next: accept its terms at {page}{login}")
    if isinstance(error, errors.RepositoryNotFoundError):
        return HubError(f"{subject} was not found, or is private{_why_unseen()}")
    if isinstance(error, errors.RevisionNotFoundError):
        return HubError(f"{subject} has no revision {revision!r}; next: see its branches and tags at {page}")
    if isinstance(error, errors.RemoteEntryNotFoundError):
        return HubError(f"{subject} has no file {_file_of(error)}; next: see what it has at {page}/tree/main")
    return None


def _why_unseen() -> str:
    if token_state():
        return (
            " and your token may not see it; next: check the name, or log in with `hf auth login` as someone "
            "who may"
        )
    return f" and you are not logged in; next: check the name, or {_NEXT_LOGIN}"


def _file_of(error: BaseException) -> str:
    path = str(getattr(getattr(error, "response", None), "url", ""))
    return repr(re.sub(r".*/resolve/[^/]+/|[?#].*", "", path))


def _status_failure(
    error: BaseException, subject: str, repo_id: str, revision: str | None, doing: str
) -> ToolkitError | None:
    """Name what the Hub answered with a bare status."""
    status = status_of(error)
    if status == 401:
        return HubError(_unauthorized(subject, doing))
    if status == 403:
        return HubError(_forbidden(error, subject, repo_id, doing))
    if status == 409:
        return HubError(f"{subject} has that already: {_server_words(error)}; next: choose another name")
    if status == 412:
        return HubError(f"{subject} was changed by someone else meanwhile; next: run the same command again")
    if status == 429:
        return HubError(f"the Hub wants fewer requests (429) while {doing} {subject}{_when_again(error)}")
    if status is not None and status >= 500:
        return HubError(
            f"the Hub is in trouble while {doing} {subject}: it answered {status}; next: try again later, "
            "what has arrived is kept"
        )
    if status is not None:
        words = _server_words(error)
        return HubError(f"the Hub refused {doing} {subject} ({status}): {words}; next: mend what it names")
    return None


def _unauthorized(subject: str, doing: str) -> str:
    source = token_state()
    if not source:
        return f"{doing} {subject} needs a login, and there is no token here; next: {_NEXT_LOGIN}"
    renew = "set another one, or unset it" if source == "HF_TOKEN" else "`hf auth login --force`"
    return (
        f"the Hub does not know the token ({source}), it is mistyped, expired or deleted; nothing can be "
        f"read with it, not even {subject}; next: {renew}"
    )


def _forbidden(error: BaseException, subject: str, repo_id: str, doing: str) -> str:
    """Ask the Hub whose token this is: its refusals read the same for a weak token and a wrong namespace."""
    namespace = repo_id.partition("/")[0]
    name, role, organizations = whose_token()
    if role == "read":
        return (
            f"the token of {name!r} has no write access, which {doing} {subject} needs; next: make one of "
            "role `write` in your settings on the Hub and `hf auth login` with it"
        )
    if name and namespace not in (name, *organizations):
        own = ", ".join([name, *organizations])
        return (
            f"{name!r} may not write under the name {namespace!r}, which is someone else's ({doing} "
            f"{subject}); next: use a name of your own: {own}"
        )
    return (
        f"the Hub forbids {doing} {subject}: {_server_words(error)}; next: check what your token may do in "
        "your settings on the Hub"
    )


def _server_words(error: BaseException) -> str:
    words = getattr(error, "server_message", None) or str(error)
    lines = [line.strip() for line in str(words).splitlines() if line.strip()]
    return lines[0][:300] if lines else type(error).__name__


def _when_again(error: BaseException) -> str:
    headers = getattr(getattr(error, "response", None), "headers", {})
    wait = headers.get("Retry-After")
    when = f"in {wait} s" if wait and str(wait).isdigit() else "in some minutes"
    return f"; next: try again {when}, what has arrived is kept"


def _network_failure(
    error: BaseException, subject: str, repo_id: str, revision: str | None, doing: str
) -> ToolkitError | None:
    from huggingface_hub import constants, errors

    if isinstance(error, errors.OfflineModeIsEnabled) or (
        isinstance(error, errors.LocalEntryNotFoundError) and constants.HF_HUB_OFFLINE
    ):
        if doing.startswith("uploading"):
            return HubError(f"HF_HUB_OFFLINE forbids {doing} {subject}; next: unset HF_HUB_OFFLINE")
        return HubError(
            f"{subject} is not in the cache as far as asked for, and HF_HUB_OFFLINE forbids to fetch it; "
            "next: unset HF_HUB_OFFLINE once"
        )
    if not is_connection_failure(error) and not isinstance(error, (TimeoutError, ConnectionError)):
        return None
    return HubError(_unreached(error, subject, doing))


def _unreached(error: BaseException, subject: str, doing: str) -> str:
    from huggingface_hub import constants

    kind, hub = type(error).__name__, f"the Hub at {constants.ENDPOINT}"
    again = "next: check the network, and HF_ENDPOINT if you set it, and run the same command again"
    cached = ", which is not in the cache as far as asked for" if doing == "reading" else ""
    if not re.match(r"https?://[^/]", constants.ENDPOINT):
        return (
            f"HF_ENDPOINT is {constants.ENDPOINT!r}, which is no address, so that {doing} {subject} cannot "
            "begin; next: unset it, or set one such as https://huggingface.co"
        )
    if isinstance(error, TimeoutError) or "Timeout" in kind:
        return f"{hub} does not answer in time while {doing} {subject}{cached}; {again}"
    if isinstance(error, ConnectionRefusedError) or kind in ("ConnectError", "ClientConnectorError"):
        return f"{hub} cannot be reached ({kind}) while {doing} {subject}{cached}; {again}"
    return (
        f"the connection to the Hub broke while {doing} {subject}; next: run the same command again, it goes "
        "on where it stopped"
    )


def _other_failure(
    error: BaseException, subject: str, repo_id: str, revision: str | None, doing: str
) -> ToolkitError | None:
    """Name what is left of the client's and the system's errors."""
    from huggingface_hub import constants, errors

    if isinstance(error, errors.FileMetadataError):
        return HubError(f"{constants.ENDPOINT} does not answer as a Hub does; next: check HF_ENDPOINT")
    if isinstance(error, errors.LocalEntryNotFoundError):
        return HubError(
            f"{subject} is not in the cache as far as asked for, and could not be fetched; next: check the "
            "network and run the same command again"
        )
    if isinstance(error, OSError):
        words = _server_words(error)
        return HubError(f"{doing} {subject} failed: {type(error).__name__}: {words}; next: try again")
    return None
