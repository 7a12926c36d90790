"""The published schema of real touches: which columns there are, of which type, and what makes a kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.columns import column_names, stored_class_names
from tactile_toolkit.read.nested import list_depth

__all__ = [
    "CLASS_NAMES",
    "MEDIA_COLUMN",
    "PLATE_COLUMN",
    "Kind",
    "class_names",
    "column_type",
    "kind_of",
    "require_types",
]

Kind = Literal["seq", "single"]
MEDIA_COLUMN: dict[Kind, str] = {"seq": "sensor_video", "single": "sensor_image"}
"""The column that makes a data set one of clips or one of images."""

PLATE_COLUMN = "plate_z_m"
"""Height of the plate in a round from which `select` took touches, metres, cell frame."""

CLASS_NAMES = tuple(str(digit) for digit in range(10))


def kind_of(schema: Any, where: str) -> Kind:
    """Tell whether a data set holds clips (``seq``) or images (``single``).

    Raises
    ------
    InputError
        It holds neither, or both.
    """
    names = column_names(schema) if schema is not None else ()
    kinds = [kind for kind, column in MEDIA_COLUMN.items() if column in names]
    if len(kinds) != 1:
        message = (
            f"{where!r} is no data set of real touches: expected a column 'sensor_video' or 'sensor_image', "
            f"found {', '.join(names) or 'no columns'}; next: name one, such as real-single-64x64"
        )
        raise InputError(message)
    return kinds[0]


def require_types(schema: Any, where: str) -> None:
    """Check the type of every known column that is there, and that the class names can be read.

    Raises
    ------
    IntegrityError
        A column has a type that its values cannot be read from; names file and column.
    """
    class_names(schema, where)
    for name, (depth, fits, expected) in _TYPES.items():
        data_type = column_type(schema, name)
        if data_type is None:
            continue
        found_depth, leaf = list_depth(data_type)
        if found_depth != depth or not fits(leaf):
            message = (
                f"{where!r}, field {name!r}: the column has the type {data_type}; expected {expected}; "
                "next: download or convert the data set again"
            )
            raise IntegrityError(message)


def column_type(schema: Any, name: str) -> Any:
    """Return the Arrow type of a column by dotted name, flat or inside structs; None when it is not there."""
    import pyarrow as pa

    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        index = schema.get_field_index(".".join(parts[:count]))
        if index < 0:
            continue
        found = schema.field(index).type
        for part in parts[count:]:
            place = found.get_field_index(part) if pa.types.is_struct(found) else -1
            if place < 0:
                return None
            found = found.field(place).type
        return found
    return None


def class_names(schema: Any, where: str = "") -> tuple[str, ...]:
    """Return the class names that `datasets` stored in the schema, or the ten digits.

    Raises
    ------
    IntegrityError
        What is stored there is no description of features; names the file, ``where``.
    """
    found = stored_class_names(schema, where)
    return CLASS_NAMES if found is None else found


def _is_text(leaf: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_string(leaf) or pa.types.is_large_string(leaf) or pa.types.is_integer(leaf))


def _is_whole(leaf: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_integer(leaf))


def _is_float(leaf: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_float32(leaf) or pa.types.is_float64(leaf))


def _is_time(leaf: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_duration(leaf)) or _is_float(leaf)


def _is_bytes(leaf: Any) -> bool:
    import pyarrow as pa

    if pa.types.is_struct(leaf) and leaf.get_field_index("bytes") >= 0:
        leaf = leaf.field(leaf.get_field_index("bytes")).type
    return bool(pa.types.is_binary(leaf) or pa.types.is_large_binary(leaf))


_TYPES: dict[str, tuple[int, Callable[[Any], bool], str]] = {
    "id": (0, _is_text, "a string"),
    "label": (0, _is_whole, "a whole number"),
    "object_id": (0, _is_whole, "a whole number"),
    PLATE_COLUMN: (0, _is_float, "a float: metres"),
    "pos_in_cell": (2, _is_float, "two floats per touch"),
    "gel_pose_cell_frame.position": (2, _is_float, "three floats per touch"),
    "gel_pose_cell_frame.quaternion": (2, _is_float, "four floats per touch"),
    "sensor_image": (1, _is_bytes, "a struct of bytes and path per touch"),
    "video_length_frames": (1, _is_whole, "a whole number per touch"),
    "gel_pose_cell_frame_seq.position": (3, _is_float, "three floats per frame of each touch"),
    "gel_pose_cell_frame_seq.quaternion": (3, _is_float, "four floats per frame of each touch"),
    "time_stamp_rel_seq": (2, _is_time, "a duration or float seconds per frame of each touch"),
    "touch_start_time_rel": (1, _is_time, "a duration or float seconds per touch"),
    "touch_end_time_rel": (1, _is_time, "a duration or float seconds per touch"),
    "sensor_video": (1, _is_bytes, "a struct of bytes and path per touch"),
}
"""Depth of nesting, test of the innermost type, and its words."""
