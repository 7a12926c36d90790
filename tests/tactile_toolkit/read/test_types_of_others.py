"""Files of other libraries, with other types: values are those that these libraries read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import mnist3d
import realtouch
import starstruck_gen
from realtouch.importing.import_options import ImportColumns
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.schemas import supported_table, supported_type
from tactile_toolkit.touch import decode_image
from tests.command_line import call
from tests.mesh_columns import list_array
from tests.real_input import SHARED, needs_shared
from tests.realtouch import factories

SIDE_M = 0.01
CORNERS_M = np.array([[0, 0, 0], [SIDE_M, 0, 0], [0, SIDE_M, 0], [0, 0, SIDE_M]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)


def digits() -> pa.Table:
    names = ["id", "label", "mesh.vertices", "mesh.faces", "source"]
    meshes = [list_array([CORNERS_M] * 3, pa.float32()), list_array([FACES] * 3, pa.int32())]
    return pa.table([pa.array([7, 8, 9]), pa.array([1, 0, 1]), *meshes, pa.array(["a", "b", "a"])], names)


def scenes() -> pa.Table:
    table: pa.Table = starstruck_gen.SceneDataset(size=3, seed=5).to_hf().with_format("arrow")[:]
    return table.replace_schema_metadata(None)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    """A small set of each kind, as a table with types of the toolkit, without metadata of `datasets`."""
    rounds = [factories.make_round(index, 2, (32, 24), frames=(4, 6)) for index in range(3)]
    folder = tmp_path_factory.mktemp("touches")
    found = {"digits": digits(), "scenes": scenes()}
    for kind, rows in (("single", factories.single_rows(rounds)), ("seq", factories.seq_rows(rounds))):
        factories.write_set(folder / kind, {"train": rows}, kind)
        table = pq.read_table(folder / kind / "data" / "train-00000-of-00001.parquet")
        found[kind] = table.replace_schema_metadata(None)
    return found


LOADERS: dict[str, Callable[[str], Any]] = {
    "digits": mnist3d.load,
    "scenes": starstruck_gen.load,
    "single": realtouch.load,
    "seq": realtouch.load,
}
TEXT = ("id", "source", "info.notes")
WHOLE = ("id", "label", "object_id", "star_count", "video_length_frames")


def with_columns(table: pa.Table, names: tuple[str, ...], change: Callable[[Any], Any]) -> pa.Table:
    """Change columns of a table, if it has them; each is one array."""
    for name in set(names) & set(table.column_names):
        array = table[name].combine_chunks()
        table = table.set_column(table.column_names.index(name), name, change(array))
    return table


def views(array: pa.Array) -> pa.Array:
    return array.cast(pa.string_view()) if pa.types.is_string(array.type) else array


def floats(array: pa.Array) -> pa.Array:
    if pa.types.is_string(array.type):
        return array
    is_nested = pa.types.is_nested(array.type)
    return array.cast(pa.list_(pa.float64()) if is_nested else pa.float64())


def large(data_type: pa.DataType) -> pa.DataType:
    if pa.types.is_list(data_type) or pa.types.is_fixed_size_list(data_type):
        return pa.large_list(large(data_type.value_type))
    if pa.types.is_struct(data_type):
        return pa.struct([each.with_type(large(each.type)) for each in data_type])
    return {pa.string(): pa.large_string(), pa.binary(): pa.large_binary()}.get(data_type, data_type)


def list_views(array: pa.Array) -> pa.Array:
    values = array.to_pylist()
    return pa.array(values, pa.list_view(array.type.value_type)) if pa.types.is_nested(array.type) else array


def by_polars(table: pa.Table, place: Path) -> None:
    frame = pl.DataFrame(table)
    frame.with_columns(
        pl.col(name).cast(pl.Categorical) for name in TEXT if frame.schema.get(name) == pl.String
    ).write_parquet(place)


def by_pandas(table: pa.Table, place: Path) -> None:
    frame = table.to_pandas()
    for name in {*TEXT, "label"} & {*frame.columns}:
        frame[name] = frame[name].astype("category")
    frame.to_parquet(place)


def by_arrow(names: tuple[str, ...], change: Callable[[Any], Any]) -> Callable[[pa.Table, Path], None]:
    return lambda table, place: pq.write_table(with_columns(table, names, change), place)


WRITERS: dict[str, Callable[[pa.Table, Path], None]] = {
    "polars": by_polars,
    "pandas": by_pandas,
    "views": by_arrow(TEXT, views),
    "dictionaries": by_arrow((*TEXT, "label", "object_id"), lambda array: array.dictionary_encode()),
    "large": lambda table, place: pq.write_table(
        table.cast(pa.schema([each.with_type(large(each.type)) for each in table.schema])), place
    ),
    "list views": by_arrow(("mesh.vertices", "pos_in_cell", "video_length_frames", "attempts"), list_views),
    "floats": by_arrow(WHOLE, floats),
}


def same(found: Any, expected: Any) -> bool:
    """Compare arrays, or nested lists, exactly."""
    return bool(np.array_equal(np.asarray(found), np.asarray(expected)))


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("kind", LOADERS)
def test_types_of_others_are_read_as_polars_reads_them(kind, writer, tables, tmp_path):
    (tmp_path / "data").mkdir()
    place = tmp_path / "data" / "train-00000-of-00001.parquet"
    WRITERS[writer](tables[kind], place)
    rows = LOADERS[kind](str(tmp_path))
    # polars 2.1 panics at list views, which pyarrow alone writes.
    expected = pl.DataFrame(tables[kind]) if writer == "list views" else pl.read_parquet(place)

    as_stored = [str(each) if kind in ("single", "seq") else int(each) for each in expected["id"]]
    assert [row.id for row in rows] == rows.ids.tolist() == as_stored
    assert rows.labels.tolist() == [row.label for row in rows] == [int(each) for each in expected["label"]]
    assert all(type(row.label) is int for row in rows)
    assert rows.by_id(as_stored[2]) == rows[2]
    for number, row in enumerate(rows):
        if kind in ("digits", "scenes"):
            assert (row.faces.dtype, row.vertices_m.dtype) == (np.int32, np.float32)
            assert same(row.vertices_m, expected["mesh.vertices"].to_list()[number])
            assert same(row.faces, expected["mesh.faces"].to_list()[number])
        else:
            assert same(row.pos_in_cell_m, expected["pos_in_cell"].to_list()[number])
            assert row.object_id == expected["object_id"][number]
    if kind == "scenes":
        assert rows.star_counts.tolist() == [int(each) for each in expected["star_count"]]
        assert [len(row.placements) for row in rows] == [len(each) for each in expected["placements"]]
    if kind == "single":
        images = [image["bytes"] for row in expected["sensor_image"].to_list() for image in row]
        assert same([touch.image for touch in rows.touches()], list(map(decode_image, images)))
    if kind == "seq":
        lengths = [int(each) for row in expected["video_length_frames"] for each in row]
        assert [len(touch.clip) for touch in rows.touches()] == lengths
    # All later code sees only types of the toolkit.
    stored = rows.to_hf()
    assert all(supported_type(each.type) == each.type for each in stored.data.schema)
    assert stored["id"][:] == expected["id"].to_list()


NO_INTEGERS: dict[str, Any] = {
    "1.5": 1.5,
    "nan": float("nan"),
    "inf": float("inf"),
    "null": None,
    "9e15": 2.0**53,
}


@pytest.mark.parametrize(
    ("kind", "value"),
    [*(("digits", value) for value in NO_INTEGERS), *((kind, "1.5") for kind in LOADERS if kind != "digits")],
)
def test_a_float_that_holds_no_integer_is_refused_at_its_row(kind, value, tables, tmp_path, capsys):
    labels = pa.array([0.0, NO_INTEGERS[value], 1.0], pa.float64())
    (tmp_path / "data").mkdir()
    place = tmp_path / "data" / "train-00000-of-00001.parquet"
    pq.write_table(with_columns(tables[kind], ("label",), lambda _: labels), place)
    rows = LOADERS[kind](str(tmp_path))
    found = "no value is stored" if value == "null" else f"the value is {NO_INTEGERS[value]}"
    problem = rf"row 1, field 'label': {found}; expected an integer"
    assert [rows[0].label, rows[2].label] == [0, 1]
    assert rows[[0, 2]].ids.tolist() == [rows[0].id, rows[2].id]
    for ask in (lambda: rows[1].label, lambda: rows.labels, lambda: list(rows.filter_labels(0))):
        with pytest.raises(IntegrityError, match=problem):
            ask()
    assert rows[[0, 2]].labels.tolist() == [0, 1]

    program = {"digits": "mnist3d", "scenes": "starstruck"}.get(kind, "tactile")
    command = "verify" if program == "tactile" else "validate"
    code, output = call(program, command, tmp_path), capsys.readouterr()
    assert "Traceback" not in output.err
    assert code == (3 if command == "verify" else 1)
    assert "label" in output.out + output.err
    assert call("tactile", "show", tmp_path) == 0


@pytest.mark.parametrize(
    ("kind", "writer"),
    [("digits", "views"), ("scenes", "floats"), ("single", "dictionaries"), ("seq", "floats")],
)
def test_commands_take_types_of_others(kind, writer, tables, tmp_path, capsys):
    (tmp_path / "data").mkdir()
    WRITERS[writer](tables[kind], tmp_path / "data" / "train-00000-of-00001.parquet")
    named = {"digits": "mnist3d", "scenes": "starstruck"}.get(kind, "realtouch")
    check = ("tactile", "verify") if named == "realtouch" else (named, "validate")
    for words in (("tactile", "info", "--kind", named), ("tactile", "show"), check):
        assert call(*words, tmp_path) == 0, capsys.readouterr()


def test_floats_among_frames_are_refused_by_touch(tables: dict[str, pa.Table], tmp_path: Path) -> None:
    lengths = [[4.0, 4.0], [4.0, 4.5], [4.0, 4.0]]
    table = with_columns(tables["seq"], ("video_length_frames",), lambda _: pa.array(lengths))
    pq.write_table(table, tmp_path / "touches.parquet")
    rows = realtouch.load(str(tmp_path / "touches.parquet"))
    for ask in (lambda: rows[1].video_length_frames, lambda: len(rows[1].sensor_video[1])):
        with pytest.raises(
            IntegrityError, match=r"row 1, touch 1, field 'video_length_frames': a clip of 4\.5"
        ):
            ask()


def test_half_floats_are_read_as_numbers(tables: dict[str, pa.Table], tmp_path: Path) -> None:
    halves = pa.list_(pa.list_(pa.float16()))
    places = with_columns(tables["single"], ("pos_in_cell",), lambda array: array.cast(halves))
    pq.write_table(places, tmp_path / "touches.parquet")
    meshes = with_columns(digits(), ("mesh.vertices",), lambda array: array.cast(halves))
    pq.write_table(meshes, tmp_path / "digits.parquet")
    stored = np.asarray(places["pos_in_cell"].to_pylist())
    rounds = realtouch.load(str(tmp_path / "touches.parquet"))
    assert np.array_equal([row.pos_in_cell_m for row in rounds], stored)
    digit = mnist3d.load(str(tmp_path / "digits.parquet"))[0]
    assert digit.vertices_m.dtype == np.float32
    assert np.array_equal(digit.vertices_m, CORNERS_M.astype(np.float16).astype(np.float32))


def test_meshes_of_no_numbers_are_refused_by_column(tmp_path: Path) -> None:
    for name, words in (("mesh.vertices", "three floats per vertex"), ("mesh.faces", "three integers")):
        flat = with_columns(digits(), (name,), lambda array: pa.array([["x"]] * len(array)))
        pq.write_table(flat, tmp_path / "digits.parquet")
        with pytest.raises(
            InputError, match=rf"field '{name}': the column has the type list.*; expected {words}"
        ):
            mnist3d.load(str(tmp_path / "digits.parquet"))


TYPES = [
    (pa.dictionary(pa.int8(), pa.large_string()), pa.string()),
    (pa.list_(pa.dictionary(pa.int8(), pa.string())), pa.list_(pa.string())),
    (pa.large_list(pa.struct([("b", pa.binary_view())])), pa.list_(pa.struct([("b", pa.binary())]))),
    (pa.list_(pa.float16(), 2), pa.list_(pa.float32(), 2)),
    (pa.map_(pa.string(), pa.float16()), pa.map_(pa.string(), pa.float32())),
    (pa.large_list_view(pa.list_view(pa.string_view())), pa.list_(pa.list_(pa.string()))),
    *[
        (each, each)
        for each in (pa.timestamp("ns", "Europe/Berlin"), pa.decimal128(9, 2), pa.null(), pa.bool_())
    ],
]


@pytest.mark.parametrize(("theirs", "ours"), TYPES, ids=lambda each: str(each))
def test_each_type_has_one_of_ours(theirs: pa.DataType, ours: pa.DataType) -> None:
    assert supported_type(theirs) == ours == supported_type(ours)


def test_values_with_nulls_and_slices_stay_the_same() -> None:
    values = [[[1.0, 2.5], [3.0, 4.0]], None, [[5.0, 6.0]], []]
    for outer in (pa.list_view, pa.large_list_view, pa.large_list):
        table = pa.table({"x": pa.array(values, outer(pa.list_(pa.float16(), 2)))})
        for part in (table, table.slice(1), table.slice(2, 1), table.slice(4)):
            found = supported_table(part)
            assert found["x"].type == pa.list_(pa.list_(pa.float32(), 2))
            assert found["x"].to_pylist() == part["x"].to_pylist()
            found.validate(full=True)
    ours = pa.table({"x": [1], "y": ["a"]})
    assert supported_table(ours) is ours


def to_views(data_type: pa.DataType) -> pa.DataType:
    if pa.types.is_struct(data_type):
        return pa.struct([each.with_type(to_views(each.type)) for each in data_type])
    return {pa.string(): pa.string_view(), pa.binary(): pa.binary_view()}.get(data_type, data_type)


IN_TYPES_OF_OTHERS: dict[str, Callable[[Any], Any]] = {
    "views": lambda array: pa.array(array.to_pylist(), to_views(array.type)),
    "dictionaries": lambda array: array.dictionary_encode() if array.type == pa.string() else array,
    "large": lambda array: array.cast(large(array.type)),
    "floats": lambda array: array.cast(pa.float64()) if pa.types.is_integer(array.type) else array,
}


@pytest.mark.parametrize("others", IN_TYPES_OF_OTHERS)
def test_recordings_are_imported_from_types_of_others(others, tables, tmp_path):
    """A row for each touch with its picture, or a table that names files of pictures."""
    images = [image for row in tables["single"]["sensor_image"].to_pylist() for image in row]
    names = [f"{number}.jpg" for number in range(len(images))]
    said = {"label": [0, 0, 1, 1, 2, 2], "round": list("aabbcc")}
    pictures = [{**image, "path": name} for image, name in zip(images, names, strict=True)]
    stored = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    sources = {"flat": {"image": pa.array(pictures, stored)}, "folder": {"file": pa.array(names)}}
    for layout, column in sources.items():
        place = tmp_path / layout
        place.mkdir()
        table = pa.table({**column, **said})
        pq.write_table(
            with_columns(table, (*table.column_names,), IN_TYPES_OF_OTHERS[others]), place / "a.parquet"
        )
        for name, image in zip(names, images, strict=True) if layout == "folder" else ():
            (place / name).write_bytes(image["bytes"])
        realtouch.import_touches(
            place, tmp_path / f"{layout}-set", realtouch.ImportSpec(layout, ImportColumns(round="round"))
        )
        rows = realtouch.load(str(tmp_path / f"{layout}-set"), "train")
        assert [row.id for row in rows] == ["a", "b", "c"]
        assert rows.labels.tolist() == [0, 1, 2]
        assert same(
            [touch.image for touch in rows.touches()], [decode_image(each["bytes"]) for each in images]
        )


@needs_shared
@pytest.mark.parametrize(
    "name",
    [
        *("datafusion", "pandas_category_id", "pandas_float_label"),
        *("polars", "duckdb_v2_zstd", "pandas_id_as_index"),
    ],
)
def test_files_from_public_reports(name: str) -> None:
    place = SHARED / "cases" / "data" / "parquet" / f"{name}.parquet"
    if not place.exists():
        pytest.skip(f"{place} is absent")
    rows, expected = realtouch.load(str(place)), pl.read_parquet(place)
    assert [row.id for row in rows] == expected["id"].to_list()
    assert rows.labels.tolist() == [0, 1, 2] == expected["label"].to_list()
    assert [row.object_id for row in rows] == expected["object_id"].to_list()
    images = [image["bytes"] for row in expected["sensor_image"].to_list() for image in row]
    assert same([touch.image for touch in rows.touches()], list(map(decode_image, images)))
    assert realtouch.verify(str(place)).ok
