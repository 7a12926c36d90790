"""Types of columns: of text, of values of JSON and NumPy, and of Arrow; they are joined without loss."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tactile_toolkit.columns import column_types

TEXT, LIST = pa.string(), pa.list_(pa.int64())


@pytest.mark.parametrize(
    ("values", "data_type"),
    [
        (["true", "", "False"], pa.bool_()),
        (["1", " 22", "", "-3"], pa.int64()),
        (["007", "3"], TEXT),
        (["007.5", "3"], TEXT),
        (["1", "2.5", "1e-3", "nan"], pa.float64()),
        (["100000000000000000000", "inf"], TEXT),
        (["9007199254740993", "0.5"], TEXT),
        (["9" * 5000, "0.5"], TEXT),
        (["1e400", "1"], TEXT),
        (["1,5", "2,25"], TEXT),
        (["9" * 19], TEXT),
        (["1_0"], TEXT),
        (["a", "1"], TEXT),
        ([None, "", " "], pa.null()),
    ],
)
def test_types_of_text(values: list[Any], data_type: pa.DataType) -> None:
    column = column_types.column_of(pa.array(values, TEXT), from_text=True)
    assert column.type == data_type
    if data_type == TEXT:
        assert column.to_pylist() == values


def test_commas_are_decimal_marks_where_the_separator_shows_it() -> None:
    """Otherwise ``1,234`` may mean a thousand, as it does beside a number with a point."""
    for values, expected in ((["1,5", "1,234"], [1.5, 1.234]), (["1,5", "1.5"], ["1,5", "1.5"])):
        types = column_types.ColumnTypes(is_text=True, decimal_commas=True)
        column = types.whole(pa.table({"x": values}), (), ())["x"]
        assert column.to_pylist() == expected
    with pytest.raises(ValueError, match="1,234"):
        column_types.floats_of(pa.array(["1,234", "x"]))


@pytest.mark.parametrize(
    ("values", "data_type"),
    [
        ([True, None, False], pa.bool_()),
        ([1, None, -3], pa.int64()),
        ([1, 2.5], pa.float64()),
        ([9007199254740993, 0.5], TEXT),
        ([10**400, 0.5], TEXT),
        ([1 << 63], TEXT),
        ([1, "a"], TEXT),
        ([True, 1], TEXT),
        ([np.float32(1), None], pa.float64()),
        ([[1, 2], [], None], LIST),
        ([[1, 2.5], (3,)], pa.list_(pa.float64())),
        ([[[1.0, 0], [0, 1]], [[1, None]]], pa.list_(pa.float64())),
        ([[[[1]]]], LIST),
        ([[[1, 2], [3]]], column_types.UNTYPED),
        ([[[1, 2], 3]], column_types.UNTYPED),
        ([["a"], [None]], pa.list_(TEXT)),
        ([[1, "a"], None], pa.list_(TEXT)),
        ([{"a": 1}, 2], column_types.UNTYPED),
        ([b"a"], column_types.UNTYPED),
        ([[1], 2], column_types.UNTYPED),
        ([["\ud800"]], pa.list_(TEXT)),
        ([[[[[[[1]]]]]]], LIST),
    ],
)
def test_types_of_values(values: list[Any], data_type: pa.DataType) -> None:
    assert column_types.column_of(values).type == data_type


@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        (pa.array(["a", "b", "a"]).dictionary_encode(), ["a", "b", "a"]),
        (pa.array(["a", None], pa.string_view()), ["a", None]),
        (pa.array([[1, 2], None], pa.list_(pa.int16(), 2)), [[1, 2], None]),
        (
            pa.array([[[1, 2], [3, 4]], [], None], pa.large_list(pa.list_(pa.int8()))),
            [[1, 2, 3, 4], [], None],
        ),
        (pa.array([1.5, None], pa.float16()), [1.5, None]),
        (pa.array([1, 1 << 63], pa.uint64()), ["1", str(1 << 63)]),
        (pa.chunked_array([], pa.int8()), []),
    ],
)
def test_columns_of_arrow_have_few_types(stored: Any, expected: list[Any]) -> None:
    assert column_types.column_of(stored).to_pylist() == expected


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([[1], [2.5], [None]], [1.0, 2.5, None]),
        ([[1 << 60], [0.5]], [str(1 << 60), "0.5"]),
        ([[1], ["a"]], ["1", "a"]),
        ([[[1]], [[0.5, 2]]], [[1.0], [0.5, 2.0]]),
        ([[[1]], [3]], [[1], 3]),
        ([[{"a": 1}], [2]], [{"a": 1}, 2]),
    ],
)
def test_joined_columns_hold_all_values_exactly(parts: list[Any], expected: list[Any]) -> None:
    column = column_types.joined(list(map(column_types.column_of, parts)))
    assert column_types.values_of(column) == expected
