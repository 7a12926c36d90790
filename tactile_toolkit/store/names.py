"""What comes from outside: places as users write them, names of files, JSON documents.

Whoever wrote them may be anyone, and a name decides what is read, overwritten or deleted. Names are parsed in
one place.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, TypeVar, cast

import msgspec

from tactile_toolkit.errors import InputError, IntegrityError, require_public

T = TypeVar("T")

_SCHEME = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*)://(?P<rest>.*)", re.DOTALL)
_LOST_SLASH = re.compile(r"(?:s3a?|gs|gcs|hf|abfs|az):/(?!/)")
_LOCAL_SCHEMES = ("file", "local")
_WEB_SCHEMES = ("http", "https")
_OTHER_NAMES = {"s3a": "s3", "gcs": "gs"}

_LONGEST_BYTES = 1024
# File systems take 255 bytes; while a file is written, its name has a prefix.
_LONGEST_PART_BYTES = 150
_DRIVE = re.compile("[A-Za-z]:")
_PORTS = frozenset(f"{port}{number}" for port in ("com", "lpt") for number in "0123456789¹²³")
_WINDOWS_DEVICES = _PORTS | {"con", "prn", "aux", "nul", "conin$", "conout$"}
_SHOWN = 80
# What systems leave in folders and archives, in lower case; names that begin with a dot are hidden anyway.
_LEFT_BY_SYSTEMS = frozenset(
    {
        "__macosx",
        "@eadir",
        "#recycle",
        "$recycle.bin",
        "system volume information",
        "thumbs.db",
        "ehthumbs.db",
        "desktop.ini",
    }
)

_STEPS = frozenset({".", ".."})

_FIRST_LINE = "{\n"

LARGEST = (1 << 63) - 1
Count = Annotated[int, msgspec.Meta(ge=0, le=LARGEST)]
Sha256 = Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{64}\Z")]


def scheme_of(place: str) -> str:
    """Return the scheme of an address, such as ``s3``; empty for a local path, also in the form ``file://``."""
    match = _SCHEME.fullmatch(place)
    scheme = match["scheme"].lower() if match else ""
    return "" if scheme in _LOCAL_SCHEMES else _OTHER_NAMES.get(scheme, scheme)


def is_remote(place: str) -> bool:
    """Return whether a place is not on a local file system."""
    return bool(scheme_of(place))


def normalize_uri(place: str) -> str:
    """Return a local path without ``file://``, or an address in its one form, without a slash at its end.

    Raises InputError for an address that names no bucket, is of the web, or may hold a key or a signature.
    """
    require_public(place)
    match, scheme = _SCHEME.fullmatch(place), scheme_of(place)
    if match is None and not _LOST_SLASH.match(place):
        return place
    rest = match["rest"].rstrip("/") if match else ""
    if match and not scheme and match["rest"].startswith("/"):
        return rest or "/"
    bucket, *parts = rest.split("/")
    is_plain = rest.isprintable() and not {".", ".."} & {bucket, *parts}
    if not scheme or not bucket or scheme in _WEB_SCHEMES or not is_plain:
        raise InputError(
            f"{place!r} is not the address of a data set; expected a folder, file:///FOLDER, "
            "s3://BUCKET/FOLDER or the like, of plain names ('.', '..' and control characters are none), "
            "and not of the web",
            next="write it so, as text (pathlib.Path drops a slash; a local folder of that name is ./NAME)",
        )
    return f"{scheme}://{rest}"


def is_hidden(path: str) -> bool:
    """Return whether a listing passes over a relative path, with slashes.

    It does where a part of the path begins with a dot (``._a.png``, ``.DS_Store``) or is one that systems
    leave in folders and archives (``__MACOSX``, ``@eaDir``, ``Thumbs.db``, ``desktop.ini``, ...). A path that
    leads elsewhere (``../a.png``) is not hidden, but wrong.
    """
    parts = path.split("/")
    return any((part[:1] == "." and part not in _STEPS) or part.lower() in _LEFT_BY_SYSTEMS for part in parts)


def problem_of_name(name: object) -> str:
    """Return why a name, a path with slashes, cannot be that of a file of a data set; empty where it can."""
    is_plain = (
        isinstance(name, str)
        and name.isprintable()
        and len(name.encode(errors="replace")) <= _LONGEST_BYTES
        and all(map(_is_plain_part, name.split("/")))
    )
    return "" if is_plain else "is not the plain relative path of a visible file on every system"


def _is_plain_part(part: str) -> bool:
    return not (
        part.startswith(".")
        or part.endswith((".", " "))
        or "\\" in part
        or _DRIVE.match(part)
        or part.partition(".")[0].rstrip().casefold() in _WINDOWS_DEVICES
        or not 0 < len(part.encode(errors="replace")) <= _LONGEST_PART_BYTES
    )


def names_inside(names: Iterable[object], where: str) -> tuple[str, ...]:
    """Return names of files that belong together, if each is that of one file in a data set folder.

    ``where`` says, for the message, who gave the names. Raises IntegrityError for one that cannot (it leads
    out of the folder, is hidden, or is not a name on every system), and for two that are one file where case
    does not count.
    """
    seen: dict[str, str] = {}
    for name in names:
        problem = problem_of_name(name)
        if not problem:
            text = str(name)
            first = seen.setdefault(unicodedata.normalize("NFC", text).casefold(), text)
            problem = "" if first == text else f"is the same file as {first!r} where case does not count"
        if problem:
            shown = ascii(name)
            shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
            raise IntegrityError(
                f"{where} names the file {shown}, which {problem}; nothing was done with it",
                next="do not use this data set, or ask who made it",
            )
    return tuple(seen.values())


@cache
def _decoder(kind: Any) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


def decode(content: str | bytes, kind: type[T], where: str) -> T:
    """Return a JSON document as a value of a type; IntegrityError, naming ``where`` it is from, otherwise."""
    try:
        decoded: T = _decoder(cast(Any, kind)).decode(content)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise damaged(where, error) from error
    return decoded


def seal(text: str) -> str:
    """Return the text of a JSON object, one line a field, with a digest of all that follows as its first."""
    fields = text.removeprefix(_FIRST_LINE)
    return f"{_head(fields.encode())}{fields}"


def _head(fields: bytes) -> str:
    digest = hashlib.sha256(fields.removesuffix(b"\n")).hexdigest()  # editors add or drop that one
    return f'{_FIRST_LINE} "sha256_of_all_below": "{digest}",\n'


_HEAD_BYTES = len(_head(b""))


def require_seal(content: str | bytes, where: str) -> None:
    """Raise IntegrityError, naming ``where`` a document is from, unless it is as :func:`seal` returned it."""
    found = content.encode(errors="surrogatepass") if isinstance(content, str) else content
    # Lines may end as git writes them on Windows; within a line JSON has no such character.
    found = found.replace(b"\r\n", b"\n")
    if found[:_HEAD_BYTES] != _head(found[_HEAD_BYTES:]).encode():
        raise damaged(where, "it was changed since it was written")


def damaged(where: str, problem: object) -> IntegrityError:
    """Return the error for a document in which a value cannot be right."""
    return IntegrityError(
        f"{where!r} is damaged: {problem}",
        next="download the data set again, or generate it again with --overwrite",
    )


def typed(values: Any, kind: type[T], where: str, field: str) -> T:
    """Return a part of a decoded document as a value of a type; raises as :func:`decode`."""
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise damaged(where, f"{field}: {error}") from error
