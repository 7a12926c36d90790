"""Columns and types that all sets of touches share, as in the published schema."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import pyarrow as pa

from tactile_toolkit import read
from tactile_toolkit.json_types import JsonObject

Kind = Literal["seq", "single"]
MEDIA_COLUMN: dict[Kind, str] = {"seq": "sensor_video", "single": "sensor_image"}
"""Column of clips or images, by which the kind of a data set is recognised."""

MEDIA_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""Arrow type of an image or clip: its bytes and its original file name."""

CLASS_NAMES = tuple(str(digit) for digit in range(10))


def with_features(schema: pa.Schema, label_names: Sequence[str] | None) -> pa.Schema:
    """Add the metadata from which `datasets` reads the features: classes, images, numbers.

    Without ``label_names``, the class is a plain number; an empty list means that there are no classes.
    """
    features = {field.name: _feature(field.name, field.type, label_names) for field in schema}
    return schema.with_metadata(read.feature_metadata(features))


def _feature(name: str, data_type: pa.DataType, label_names: Sequence[str] | None) -> JsonObject:
    if name == "label" and label_names is not None:
        return read.label_feature(label_names)
    if read.list_depth(data_type)[0]:
        length = getattr(data_type, "list_size", -1)
        inner = _feature(name, data_type.value_type, label_names)
        # Both old and new releases of `datasets` read "Sequence" as a list.
        return {"feature": inner, "length": length, "_type": "Sequence"}
    if name in MEDIA_COLUMN.values() or data_type == MEDIA_TYPE:
        return {"_type": "Video" if name == MEDIA_COLUMN["seq"] else "Image"}
    return {"dtype": read.dtype_name(data_type), "_type": "Value"}
