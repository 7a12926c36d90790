"""Columns of a source whose meaning is not known are kept with their types, as extra columns.

A touch has one value in such a column, or one for each picture of its clip. Missing values stay missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import pyarrow as pa

from realtouch.importing import found_touches, import_columns, recordings, source_files
from realtouch.touches.schema import EXTRA_PREFIX
from tactile_toolkit import errors, wording
from tactile_toolkit.columns import column_types

BOOKKEEPING = frozenset(
    {"id", "round_id", "touch", "frame", "file", "image", "key", "sha256", "meta_file", "meta_sha256"}
)
"""Columns by which exports of this toolkit find their files; they become extra columns only if named."""

_MAX_COLUMNS = 1000


def used_names(columns: import_columns.ImportColumns) -> set[str | None]:
    """Return the columns of a source that hold labels, poses and so on, not extra values."""
    named = {source for _, source in columns.extra}
    used: set[str | None] = {*columns.names(), columns.image} - named
    if columns.label == f"{source_files.NUMBERED}_name":
        used.add(source_files.NUMBERED)
    return used


def extra_sources(
    touches: found_touches.FoundTouches, columns: import_columns.ImportColumns
) -> dict[str, str]:
    """Return the extra columns of touches: the name in the source by the new name.

    Raises InputError if two columns would have one name.
    """
    renamed = {source: name for name, source in columns.extra if source}
    left_out = {name for name, source in columns.extra if not source}
    no_extra = used_names(columns) | (BOOKKEEPING - renamed.keys()) | left_out
    if not touches.has_clips:
        no_extra.discard(recordings.TIME_S)
    sources: dict[str, str] = {}
    for source in touches.names:
        if source in no_extra:
            continue
        name = renamed.get(source, source)
        if name in sources:
            raise errors.InputError(
                f"the columns {sources[name]!r} and {source!r} would both be kept as {name!r}",
                next=f"name one of them: --map NEW={sources[name]}",
            )
        if import_columns.is_extra_name(name) and len(sources) < _MAX_COLUMNS:
            sources[name] = source
    return sources


def extra_types(
    touches: found_touches.FoundTouches, columns: import_columns.ImportColumns
) -> dict[str, pa.DataType]:
    """Return the type of the value of a touch in each extra column, by the name of the column in a data set.

    A column of objects, bytes or lists of several lengths is not kept, nor one without any value.
    """
    types: dict[str, pa.DataType] = {}
    for name, source in extra_sources(touches, columns).items():
        per_frame = source in touches.per_frame.column_names
        entry = _type_of(touches, source, per_frame=per_frame)
        if entry is not None and per_frame:
            types[f"{EXTRA_PREFIX['frame']}{name}"] = pa.list_(entry)
        elif entry is not None:
            types[f"{EXTRA_PREFIX['touch']}{name}"] = entry
    return types


def _type_of(touches: found_touches.FoundTouches, source: str, *, per_frame: bool) -> pa.DataType | None:
    """Return the type in which the values of a column are stored; None if they are not stored."""
    kind = touches.of_frames(source).type.value_type if per_frame else touches.said[source].type
    leaf = kind.value_type if pa.types.is_list(kind) else kind
    if leaf == column_types.UNTYPED or pa.types.is_null(leaf) or source not in touches.known:
        return None
    if pa.types.is_temporal(leaf):
        leaf = pa.string()
    return pa.list_(leaf) if pa.types.is_list(kind) else leaf


def extra_arrays(
    touches: found_touches.FoundTouches,
    columns: import_columns.ImportColumns,
    types: Mapping[str, pa.DataType],
) -> Iterator[pa.Array]:
    """Yield the values of each extra column, an entry for each touch."""
    sources = dict(columns.extra)
    for column, data_type in types.items():
        name, is_frame = _name_of(column)
        source = sources.get(name, name)
        if is_frame:
            yield touches.of_frames(source).cast(data_type)
        else:
            values = touches.value(source)
            assert values is not None
            yield values.cast(data_type)


def _name_of(column: str) -> tuple[str, bool]:
    """Return the name of an extra column of a data set, and whether it has an entry for each picture."""
    prefix = EXTRA_PREFIX["frame"]
    is_frame = column.startswith(prefix)
    return column.removeprefix(prefix if is_frame else EXTRA_PREFIX["touch"]), is_frame


def kept_sources(columns: import_columns.ImportColumns, types: Iterable[str]) -> dict[str, str]:
    """Return the fields that some extra columns of a data set keep, with their names there."""
    sources = dict(columns.extra)
    names = (_name_of(column)[0] for column in types)
    return {sources.get(name, name): name for name in names}


def not_kept(
    touches: found_touches.FoundTouches, columns: import_columns.ImportColumns, types: Iterable[str]
) -> dict[str, int]:
    """Return the number of touches with each field that is neither used nor kept, by its printable name."""
    kept = used_names(columns) | kept_sources(columns, types).keys()
    counts: dict[str, int] = {}
    for name in touches.names:
        if name not in kept:
            tables = [table for table in (touches.said, touches.per_frame) if name in table.column_names]
            count = max(len(table) - table[name].null_count for table in tables)
            shown = wording.printable(name)
            counts[shown] = counts.get(shown, 0) + count
    return {name: count for name, count in counts.items() if count}
