"""JSON that anybody may have written or a disk may have changed, decoded into typed values."""

from __future__ import annotations

import contextlib
import re
from functools import cache
from typing import Annotated, Any, TypeVar, cast

import msgspec

from tactile_toolkit.errors import IntegrityError

__all__ = ["LARGEST", "Count", "Sha256", "damaged", "decode", "typed"]

T = TypeVar("T")

LARGEST = (1 << 63) - 1
_DIGEST = r"\A[0-9a-f]{64}\Z"
_WORDS = {f"`str` matching regex {_DIGEST!r}": "64 hexadecimal digits"}
_LONGEST_SHOWN = 80
_STEP = re.compile(r"\.(?P<name>[^.\[\]]+)|\[(?P<index>[0-9]+)\]")

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
        found = None
        with contextlib.suppress(msgspec.DecodeError, RecursionError):  # too deep, or of 5,000 digits
            found = msgspec.json.decode(content)
        raise _wrong(error, found, where) from error
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        message = f"{where!r} is damaged, a JSON object was expected ({type(error).__name__}: {error})"
        raise IntegrityError(message) from error
    return decoded


def typed(values: Any, kind: type[T], where: str, field: str) -> T:
    """Return a part of a decoded document as a value of a type; raises as :func:`decode`."""
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise _wrong(error, values, where, field) from error


def damaged(where: str, field: str, problem: str) -> IntegrityError:
    """Return the error for a value of a document that cannot be right."""
    message = (
        f"{where!r} is damaged, {field or 'all of it'}: {problem}; next: download or generate the data set "
        "again"
    )
    return IntegrityError(message)


def _wrong(error: msgspec.ValidationError, values: Any, where: str, field: str = "") -> IntegrityError:
    """Return the error for a value of another type, with the place that msgspec gives and what is there."""
    problem, _, place = str(error).removesuffix("`").partition(" - at `$")
    found = values
    for step in _STEP.finditer(place):
        inside = int(step["index"]) if step["index"] else step["name"]
        found = None if found is None else found[inside] if isinstance(inside, int) else found.get(inside)
    if "[...]" in place:  # msgspec does not name the keys of mappings
        shown = "one of them"
    elif isinstance(found, str | int | float):
        shown = repr(found)
    else:
        shown = "nothing" if found is None else f"a value of the type {type(found).__name__}"
    expected = re.sub(r"^Expected |, got .*|`", "", problem)
    for text, words in _WORDS.items():
        expected = expected.replace(text.replace("`", ""), words)
    shown = shown if len(shown) <= _LONGEST_SHOWN else f"{shown[:_LONGEST_SHOWN]}..."
    return damaged(where, f"{field}{place}".lstrip("."), f"found {shown}, expected {expected}")
