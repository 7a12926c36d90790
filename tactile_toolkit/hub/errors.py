"""What went wrong with the Hub, in words that say what to do next.

The client libraries raise a dozen kinds of errors, wrap some in others, and tell a private repository from a
missing one by nothing at all. :func:`failure_of` looks through all that and names the failure once.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from tactile_toolkit.errors import HubError, InputError, StorageError, ToolkitError

__all__ = [
    "cause_chain",
    "failure_of",
    "is_connection_failure",
    "named_failures",
    "not_cached",
    "require_repository_name",
    "scrub",
    "shown_cause",
    "status_of",
    "storage_failure_as_hub_error",
]

# Tokens of users begin with hf_, those of organisations with api_org_.
_TOKEN = re.compile(r"\b(?:hf|api_org)_[A-Za-z0-9]{6,}")
_HEADER = re.compile(r"(?i)\b(bearer|authorization:?)\s+(?!bearer)[^\s'\"]+")
# Addresses of stores carry what signs them behind the question mark.
_QUERY = re.compile(r"(https?://[^\s'\"<>?]+)\?[^\s'\"<>]+")
_HIDDEN = "hf_***"

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
_LOGIN = "log in with `hf auth login` (or set HF_TOKEN)"


def scrub(text: str) -> str:
    """Return a text without the token in use, without what looks like one, and without signatures."""
    from huggingface_hub import get_token

    token = get_token()
    if token:
        text = text.replace(token, _HIDDEN)
    return _HEADER.sub(rf"\1 {_HIDDEN}", _TOKEN.sub(_HIDDEN, _QUERY.sub(r"\1", text)))


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


def status_of(error: BaseException) -> int | None:
    """Return the HTTP status that an error carries."""
    status = getattr(getattr(error, "response", None), "status_code", None)
    return int(status) if status is not None else None


def is_connection_failure(error: BaseException) -> bool:
    """Tell an error of the HTTP library, which is another one in each major release of huggingface_hub."""
    roots = {kind.__module__.partition(".")[0] for kind in type(error).__mro__}
    libraries = {"httpx", "httpx2", "httpcore", "httpcore2", "requests", "urllib3", "aiohttp"}
    return status_of(error) is None and bool(roots & libraries)


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
    """Say what is missing in the cache while the Hub cannot be asked."""
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        why, then = "HF_HUB_OFFLINE forbids to fetch it", "unset HF_HUB_OFFLINE once"
    else:
        why = f"the Hub at {constants.ENDPOINT} gives no answer now"
        then = "check the network, and run the same command again"
    return HubError(f"{what} of Hub data set {repo_id!r} is not in the cache, and {why}; next: {then}")


def require_repository_name(repo_id: str) -> None:
    """Refuse what is not ``USER/NAME``: the Hub would make a repository of a bare name, and lose it."""
    from huggingface_hub import errors

    client: Any = import_module("huggingface_hub.utils")  # its names are not exported to type checkers
    with named_failures(repo_id):
        if repo_id.count("/") != 1:
            raise errors.HFValidationError
        client.validate_repo_id(repo_id)


def failure_of(
    error: Exception,
    repo_id: str,
    revision: str | None = None,
    doing: str = "reading",
    tries: int = 1,
    *,
    is_answer: bool = False,
) -> ToolkitError | None:
    """Name a failure that came after so many tries; None for one that has nothing to do with the Hub.

    Where nothing but an answer of the Hub was read (``is_answer``), what cannot be read is not one.
    """
    chain = cause_chain(error)
    if any(isinstance(link, ToolkitError) for link in chain):
        return None
    request = _Request(repo_id, revision, doing)
    # The most telling question first, of every link: what wraps an error says less than the error itself.
    questions = (request.storage, request.client_error, request.status, request.network, request.other)
    for question in questions:
        for link in chain:
            found = question(link)
            if found is not None:
                often = f" (tried {tries} times)" if tries > 1 else ""
                head, next_step, rest = str(found).partition("; next: ")
                return type(found)(scrub(f"{head}{often}{next_step}{rest}"))
    # A page for people (a login of the network), a list where names were expected, ...
    if is_answer and isinstance(error, (ValueError, TypeError, LookupError, AttributeError, RecursionError)):
        return HubError(request.not_a_hub(f"{type(error).__name__}: {_server_words(error)}"))
    return None


@dataclass(frozen=True, slots=True)
class _Request:
    """What was asked of the Hub; each method names one sort of failure, or returns None for any other."""

    repo_id: str
    revision: str | None
    doing: str

    @property
    def subject(self) -> str:
        return f"Hub data set {self.repo_id!r}"

    @property
    def task(self) -> str:
        return f"{self.doing} {self.subject}"

    def storage(self, error: BaseException) -> ToolkitError | None:
        if not isinstance(error, OSError) or status_of(error) is not None:
            return None
        where = f" ({error.filename!r})" if error.filename else ""
        if error.errno in _FULL:
            return StorageError(
                f"no space is left on the device{where} while {self.task}; nothing "
                "half-written counts as whole; next: free some space, or choose another place with --out or "
                "HF_HOME, and run it again"
            )
        if error.errno in _FORBIDDEN:
            return StorageError(
                f"may not write{where} while {self.task}: {error.strerror}; next: choose "
                "another place with --out or HF_HOME"
            )
        return None

    def client_error(self, error: BaseException) -> ToolkitError | None:
        """Name the errors that the client has a type of its own for."""
        from huggingface_hub import constants, errors

        page, logged_in = f"{constants.ENDPOINT}/datasets/{self.repo_id}", bool(_token_source())
        accept = f"accept its terms at {page}" + ("" if logged_in else f", and {_LOGIN}")
        unseen = (
            "your token may not see it; next: check the name, or log in with `hf auth login` as someone who "
            "may"
            if logged_in
            else f"you are not logged in; next: check the name, or {_LOGIN}"
        )
        address = str(getattr(getattr(error, "response", None), "url", ""))
        file = re.sub(r".*/resolve/[^/]+/|[?#].*", "", address)
        # In this order: that a repository is gated is, to the client, a kind of its not being found.
        words: dict[type[Exception], str] = {
            errors.LocalTokenNotFoundError: self._needs_login(),
            errors.GatedRepoError: f"{self.subject} is gated; next: {accept}",
            errors.RepositoryNotFoundError: f"{self.subject} was not found, or is private and {unseen}",
            errors.RevisionNotFoundError: (
                f"{self.subject} has no revision {self.revision!r}; next: see its branches and tags at {page}"
            ),
            errors.RemoteEntryNotFoundError: (
                f"{self.subject} has no file {file!r}; next: see what it has at {page}/tree/main"
            ),
        }
        if isinstance(error, errors.HFValidationError):
            return InputError(f"{self.repo_id!r} is not a name of a repository; next: give USER/NAME")
        return next((HubError(text) for kind, text in words.items() if isinstance(error, kind)), None)

    def status(self, error: BaseException) -> ToolkitError | None:
        """Name what the Hub answered with a bare status."""
        status = status_of(error)
        if status is None:
            return None
        wait = getattr(getattr(error, "response", None), "headers", {}).get("Retry-After")
        when = f"in {wait} s" if wait and str(wait).isdigit() else "in some minutes"
        doing = self.task
        words = {
            409: f"{self.subject} has that already: {_server_words(error)}; next: choose another name",
            412: f"{self.subject} was changed by someone else meanwhile; next: run the same command again",
            429: (
                f"the Hub wants fewer requests (429) while {doing}; next: try again {when}, what has "
                "arrived is kept"
            ),
        }
        if status == 401:
            return HubError(self._unauthorized())
        if status == 403:
            return HubError(self._forbidden(error))
        if status >= 500:
            return HubError(
                f"the Hub is in trouble while {doing}: it answered {status}; next: try again later, what has "
                "arrived is kept"
            )
        refused = f"the Hub refused {doing} ({status}): {_server_words(error)}; next: mend what it names"
        return HubError(words.get(status, refused))

    def network(self, error: BaseException) -> ToolkitError | None:
        from huggingface_hub import constants, errors

        doing = self.task
        not_here = isinstance(error, errors.LocalEntryNotFoundError) and constants.HF_HUB_OFFLINE
        if isinstance(error, errors.OfflineModeIsEnabled) or not_here:
            if self.doing.startswith("uploading"):
                return HubError(f"HF_HUB_OFFLINE forbids {doing}; next: unset HF_HUB_OFFLINE")
            return HubError(
                f"{self.subject} is not in the cache as far as asked for, and HF_HUB_OFFLINE forbids to "
                "fetch it; next: unset HF_HUB_OFFLINE once"
            )
        if not is_connection_failure(error) and not isinstance(error, (TimeoutError, ConnectionError)):
            return None
        kind, hub = type(error).__name__, f"the Hub at {constants.ENDPOINT}"
        again = "next: check the network, and HF_ENDPOINT if you set it, and run the same command again"
        cached = ", which is not in the cache as far as asked for" if self.doing == "reading" else ""
        if not re.match(r"https?://[^/]", constants.ENDPOINT):
            return HubError(
                f"HF_ENDPOINT is {constants.ENDPOINT!r}, which is not an address, so that {doing} cannot "
                "begin; next: unset it, or set one such as https://huggingface.co"
            )
        if isinstance(error, TimeoutError) or "Timeout" in kind:
            return HubError(f"{hub} does not answer in time while {doing}{cached}; {again}")
        if isinstance(error, ConnectionRefusedError) or kind in ("ConnectError", "ClientConnectorError"):
            return HubError(f"{hub} cannot be reached ({kind}) while {doing}{cached}; {again}")
        return HubError(
            f"the connection to the Hub broke while {doing}; next: run the same command again, it goes on "
            "where it stopped"
        )

    def other(self, error: BaseException) -> ToolkitError | None:
        """Name what is left of the client's and the system's errors."""
        from huggingface_hub import errors

        if isinstance(error, errors.FileMetadataError):
            return HubError(self.not_a_hub("FileMetadataError"))
        if isinstance(error, errors.LocalEntryNotFoundError):
            return HubError(
                f"{self.subject} is not in the cache as far as asked for, and could not be fetched; next: "
                "check the network and run the same command again"
            )
        if isinstance(error, OSError):
            what = f"{type(error).__name__}: {_server_words(error)}"
            return HubError(f"{self.task} failed: {what}; next: try again")
        return None

    def not_a_hub(self, found: str) -> str:
        from huggingface_hub import constants

        return (
            f"{constants.ENDPOINT} does not answer as a Hub does while {self.task} ({scrub(found)}); next: "
            "check HF_ENDPOINT, and whether the network asks for a login"
        )

    def _needs_login(self) -> str:
        return f"{self.task} needs a login, and there is no token here; next: {_LOGIN}"

    def _unauthorized(self) -> str:
        source = _token_source()
        if not source:
            return self._needs_login()
        renew = "set another one, or unset it" if source == "HF_TOKEN" else "`hf auth login --force`"
        return (
            f"the Hub does not know the token ({source}), it is mistyped, expired or deleted; nothing can be "
            f"read with it, not even {self.subject}; next: {renew}"
        )

    def _forbidden(self, error: BaseException) -> str:
        """Ask the Hub whose token this is: its refusals read the same for a weak token and another's name."""
        from huggingface_hub import HfApi

        doing, namespace = self.task, self.repo_id.partition("/")[0]
        person: dict[str, Any] = {}
        # Only to word the refusal better: whatever goes wrong here must not hide that refusal.
        with contextlib.suppress(Exception):
            person = HfApi().whoami()
        name = str(person.get("name", ""))
        if person.get("auth", {}).get("accessToken", {}).get("role") == "read":
            return (
                f"the token of {name!r} has no write access, which {doing} needs; next: make one of role "
                "`write` in your settings on the Hub and `hf auth login` with it"
            )
        own = [name, *(str(entry["name"]) for entry in person.get("orgs", ()))]
        if name and namespace not in own:
            return (
                f"{name!r} may not write under the name {namespace!r}, which is someone else's ({doing}); "
                f"next: use a name of your own: {', '.join(own)}"
            )
        return (
            f"the Hub forbids {doing}: {_server_words(error)}; next: check what your token may do in your "
            "settings on the Hub"
        )


def _token_source() -> str:
    """Return where the token in use comes from (``"HF_TOKEN"`` or ``"stored login"``); empty without one."""
    from huggingface_hub import get_token

    if not get_token():
        return ""
    named = any(os.environ.get(name) for name in ("HF_TOKEN", "HUGGING_FACE_HUB_TOKEN"))
    return "HF_TOKEN" if named else "stored login"


def _server_words(error: BaseException) -> str:
    words = getattr(error, "server_message", None) or str(error)
    lines = [line.strip() for line in str(words).splitlines() if line.strip()]
    return lines[0][:300] if lines else type(error).__name__
