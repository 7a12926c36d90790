"""Columns of a data set that follow from the fields of a source: labels, positions, poses and extra columns.

Columns whose meaning is not known are kept with their types, as extra columns. A touch has one value in such
a column, or one for each picture of its clip. Missing values stay missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from realtouch.importing import fields, import_options, source_files, source_touches
from realtouch.touches.schema import EXTRA_PREFIX, POSE_COLUMN, extra_columns
from tactile_toolkit import errors
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import Float64

BOOKKEEPING = frozenset(
    {"id", "round_id", "touch", "frame", "file", "image", "key", "sha256", "meta_file", "meta_sha256"}
)
"""Columns by which exports of this toolkit find their files; they become extra columns only if named."""
_MAX_COLUMNS = 1000
_SAME_M = 1e-9
_SEVERAL_POSITIONS = errors.ItemError(
    "position",
    "it differs between the pictures of the clip; expected one value (--map position= leaves it out)",
)
_LONGEST_S = 1e6  # of a clip


def with_stored_columns(
    touches: source_touches.SourceTouches,
    columns: import_options.ImportColumns,
    names: Sequence[str],
    extras: ExtraColumns,
) -> source_touches.SourceTouches:
    """Return touches with the columns of a data set that follow from their fields, and with problems.

    Labels, objects, positions, poses and ``extras`` are read here, for all touches at once; a position or
    pose that is not known is NaN. Of the fields, those that are not kept are left.
    """
    labels, problems = fields.labels_of(touches, columns.label, names)
    made: dict[str, pa.Array] = {"label": pa.array(labels)}
    read = touches.with_problems(problems)
    if columns.object_id:
        object_ids, problems = fields.objects_of(touches, columns.object_id)
        made["object_id"] = pa.array(object_ids)
        read = read.with_problems(problems)
    if columns.position:
        of_pictures_m, problems = _of_pictures(read, fields.stated_positions, columns, columns.position, 2)
        owners = touches.owners
        of_touches, first = np.unique(owners, return_index=True)
        positions_m = np.full((len(touches), 2), np.nan)
        positions_m[of_touches] = of_pictures_m[first]
        made["pos_in_cell"] = _vectors(positions_m)
        differs = (np.abs(of_pictures_m - positions_m[owners]) > _SAME_M).any(axis=1)
        read = read.with_problems(dict.fromkeys(owners[differs].tolist(), _SEVERAL_POSITIONS) | problems)
    if columns.pose:
        of_pictures, problems = _of_pictures(read, fields.poses, columns, columns.pose, 7)
        read = read.with_problems(problems)
        pose_column = POSE_COLUMN["seq" if touches.has_clips else "single"]
        for part, numbers in (("position", slice(3)), ("quaternion", slice(3, 7))):
            vectors = _vectors(of_pictures[:, numbers])
            if touches.has_clips:
                vectors = column_types.lists_of(vectors, touches.picture_counts)
            made[f"{pose_column}.{part}"] = vectors
    made |= extras.arrays(touches)
    read = read.with_problems(_problems_of_times(touches, columns))
    return replace(extras.without_kept(read), stored=pa.table(made))


def _vectors(rows: Float64) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(rows.reshape(-1)), rows.shape[1])


def _of_pictures(
    touches: source_touches.SourceTouches,
    read: Callable[[fields.Fields, import_options.ImportColumns], Float64],
    columns: import_options.ImportColumns,
    names: tuple[str, ...],
    width: int,
) -> tuple[Float64, dict[int, errors.ItemError]]:
    """Return the values of columns for each picture, NaN where there is none, and problems of touches."""
    owners = touches.owners
    problems = dict[int, errors.ItemError]()
    values = {name: touches.of_pictures(name) for name in names}
    numbers, wrong = fields.each_of(
        read, values, columns, np.flatnonzero(touches.is_usable[owners]), (width,)
    )
    for row, error in wrong.items():
        touch = int(owners[row])
        if not {*names}.isdisjoint(touches.per_frame.column_names):
            number = row - int(np.searchsorted(owners, touch))
            error = errors.ItemError(error.reason, f"picture {number}: {error.message}")
        problems.setdefault(touch, error)
    return numbers, problems


def _problems_of_times(
    touches: source_touches.SourceTouches, columns: import_options.ImportColumns
) -> dict[int, errors.ItemError]:
    """Return a problem for each clip without the times that are named, and for each that lasts too long."""
    problems: dict[int, errors.ItemError] = {}
    for index in np.flatnonzero(touches.listing["frames"].to_numpy()).tolist():
        time_s = touches.listing["time_s"][index].values
        if time_s is None and columns.time:
            words = f"no {columns.time!r} for each picture; expected the time of each"
            problems[index] = errors.ItemError("time", words)
        elif time_s is not None and (lasts_s := time_s[-1].as_py() - time_s[0].as_py()) > _LONGEST_S:
            words = f"the clip lasts {lasts_s:g} s; expected seconds (--time-unit states another unit)"
            problems[index] = errors.ItemError("time", words)
    return problems


@dataclass(frozen=True)
class ExtraColumns:
    """The columns of a source that are kept as extra ones.

    ``columns`` says what columns mean, and renames some. ``types`` holds the type of the value of a touch by
    the name of the column in a data set.
    """

    columns: import_options.ImportColumns
    types: Mapping[str, pa.DataType]

    @classmethod
    def of(cls, touches: source_touches.SourceTouches, columns: import_options.ImportColumns) -> ExtraColumns:
        """Choose the extra columns of touches.

        A column of objects, bytes or lists of several lengths is not kept, nor one without any value. Raises
        InputError if two columns would have one name.
        """
        types: dict[str, pa.DataType] = {}
        renamed = {source: name for name, source in columns.extra if source}
        no_extra = _used(columns) | (BOOKKEEPING - renamed.keys())
        no_extra |= {name for name, source in columns.extra if not source}
        if not touches.has_clips:
            no_extra.discard(source_touches.TIME_S)
        known = touches.known
        sources: dict[str, str] = {}
        for source in [name for name in touches.names if name not in no_extra]:
            name = renamed.get(source, source)
            if name in sources:
                raise errors.InputError(
                    f"the columns {sources[name]!r} and {source!r} would both be kept as {name!r}",
                    next=f"name one of them: --map NEW={sources[name]}",
                )
            if not import_options.is_extra_name(name) or len(sources) == _MAX_COLUMNS:
                continue
            sources[name] = source
            is_frame = source in touches.per_frame.column_names
            kind = touches.of_frames(source).type.value_type if is_frame else touches.per_touch[source].type
            leaf = kind.value_type if pa.types.is_list(kind) else kind
            if leaf == column_types.UNTYPED or pa.types.is_null(leaf) or source not in known:
                continue
            if pa.types.is_temporal(leaf):
                leaf = pa.string()
            entry = pa.list_(leaf) if pa.types.is_list(kind) else leaf
            if is_frame:
                types[f"{EXTRA_PREFIX['frame']}{name}"] = pa.list_(entry)
            else:
                types[f"{EXTRA_PREFIX['touch']}{name}"] = entry
        return cls(columns, types)

    @property
    def names(self) -> dict[str, str]:
        """Name in the data set of each column that is kept, by its name in the source."""
        sources = dict(self.columns.extra)
        return {sources.get(name, name): name for name in extra_columns(self.types)}

    def arrays(self, touches: source_touches.SourceTouches) -> dict[str, pa.Array]:
        """Return the values of each extra column, an entry for each touch."""
        made = {}
        for (column, kind), source in zip(self.types.items(), self.names, strict=True):
            is_frame = column.startswith(EXTRA_PREFIX["frame"])
            values = touches.of_frames(source) if is_frame else touches.value(source)
            assert values is not None
            made[column] = values.cast(kind)
        return made

    def without_kept(self, touches: source_touches.SourceTouches) -> source_touches.SourceTouches:
        """Return touches with the fields that are neither used nor kept."""
        kept = _used(self.columns) | self.names.keys()
        per_touch, per_frame = (
            table.select([name for name in table.column_names if name not in kept])
            for table in (touches.per_touch, touches.per_frame)
        )
        return replace(touches, per_touch=per_touch, per_frame=per_frame)


def _used(columns: import_options.ImportColumns) -> set[str | None]:
    """Return the columns of a source that hold labels, poses and so on, not extra values."""
    named = {source for _, source in columns.extra}
    used: set[str | None] = {*columns.names(), columns.image} - named
    if columns.label == f"{source_files.NUMBERED}_name":
        used.add(source_files.NUMBERED)
    return used
