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
from realtouch.schema import EXTRA_PREFIX
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
    re.IGNORECASE,
)
_LEADING_ZERO = re.compile(r"\s*[+-]?0[0-9]")
_INT64 = np.iinfo(np.int64)
_LISTS = (list, tuple, np.ndarray)


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
    """Return the type of what a touch has in each extra column, by the name of the column in a data set.

    Values of all touches decide: bool, int64, float64 or string, or a list of these; text that is a number is
    one. A matrix is a list, row by row. Columns with objects, bytes or uneven lists have no type, and are not
    kept.
    """
    types: dict[str, pa.DataType] = {}
    for name, source in extra_sources(_names_in(items), columns).items():
        pictures = [item.per_frame[source] for item in items if source in item.per_frame]
        values = (item.values[source] for item in items if source in item.values)
        entry = value_type(chain(values, _told_apart(pictures)))
        if entry is None:
            continue
        if pictures:
            types[f"{EXTRA_PREFIX['frame']}{name}"] = pa.list_(entry)
        else:
            types[f"{EXTRA_PREFIX['touch']}{name}"] = entry
    if columns.time and not items[0].frames and items[0].time_s is None:
        name = f"{EXTRA_PREFIX['touch']}{TIME_S}"
        if name in types:
            raise InputError(
                f"the source has a column {TIME_S!r} beside that of the time, {columns.time!r}",
                next=f"map one of them to the time, or name the other one: --map NEW={TIME_S}",
            )
        types[name] = pa.float64()
    return types


def _told_apart(arrays: Iterable[AnyArray]) -> Iterator[object]:
    """Yield entries of arrays that decide their type: one of numbers, whose type is that of all."""
    for array in arrays:
        if array.dtype.kind in "biuf" and len(array):
            largest = array.max() if array.dtype.kind == "u" and array.size else array.dtype.type(0)
            yield largest if array.ndim == 1 else [largest]
        else:
            yield from array


def extra_arrays(
    items: Sequence[FoundTouch], columns: ImportColumns, types: Mapping[str, pa.DataType]
) -> Iterator[pa.Array]:
    """Yield the values of each extra column, an entry a touch."""
    for column, data_type in types.items():
        name, is_frame = _name_of(column)
        source = dict(columns.extra).get(name, name)
        if name == TIME_S and columns.time and not is_frame:
            yield pa.array([time_of(item, columns) for item in items], data_type)
        elif not is_frame:
            values = (item.values.get(source) for item in items)
            yield pa.array(list(_converted(values, data_type)), data_type)
        else:
            entry = data_type.value_type
            yield pa.array([list(_converted(_of_frames(item, source), entry)) for item in items], data_type)


def _of_frames(item: FoundTouch, source: str) -> Sequence[object]:
    """Return the value of each picture of a clip; what is said of the clip holds for all of them."""
    if source in item.per_frame:
        values = item.per_frame[source]
        return values.tolist() if values.ndim == 1 else list(values)
    return [item.values.get(source)] * item.frames


def _name_of(column: str) -> tuple[str, bool]:
    """Return the name of an extra column of a data set, and whether it has an entry for each picture."""
    prefix = EXTRA_PREFIX["frame"]
    is_frame = column.startswith(prefix)
    return column.removeprefix(prefix if is_frame else EXTRA_PREFIX["touch"]), is_frame


def _names_in(items: Iterable[FoundTouch]) -> dict[str, None]:
    """Return the names of all fields, in order."""
    names: dict[str, None] = {}
    for item in items:
        names.update(dict.fromkeys(item.values))
        names.update(dict.fromkeys(item.per_frame))
    return names


def not_kept(items: Sequence[FoundTouch], columns: ImportColumns, types: Iterable[str]) -> dict[str, int]:
    """Return of how many touches each field is neither used nor kept, by its name as it can be shown."""
    sources = dict(columns.extra)
    names = (_name_of(column)[0] for column in types)
    kept = used_names(columns) | {sources.get(name, name) for name in names}
    counts: dict[str, int] = {}
    for name in _names_in(items):
        if name not in kept:
            values = [item.per_frame.get(name, item.values.get(name)) for item in items]
            count = sum(value is not None and not (isinstance(value, str) and not value) for value in values)
            shown = printable(str(name))
            counts[shown] = counts.get(shown, 0) + count
    return {name: count for name, count in counts.items() if count}


def time_of(item: FoundTouch, columns: ImportColumns) -> float | None:
    """Return the time of an image in seconds; None if it is missing. ItemError if it is no time."""
    value = item.values.get(columns.time or "")
    if value is None and TIME_S in item.values:  # of a picture of a recording, in seconds
        value, columns = item.values[TIME_S], ImportColumns()
    return None if _is_missing(value) else float(times_s([value], columns)[0])


def value_type(values: Iterable[object]) -> pa.DataType | None:
    """Return the type of all values that are not missing; None without any, or if they have none."""
    given: list[Any] = [value for value in values if not _is_missing(value)]
    kinds = set(map(type, given))
    if any(issubclass(kind, np.generic) for kind in kinds):
        given = [value.item() if isinstance(value, np.generic) else value for value in given]
        kinds = set(map(type, given))
    if not kinds or kinds & {dict, bytes}:
        return None
    if kinds & {*_LISTS}:
        try:
            inner = value_type(chain.from_iterable(map(_leaves, given)))
        except ValueError:
            return None
        return None if inner is None or pa.types.is_list(inner) else pa.list_(inner)
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int} and all(_INT64.min <= value <= _INT64.max for value in given):
        return pa.int64()
    if float in kinds and kinds <= {int, float}:
        return pa.float64()
    return _text_type(given, kinds == {str})


def _leaves(value: Any) -> list[Any]:
    """Return the values of a list, or those of a matrix row by row; ValueError for rows that differ."""
    if not isinstance(value, _LISTS):
        raise ValueError(value)
    leaves = list(value)
    for _ in range(_MOST_LISTS):
        if not any(isinstance(each, _LISTS) for each in leaves):
            break
        if len({len(each) if isinstance(each, _LISTS) else -1 for each in leaves}) > 1:
            raise ValueError(value)
        leaves = [each for row in leaves for each in row]
    return leaves


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


def _is_missing(value: object) -> bool:
    return value is None or (isinstance(value, str) and not value.strip())


def _converted(values: Iterable[Any], data_type: pa.DataType) -> Iterator[Any]:
    """Yield values as those of a type; None for missing ones."""
    if pa.types.is_list(data_type):
        entry = data_type.value_type
        for value in values:
            if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and not pa.types.is_string(entry):
                yield value.ravel().astype(entry.to_pandas_dtype(), copy=False)
            else:
                yield None if _is_missing(value) else list(_converted(_leaves(value), entry))
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


def _float(value: Any) -> float:
    return number_of(value) if isinstance(value, str) else float(value)


def _boolean(value: Any) -> bool:
    return _BOOLEANS[value.strip().lower()] if isinstance(value, str) else bool(value)
