from __future__ import annotations

from itertools import pairwise

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import require_mesh_columns
from tactile_toolkit.read import RaggedColumn, class_names, vectors_type
from tactile_toolkit.read.record import ragged_array, ragged_column
from tactile_toolkit.read.schemas import feature_metadata, label_feature
from tests.mesh_columns import list_array

lengths = st.lists(st.integers(0, 5), max_size=6)


@given(lengths)
def test_ragged_columns_and_back(counts):
    offsets = np.cumsum([0, *counts])
    values = np.arange(3 * offsets[-1], dtype=np.float32).reshape(-1, 3)
    array = ragged_array(RaggedColumn(values, offsets), pa.float32())
    assert array.equals(list_array([values[a:b] for a, b in pairwise(offsets)], pa.float32()))
    back = ragged_column(array)
    assert np.array_equal(back.values, values)
    assert np.array_equal(back.offsets, offsets)


def test_class_names_are_read_from_the_schema_or_default():
    schema = pa.schema([("label", pa.int64())])
    assert class_names(schema, ("a", "b")) == ("a", "b")
    named = schema.with_metadata(feature_metadata({"label": label_feature(("1", "2"))}))
    assert class_names(named, ("a", "b")) == ("1", "2")
    unlabelled = schema.with_metadata(feature_metadata({}))
    assert class_names(unlabelled, ("a", "b")) == ("a", "b")


def test_missing_column_is_named():
    flat = pa.schema(
        [
            *[("id", pa.int64()), ("label", pa.int64())],
            *[("mesh.vertices", vectors_type(pa.float32())), ("mesh.faces", vectors_type(pa.int32()))],
        ]
    )
    require_mesh_columns(flat, "set", "make it")
    with pytest.raises(
        InputError, match=r"'set' is not a data set of meshes: column 'mesh.faces' .* `make it`"
    ):
        require_mesh_columns(flat.remove(3), "set", "make it")
