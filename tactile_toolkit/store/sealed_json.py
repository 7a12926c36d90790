"""JSON documents of a folder: typed when they are read, and sealed with a digest of themselves."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Annotated, Any, TypeVar, cast

import msgspec

from tactile_toolkit.errors import IntegrityError

T = TypeVar("T")

LARGEST = (1 << 63) - 1
Count = Annotated[int, msgspec.Meta(ge=0, le=LARGEST)]
Sha256 = Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{64}\Z")]

_FIRST_LINE = "{\n"


@cache
def _decoder(kind: object) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


def decode(content: str | bytes, kind: type[T], where: str) -> T:
    """Return a JSON document as a value of a type; IntegrityError, with ``where``, for another text."""
    try:
        decoded: T = _decoder(cast(Any, kind)).decode(content)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise damaged_error(where, error) from error
    return decoded


def seal(text: str) -> str:
    """Return the text of a JSON object, a line for each field, the first one a digest of the rest."""
    fields = text.removeprefix(_FIRST_LINE)
    return f"{_head(fields.encode())}{fields}"


def _head(fields: bytes) -> str:
    digest = hashlib.sha256(fields.removesuffix(b"\n")).hexdigest()  # editors add or drop the last line break
    return f'{_FIRST_LINE} "sha256_of_all_below": "{digest}",\n'


def require_seal(content: str | bytes, where: str) -> None:
    """Raise IntegrityError, which names ``where``, unless a document is as :func:`seal` returned it."""
    if isinstance(content, str):
        content = content.encode(errors="surrogatepass")
    # Git may have changed line ends on Windows; JSON has no such character within a line.
    found = content.replace(b"\r\n", b"\n")
    length = len(_head(b""))
    if found[:length] != _head(found[length:]).encode():
        raise damaged_error(where, "it was changed since it was written")


def damaged_error(where: str, problem: object) -> IntegrityError:
    """Return the error for a document with an impossible value."""
    return IntegrityError(
        f"{where!r} is damaged: {problem}",
        next="download the data set again, or generate it again with --overwrite",
    )


def convert_json(values: object, kind: type[T], where: str, field: str) -> T:
    """Return a part of a decoded document as a value of a type; raises as :func:`decode`."""
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise damaged_error(where, f"{field}: {error}") from error
