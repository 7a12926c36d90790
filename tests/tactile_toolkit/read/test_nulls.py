from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import mnist3d
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.record import null_fields, ragged_column
from tests.command_line import call

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
    """Also if the buffer still has numbers, as in libraries that only mark missing values."""
    gone = pa.array([False, True])
    numbers = pa.array([1, 2, 3, 4, 5, None if level == "number" else 6], pa.float32())
    vectors = pa.FixedSizeListArray.from_arrays(numbers, 3, mask=gone if level == "vector" else None)
    starts = pa.array([0, 1, 2], pa.int32())
    rows = pa.ListArray.from_arrays(starts, vectors, mask=gone if level == "row" else None)
    with pytest.raises(ValueError, match="1 null values where every row needs one"):
        ragged_column(rows)


COLUMNS = {
    "id": pa.int64(),
    "label": pa.int64(),
    "mesh.vertices": VECTORS,
    "mesh.faces": pa.list_(pa.list_(pa.int32(), 3)),
    "volume_m3": pa.float32(),
}
FIELDS = {
    "id": "id",
    "label": "label",
    "mesh.vertices": "vertices_m",
    "mesh.faces": "faces",
    "volume_m3": "volume_m3",
}


@pytest.fixture
def digits_without(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Five tetrahedra, of which the last but one has no value."""
    corners = [[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]]
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    values = {"mesh.vertices": corners, "mesh.faces": faces, "volume_m3": 2e-5}
    rows = [{"id": row, "label": row, **values} for row in range(5)]
    rows[3][request.param] = None
    file = tmp_path / "train-00000-of-00001.parquet"
    pq.write_table(pa.Table.from_pylist(rows, pa.schema(COLUMNS.items())), file)
    return file


@pytest.mark.parametrize(
    ("digits_without", "name"), [(name, name) for name in COLUMNS], indirect=["digits_without"]
)
def test_a_null_is_named_with_file_and_row(digits_without: Path, name: str) -> None:
    """The other rows are read."""
    digits = mnist3d.load(str(digits_without))
    for row in (0, 1, 2, 4):
        assert (digits[row].id, digits[row].label, len(digits[row].vertices_m)) == (row, row, 4)
        assert len(digits[row].faces) == 4
    with pytest.raises(
        IntegrityError, match=rf"{digits_without}', row 3, field '{name}': no value is stored"
    ):
        getattr(digits[3], FIELDS[name])


@pytest.mark.parametrize("digits_without", ["mesh.vertices", "label"], indirect=True)
@pytest.mark.parametrize("command", ["preview", "gallery", "export --format flat"])
def test_commands_name_a_null(digits_without, command, tmp_path, capsys):
    name, *options = command.split()
    assert (
        call("tactile", name, digits_without, *options, "--kind", "mnist3d", "--out", tmp_path / "out") == 3
    )
    assert f"{digits_without}', row 3, field" in "".join(capsys.readouterr().err.split("\n"))
