from __future__ import annotations

import pyarrow as pa
import pytest

from tactile_toolkit.read.columns import null_fields, ragged_column

VECTORS = pa.list_(pa.list_(pa.float32(), 3))
OBJECTS = pa.list_(pa.struct([("shape", pa.string()), ("x", pa.float64())]))


def obj(shape="star", x=0.0):
    return {"shape": shape, "x": x}


@pytest.mark.parametrize(
    ("name", "column", "found"),
    [
        ("id", pa.array([1, None, 3]), {1: "id"}),
        ("v", pa.array([[[1, 2, 3]], None, []], VECTORS), {1: "v"}),
        ("v", pa.array([[], [[1, 2, 3], [1, None, 3]], [None]], VECTORS), {1: "v", 2: "v"}),
        ("o", pa.array([[obj()], [obj(), obj(None)], [None]], OBJECTS), {1: "o.shape", 2: "o"}),
        ("o", pa.array([[obj(x=None)], [], [obj()]], OBJECTS), {0: "o.x"}),
        ("o", pa.array([[], [], [obj()]], OBJECTS), {}),
    ],
)
def test_rows_with_a_null_are_found_with_the_field(name, column, found):
    padding = pa.array([column.slice(0, 1)[0]] * 2, column.type)
    table = pa.table({name: pa.concat_arrays([padding, column])})
    assert null_fields(table.slice(2), [name, "absent"]) == found


def test_field_of_a_struct_is_found_by_its_dotted_name():
    table = pa.table({"mesh": pa.array([{"faces": [1]}, {"faces": None}])})
    assert null_fields(table, ["mesh.faces"]) == {1: "mesh.faces"}


@pytest.mark.parametrize("level", ["row", "vector", "number"])
def test_no_null_is_viewed_as_numbers(level):
    """Also where numbers lie beneath it, as libraries leave them that only mark what is gone."""
    gone = pa.array([False, True])
    numbers = pa.array([1, 2, 3, 4, 5, None if level == "number" else 6], pa.float32())
    vectors = pa.FixedSizeListArray.from_arrays(numbers, 3, mask=gone if level == "vector" else None)
    starts = pa.array([0, 1, 2], pa.int32())
    rows = pa.ListArray.from_arrays(starts, vectors, mask=gone if level == "row" else None)
    with pytest.raises(ValueError, match="1 null values where every row needs one"):
        ragged_column(rows)
