"""The published schema of touches: columns and types, and rows packed from arrays and taken apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from realtouch.contact import PLATE_COLUMN
from tactile_toolkit import read, store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import MEDIA_COLUMN, MEDIA_TYPE, Kind

POSE_COLUMN: dict[Kind, str] = {"seq": "gel_pose_cell_frame_seq", "single": "gel_pose_cell_frame"}
"""The columns ``.position`` and ``.quaternion`` below it hold the pose of the gel, of each frame or touch."""

Origin = Literal["real", "synthetic", "imported"]
"""Where touches are from; manifests of conversions state it as the option ``touches``."""

_FLOAT = (pa.types.is_floating,)
_WHOLE = (pa.types.is_integer, *_FLOAT)  # of floats, each value must be one
_TEXT = (pa.types.is_string, *_WHOLE)
_TIME = (pa.types.is_duration, *_FLOAT)
_BYTES = (pa.types.is_binary,)
KNOWN_COLUMNS: dict[str, read.Expected] = {
    "id": (0, _TEXT, "a string"),
    "label": (0, _WHOLE, "an integer"),
    "object_id": (0, _WHOLE, "an integer"),
    PLATE_COLUMN: (0, _FLOAT, "a float: metres"),
    "pos_in_cell": (2, _FLOAT, "two floats per touch"),
    "gel_pose_cell_frame.position": (2, _FLOAT, "three floats per touch"),
    "gel_pose_cell_frame.quaternion": (2, _FLOAT, "four floats per touch"),
    "sensor_image": (1, _BYTES, "a struct of bytes and path per touch"),
    "video_length_frames": (1, _WHOLE, "an integer per touch"),
    "gel_pose_cell_frame_seq.position": (3, _FLOAT, "three floats per frame of each touch"),
    "gel_pose_cell_frame_seq.quaternion": (3, _FLOAT, "four floats per frame of each touch"),
    "time_stamp_rel_seq": (2, _TIME, "a duration or float seconds per frame of each touch"),
    "touch_start_time_rel": (1, _TIME, "a duration or float seconds per touch"),
    "touch_end_time_rel": (1, _TIME, "a duration or float seconds per touch"),
    "sensor_video": (1, _BYTES, "a struct of bytes and path per touch"),
}
"""Depth, types and description of the columns of a set of touches."""

PER_TOUCH_COLUMNS = tuple(name for name, (depth, _, _) in KNOWN_COLUMNS.items() if depth)
"""Columns that hold one entry per touch."""


def is_per_touch(name: str, data_type: pa.DataType) -> bool:
    """Return whether a column may hold an entry per touch: known ones, and lists of vectors in ``info``."""
    return name in PER_TOUCH_COLUMNS or (name.startswith("info.") and read.list_depth(data_type)[0] >= 2)


def media_kind(schema: pa.Schema | None, where: str) -> Kind:
    """Return whether a set holds clips (``seq``) or images (``single``); InputError if neither or both."""
    names: tuple[str, ...] = ()
    if schema is not None:
        names = read.column_names(schema)
    kinds = [kind for kind, column in MEDIA_COLUMN.items() if column in names]
    if len(kinds) != 1:
        raise InputError(
            f"{where!r} is not a data set of touches: expected a column 'sensor_video' or 'sensor_image', "
            f"found {', '.join(names) or 'no columns'}",
            next="name one, such as real-single-64x64",
        )
    return kinds[0]


def _is_rendered(schema: pa.Schema) -> bool:
    """Return whether images were rendered: the object then has a pose for each touch, not one a round."""
    pose = column_type(schema, "info.object_pose.position")
    has_images = column_type(schema, MEDIA_COLUMN["single"]) is not None
    return has_images and pose is not None and read.list_depth(pose)[0] == 2


def origin_of(schema: pa.Schema, manifest: store.Manifest | None) -> Origin:
    """Return where touches are from: rendered ones by their columns, others by the manifest."""
    if manifest is not None:
        options = manifest.spec.get("options")
        stated = isinstance(options, dict) and options.get("touches")
        if stated == "imported" or manifest.spec.get("operation") == "import":
            return "imported"
        if stated == "synthetic":
            return "synthetic"
    return "synthetic" if _is_rendered(schema) else "real"


def require_types(shard: read.Shard) -> None:
    """Check the type of every known column that is there, and that the class names can be read.

    Raises IntegrityError, which names file and column, for a type that values cannot be read from.
    """
    # Read here so that an error names the file, and not only at the first label.
    _ = shard.class_names
    problem = read.wrong_type(shard.types, KNOWN_COLUMNS)
    if problem:
        raise IntegrityError(f"{shard.path!r}, {problem}", next="download or convert the data set again")


def column_type(schema: pa.Schema, name: str) -> Any:
    """Return the Arrow type of a column by dotted name, flat or inside structs; None when it is not there."""
    return read.column_types(schema).get(name)


def flat_schema(schema: pa.Schema) -> pa.Schema:
    """Return the fields of a schema with structs ``a{b, c}`` as flat columns ``a.b``, ``a.c``."""
    flat = _without_structs(schema.empty_table()).schema
    return pa.schema([pa.field(field.name, _plain_type(field.type)) for field in flat])


def _plain_type(data_type: pa.DataType) -> pa.DataType:
    """Return a type whose lists carry no names of their own; pickling would change those, and the bytes."""
    if pa.types.is_fixed_size_list(data_type):
        return pa.list_(_plain_type(data_type.value_type), data_type.list_size)
    if read.list_depth(data_type)[0]:
        return pa.list_(_plain_type(data_type.value_type))
    return data_type


def flat_row(row: read.Row) -> pa.Table:
    """Return a stored row as a table with structs ``a{b, c}`` as flat columns ``a.b``, ``a.c``."""
    return _without_structs(row.group.table.slice(row.index, 1))


def _without_structs(table: pa.Table) -> pa.Table:
    # Unpacks one level of structs at a time.
    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table


def number_lists(rows: Sequence[AnyArray], data_type: pa.DataType) -> pa.Array:
    """Pack one array (T_i, width) or (T_i,) per row into an Arrow list column of the given type."""
    flat = np.concatenate([row.reshape(-1) for row in rows])
    depth, leaf = read.list_depth(data_type)
    inner = pa.array(flat.astype(leaf.to_pandas_dtype(), copy=False), leaf)
    if depth == 2:
        inner = pa.FixedSizeListArray.from_arrays(inner, data_type.value_type.list_size)
    return _outer_list(inner, [len(row) for row in rows], data_type)


def bytes_lists(
    rows: Sequence[Sequence[bytes | memoryview]], suffix: str, data_type: pa.DataType
) -> pa.Array:
    """Pack encoded images or clips into a list column of structs; their paths are ``TOUCH.suffix``."""
    blobs = pa.array([bytes(blob) for row in rows for blob in row], pa.binary())
    paths = pa.array([f"{touch:03d}.{suffix}" for row in rows for touch in range(len(row))], pa.string())
    inner = pa.StructArray.from_arrays([blobs, paths], fields=list(MEDIA_TYPE))
    return _outer_list(inner, [len(row) for row in rows], data_type)


def take_touches(table: pa.Table, touches: Sequence[int], count: int) -> pa.Table:
    """Return a flat table of one row of ``count`` touches with some of them only, in the order given."""
    chosen = pa.array(touches, pa.int64())
    columns = []
    for name in table.column_names:
        array = table.column(name).combine_chunks()
        # A column of another length has no entry per touch and is kept as a whole.
        if is_per_touch(name, array.type) and len(array.flatten()) == count:
            values = array.flatten().take(chosen)
            array = _outer_list(values, [len(touches)], pa.list_(array.type.value_type))
        columns.append(array)
    return pa.table(columns, names=table.column_names)


def _outer_list(inner: pa.Array, lengths: Sequence[int], data_type: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(data_type):
        return pa.FixedSizeListArray.from_arrays(inner, type=data_type)
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), inner, type=data_type)
