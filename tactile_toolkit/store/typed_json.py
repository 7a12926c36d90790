"""JSON that anyone may have written or a disk may have changed, decoded into typed values."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, TypeVar, cast

import msgspec

from tactile_toolkit.errors import IntegrityError

T = TypeVar("T")

LARGEST = (1 << 63) - 1
_DIGEST = r"\A[0-9a-f]{64}\Z"

Count = Annotated[int, msgspec.Meta(ge=0, le=LARGEST)]
Sha256 = Annotated[str, msgspec.Meta(pattern=_DIGEST)]


@cache
def _decoder(kind: Any) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


def decode(content: str | bytes, kind: type[T], where: str) -> T:
    """Return a JSON document as a value of a type; IntegrityError, naming ``where`` it is from, otherwise."""
    try:
        decoded: T = _decoder(cast(Any, kind)).decode(content)
    except msgspec.ValidationError as error:
        raise _wrong(error, where) from error
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise IntegrityError(
            f"{where!r} is damaged, a JSON object was expected ({type(error).__name__}: {error})"
        ) from error
    return decoded


def typed(values: Any, kind: type[T], where: str, field: str) -> T:
    """Return a part of a decoded document as a value of a type; raises as :func:`decode`."""
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise _wrong(error, where, field) from error


def damaged(where: str, field: str, problem: str) -> IntegrityError:
    """Return the error for a value of a document that cannot be right."""
    found = f"{where!r} is damaged, {field or 'all of it'}: {problem}"
    return IntegrityError(f"{found}; next: download or generate the data set again")


def _wrong(error: msgspec.ValidationError, where: str, field: str = "") -> IntegrityError:
    """Return the error for a value of another type, at the place that msgspec gives."""
    problem, _, place = str(error).replace("`", "").partition(" - at $")
    if problem.startswith("Expected "):
        expected, _, found = problem.removeprefix("Expected ").partition(", got ")
        expected = expected.replace(f"str matching regex {_DIGEST!r}", "64 hexadecimal digits")
        problem = f"found {found or 'another value'}, expected {expected}"
    return damaged(where, f"{field}{place}".lstrip("."), problem)
