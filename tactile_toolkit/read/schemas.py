"""Schemas of stored rows: columns by dotted name, their types, and features of `datasets`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import msgspec
import pyarrow as pa

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.value_types import JsonDict, JsonObject, JsonValue

N = TypeVar("N", tuple[str, ...], None)

# Names of Arrow that differ in numpy and `datasets`.
_DTYPES = {"double": "float64", "float": "float32", "halffloat": "float16"}
# Features of `datasets` for files, and their names in cards.
# Key of the metadata of a merged file: the columns, in JSON, that the data set of its rows did not have.
_ABSENT = b"absent_columns"
_MEDIA = {"Image": "image", "Video": "video", "Audio": "audio", "Mesh": "mesh"}


class Expected(NamedTuple):
    """Required type of a column: depth of nesting, tests of the innermost type, one of which must hold."""

    depth: int
    tests: tuple[Callable[[pa.DataType], bool], ...]
    description: str

    @staticmethod
    def problem(types: Mapping[str, pa.DataType], expected: Mapping[str, Expected]) -> str:
        """Describe the first existing column with an unreadable type; empty if there is none."""
        for name in filter(types.__contains__, expected):
            depth, tests, description = expected[name]
            found_depth, leaf = list_depth(types[name])
            if pa.types.is_struct(leaf) and leaf.get_field_index("bytes") >= 0:
                leaf = leaf.field("bytes").type
            if found_depth != depth or not any(test(leaf) for test in tests):
                return f"field {name!r}: the column has the type {types[name]}; expected {description}"
        return ""


def list_depth(data_type: pa.DataType) -> tuple[int, pa.DataType]:
    """Return the number of nested lists in an Arrow type, and the innermost type."""
    depth = 0
    while isinstance(data_type, (pa.ListType, pa.FixedSizeListType)):
        depth = depth + 1
        data_type = data_type.value_type
    return depth, data_type


def absent_columns(schema: pa.Schema) -> tuple[str, ...] | None:
    """Return the columns of a file that hold only nulls, as the data set of its rows had none.

    Only a file that was merged with files of other columns states them; None for others.
    """
    stated = (schema.metadata or {}).get(_ABSENT)
    return None if stated is None else tuple(json.loads(stated))


def with_absent(schema: pa.Schema, columns: Iterable[str]) -> pa.Schema:
    """Return the schema of a merged file whose rows lack some columns."""
    absent = json.dumps([name for name in schema.names if name in {*columns}]).encode()
    return schema.with_metadata({**(schema.metadata or {}), _ABSENT: absent})


def column_types(fields: Iterable[pa.Field], prefix: str = "") -> dict[str, pa.DataType]:
    """Return the Arrow type of each column of a schema by dotted name; structs precede their fields.

    Struct ``a<b, c>`` and flat columns ``a.b``, ``a.c`` have the same names. Without those of
    :func:`absent_columns`.
    """
    if isinstance(fields, pa.Schema):
        absent = absent_columns(fields) or ()
        fields = (column for column in fields if column.name not in absent)
    types = {}
    for column in fields:
        name = prefix + column.name
        types[name] = column.type
        if pa.types.is_struct(column.type):
            types |= column_types(column.type, f"{name}.")
    return types


def column_names(schema: pa.Schema) -> tuple[str, ...]:
    """List columns by dotted name, at any depth, with the fields of structs."""
    types = column_types(schema).items()
    return tuple([name for name, data_type in types if not pa.types.is_struct(data_type)])


class _Label(msgspec.Struct):
    names: list[str] | None = None


class _Info(msgspec.Struct):
    features: JsonDict | None = None


class _Metadata(msgspec.Struct):
    info: _Info | None = None


def dtype_name(data_type: pa.DataType) -> str:
    """Return the name in `datasets` of an Arrow type of scalars."""
    return _DTYPES.get(str(data_type), str(data_type))


def value_feature(data_type: pa.DataType, leaf: JsonObject | None = None) -> JsonObject:
    """Describe a column to `datasets`: the values in lists as ``leaf``, by default by their type."""
    if not isinstance(data_type, (pa.ListType, pa.FixedSizeListType)):
        return leaf or {"dtype": dtype_name(data_type), "_type": "Value"}
    length = getattr(data_type, "list_size", -1)
    # Both old and new releases of `datasets` read "Sequence" as a list.
    return {"feature": value_feature(data_type.value_type, leaf), "length": length, "_type": "Sequence"}


def label_feature(names: Sequence[str]) -> JsonDict:
    """Describe the label column to `datasets`."""
    return {"names": list(names), "_type": "ClassLabel"}


def feature_metadata(features: JsonObject) -> dict[str, str]:
    """Return schema metadata from which `datasets` reads the features of a Parquet file."""
    return {"huggingface": json.dumps({"info": {"features": dict(features)}})}


def stored_features(schema: pa.Schema, path: str) -> JsonDict:
    """Return the features that `datasets` stored in a schema, by column; empty if there are none.

    Raises IntegrityError, which names the file ``path``, when the metadata do not describe features.
    """
    text = (schema.metadata or {}).get(b"huggingface", b"{}")
    try:
        features = (msgspec.json.decode(text, type=_Metadata).info or _Info()).features or {}
        msgspec.convert(features.get("label"), _Label | None)
    except (msgspec.MsgspecError, RecursionError) as error:
        beginning = text[:80].decode(errors="replace")
        raise IntegrityError(
            f"{path!r}, field 'label': the metadata 'huggingface' begins with {beginning!r}; expected the "
            "features of the data set, class names among them, in JSON",
            next="download or convert the data set again",
        ) from error
    return features


def class_names(schema: pa.Schema, default: N, path: str = "") -> tuple[str, ...] | N:
    """Return the class names that `datasets` stored in a schema, or ``default``.

    Raises IntegrityError, which names the data set ``path``, for invalid metadata.
    """
    names = (stored_features(schema, path).get("label") or {}).get("names")
    return default if names is None else tuple(names)


def yaml_features(schema: pa.Schema, path: str = "") -> list[JsonDict]:
    """Describe each column of a schema as `datasets` does in ``dataset_info.features``.

    Classes, images and videos follow from the metadata of `datasets`. A column with a dotted name, such as
    ``mesh.vertices``, is not a struct. Raises IntegrityError, which names the file ``path``, for
    metadata that cannot be read.
    """
    # Not by `datasets`, whose import takes longer than making a small data set.
    features = stored_features(schema, path)
    return [{"name": column.name, **_entry(column.type, features.get(column.name))} for column in schema]


def supported_type(data_type: pa.DataType) -> pa.DataType:
    """Return the supported type for the same values: no dictionary, view, 64-bit offset or half float."""
    kinds = pa.types
    if kinds.is_dictionary(data_type):
        return supported_type(data_type.value_type)
    if kinds.is_string_view(data_type) or kinds.is_large_string(data_type):
        return pa.string()
    if kinds.is_binary_view(data_type) or kinds.is_large_binary(data_type):
        return pa.binary()
    if kinds.is_float16(data_type):
        return pa.float32()
    if kinds.is_struct(data_type):
        return pa.struct([child.with_type(supported_type(child.type)) for child in data_type])
    if kinds.is_map(data_type):
        return pa.map_(supported_type(data_type.key_type), supported_type(data_type.item_type))
    lists = (pa.ListType, pa.LargeListType, pa.ListViewType, pa.LargeListViewType, pa.FixedSizeListType)
    if not isinstance(data_type, lists):
        return data_type
    element = data_type.value_field.with_type(supported_type(data_type.value_type))
    return pa.list_(element, getattr(data_type, "list_size", -1))


def supported_schema(schema: pa.Schema) -> pa.Schema:
    """Return a schema with :func:`supported_type` of each column; unchanged if all are supported."""
    types = list(map(supported_type, schema.types))
    if types == schema.types:
        return schema
    # Metadata of a changed field, such as its categories, are no longer valid.
    fields = [
        column if column.type == data_type else pa.field(column.name, data_type, column.nullable)
        for column, data_type in zip(schema, types, strict=True)
    ]
    return pa.schema(fields, schema.metadata)


def supported_table(table: pa.Table) -> pa.Table:
    """Return a table with the types of :func:`supported_schema`; the same table where it has them."""
    schema = supported_schema(table.schema)
    if schema is table.schema or schema.types == table.schema.types:
        return table
    columns = [_converted(*pair) for pair in zip(table.columns, schema.types, strict=True)]
    return pa.table(columns, schema=schema)


def _converted(column: pa.ChunkedArray, data_type: pa.DataType) -> pa.ChunkedArray:
    if "list_view" not in str(column.type):
        return column.cast(data_type)
    # pyarrow 26 casts list views with nulls incorrectly.
    return pa.chunked_array([pa.array(chunk.to_pylist(), data_type) for chunk in column.chunks], data_type)


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
    return {"dtype": dtype_name(data_type)}
