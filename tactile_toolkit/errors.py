"""The only exception types of the project, named by what the reader of the message must do.

::

    ToolkitError                 (exit code 1)
    +-- InputError               change what you gave: a path, an option, a file        (2)
    |   +-- SpecMismatchError    the folder belongs to another specification
    |   +-- MissingExtraError    install an optional package
    |   +-- BusyError            another process holds the folder or file: wait for it, or end it
    |   +-- StorageError         make room, or choose a writable folder (4: in a download)
    |   +-- ItemError            one image or mesh cannot be used; the run lists it and continues
    +-- UnfinishedError          wait for the run that makes the data set, or give its command again (1)
    +-- IntegrityError           stored data is damaged: fetch or make it again       (3)
    +-- RemoteError              an object store or the network failed                (4)
        +-- HubError             the Hub failed

Every message names the file, row or option, what was found, what was expected, and the next step.

Keys, tokens and passwords are redacted. An address from a user that may hold one is refused, not repeated.
Messages, which may quote clients and servers, are searched for anything that looks like a secret.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager

from tactile_toolkit import wording

# `pathlib` leaves one slash of an address. A single letter is a drive of Windows.
_ADDRESS = re.compile(
    r"(?:-[A-Za-z]|--[\w-]+=)?\s*(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+)://?(?P<rest>.*)", re.DOTALL
)
# An address of scp or rsync, USER:PASSWORD@HOST:PATH. A single letter is a drive of Windows.
_COPY_ADDRESS = re.compile(
    r"(?P<option>-[A-Za-z]|--[\w-]+=)?[^/\\@:\s]{2,}:[^/]*(?P<host>@[\w.-]+[:/].*)", re.DOTALL
)
_COPY_LOGIN = re.compile(r"(?<![^\s'\"<>=])[^\s'\"<>/@:]{2,}:[^\s'\"<>/@]+@(?=[\w.-]+[:/])")
# Everything else may be a user, a key, a password, a signature or a parameter.
_PLAIN = re.compile(r"[^/@?#;:%]*(?::[0-9]{1,5})?(?:/[^@?#;]*)?")
_PLAIN_ON_HUB = re.compile(rf"datasets/[^/@?#;:]+/[^?#;:]*|{_PLAIN.pattern}")
_PLAIN_LOCAL = re.compile(rf"/.*|{_PLAIN.pattern}", re.DOTALL)
_PLAIN_BY_SCHEME = {"hf": _PLAIN_ON_HUB, "file": _PLAIN_LOCAL, "local": _PLAIN_LOCAL}
_LOGIN = re.compile(r"(\w://)(?:[^/\s'\"<>@]*|[^/\s'\"<>@:]*:(?![0-9]+/)[^\s'\"<>]*)@")
_SIGNED = re.compile(r"(\w://[^\s'\"<>?#;]+)[?#;](?!\.\.\.)[^\s'\"<>]+?(?=;?(?:[\s'\"<>]|$))")
# Access keys of S3; tokens of users (hf_) and organisations (api_org_) of the Hub.
_TOKEN = re.compile(r"\b(?:(?:AKIA|ASIA)[A-Z0-9]{12,}|(?:hf|api_org)_[A-Za-z0-9]{10,})")
_HEADER = re.compile(
    r"(?i)\b(authorization['\"]?\s*[:=]\s*['\"]?(?:(?:basic|bearer|digest|token)\s+)?|bearer\s+)[^\s'\";,]+"
)
_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_RESOURCE_ERRNOS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EINTR)
_SHORTEST = 8  # shorter secrets are those of tests, such as the word `test`, which is also a split


class ToolkitError(Exception):
    """Root of all errors that the toolkit raises on purpose; quoted data is printed as escapes, if needed.

    Parameters
    ----------
    what : str
        What was found where, and what was expected.
    next : str
        What the reader can do about it.
    field : str
        Parameter with which the message begins, such as ``half_thickness_mm``; ``what`` continues after it.
        A command line names its option instead.
    """

    exit_code = 1

    def __init__(self, what: object = "", next: str = "", *, field: str = "") -> None:
        self.field = field
        # Kept apart: a path may contain the words "; next: ".
        self._found = redact(str(what))
        self._next = redact(f"; next: {next}") if next else ""
        # The whole message. Not a property: a loader of torch would make the error of a worker anew by it.
        self.message = self.naming(field)
        super().__init__(self.message)

    @property
    def what(self) -> str:
        """What was found, without the next step."""
        return wording.printable(f"{self.field} {self._found}".removeprefix(" "))

    @property
    def step(self) -> str:
        """The next step; empty if none is stated."""
        return self._next.removeprefix("; next: ")

    def naming(self, field: str) -> str:
        """Return the message with another name for its parameter, such as that of an option."""
        return f"{field} {self._found}{self._next}".removeprefix(" ")

    def __str__(self) -> str:
        return wording.printable(self.message)


class InputError(ToolkitError):
    """A path, option, file or value given by the user cannot be used."""

    exit_code = 2

    @classmethod
    def of_system(cls, error: OSError) -> InputError:
        """Return the error for a file that the system refused to open, read or write."""
        reason = resource_shortage(error) or f"{error.strerror}; next: give another path"
        return cls(f"{str(error.filename)!r}: {reason}")


def require_public(address: str) -> None:
    """Raise InputError for an address that may hold a user, key or signature, without repeating it."""
    shown = public_address(address)
    if shown != address:
        raise InputError(
            f"the address {shown!r} may hold a user, a key or a signature; expected none of @ ? # ; in it",
            next="give credentials as the store's own tools take them, such as AWS_PROFILE",
        )


def resource_shortage(error: Exception) -> str | None:
    """Return a message for an error of scarce resources (memory, file handles); None for other errors."""
    if isinstance(error, MemoryError):
        error = OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
    if not isinstance(error, OSError) or error.errno not in _RESOURCE_ERRNOS:
        return None
    return (
        f"{error.strerror}; next: end programs that are not needed, raise the limit of open files "
        "(ulimit -n) or use fewer --workers, and run it again"
    )


class SpecMismatchError(InputError):
    """A data set folder was made by another specification than the requested one."""


class MissingExtraError(InputError):
    """A feature needs an optional package that is not installed.

    Parameters
    ----------
    feature : str
        The requested feature, in the user's words.
    package : str
        The package that is missing.
    extra : str
        The extra of this project that installs it.
    """

    def __init__(self, feature: str, package: str, extra: str) -> None:
        super().__init__(
            f"{feature} needs the package {package!r}, which is not installed", next=install_line(extra)
        )
        self.args = (feature, package, extra)  # by which it crosses process borders


@contextmanager
def needs_extra(feature: str, package: str, extra: str) -> Iterator[None]:
    """Turn an ImportError into the :class:`MissingExtraError` of a feature."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(feature, package, extra) from error


def install_line(extra: str) -> str:
    """Return the pip command for the packages of an extra, with or without a checkout of the toolkit."""
    # Imported here: every command line starts with this file.
    import shlex
    from importlib.metadata import PackageNotFoundError, requires

    try:
        entries = [entry.partition(";") for entry in requires("tactile-toolkit") or ()]
    except PackageNotFoundError:
        entries = []
    # Build tools write either kind of quotes.
    names = [name.strip() for name, _, marker in entries if re.search(rf"extra == ['\"]{extra}['\"]", marker)]
    packages = " ".join(map(shlex.quote, names)) or f"'.[{extra}]'"
    return f"pip install {packages} (the extra `{extra}`)"


class BusyError(InputError):
    """Another process holds the lock of a file or folder."""


class StorageError(InputError):
    """Data could not be written: no space left, no permission, a read-only folder."""


class ItemError(InputError):
    """One item of a source cannot be turned into a row.

    Parameters
    ----------
    reason : str
        A short, stable word for tables and manifests, such as ``"no-ink"``.
    message : str
        What was found where, and what was expected.
    next : str
        What the reader can do about it.
    """

    def __init__(self, reason: str, message: str, next: str = "") -> None:
        super().__init__(message, next)
        self.reason = reason
        self.args = (reason, self.message)


class UnfinishedError(ToolkitError):
    """The run that makes a data set is under way or was interrupted; its finished shards are intact."""


class IntegrityError(ToolkitError):
    """Stored data does not match its checksum, schema or row count."""

    exit_code = 3

    @classmethod
    def in_file(cls, path: str, problem: str) -> IntegrityError:
        """Return the error for a file of a data set; ``problem`` follows the quoted path."""
        again = "make or fetch it again; `verify` names everything that is damaged in a data set"
        return cls(f"{path!r}{problem}", next=again)


class RemoteError(ToolkitError):
    """An object store or the network refused or failed: no connection, no credentials, no permission."""

    exit_code = 4


class HubError(RemoteError):
    """The Hugging Face Hub, or the network on the way there, refused or failed."""


def public_address(address: str) -> str:
    """Return an address that may be shown; of one that may hold a secret, only the scheme.

    An option in front of it stays, as in ``--out=s3://...``.
    """
    match = _ADDRESS.fullmatch(address)
    if match is None:
        copied = _COPY_ADDRESS.fullmatch(address)
        return address if copied is None else f"{copied['option'] or ''}...{copied['host']}"
    plain = _PLAIN_BY_SCHEME.get(match["scheme"].lower(), _PLAIN)
    if plain.fullmatch(match["rest"]):
        return address
    return f"{address[: match.start('rest')]}..."


def redact(text: str, *secrets: str | None) -> str:
    """Return a text for a message, without keys, tokens, and users and signatures in addresses."""
    for secret in (*secrets, *map(os.environ.get, _SECRET_VARIABLES)):
        if secret and len(secret) >= _SHORTEST:
            text = text.replace(secret, "***")
    text = _HEADER.sub(r"\1***", _TOKEN.sub("***", text))
    return _SIGNED.sub(r"\1?...", _COPY_LOGIN.sub("...@", _LOGIN.sub(r"\1...@", text)))
