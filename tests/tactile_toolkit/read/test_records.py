from __future__ import annotations

import gc
import pickle
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.cache import cache_folder
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.places import open_place
from tactile_toolkit.read import Record, RecordDataset, Shard, ShardedTable
from tactile_toolkit.read.record import ragged_column
from tactile_toolkit.store import build, open_folder
from tests.forked import run_forked
from tests.mesh_columns import list_array
from tests.tactile_toolkit.toy import points, toy_plan

IDS = [number for number in range(20) if number % 10 != 9]


class ToyRecord(Record):
    __slots__ = ()

    @property
    def id(self) -> int:
        return int(self.row.value("id"))

    @property
    def points(self) -> np.ndarray:
        return self.row.array("points")


class ToyDataset(RecordDataset[ToyRecord]):
    record_class = ToyRecord


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("toy") / "set"
    build(open_folder(str(path)), toy_plan())
    return path


def opened(folder: Path) -> ToyDataset:
    return ToyDataset(ShardedTable(open_place(str(folder)).shards("train")), label_names=("a", "b", "c"))


@pytest.fixture
def dataset(folder) -> ToyDataset:
    return opened(folder)


def test_rows_are_those_written(dataset):
    assert len(dataset) == len(IDS)
    assert [record.id for record in dataset] == IDS
    for record in dataset:
        np.testing.assert_array_equal(record.points, points(record.id))
        assert record.points.dtype == np.float32
        assert not record.points.flags.writeable


def test_opening_reads_no_row_and_unpacks_nothing(dataset, monkeypatch):
    monkeypatch.setattr(Shard, "read", None)
    assert len(dataset) == len(IDS)
    assert len(dataset[3:9]) == 6
    assert not cache_folder().exists()


def test_labels_are_read_without_other_columns(dataset, monkeypatch):
    read = Shard.read
    asked = []
    monkeypatch.setattr(Shard, "read", lambda self, **options: asked.append(options) or read(self, **options))
    assert dataset.labels.tolist() == [number % 3 for number in IDS]
    assert {tuple(options["columns"]) for options in asked} == {("label",)}


index = st.one_of(
    st.slices(len(IDS)),
    st.lists(st.integers(-len(IDS), len(IDS) - 1)),
    st.lists(st.integers(-len(IDS), len(IDS) - 1)).map(tuple),
    st.builds(range, st.integers(0, 5), st.integers(0, len(IDS)), st.integers(1, 3)),
    st.lists(st.booleans(), min_size=len(IDS), max_size=len(IDS)),
)


@given(first=index, data=st.data())
def test_indexing_agrees_with_numpy(folder, first, data):
    dataset = opened(folder)
    truth = np.array(IDS)
    view, expected = (
        dataset[first],
        truth[first if isinstance(first, slice) else np.array(first, dtype=_kind(first))],
    )
    assert view.ids.tolist() == expected.tolist()
    assert [record.id for record in view] == expected.tolist()
    if len(view):
        place = data.draw(st.integers(-len(view), len(view) - 1))
        assert view[place].id == expected[place]
    joined = view + dataset[::-1]
    assert joined.ids.tolist() == [*expected.tolist(), *IDS[::-1]]
    assert [record.id for record in joined[::2]] == joined.ids.tolist()[::2]


def _kind(values):
    return bool if values and isinstance(values[0], bool) else np.int64


@pytest.mark.parametrize("wrong", [18, -19, 10**9])
def test_index_out_of_range(dataset, wrong):
    with pytest.raises(IndexError, match=f"index {wrong} is out of range for 18 rows"):
        dataset[wrong]


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        ([True] * 3, IndexError, "boolean index did not match"),
        (np.ones((18, 1), bool), TypeError, "not bool of shape (18, 1)"),
        ([0.5], TypeError, "a slice, ints or booleans, not float64 of shape (1,)"),
        (["a"], TypeError, "not <U1 of shape (1,)"),
        ([[0, 1]], TypeError, "not int64 of shape (1, 2)"),
        ([99, 3], IndexError, "index 99 is out of bounds"),
        ([-19], IndexError, "index -19 is out of bounds"),
        (range(17, 20), IndexError, "index 18 is out of bounds"),
        ("12", TypeError, "are chosen by number, and '12' is a text"),
    ],
)
def test_bad_selection(dataset, wrong, error, words):
    with pytest.raises(error, match=re.escape(words)):
        dataset[wrong]


def test_filter_and_group_by_label(dataset):
    assert dataset.filter_labels("b").ids.tolist() == [i for i in IDS if i % 3 == 1]
    assert dataset.filter_labels([0, "c"]).ids.tolist() == [i for i in IDS if i % 3 != 1]
    groups = dataset.by_label()
    assert list(groups) == ["a", "b", "c"]
    assert sorted(i for group in groups.values() for i in group.ids.tolist()) == IDS
    with pytest.raises(InputError, match="no class 'z'"):
        dataset.filter_labels("z")
    with pytest.raises(InputError, match="no class 7"):
        dataset.filter_labels(7)
    for wrong in (1.5, True, None):
        with pytest.raises(InputError, match=r"no class .* expected an integer below 3 or one of a"):
            dataset.filter_labels([wrong])


def test_unknown_column_and_frozen_record(dataset):
    for name in ("colour", "points.x", "points.x.y"):
        with pytest.raises(InputError, match=f"no column '{name}'"):
            dataset.column(name)
    record = dataset[0]
    with pytest.raises(AttributeError, match="ToyRecord is frozen; 'id' cannot be set"):
        record.id = 3
    assert record.id == IDS[0]


def test_records_and_views_pickle_small(dataset):
    record = pickle.loads(pickle.dumps(dataset[7]))
    assert record.id == IDS[7]
    np.testing.assert_array_equal(record.points, points(IDS[7]))
    view = dataset[4:8]
    view[0].points  # noqa: B018 - memory maps must not be pickled
    content = pickle.dumps(view)
    assert len(content) < 3000
    assert pickle.loads(content).ids.tolist() == IDS[4:8]


FORKS = """
import multiprocessing, sys
from tests.tactile_toolkit.read.test_records import IDS, opened
dataset = opened(sys.argv[1])
dataset[0].points  # open in the parent first
child = multiprocessing.get_context("fork").Process(
    target=lambda: print(sum(record.id for record in dataset), flush=True)
)
child.start()
child.join()
"""


def test_reads_in_a_forked_process(folder):
    assert run_forked(FORKS, folder) == f"{sum(IDS)}\n"


def _sum(dataset: ToyDataset) -> int:
    return sum(record.id for record in dataset)


def test_reads_after_pickling_to_another_process(dataset):
    dataset[0].points  # noqa: B018 - open in the parent first
    assert run_forked(_sum, dataset) == f"{sum(IDS)}\n"


def _count_garbage(folder: Path) -> int:
    dataset = opened(folder)
    gc.collect()
    gc.disable()
    for record in dataset:
        record.points  # noqa: B018
    del record
    return gc.collect()


def test_records_form_no_reference_cycles(folder):
    """In a process of its own, without the garbage of other tests."""
    assert run_forked(_count_garbage, folder) == "0\n"


def test_no_such_place_or_split(folder, tmp_path):
    with pytest.raises(InputError, match=r"no split 'holdout'.*it has train, test"):
        open_place(str(folder)).shards("holdout")
    with pytest.raises(InputError, match="does not exist; expected a folder"):
        open_place(str(tmp_path / "nowhere")).shards("train")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is empty; expected a data set"):
        open_place(str(tmp_path / "empty")).shards("train")


def test_folder_without_manifest_is_found_by_names(folder, tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    for index in range(2):
        name = f"test-{index:05d}-of-00002.parquet"
        (data / name).write_bytes((folder / "data" / name).read_bytes())
    assert sum(len(shard) for shard in open_place(str(tmp_path)).shards("test")) == 9
    (data / "test-00001-of-00002.parquet").unlink()
    with pytest.raises(IntegrityError, match="1 of 2 files of split 'test'"):
        open_place(str(tmp_path)).shards("test")


@given(lengths=st.lists(st.integers(0, 5), max_size=8), fixed=st.booleans(), first=st.integers(0, 3))
def test_ragged_columns_of_every_list_type(lengths, fixed, first):
    rows = [np.arange(n * 3, dtype=np.float32).reshape(n, 3) + 100 * i for i, n in enumerate(lengths)]
    if fixed:
        array = list_array(rows, pa.float32())
    else:
        array = pa.array([row.tolist() for row in rows], pa.list_(pa.list_(pa.float32())))
    array = array[first:]
    column = ragged_column(array)
    assert len(column) == len(rows[first:])
    assert not column.values.flags.writeable
    for got, expected in zip((column[i] for i in range(len(column))), rows[first:], strict=True):
        np.testing.assert_array_equal(got.reshape(-1, 3), expected)


def test_uneven_rows_are_refused():
    with pytest.raises(ValueError, match="inner lists of 2 and 3"):
        ragged_column(pa.array([[[1.0, 2.0, 3.0], [1.0, 2.0]]], pa.list_(pa.list_(pa.float32()))))
