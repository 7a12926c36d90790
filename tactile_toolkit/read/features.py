"""Metadata of `datasets` in Arrow schemas: the features of a data set."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TypeVar

import msgspec
import pyarrow as pa

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.json_types import JsonDict, JsonObject

N = TypeVar("N", tuple[str, ...], None)

# Names of Arrow that differ in numpy and `datasets`.
_DTYPES = {"double": "float64", "float": "float32", "halffloat": "float16"}


class _Label(msgspec.Struct):
    names: list[str] | None = None


class _Info(msgspec.Struct):
    features: JsonDict | None = None


class _Metadata(msgspec.Struct):
    info: _Info | None = None


def dtype_name(data_type: pa.DataType) -> str:
    """Return the name in `datasets` of an Arrow type of scalars."""
    return _DTYPES.get(str(data_type), str(data_type))


def label_feature(names: Sequence[str]) -> JsonDict:
    """Describe the label column to `datasets`."""
    return {"names": list(names), "_type": "ClassLabel"}


def feature_metadata(features: JsonObject) -> dict[str, str]:
    """Return schema metadata from which `datasets` reads the features of a Parquet file."""
    return {"huggingface": json.dumps({"info": {"features": dict(features)}})}


def stored_features(schema: pa.Schema, where: str) -> JsonDict:
    """Return the features that `datasets` stored in a schema, by column; empty if there are none.

    Raises IntegrityError, which names the file ``where``, when the metadata do not describe features.
    """
    text = (schema.metadata or {}).get(b"huggingface", b"{}")
    try:
        found = (msgspec.json.decode(text, type=_Metadata).info or _Info()).features or {}
        msgspec.convert(found.get("label"), _Label | None)
    except (msgspec.MsgspecError, RecursionError) as error:
        beginning = text[:80].decode(errors="replace")
        raise IntegrityError(
            f"{where!r}, field 'label': the metadata 'huggingface' begins with {beginning!r}; expected the "
            "features of the data set, class names among them, in JSON",
            next="download or convert the data set again",
        ) from error
    return found


def class_names(schema: pa.Schema, default: N, where: str = "") -> tuple[str, ...] | N:
    """Return the class names that `datasets` stored in a schema, or ``default``.

    Raises IntegrityError, which names the data set ``where``, for invalid metadata.
    """
    names = (stored_features(schema, where).get("label") or {}).get("names")
    return default if names is None else tuple(names)
