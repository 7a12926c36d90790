"""What goes wrong with an object store, as one sentence each that names the next step."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError, RemoteError, ToolkitError
from tactile_toolkit.store.address import shown

__all__ = ["failure_of", "is_passing", "not_installed", "shown_cause"]

_CLIENTS = {"botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "huggingface_hub", "httpx", "httpcore"}
_CLIENTS |= {"requests", "urllib3", "s3fs", "azure", "adlfs", "fsspec", "httpx2", "httpcore2"}
_PASSING = {"SlowDown", "InternalError", "ServiceUnavailable", "RequestTimeout", "OperationAborted"}
_PASSING |= {"Throttling", "ThrottlingException", "ConditionalRequestConflict", "RequestLimitExceeded"}
_PASSING |= {"408", "429", "500", "502", "503", "504"}
_BROKEN = {"ConnectionClosedError", "IncompleteRead", "IncompleteReadError", "ClientPayloadError"}
_BROKEN |= {"ResponseStreamingError", "ServerDisconnectedError", "HTTPClientError", "ClientOSError"}
_GIVE_CREDENTIALS = (
    "next: give credentials as the store's own tools take them (for S3: AWS_PROFILE, AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY, or `aws configure`)"
)
_SET_REGION = "next: set AWS_DEFAULT_REGION to that of the bucket"


@dataclass(frozen=True, slots=True)
class _Cause:
    """A sentence for the errors that have one of these codes or, with ``names``, types of these names."""

    codes: str
    names: str
    sentence: str
    kind: type[ToolkitError] = RemoteError


_CAUSES = (
    _Cause("", "FileExpired", "{where} was replaced while it was read; next: run the same command again",
           IntegrityError),
    _Cause("", "NoCredentialsError PartialCredentialsError CredentialRetrievalError ProfileNotFound "
           "TokenRetrievalError SSOTokenLoadError UnauthorizedSSOTokenError DefaultCredentialsError "
           "RefreshError",
           f"{{where}} needs credentials, and none can be used here ({{said}}); {_GIVE_CREDENTIALS}"),
    _Cause("ExpiredToken TokenRefreshRequired RequestExpired", "",
           "the credentials for {where} have expired ({code}); next: renew them, and run it again"),
    _Cause("RequestTimeTooSkewed", "",
           "{where}: the clock of this machine is wrong, says the store; next: set it right"),
    _Cause("InvalidAccessKeyId SignatureDoesNotMatch InvalidToken AuthFailure 401", "",
           f"{{where}}: the store does not take the credentials ({{code}}); {_GIVE_CREDENTIALS}"),
    # The answer of S3 to a question for the head of a file.
    _Cause("400", "",
           "{where}: the store answers '400 Bad Request' and gives no reason, as S3 does for a wrong region "
           "or expired credentials; next: set AWS_DEFAULT_REGION to the region of the bucket, check "
           "AWS_ENDPOINT_URL if you set it, and renew the credentials"),
    _Cause("", "RecursionError",
           "{where}: the store sends its client in a circle, as for a bucket of another region; "
           + _SET_REGION),
    _Cause("PermanentRedirect AuthorizationHeaderMalformed 301 307 IllegalLocationConstraint", "",
           "{where} lies in another region ({code}); " + _SET_REGION),
    _Cause("InvalidBucketName NoSuchBucketName", "InvalidBucketName ParamValidationError",
           "{where} holds no name that a bucket or file can have; next: check it", InputError),
    _Cause("403 AccessDenied AccessDeniedException AllAccessDisabled", "PermissionError",
           "{doing} {where} is refused ({code}): the store does not know these credentials, or they may not "
           f"do that; {_GIVE_CREDENTIALS}, or ask the owner of the bucket"),
)  # fmt: skip
_NO_ANSWER = (
    "the store of {where} gives no answer ({said}); finished files stay; next: check the network and the "
    "address of the store (for S3: AWS_ENDPOINT_URL), and run the same command again"
)
_OTHER = "{doing} {where} failed: {said}; finished files stay; next: run the same command again"


def failure_of(error: Exception, doing: str, address: str) -> ToolkitError | None:
    """Return the failure of a store as an error of ours; None for one that has nothing to do with it.

    ``doing`` says what was done there, such as ``"reading"``.
    """
    chain = list(_chain(error))
    if any(isinstance(link, ToolkitError) for link in chain):
        return None
    names, code, said = {type(link).__name__ for link in chain}, _code_of(chain), _said(chain)
    words = {"where": repr(address), "doing": doing, "code": code or "permission denied", "said": said}
    for cause in _CAUSES:
        if code in cause.codes.split() or names & set(cause.names.split()):
            return cause.kind(cause.sentence.format(**words))
    if _is_silence(chain):
        return RemoteError(_NO_ANSWER.format(**words))
    if code is not None or any(map(_is_of_client, chain)) or isinstance(error, OSError):
        return RemoteError(_OTHER.format(**words | {"said": f"{code}: {said}" if code else said}))
    return None


def is_passing(error: Exception) -> bool:
    """Return whether the same request may succeed a little later."""
    chain = list(_chain(error))
    return _code_of(chain) in _PASSING or _is_silence(chain)


def not_installed(address: str, scheme: str, package: str | None, error: ImportError) -> InputError:
    """Return the error for a store whose client is not installed."""
    if scheme == "s3":
        return MissingExtraError(f"{address!r}", "s3fs", "s3")
    found = f"the package {package!r}, which is not installed" if package else f"a package ({error})"
    name = package or "the one that it names"
    return InputError(f"{address!r} needs {found}; next: pip install {name}")


def shown_cause(error: Exception) -> Exception | None:
    """Return an error as the cause to show; None when its text holds a secret."""
    texts = [str(link) for link in _chain(error)]
    return error if all(_hidden(text) == text for text in texts) else None


def _chain(error: BaseException) -> Iterator[BaseException]:
    link: BaseException | None = error
    seen: list[BaseException] = []
    while link is not None and link not in seen:
        yield link
        seen.append(link)
        link = link.__cause__ or link.__context__


def _code_of(chain: list[BaseException]) -> str | None:
    """Return the word or number that a store gives for what went wrong."""
    for link in chain:
        response = getattr(link, "response", None)
        if isinstance(response, Mapping):
            return str(response.get("Error", {}).get("Code", ""))
        status = getattr(response, "status_code", None)
        if status is None and _is_of_client(link):
            status = getattr(link, "code", None) or getattr(link, "status", None)
        if isinstance(status, int):
            return str(status)
    return None


def _is_silence(chain: list[BaseException]) -> bool:
    """Return whether a store gave no answer, or broke off in the middle of one."""
    return _code_of(chain) is None and any(
        isinstance(link, (ConnectionError, TimeoutError))
        or (_is_of_client(link) and re.search("Connect|Timeout", type(link).__name__))
        or type(link).__name__ in _BROKEN
        for link in chain
    )


def _is_of_client(error: BaseException) -> bool:
    # The parser of aiohttp numbers what it cannot read (an answer that ends too early) like a status of HTTP.
    if type(error).__module__ == "aiohttp.http_exceptions":
        return False
    return any(kind.__module__.partition(".")[0] in _CLIENTS for kind in type(error).__mro__)


_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_ACCESS_KEY = re.compile(r"\b(?:AKIA|ASIA)[A-Z0-9]{12,}\b|\bhf_[A-Za-z0-9]{6,}")
_ADDRESS = re.compile(r"\w+://[^\s'\"<>]+")


def _hidden(text: str) -> str:
    """Return a text without keys, tokens and signatures."""
    for name in _SECRET_VARIABLES:
        if os.environ.get(name):
            text = text.replace(os.environ[name], "***")
    return _ADDRESS.sub(lambda match: shown(match[0]), _ACCESS_KEY.sub("***", text))


def _said(chain: list[BaseException]) -> str:
    """Return the first line of what the innermost error of a client says, or else its kind."""
    link = next((each for each in reversed(chain) if _is_of_client(each)), chain[0])
    first = (_hidden(str(link)).strip().splitlines() or [""])[0][:300]
    return first or type(link).__name__
