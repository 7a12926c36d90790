"""Single columns: found by dotted name, checked, and with the same types in every process."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read import RecordDataset, Shard, ShardedTable, class_names
from tactile_toolkit.read.record import nested_column

LARGEST = 2**63 - 1


def dataset(folder: Path, *columns: pa.Array, group_rows: int = 2) -> RecordDataset:
    """Return a data set with a shard for each array, which is its column ``label``."""
    shards = []
    for index, column in enumerate(columns):
        place = folder / f"{index}.parquet"
        pq.write_table(pa.table({"label": column}), place, row_group_size=group_rows)
        shards.append(Shard(str(place)))
    return RecordDataset(ShardedTable(tuple(shards)), label_names=("a", "b"))


def test_integers_are_those_stored(tmp_path):
    rows = dataset(tmp_path, pa.array([0, 1, -1]), pa.array([LARGEST, 7]))
    for _ in range(2):
        assert rows.labels.tolist() == [0, 1, -1, LARGEST, 7]
    assert rows.labels.dtype == np.int64
    assert rows[::-2].labels.tolist() == [7, -1, 0]
    assert rows[[3, 0]].labels.tolist() == [LARGEST, 0]
    assert rows[:0].labels.tolist() == []
    assert (rows[:1] + rows[3:4]).labels.tolist() == [0, LARGEST]
    with pytest.raises(InputError, match="no column 'writer'"):
        rows.int_column("writer")


@pytest.mark.parametrize(
    ("column", "found"),
    [
        (pa.array([4, None, 2**53 - 1]), "no value is stored"),
        (pa.array([4, 2**63, 2**53 - 1], pa.uint64()), f"the value is {2**63}"),
        (pa.array([4.0, float("nan"), 2.0]), "the value is nan"),
    ],
)
def test_values_that_are_not_integers_are_named_and_the_others_stay_exact(column, found, tmp_path):
    rows = dataset(tmp_path, pa.array([1, 2, 3]), column)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(
            IntegrityError, match=rf"1\.parquet', row 1, field 'label': {found}; expected an integer"
        ):
            _ = rows.labels
        with pytest.raises(IntegrityError, match="row 1, field 'label'"):
            _ = rows[4:].labels
        assert rows[[0, 3, 5]].labels.tolist() == [1, 4, int(column[2].as_py())]


def test_a_field_of_a_struct_is_read_like_a_flat_column(tmp_path):
    inner = pa.array([{"a": {"b": 3}, "c": "x"}, {"a": None, "c": "y"}, {"a": {"b": 5}, "c": "z"}])
    pq.write_table(pa.table({"info": inner, "flat.c": ["u", "v", "w"]}), tmp_path / "nested.parquet")
    rows = RecordDataset(ShardedTable((Shard(str(tmp_path / "nested.parquet")),)))
    assert rows.column("info.c").tolist() == ["x", "y", "z"]
    assert rows.column("flat.c").tolist() == ["u", "v", "w"]
    np.testing.assert_array_equal(rows.column("info.a.b"), [3, np.nan, 5])
    assert rows.column("info")[0] == {"a": {"b": 3}, "c": "x"}
    for name in ("info.d", "info.c.d", "nothing"):
        with pytest.raises(InputError, match=f"no column '{name}'"):
            rows.column(name)


def described(text: bytes) -> pa.Schema:
    return pa.schema([("label", pa.int64())]).with_metadata({"huggingface": text})


@pytest.mark.parametrize(
    "text",
    [
        b"not json",
        b"\xff\xfe",
        b"[]",
        b"[" * 100_000,
        b'{"info": {"features": []}}',
        b'{"info": {"features": {"label": 3}}}',
        b'{"info": {"features": {"label": {"names": "abc"}}}}',
        b'{"info": {"features": {"label": {"names": [1, 2]}}}}',
    ],
)
def test_invalid_descriptions_are_named(text):
    with pytest.raises(
        IntegrityError, match=r"'x\.parquet', field 'label': the metadata 'huggingface'"
    ) as caught:
        class_names(described(text), None, "x.parquet")
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("values", [{}, {"a": 1}, {"info": None}, {"info": {"features": {"label": {}}}}])
def test_descriptions_without_classes_are_accepted(values):
    assert class_names(described(json.dumps(values).encode()), None, "x.parquet") is None


@pytest.mark.parametrize(
    ("path", "origin"),
    [
        ("sets/digits/data/test-00000-of-00001.parquet", ("'digits'", "test")),
        ("/sets//digits/./data/train-00003-of-00004.parquet", ("'digits'", "train")),
        ("/sets/digits/test-00000-of-00001.parquet", ("'digits'", "test")),
        ("/sets/digits/odd.parquet", ("'digits'", "")),
        ("s3://lake/sets/digits/data/test-00000-of-00001.parquet", ("'digits'", "test")),
        ("hf://datasets/you/digits@main/data/test-00000-of-00001.parquet", ("'you/digits'", "test")),
        ("hf://datasets/you/digits/data/test-00000-of-00001.parquet", ("'you/digits'", "test")),
        ("/hub/datasets--you--digits/snapshots/1/data/test-00000-of-00001.parquet", ("'you/digits'", "test")),
        ("/data/test-00000-of-00001.parquet", ("'data'", "test")),
    ],
)
def test_a_shard_names_its_data_set(path, origin):
    assert Shard(path).origin == origin


def test_missing_byte_strings_become_none() -> None:
    stored = [b"a", None, b"", b"bc"]
    found = nested_column(pa.array(stored, pa.binary())).values
    assert [None if each is None else bytes(each) for each in map(found.__getitem__, range(4))] == stored
