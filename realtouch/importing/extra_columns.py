"""Columns of a source that mean nothing to this toolkit: kept with their types, as extra columns.

A touch has one value of each, or one for each picture of its clip. Missing values stay missing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.import_columns import ImportColumns, is_extra_name
from realtouch.importing.fields import NUMBERED, number_of, times_s
from realtouch.importing.found_touches import FoundTouch
from realtouch.schema import EXTRA_PREFIX
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
_INTEGER = re.compile(r"\s*[+-]?(?:0|[1-9][0-9]{0,18})\s*")
_NUMBER = re.compile(  # without zeros ahead of it, as numbers of parts have
    r"\s*[+-]?(?:(?:0|[1-9][0-9]*)?(?:[.,][0-9]*)?(?:e[+-]?[0-9]+)?|nan|inf)\s*", re.IGNORECASE
)
_MOST_EXACT = 1 << 53  # below which float64 holds every integer
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
        if array.dtype.kind in "biuf" and array.size:
            yield array.max() if array.ndim == 1 else [array.max()]
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
            yield pa.array(_converted(values, data_type), data_type)
        else:
            entry = data_type.value_type
            yield pa.array([_converted(_of_frames(item, source), entry) for item in items], data_type)


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
    return dict.fromkeys(name for item in items for name in (*item.values, *item.per_frame))


def kept_sources(columns: ImportColumns, types: Iterable[str]) -> dict[str, str]:
    """Return the fields that are kept in some extra columns of a data set, with their names there."""
    sources = dict(columns.extra)
    names = (_name_of(column)[0] for column in types)
    return {sources.get(name, name): name for name in names}


def not_kept(items: Sequence[FoundTouch], columns: ImportColumns, types: Iterable[str]) -> dict[str, int]:
    """Return of how many touches each field is neither used nor kept, by its name as it can be shown."""
    kept = used_names(columns) | kept_sources(columns, types).keys()
    counts: dict[str, int] = {}
    for name in _names_in(items):
        if name not in kept:
            values = (item.per_frame.get(name, item.values.get(name)) for item in items)
            count = sum(_plain(value) is not None for value in values)
            shown = printable(str(name))
            counts[shown] = counts.get(shown, 0) + count
    return {name: count for name, count in counts.items() if count}


def time_of(item: FoundTouch, columns: ImportColumns) -> float | None:
    """Return the time of an image in seconds; None if it is missing. ItemError if it is no time."""
    value = item.values.get(columns.time or "")
    if value is None and TIME_S in item.values:  # of a picture of a recording, in seconds
        value, columns = item.values[TIME_S], ImportColumns()
    return None if _plain(value) is None else float(times_s([value], columns)[0])


def value_type(values: Iterable[object]) -> pa.DataType | None:
    """Return the type of all values that are not missing; None without any, or if they have none."""
    given = [value for value in map(_plain, values) if value is not None]
    if not given:
        return None
    with suppress(ValueError):
        if any(issubclass(kind, _LISTS) for kind in set(map(type, given))):
            inner = value_type(chain.from_iterable(map(_leaves, given)))
            return None if inner is None or pa.types.is_list(inner) else pa.list_(inner)
    for data_type, convert in _TYPES.items():
        with suppress(ValueError, OverflowError):
            pa.array(list(map(convert, given)), data_type)
            return data_type
    return None


def _plain(value: Any) -> Any:
    """Return a number of numpy as one of Python, and None for an empty text."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, str) and not value.strip() else value


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


def _boolean(value: Any) -> bool:
    found = _BOOLEANS.get(value.strip().lower()) if isinstance(value, str) else value
    if not isinstance(found, bool):
        raise ValueError(value)
    return found


def _integer(value: Any) -> int:
    if type(value) is not int and not (isinstance(value, str) and _INTEGER.fullmatch(value)):
        raise ValueError(value)
    return int(value)


def _real(value: Any) -> float:
    """Return a number; ValueError for anything else, and for integers that it would round."""
    if isinstance(value, str) and _NUMBER.fullmatch(value):
        number = number_of(value)
    elif type(value) in (int, float):
        number = float(value)
    else:
        raise ValueError(value)
    is_whole = type(value) is int or (isinstance(value, str) and value.strip("+- ").isdecimal())
    if is_whole and abs(number) >= _MOST_EXACT:
        raise ValueError(value)
    if math.isinf(number) and isinstance(value, str) and value.strip()[-1].isdecimal():  # such as 1e400
        raise ValueError(value)
    return number


def _text(value: Any) -> str:
    if isinstance(value, (dict, bytes, *_LISTS)):
        raise ValueError(value)
    return str(value)


_TYPES: dict[pa.DataType, Callable[[Any], Any]] = {
    pa.bool_(): _boolean,
    pa.int64(): _integer,
    pa.float64(): _real,
    pa.string(): _text,
}
"""Types of values, each with what converts one to it or raises ValueError: the first that fits all."""


def _converted(values: Iterable[Any], data_type: pa.DataType) -> list[Any]:
    """Return values as those of a type; None for missing ones."""
    if not pa.types.is_list(data_type):
        convert = _TYPES[data_type]
        return [None if value is None else convert(value) for value in map(_plain, values)]
    entry, found = data_type.value_type, list[Any]()
    for value in map(_plain, values):
        if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and not pa.types.is_string(entry):
            found.append(value.ravel().astype(entry.to_pandas_dtype(), copy=False))
        else:
            found.append(None if value is None else _converted(_leaves(value), entry))
    return found
