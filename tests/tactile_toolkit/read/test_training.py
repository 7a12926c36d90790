"""Training on real data sets: the items of ranks and workers, and how an interrupted job continues."""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, strategies as st

import realtouch
import starstruck_gen
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read import RecordDataset, Shard, ShardedTable
from tactile_toolkit.read.order import GlobalOrder
from tests.processes import PATIENCE_S
from tests.realtouch import factories

torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
stateful = pytest.importorskip(
    "torchdata.stateful_dataloader", reason="torchdata (extra `torch`) is not installed"
)

from tactile_toolkit.read import TrainingBatches  # noqa: E402

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore")]

ROOT = Path(__file__).resolve().parents[3]
SHARD_ROWS = (7, 12, 1, 0, 9, 14)
TOTAL = sum(SHARD_ROWS)


def ids(items: list[Any]) -> list[int]:
    """Return the ids of a batch of rows; at the top level, so that it can be pickled."""
    return [int(item.row.value("id")) for item in items]


class Rows(RecordDataset[Any]):
    """Rows of any kind."""


def write_shards(folder: Path) -> list[str]:
    """Write shards with consecutive ids, in row groups of four rows."""
    paths, first = [], 0
    for index, count in enumerate(SHARD_ROWS):
        path = folder / f"train-{index:05d}-of-{len(SHARD_ROWS):05d}.parquet"
        pq.write_table(pa.table({"id": np.arange(first, first + count)}), path, row_group_size=4)
        paths.append(str(path))
        first += count
    return paths


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return write_shards(tmp_path_factory.mktemp("rows"))


@pytest.fixture
def rows(paths: list[str]) -> Rows:
    return Rows(ShardedTable(tuple(map(Shard, paths))))


def batches_of(rows: Any, batch_size: int = 3, **options: Any) -> TrainingBatches:
    return TrainingBatches(rows, batch_size, collate_fn=ids, **{"seed": 5, "window": 2} | options)


def loader_of(batches: TrainingBatches, workers: int, **options: Any) -> Any:
    options = options | ({"timeout": PATIENCE_S} if workers else {})
    return stateful.StatefulDataLoader(batches, batch_size=None, num_workers=workers, **options)


def epoch_ids(rows: Any, epoch: int, seed: int | None = 5, window: int = 2) -> list[int]:
    """Return the order of an epoch as documented."""
    order = GlobalOrder(rows.stored_parts(), seed, window)
    return rows.ids[order.epoch(epoch).positions(np.arange(len(order)))].tolist()


def flat(batches: Any) -> list[int]:
    return [item for batch in batches for item in batch]


def a_rank_is_given_the_same_batches_whatever_its_workers(rows: Rows) -> None:
    plain = list(batches_of(rows, rank=1, world_size=2))
    expected = epoch_ids(rows, 0)
    assert flat(plain) == [*expected[1::2], expected[0]], "43 items: the second rank gets the first one again"
    batches = batches_of(rows, rank=1, world_size=2)
    for epoch, workers in enumerate((0, 2)):
        given = flat(list(torch.utils.data.DataLoader(batches, batch_size=None, num_workers=workers)))
        assert given == [*epoch_ids(rows, epoch)[1::2], epoch_ids(rows, epoch)[0]], "workers take over"
    plain_loader, stateful_loader = torch.utils.data.DataLoader, stateful.StatefulDataLoader
    for kind, workers in ((plain_loader, 0), (plain_loader, 3), (stateful_loader, 0), (stateful_loader, 1)):
        batches = batches_of(rows, rank=1, world_size=2)
        loader = kind(batches, batch_size=None, num_workers=workers)
        assert len(loader) == len(plain) == 8
        assert list(loader) == plain
        assert batches.epoch == 1
        assert flat(loader) == [*epoch_ids(rows, 1)[1::2], epoch_ids(rows, 1)[0]], "each pass is an epoch"


@given(
    st.lists(st.tuples(st.integers(1, 5), st.integers(1, 6), st.integers(0, 5)), max_size=4),
    st.tuples(st.integers(1, 5), st.integers(1, 6)),
    st.booleans(),
    st.integers(1, 7),
)
def test_a_job_goes_on_on_other_ranks_without_losing_or_doubling_an_item(
    rows_for_ever: Rows, legs: list[tuple[int, int, int]], last: tuple[int, int], drop_last: bool, window: int
) -> None:
    """Each leg runs on some ranks and is stopped after some batches; states are passed on as JSON."""
    rows = rows_for_ever
    state: str | None = None
    turns: list[int] = []
    for ranks, batch_size, count in [*legs, (*last, 10**6)]:
        shares, states = [], set()
        for rank in range(ranks):
            options = {"rank": rank, "world_size": ranks, "window": window, "drop_last": drop_last}
            batches = batches_of(rows, batch_size, **options)
            if state is not None:
                batches.load_state_dict(json.loads(state))
            assert batches.epoch == 0
            share = [batch for _, batch in zip(range(count), batches, strict=False)]
            shares.append(share)
            states.add(json.dumps(batches.state_dict()))
        assert len(states) == 1, "any rank's state is that of all"
        state = states.pop()
        assert len({tuple(map(len, share)) for share in shares}) == 1, "all ranks take the same steps"
        for step in zip(*shares, strict=True):
            turns += [item for turn in zip(*step, strict=True) for item in turn]
    expected = epoch_ids(rows, 0, window=window)
    if drop_last:
        assert turns == expected[: len(turns)]
        assert TOTAL - len(turns) < last[0] * last[1]
    else:
        assert turns[:TOTAL] == expected
        assert turns[TOTAL:] == expected[: len(turns) - TOTAL]


@pytest.fixture(scope="module")
def rows_for_ever(paths: list[str]) -> Rows:
    """Fixtures of the module, as hypothesis requires; tests leave no state in them."""
    return Rows(ShardedTable(tuple(map(Shard, paths))))


def the_state_of_a_loader_goes_on_with_the_same_or_with_other_workers(rows: Rows) -> None:
    stops_and_goes_on(rows, 0)
    stops_and_goes_on(rows, 7, snapshot_every_n_steps=3)
    stops_and_goes_on(rows, 4, persistent_workers=True)


def stops_and_goes_on(rows: Rows, steps: int, **options: Any) -> None:
    expected = [epoch_ids(rows, epoch) for epoch in range(3)]
    batches = batches_of(rows)
    loader = loader_of(batches, 2, **options)
    assert flat(loader) == expected[0]
    passing = iter(loader)
    given = flat(next(passing) for _ in range(steps))
    state = loader.state_dict()
    del passing

    same = batches_of(rows)
    same_loader = loader_of(same, 2, **options)
    same_loader.load_state_dict(state)
    assert given + flat(same_loader) == expected[1]
    assert flat(same_loader) == expected[2]
    for workers in (0, 3):
        other = batches_of(rows, 4)
        other.load_state_dict({"step": 12, "data": state})
        assert other.epoch == 1
        other.set_epoch(1)  # as loops do anyway
        other_loader = loader_of(other, workers)
        assert given + flat(other_loader) == expected[1]
        assert flat(other_loader) == expected[2]


def a_state_at_the_end_of_an_epoch_begins_the_next(rows: Rows) -> None:
    for workers in (0, 2):
        loader = loader_of(batches_of(rows), workers)
        assert flat(loader) == epoch_ids(rows, 0)
        state = loader.state_dict()
        batches = batches_of(rows)
        batches.load_state_dict(state)
        assert batches.epoch == 1
        assert flat(loader_of(batches, 1)) == epoch_ids(rows, 1)
        again = loader_of(batches_of(rows), workers)
        again.load_state_dict(state)
        assert flat(again) == epoch_ids(rows, 1)


def looking_at_a_batch_before_going_on_loses_nothing(rows: Rows) -> None:
    batches = batches_of(rows)
    given = flat(batch for _, batch in zip(range(5), batches, strict=False))
    state = batches.state_dict()
    resumed = batches_of(rows)
    resumed.load_state_dict(state)
    loader = loader_of(resumed, 2)
    _ = next(iter(loader))
    resumed.set_epoch(0)
    assert given + flat(loader) == epoch_ids(rows, 0)
    resumed.set_epoch(7)
    assert flat(loader) == epoch_ids(rows, 7)


def states_that_cannot_be_resumed_are_refused_by_name(rows: Rows) -> None:
    loader = loader_of(batches_of(rows), 2)
    _ = next(iter(loader))
    state = loader.state_dict()
    for other, found in ((batches_of(rows, seed=6), "order"), (batches_of(rows[1:]), "order")):
        with pytest.raises(InputError, match=rf"{found}.*next: take data, seed and window"):
            other.load_state_dict(state)
    with pytest.raises(InputError, match="no state of TrainingBatches was given"):
        batches_of(rows).load_state_dict({"model": {}})
    with pytest.raises(InputError, match=r"save the state_dict\(\) of a torchdata"):
        loader.dataset.state_dict()
    for changed, name in (
        (batches_of(rows, 5), "batch_size"),
        (batches_of(rows, world_size=2, rank=0), "world"),
    ):
        resumed = loader_of(changed, 2)
        resumed.load_state_dict(state)
        with pytest.raises(InputError, match=rf"{name}.* give the state to load_state_dict\(\) of the Tr"):
            next(iter(resumed))
    batches = batches_of(rows)
    assert len(flat(loader_of(batches, 2))) == TOTAL
    with pytest.raises(InputError, match=r"3 workers continue after 2; next: call set_epoch"):
        list(loader_of(batches, 3))


@pytest.mark.own_process
def test_loaders_with_workers(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one process, because each must begin without threads of others."""
    # A loader whose state was refused ends each of its workers after this time, by default 5 s.
    monkeypatch.setattr("torch.utils.data._utils.MP_STATUS_CHECK_INTERVAL", 0.2)
    a_rank_is_given_the_same_batches_whatever_its_workers(rows)
    the_state_of_a_loader_goes_on_with_the_same_or_with_other_workers(rows)
    a_state_at_the_end_of_an_epoch_begins_the_next(rows)
    looking_at_a_batch_before_going_on_loses_nothing(rows)
    states_that_cannot_be_resumed_are_refused_by_name(rows)
    gc.collect()  # with the time above


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"batch_size": 0}, "batch_size is 0"),
        ({"batch_size": 2.5}, "batch_size is 2.5"),
        ({"seed": -1}, "seed is -1"),
        ({"window": 0}, "window is 0"),
        ({"rank": 2, "world_size": 2}, "rank is 2 of 2"),
        ({"rank": 0}, "rank is 0 of None"),
    ],
)
def test_impossible_numbers_are_refused(rows: Rows, options: dict[str, Any], found: str) -> None:
    with pytest.raises(InputError, match=found):
        batches_of(rows, **options)
    with pytest.raises(InputError, match="list was given; expected a data set of the toolkit"):
        TrainingBatches([1, 2], 2)


def test_ranks_are_those_of_the_launcher(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (batches_of(rows).rank, batches_of(rows).world_size) == (0, 1)
    monkeypatch.setenv("RANK", "3")
    monkeypatch.setenv("WORLD_SIZE", "8")
    assert (batches_of(rows).rank, batches_of(rows).world_size) == (3, 8)


def test_views_come_shard_by_shard(paths: list[str]) -> None:
    """For any selection, union or shuffle: in stored order without a seed, each item once with a seed."""
    table = ShardedTable(tuple(map(Shard, paths)))
    rows = Rows(table)
    some = (rows[5:30], rows[::-1], rows[::3], rows.shuffle(3), rows[[9, 9, 2]], rows[:0])
    for view in (rows, *some, rows + rows):
        stored = flat(batches_of(view, seed=None))
        expected = sorted(view.ids.tolist()) if len(view) <= TOTAL else [*rows.ids, *rows.ids]
        assert stored == expected
        assert sorted(flat(batches_of(view))) == sorted(view.ids.tolist())
        groups = view.row_groups(np.arange(len(view)))
        shards = [path for path, _ in ((shard.path, index) for shard, index in groups)]
        held = {(str(record.row.path), record.row.number // 4) for record in view}
        assert {(shard.path, index) for shard, index in groups} == held
        assert len(view) > TOTAL or shards == sorted(shards)


def test_touches_and_scenes(tmp_path: Path) -> None:
    from realtouch.touch_tensors import TouchTensors
    from tactile_toolkit.mesh import SolidTensors

    rounds = [factories.make_round(index, 5, (64, 48), (4, 5)) for index in range(7)]
    layout = factories.Layout(shards=4, group_rows=1)
    folder = factories.write_set(tmp_path, {"train": factories.single_rows(rounds)}, "single", layout)
    data = realtouch.load(folder)
    for touches in (
        data.touches(),
        data[[6, 1, 3, 0]].touches(),
        data.touches()[::-2],
        data.touches().sample(9, 1),
    ):
        batches = TrainingBatches(TouchTensors(touches, target=where), 4, seed=1, window=2)
        given = [
            pair
            for _, (labels, numbers) in batches
            for pair in zip(*map(torch.Tensor.tolist, (labels, numbers)), strict=True)
        ]
        assert sorted(given) == sorted((t.object_id, t.touch_index) for t in touches)
        parts = touches.stored_parts()
        for part in range(len(parts)):
            assert len({touches[int(place)].round.row.path for place in parts.positions(part)}) == 1
    images, labels = next(iter(TrainingBatches(TouchTensors(data), 4, seed=None)))
    np.testing.assert_array_equal(images.numpy().transpose(0, 2, 3, 1), data.touches().images(slice(4)))
    assert labels.tolist() == [touch.label for touch in data.touches()[:4]]

    scenes = starstruck_gen.SceneDataset(size=10_000, seed=2)
    assert len(scenes.stored_parts()) == 3
    order = list(TrainingBatches(SolidTensors(scenes[4090:4110], target="id"), 8, seed=3))
    assert sorted(int(scene) for _, chosen in order for scene in chosen) == scenes.ids[4090:4110].tolist()
    points = {
        int(scene): cloud for clouds, chosen in order for cloud, scene in zip(clouds, chosen, strict=True)
    }
    second = TrainingBatches(SolidTensors(scenes[4090:4110], target="id"), 20, seed=3)
    second.set_epoch(1)
    clouds, chosen = next(iter(second))
    assert not any(
        torch.equal(cloud, points[int(scene)]) for cloud, scene in zip(clouds, chosen, strict=True)
    ), "the points of an epoch are those of the epoch of the order"


def where(touch: realtouch.Touch) -> tuple[int, int]:
    return touch.object_id, touch.touch_index


def test_damage_is_named_where_it_is_met(tmp_path: Path) -> None:
    rows = Rows(ShardedTable(tuple(map(Shard, write_shards(tmp_path)))))
    damaged = tmp_path / "train-00004-of-00006.parquet"
    content = bytearray(damaged.read_bytes())
    content[8] ^= 0xFF
    damaged.write_bytes(content)
    with pytest.raises(IntegrityError, match="train-00004"):
        list(batches_of(rows))


JOB = """
    import json, os, sys, time
    from pathlib import Path
    import torch, torch.distributed as dist
    from torchdata.stateful_dataloader import StatefulDataLoader
    from tactile_toolkit.read import RecordDataset
    from tactile_toolkit.read import Shard, ShardedTable
    from tactile_toolkit.read import TrainingBatches

    def ids(items):
        return [int(item.row.value("id")) for item in items]

    folder, workers, stop, *paths = sys.argv[1:]
    folder, stop = Path(folder), int(stop)
    dist.init_process_group("gloo")
    batches = TrainingBatches(
        RecordDataset(ShardedTable(tuple(map(Shard, paths)))), 2, seed=5, window=2, collate_fn=ids
    )
    # A program that is no file cannot be read again by workers that start afresh, as from Python 3.14 on.
    started = "fork" if int(workers) else None
    loader = StatefulDataLoader(
        batches, batch_size=None, num_workers=int(workers), multiprocessing_context=started
    )
    saved = folder / "state"
    if saved.exists():
        batches.load_state_dict(torch.load(saved)["data"])
    for epoch in range(batches.epoch, 2):
        batches.set_epoch(epoch)
        for step, batch in enumerate(loader):
            given = [None] * dist.get_world_size()
            dist.all_gather_object(given, batch)
            if dist.get_rank() == dist.get_world_size() - 1:
                with (folder / "log").open("a") as log:
                    log.write(json.dumps([epoch, given]) + "\\n")
                torch.save({"data": loader.state_dict()}, folder / "new")
                (folder / "new").rename(saved)
            dist.barrier()
            if epoch == 1 and step == stop:
                (folder / f"stopped-{dist.get_rank()}").touch()
                time.sleep(10_000)
    dist.destroy_process_group()
"""


def start_job(
    folder: Path, ranks: int, workers: int, stop: int, paths: list[str]
) -> list[subprocess.Popen[str]]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": str(ranks)}
    words = [textwrap.dedent(JOB), str(folder), str(workers), str(stop), *paths]
    return [
        subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", *words],
            cwd=ROOT,
            env=os.environ | shared | {"RANK": str(rank), "OMP_NUM_THREADS": "1"},
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(ranks)
    ]


def test_a_job_of_several_processes_that_is_killed_goes_on_on_others(paths, tmp_path):
    """Two ranks of two workers are killed in the second epoch; one rank without workers finishes it."""
    job = start_job(tmp_path, 2, 2, 3, paths)
    while len(list(tmp_path.glob("stopped-*"))) < 2:
        for process in job:
            assert process.poll() is None, process.communicate()[1]
        signal.sigtimedwait([], 0.05)
    for process in job:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    for process in start_job(tmp_path, 1, 0, -1, paths):
        errors = process.communicate()[1]
        assert process.returncode == 0, errors
    log = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    rows = Rows(ShardedTable(tuple(map(Shard, paths))))
    for epoch in (0, 1):
        steps = [given for number, given in log if number == epoch]
        assert all(len({len(batch) for batch in given}) == 1 for given in steps), "equal steps on all ranks"
        turns = [item for given in steps for turn in zip(*given, strict=True) for item in turn]
        expected = epoch_ids(rows, epoch)
        assert turns[:TOTAL] == expected
        assert turns[TOTAL:] == expected[: len(turns) - TOTAL]
    assert [len(given) for number, given in log if number == 1] == [2] * 4 + [1] * 14
