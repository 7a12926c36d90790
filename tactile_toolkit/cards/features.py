"""Columns of a Parquet file in the words of a card: ``dataset_info.features`` as `datasets` itself writes it.

Written here, because importing `datasets` would take longer than making a small data set.
"""

from __future__ import annotations

import json
from typing import Any

__all__ = ["yaml_features"]

_DTYPES = {"double": "float64", "float": "float32", "halffloat": "float16"}
_MEDIA = {"Image": "image", "Video": "video", "Audio": "audio"}


def yaml_features(schema: Any) -> list[dict[str, Any]]:
    """Describe the columns of a schema.

    Parameters
    ----------
    schema : pyarrow.Schema
        With the metadata that `datasets` stores, which names classes, images and videos. Dots in the names of
        columns stay: ``mesh.vertices`` is one column, no struct.

    Returns
    -------
    list of dict
        One entry per column, in order; equal to what `datasets` writes for the same file.
    """
    metadata = (schema.metadata or {}).get(b"huggingface")
    features = json.loads(metadata)["info"]["features"] if metadata else {}
    return [_named(field.name, _entry(field.type, features.get(field.name))) for field in schema]


def _named(name: str, entry: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, **entry}


def _entry(data_type: Any, feature: Any) -> dict[str, Any]:
    """Describe one column or list element, by its Arrow type and what the metadata knows of it."""
    import pyarrow as pa

    special = _special(feature)
    if special is not None:
        return {"dtype": special}
    if _is_list(data_type):
        inner = _entry(data_type.value_type, _element(feature))
        fixed = {"length": data_type.list_size} if pa.types.is_fixed_size_list(data_type) else {}
        return {"list": _unwrapped(inner), **fixed}
    if pa.types.is_struct(data_type):
        known = feature if isinstance(feature, dict) else {}
        return {"struct": [_named(f.name, _entry(f.type, known.get(f.name))) for f in data_type]}
    return {"dtype": _dtype(data_type)}


def _special(feature: Any) -> Any:
    kind = feature.get("_type") if isinstance(feature, dict) else None
    if kind == "ClassLabel":
        return {"class_label": {"names": {str(n): name for n, name in enumerate(feature["names"])}}}
    return _MEDIA.get(kind) if isinstance(kind, str) else None


def _element(feature: Any) -> Any:
    """Return what the metadata says of the elements of a list, in the spellings of all releases."""
    if isinstance(feature, list):
        return feature[0]
    return feature.get("feature") if isinstance(feature, dict) else None


def _unwrapped(inner: dict[str, Any]) -> Any:
    """Return the short form of an element: a bare dtype, a bare list of fields."""
    return next(iter(inner.values())) if set(inner) in ({"dtype"}, {"struct"}) else inner


def _is_list(data_type: Any) -> bool:
    import pyarrow as pa

    kinds = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    return any(fits(data_type) for fits in kinds)


def _dtype(data_type: Any) -> str:
    return _DTYPES.get(str(data_type), str(data_type))
