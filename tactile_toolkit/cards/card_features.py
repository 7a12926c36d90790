"""Columns as `datasets` describes them in the head of a card."""

from __future__ import annotations

import pyarrow as pa

from tactile_toolkit import read
from tactile_toolkit.json_types import JsonDict, JsonValue

_MEDIA = {"Image": "image", "Video": "video", "Audio": "audio", "Mesh": "mesh"}


def yaml_features(schema: pa.Schema, where: str = "") -> list[JsonDict]:
    """Describe each column of a schema as `datasets` does in ``dataset_info.features``.

    Classes, images and videos follow from the metadata of `datasets`. A column with a dotted name, such as
    ``mesh.vertices``, is not a struct. Raises IntegrityError, which names the file ``where``, for
    metadata that cannot be read.
    """
    # Not by `datasets`, whose import takes longer than making a small data set.
    features = read.stored_features(schema, where)
    return [{"name": each.name, **_entry(each.type, features.get(each.name))} for each in schema]


def _entry(data_type: pa.DataType, feature: JsonValue) -> JsonDict:
    """Describe a column or list element by its Arrow type and metadata."""
    known = feature if isinstance(feature, dict) else {}
    if known.get("_type") == "ClassLabel" and isinstance(known.get("names"), list):
        return {"dtype": {"class_label": {"names": {str(n): name for n, name in enumerate(known["names"])}}}}
    if isinstance(known.get("_type"), str) and known["_type"] in _MEDIA:
        return {"dtype": _MEDIA[known["_type"]]}
    types = pa.types
    if types.is_list(data_type) or types.is_fixed_size_list(data_type):
        # Metadata of the elements, in the forms of all releases.
        element = next(iter(feature), None) if isinstance(feature, list) else known.get("feature")
        inner = _entry(data_type.value_type, element)
        fixed = {"length": data_type.list_size} if types.is_fixed_size_list(data_type) else {}
        is_short = set(inner) in ({"dtype"}, {"struct"})
        return {"list": next(iter(inner.values())) if is_short else inner, **fixed}
    if types.is_struct(data_type):
        return {"struct": [{"name": f.name, **_entry(f.type, known.get(f.name))} for f in data_type]}
    return {"dtype": read.dtype_name(data_type)}
