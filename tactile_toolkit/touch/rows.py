"""Writing rounds in the published schema: flat columns, and the features that `datasets` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.read.columns import list_depth

__all__ = [
    "PER_TOUCH_COLUMNS",
    "bytes_lists",
    "flat_schema",
    "flat_table",
    "is_per_touch",
    "media_type",
    "number_lists",
    "take_touches",
    "with_features",
]

PER_TOUCH_COLUMNS = (
    "pos_in_cell",
    "gel_pose_cell_frame.position",
    "gel_pose_cell_frame.quaternion",
    "sensor_image",
    "video_length_frames",
    "gel_pose_cell_frame_seq.position",
    "gel_pose_cell_frame_seq.quaternion",
    "time_stamp_rel_seq",
    "touch_start_time_rel",
    "touch_end_time_rel",
    "sensor_video",
)
"""Columns that hold one entry per touch."""

_MEDIA_FEATURES = {"sensor_image": "Image", "sensor_video": "Video"}


def flat_schema(schema: Any) -> Any:
    """Return the fields of a schema with structs ``a{b, c}`` as flat columns ``a.b``, ``a.c``."""
    import pyarrow as pa

    return pa.schema([leaf for field in schema for leaf in _leaves(field.name, field.type)])


def _leaves(name: str, data_type: Any) -> list[Any]:
    import pyarrow as pa

    if not pa.types.is_struct(data_type):
        return [pa.field(name, _plain_type(data_type))]
    return [leaf for child in data_type for leaf in _leaves(f"{name}.{child.name}", child.type)]


def _plain_type(data_type: Any) -> Any:
    """Return a type whose lists carry no names of their own; pickling would change those, and the bytes."""
    import pyarrow as pa

    if pa.types.is_fixed_size_list(data_type):
        return pa.list_(_plain_type(data_type.value_type), data_type.list_size)
    return pa.list_(_plain_type(data_type.value_type)) if list_depth(data_type)[0] else data_type


def flat_table(table: Any) -> Any:
    """Return a table with structs ``a{b, c}`` as flat columns ``a.b``, ``a.c``."""
    import pyarrow as pa

    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table


def with_features(schema: Any, label_names: Sequence[str]) -> Any:
    """Add the metadata from which `datasets` reads the features: classes, images, videos, numbers.

    Parameters
    ----------
    schema : pyarrow.Schema
        Flat columns.
    label_names : sequence of str
        Names of the classes.
    """
    features = {field.name: _feature(field.name, field.type, label_names) for field in schema}
    return schema.with_metadata({"huggingface": json.dumps({"info": {"features": features}})})


def _feature(name: str, data_type: Any, label_names: Sequence[str]) -> Mapping[str, Any]:
    import pyarrow as pa

    if name == "label":
        return {"names": list(label_names), "_type": "ClassLabel"}
    if list_depth(data_type)[0]:
        length = data_type.list_size if pa.types.is_fixed_size_list(data_type) else -1
        inner = _feature(name, data_type.value_type, label_names)
        # "Sequence" is the spelling that both old and new releases of `datasets` read as a list.
        return {"feature": inner, "length": length, "_type": "Sequence"}
    if name in _MEDIA_FEATURES:
        return {"_type": _MEDIA_FEATURES[name]}
    names = {"double": "float64", "float": "float32"}
    return {"dtype": names.get(str(data_type), str(data_type)), "_type": "Value"}


def media_type() -> Any:
    """Return the Arrow type of an image or clip: its bytes, and the name it once had."""
    import pyarrow as pa

    return pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def number_lists(rows: Sequence[NDArray[Any]], data_type: Any) -> Any:
    """Pack one array (T_i, width) or (T_i,) per row into an Arrow list column of the given type."""
    import pyarrow as pa

    flat = np.concatenate([row.reshape(-1) for row in rows])
    leaf = list_depth(data_type)[1]
    inner = pa.array(flat.astype(leaf.to_pandas_dtype(), copy=False), leaf)
    if list_depth(data_type)[0] == 2:
        inner = pa.FixedSizeListArray.from_arrays(inner, data_type.value_type.list_size)
    return _outer_list(inner, [len(row) for row in rows], data_type)


def bytes_lists(rows: Sequence[Sequence[bytes | memoryview]], suffix: str, data_type: Any) -> Any:
    """Pack encoded images or clips into a list column of structs; paths are ``TOUCH.suffix``."""
    import pyarrow as pa

    blobs = pa.array([bytes(blob) for row in rows for blob in row], pa.binary())
    paths = pa.array([f"{touch:03d}.{suffix}" for row in rows for touch in range(len(row))], pa.string())
    inner = pa.StructArray.from_arrays([blobs, paths], fields=list(media_type()))
    return _outer_list(inner, [len(row) for row in rows], data_type)


def _outer_list(inner: Any, lengths: Sequence[int], data_type: Any) -> Any:
    import pyarrow as pa

    if pa.types.is_fixed_size_list(data_type):
        return pa.FixedSizeListArray.from_arrays(inner, type=data_type)
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), inner, type=data_type)


def take_touches(table: Any, touches: Sequence[int], count: int) -> Any:
    """Return a flat table of one row with some of its touches only.

    Parameters
    ----------
    table : pyarrow.Table
        One row, flat columns.
    touches : sequence of int
        Touches to keep, in order.
    count : int
        T, how many there are.
    """
    import pyarrow as pa

    chosen = pa.array(touches, pa.int64())
    columns = []
    for name in table.column_names:
        array = table.column(name).combine_chunks()
        if is_per_touch(name, array.type) and _row_length(array) == count:
            values = array.flatten().take(chosen)
            array = _outer_list(values, [len(touches)], pa.list_(array.type.value_type))
        columns.append(array)
    return pa.table(columns, names=table.column_names)


def is_per_touch(name: str, data_type: Any) -> bool:
    """Tell whether a column may hold an entry per touch: known ones, and lists of vectors in ``info``."""
    return name in PER_TOUCH_COLUMNS or (name.startswith("info.") and list_depth(data_type)[0] >= 2)


def _row_length(array: Any) -> int:
    import pyarrow as pa

    return int(array.type.list_size) if pa.types.is_fixed_size_list(array.type) else len(array.flatten())
