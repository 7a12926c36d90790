"""A row is declared once: schema, table and descriptions of its columns follow."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, field

import numpy as np
import pyarrow as pa
import pytest

from mnist3d.digit_card import facts_table, summarise_columns
from tactile_toolkit.read import vectors_type
from tactile_toolkit.rows import TypedRow, column

OBJECTS = pa.list_(pa.struct([("name", pa.string()), ("x_m", pa.float64())]))


class Base(TypedRow):
    id: int = column(pa.int64())
    points: np.ndarray = column(vectors_type(pa.float32(), 2), "N x 2, m", "corners", name="base.points")


class Full(Base):
    id: int = column(pa.int64(), "", "number")
    objects: list = column(OBJECTS, "one each", "what is there")
    tags: list = column(pa.list_(pa.string()))
    note: str = field()


def full(number: int, objects: list, points: int = 2) -> Full:
    corners = np.full((points, 2), number, np.float32)
    return Full(id=number, points=corners, objects=objects, tags=["a"] * number, note="not stored")


def test_columns_of_the_base_come_first_and_other_attributes_are_not_stored():
    assert Full.plain_schema().names == ["id", "base.points", "objects", "tags"]
    assert Full.plain_schema().types == [
        pa.int64(),
        vectors_type(pa.float32(), 2),
        OBJECTS,
        pa.list_(pa.string()),
    ]
    assert Full.meanings()["base.points"] == ("N x 2, m", "corners")
    assert Full.meanings()["id"] == ("", "number")
    with pytest.raises(FrozenInstanceError):
        full(1, []).id = 2  # type: ignore[misc]


@pytest.mark.parametrize("objects", [[], [("box", 0.5), ("disc", 1.5)]])
def test_a_table_holds_the_rows(objects):
    schema = Full.plain_schema().with_metadata({"made": "here"})
    table = Full.table([full(1, objects), full(2, [], points=0), full(3, objects)], schema)
    table.validate(full=True)
    assert table.schema.equals(schema, check_metadata=True)
    expected = [{"name": name, "x_m": x_m} for name, x_m in objects]
    assert table.to_pylist() == [
        {"id": 1, "base.points": [[1.0, 1.0]] * 2, "objects": expected, "tags": ["a"]},
        {"id": 2, "base.points": [], "objects": [], "tags": ["a"] * 2},
        {"id": 3, "base.points": [[3.0, 3.0]] * 2, "objects": expected, "tags": ["a"] * 3},
    ]
    assert Full.table([], schema).equals(schema.empty_table())


class Print(TypedRow):
    split: str = column(pa.string())
    words: tuple = column(pa.list_(pa.string()), role="facet", title="Warnings")
    height_mm: float = column(pa.float64(), "mm", role="measure", title="Height", decimals=1)
    story: str = column(pa.string(), role="hidden", default="")


class Splits:
    @staticmethod
    def split_table():
        return {"train": {"rows": 3}, "test": {"rows": 0}}


def test_a_split_is_summed_up_by_the_roles_of_its_columns():
    rows = [
        Print("train", ("thin",), 1.25),
        Print("train", ("thin", "tall"), 9.0),
        Print("train", (), 2.0),
    ]
    table = Print.table(rows)
    assert table.column_names == ["split", "words", "height_mm"]
    declared = Print.with_role("facet", "measure")
    train, test = summarise_columns(Splits, table, declared)
    assert train.to_dict() == {
        "split": "train",
        "rows": 3,
        "words": {"tall": 1, "thin": 2},
        "height_mm": (1.25, 2.0, 9.0),
    }
    assert (test.facets, test.measures) == ({"words": {}}, {"height_mm": ()})
    assert facts_table([train, test], declared) == (
        ("", "train", "test"),
        [
            ("Warnings", "tall: 1, thin: 2", "none"),
            ("Height, mm", "1.2 to 9.0 (median 2.0)", "-"),
        ],
    )
