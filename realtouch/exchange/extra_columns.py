"""Columns of a source that mean nothing to this toolkit: kept with their types, as extra columns.

A touch has one value of each, or one for each picture of its clip. Missing values stay missing.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.exchange.fields import NUMBERED, number_of, times_s
from realtouch.exchange.found_touches import FoundTouch
from realtouch.touch_options import ImportColumns, is_extra_name
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError
from tactile_toolkit.shown_text import printable

BOOKKEEPING = frozenset(
    {"id", "round_id", "touch", "frame", "file", "image", "key", "sha256", "meta_file", "meta_sha256"}
)
"""Columns by which exports of this toolkit find their files: no extra columns, unless they are named."""

TIME_S = "time_s"
"""Extra column of single images with their time in seconds, where a column states it."""

_MOST_COLUMNS = 1000
_MOST_LISTS = 4  # one inside of the other
_BOOLEANS = {"true": True, "false": False}
_INTEGER = re.compile(r"\s*[+-]?(?:0|[1-9][0-9]{0,18})\s*\Z")
_FLOAT = re.compile(
    r"\s*[+-]?(?:[0-9]+(?:\.[0-9]*|,[0-9]+)?|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?\s*\Z|\s*[+-]?(?:nan|inf)\s*\Z",
    re.I,
)
_LEADING_ZERO = re.compile(r"\s*[+-]?0[0-9]")
_INT64 = np.iinfo(np.int64)


def used_names(columns: ImportColumns) -> set[str | None]:
    """Return the columns of a source that hold labels, poses and so on, not extra values."""
    named = {source for _, source in columns.extra}
    used: set[str | None] = {*columns.names(), columns.image} - named
    if columns.label == f"{NUMBERED}_name":
        used.add(NUMBERED)
    return used


def extra_sources(names: Iterable[str | None], columns: ImportColumns) -> dict[str, str]:
    """Return the extra columns that a source with some names has: new names, with those of the source.

    InputError for two columns of one new name.
    """
    renamed = {source: name for name, source in columns.extra if source}
    left_out = {name for name, source in columns.extra if not source}
    no_extra = used_names(columns) | (BOOKKEEPING - renamed.keys()) | left_out
    sources: dict[str, str] = {}
    for source in names:
        if source in no_extra or source is None:
            continue
        name = renamed.get(source, source)
        if name in sources:
            raise InputError(
                f"the columns {sources[name]!r} and {source!r} would both be kept as {name!r}",
                next=f"name one of them: --map NEW={sources[name]}",
            )
        if is_extra_name(name) and len(sources) < _MOST_COLUMNS:
            sources[name] = source
    return sources


def extra_types(items: Sequence[FoundTouch], columns: ImportColumns) -> dict[str, pa.DataType]:
    """Return the type of the value of a touch in each extra column, by its new name.

    Values of all touches decide: bool, int64, float64 or string, or lists of these; text that is a number is
    one. Columns with objects, bytes or lists of several depths have no type, and are not kept.
    """
    found: dict[str, list[object]] = {}
    pictures: dict[str, list[AnyArray]] = {}
    for item in items:
        for name, value in item.values.items():
            found.setdefault(name, []).append(value)
        for name, values in item.per_frame.items():
            pictures.setdefault(name, []).append(values)
    types: dict[str, pa.DataType] = {}
    for name, source in extra_sources(dict.fromkeys((*found, *pictures)), columns).items():
        if source in pictures:
            data_type = _array_type(pictures[source])
        else:
            data_type = value_type(found[source])
        if data_type is not None:
            types[name] = data_type
    if columns.time and not items[0].frames:
        if TIME_S in types:
            raise InputError(
                f"the source has a column {TIME_S!r} beside that of the time, {columns.time!r}",
                next=f"map one of them to the time, or name the other one: --map NEW={TIME_S}",
            )
        types[TIME_S] = pa.float64()
    return types


def extra_arrays(
    items: Sequence[FoundTouch], columns: ImportColumns, types: Mapping[str, pa.DataType]
) -> Iterator[pa.Array]:
    """Yield the values of each extra column, an entry a touch."""
    sources = {name: source for name, source in columns.extra if source}
    for name, data_type in types.items():
        source = sources.get(name, name)
        if name == TIME_S and columns.time:
            yield pa.array([_time_s(item, columns) for item in items], data_type)
            continue
        values = [item.per_frame.get(source, item.values.get(source)) for item in items]
        yield pa.array(list(_converted(values, data_type)), data_type)


def not_kept(items: Iterable[FoundTouch], columns: ImportColumns, types: Iterable[str]) -> Iterator[str]:
    """Yield the name of each field of each touch that is neither used nor kept, as it can be shown."""
    sources = dict(columns.extra)
    kept = used_names(columns) | {sources.get(name, name) for name in types}
    for item in items:
        for name in (item.values.keys() | item.per_frame.keys()) - kept:
            value = item.values.get(name, "")
            if name in item.per_frame or (value is not None and value != ""):
                yield printable(str(name))


def _time_s(item: FoundTouch, columns: ImportColumns) -> float:
    value = item.values.get(columns.time or "")
    if value is None and TIME_S in item.values:  # of a picture of a recording, in seconds
        value, columns = item.values[TIME_S], ImportColumns()
    return float(times_s([value], columns)[0])


def value_type(values: Iterable[object], depth: int = 0) -> pa.DataType | None:
    """Return the type of all values that are not missing; None without any, or if they have none."""
    given: list[Any] = [value for value in values if not _is_missing(value)]
    kinds = set(map(type, given))
    if any(issubclass(kind, np.generic) for kind in kinds):
        given = [value.item() if isinstance(value, np.generic) else value for value in given]
        kinds = set(map(type, given))
    if not kinds or kinds & {dict, bytes} or depth > _MOST_LISTS:
        return None
    if kinds <= {list, tuple, np.ndarray}:
        inner = value_type(chain.from_iterable(map(_as_list, given)), depth + 1)
        return None if inner is None else pa.list_(inner)
    if kinds & {list, tuple, np.ndarray}:
        return None
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int} and all(_INT64.min <= value <= _INT64.max for value in given):
        return pa.int64()
    if float in kinds and kinds <= {int, float}:
        return pa.float64()
    return _text_type(given, kinds == {str})


def _text_type(values: Sequence[Any], may_be_numbers: bool) -> pa.DataType | None:
    """Return the type of text, as tables have it for all values; None for text that is not Unicode."""
    words = [str(value).strip() for value in values]
    if may_be_numbers and all(word.lower() in _BOOLEANS for word in words):
        return pa.bool_()
    if may_be_numbers and all(map(_INTEGER.match, words)):
        if all(_INT64.min <= int(word) <= _INT64.max for word in words):
            return pa.int64()
    elif may_be_numbers and all(map(_FLOAT.match, words)) and not any(map(_LEADING_ZERO.match, words)):
        return pa.float64()
    try:
        "".join(words).encode()
    except UnicodeEncodeError:
        return None
    return pa.string()


def _array_type(arrays: Sequence[AnyArray]) -> pa.DataType | None:
    """Return the type of the values of a clip, which has an entry for each picture."""
    kinds, depths = {array.dtype.kind for array in arrays}, {array.ndim for array in arrays}
    leaf = value_type(chain.from_iterable(array.ravel()[:1].tolist() for array in arrays))
    if not kinds <= set("biuf"):
        leaf = value_type(chain.from_iterable(array.ravel().tolist() for array in arrays))
    elif len(kinds) > 1:
        leaf = pa.float64() if kinds <= set("iuf") else pa.string()
    elif kinds == {"u"} and max(int(array.max(initial=0)) for array in arrays) > _INT64.max:
        leaf = pa.string()
    if leaf is None or len(depths) > 1 or not 0 < max(depths) <= _MOST_LISTS:
        return None
    for _ in range(max(depths)):
        leaf = pa.list_(leaf)
    return leaf


def _as_list(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _is_missing(value: object) -> bool:
    return value is None or (isinstance(value, str) and not value.strip())


def _converted(values: Iterable[Any], data_type: pa.DataType) -> Iterator[Any]:
    """Yield values as those of a type; None for missing ones, and for those of another depth."""
    if pa.types.is_list(data_type):
        for value in values:
            if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "biuf":
                yield _numeric(value, data_type.value_type)
            elif isinstance(value, (list, tuple, np.ndarray)):
                yield list(_converted(value, data_type.value_type))
            else:
                yield None
        return
    convert: Any = str
    if pa.types.is_boolean(data_type):
        convert = _boolean
    elif pa.types.is_integer(data_type):
        convert = int
    elif pa.types.is_floating(data_type):
        convert = _float
    for value in values:
        yield None if _is_missing(value) else convert(value)


def _numeric(values: AnyArray, leaf: pa.DataType) -> Any:
    if pa.types.is_string(leaf):
        return list(map(str, values.tolist()))
    return values.astype(leaf.to_pandas_dtype(), copy=False)


def _float(value: Any) -> float:
    return number_of(value) if isinstance(value, str) else float(value)


def _boolean(value: Any) -> bool:
    return _BOOLEANS[value.strip().lower()] if isinstance(value, str) else bool(value)
