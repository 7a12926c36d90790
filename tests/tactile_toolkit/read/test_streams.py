"""Streams in a loader of torch: each item once, for any number of workers."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import mnist3d
import realtouch
import starstruck_gen
from tests.realtouch import factories
from tests.tactile_toolkit.read.test_types_of_others import digits, scenes


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Sets of six rows in three shards, with a row group for each row."""
    place = tmp_path_factory.mktemp("streams")
    layout = factories.Layout(shards=3, group_rows=1)
    rounds = [factories.make_round(index, 2, (32, 24), frames=(4, 6)) for index in range(6)]
    factories.write_set(place / "single", {"train": factories.single_rows(rounds)}, "single", layout)
    factories.write_set(place / "seq", {"train": factories.seq_rows(rounds)}, "seq", layout)
    for kind, table in (("digits", digits()), ("scenes", scenes())):
        (place / kind / "data").mkdir(parents=True)
        rows = pa.concat_tables([table, table]).slice(0, 6)
        rows = rows.set_column(rows.column_names.index("id"), "id", pa.array(range(6)))
        for shard in range(3):
            name = place / kind / "data" / f"train-{shard:05d}-of-00003.parquet"
            pq.write_table(rows.slice(2 * shard, 2), name, row_group_size=1)
    return {kind: place / kind for kind in ("single", "seq", "digits", "scenes")}


KINDS = ("single", "seq", "digits", "scenes")


def stream_of(kind: str, place: Path) -> Any:
    load: Any = {"digits": mnist3d.load, "scenes": starstruck_gen.load}.get(kind, realtouch.load)
    return load(str(place), "train", streaming=True)


def ids(items: Iterable[Any]) -> list[Any]:
    return [item.id for item in items]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("workers", [4, 1, 9])
def test_workers_share_the_rows(kind, workers, sets, monkeypatch):
    stream = stream_of(kind, sets[kind])
    every = ids(stream)
    assert len(every) == len(set(every)) == 6
    torch_data = ModuleType("torch.utils.data")
    monkeypatch.setitem(sys.modules, "torch.utils.data", torch_data)
    found = []
    for worker in range(workers):
        info = SimpleNamespace(id=worker, num_workers=workers)
        torch_data.get_worker_info = lambda info=info: info  # type: ignore[attr-defined]
        found += ids(stream)
    assert sorted(found) == sorted(every)


@pytest.mark.torch
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("workers", "start"), [(0, None), (2, "fork"), (4, "fork"), (2, "spawn")])
def test_a_loader_of_torch_takes_a_stream(workers: int, start: str | None, sets: dict[str, Path]) -> None:
    torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
    for kind in KINDS if start != "spawn" else ("single",):
        stream = stream_of(kind, sets[kind])
        assert isinstance(stream, torch.utils.data.IterableDataset)
        loader = torch.utils.data.DataLoader(
            stream, batch_size=None, num_workers=workers, multiprocessing_context=start
        )
        for _epoch in range(2):
            found = ids(loader)
            assert sorted(found) == sorted(ids(stream))
            assert workers or found == ids(stream)
