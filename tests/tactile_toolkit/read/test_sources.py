"""Sources of data sets: each kind gives the same rows by number, in blocks and by column."""

from __future__ import annotations

import pickle
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import starstruck_gen
from starstruck_gen.scene_dataset import MadeScenes
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read import Row, RowSource, Shard, ShardedTable
from tests.realtouch import factories
from tests.realtouch.factories import Layout


@pytest.fixture(scope="module")
def shard(tmp_path_factory: pytest.TempPathFactory) -> Shard:
    """Three row groups of two rounds."""
    rounds = [factories.make_round(index, 2, (24, 32), (4, 5)) for index in range(6)]
    folder = tmp_path_factory.mktemp("rounds")
    factories.write_set(folder, {"train": factories.single_rows(rounds)}, "single", Layout(group_rows=2))
    return Shard(str(folder / "data" / "train-00000-of-00001.parquet"))


def source_of(kind: str, shard: Shard) -> RowSource:
    if kind == "made":
        return MadeScenes(starstruck_gen.SceneSpec(), "train", 5, 3)
    return shard


@pytest.mark.parametrize("kind", ["file", "made"])
def test_a_source_gives_the_same_rows_in_every_way(kind: str, shard: Shard) -> None:
    source = source_of(kind, shard)
    copy: RowSource = pickle.loads(pickle.dumps(source))
    table = ShardedTable((source,))
    in_blocks = [Row(block, row) for block in table.blocks() for row in range(len(block.table))]
    assert len(in_blocks) == len(source) == source.group_starts[-1] == sum(source.part_sizes)
    for number, row in enumerate(in_blocks):
        assert row.equals(Row(*source.locate(number)))
        assert row.equals(Row(*copy.locate(number)))
        assert row.number == Row(*source.locate(number)).number
    few = [block.table.column_names for block in table.blocks(["label", "id"])]
    assert {frozenset(names) for names in few} == {frozenset(["id", "label"])}
    assert source.column("id").to_pylist() == [row.value("id") for row in in_blocks]
    assert (copy.identity, copy.set_name, copy.origin) == (source.identity, source.set_name, source.origin)
    assert in_blocks[0].group.table.schema.equals(source.schema)


def test_a_file_that_was_replaced_is_not_called_damaged(tmp_path: Path) -> None:
    """The known footer is that of another file: its positions of columns are invalid."""
    place = tmp_path / "train.parquet"
    pq.write_table(pa.table({"id": range(1000), "text": ["a"] * 1000}), place)
    shard = Shard(str(place))
    assert len(shard) == 1000
    pq.write_table(pa.table({"id": [1]}), tmp_path / "new.parquet")
    (tmp_path / "new.parquet").replace(place)
    for read in (lambda: next(shard.blocks(0)), shard.read, lambda: shard.column("id"), shard.fingerprint):
        with pytest.raises(IntegrityError, match="was replaced or changed after the data set was loaded"):
            read()
