"""The order of training, compared with a slow one of lists, for any ranks and any interruptions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

import starstruck_gen
from tactile_toolkit.read.order import GlobalOrder, Prefetcher, RankSampler, StoredParts


def parts_of(sizes: list[int], order: list[int] | None = None) -> StoredParts:
    starts = np.cumsum([0, *sizes])
    return StoredParts(np.unique(starts), None if order is None else np.array(order, np.int64))


def plain_order(sizes: list[int], seed: int | None, window: int, epoch: int) -> list[int]:
    """Return the documented order, computed with lists."""
    ends = np.cumsum([0, *(size for size in sizes if size)]).tolist()
    shards = [list(range(first, last)) for first, last in pairwise(ends)]

    def shuffled(values: list, stream: int) -> list:
        if seed is None:
            return values
        bits = np.random.PCG64([seed, epoch, stream]).random_raw(len(values)).tolist()
        return [value for _, _, value in sorted(zip(bits, range(len(values)), values, strict=True))]

    shards = shuffled(shards, 0)
    windows = [shards[first : first + window] for first in range(0, len(shards), window)]
    return [
        item
        for number, held in enumerate(windows)
        for item in shuffled([item for shard in held for item in shard], 1 + number)
    ]


sizes_lists = st.lists(st.integers(0, 9), max_size=8)
seeds = st.none() | st.integers(0, 2**40)


@given(sizes_lists, seeds, st.integers(1, 9), st.integers(0, 5))
def test_an_epoch_is_all_items_shard_by_shard_and_shuffled_in_windows(sizes, seed, window, epoch):
    order = GlobalOrder(parts_of(sizes), seed, window)
    total = sum(sizes)
    assert len(order) == total
    found = order.epoch(epoch).positions(np.arange(total)).tolist()
    assert found == plain_order(sizes, seed, window, epoch)
    assert sorted(found) == list(range(total))
    backwards = order.epoch(epoch).positions(np.arange(total)[::-1]).tolist()
    assert backwards == found[::-1], "an item depends only on its number"


@given(sizes_lists.filter(sum), st.integers(1, 9), st.data())
def test_views_are_read_in_the_order_in_which_they_are_stored(sizes, window, data):
    """Without a seed, that is the order of training; with a seed, each item occurs once."""
    stored = data.draw(st.permutations(range(sum(sizes))))
    parts = parts_of(sizes, stored)
    numbers = np.arange(sum(sizes))
    assert GlobalOrder(parts, None, window).epoch(3).positions(numbers).tolist() == stored
    plain = plain_order(sizes, 5, window, 3)
    shuffled = GlobalOrder(parts, 5, window).epoch(3).positions(numbers).tolist()
    assert shuffled == [stored[item] for item in plain]


class Job:
    """A job that runs some batches on some ranks, and continues on others; its ranks take turns."""

    def __init__(self, total: int) -> None:
        self.total, self.start = total, 0
        self.given: list[int] = []

    def run(self, ranks: int, batch_size: int, batches: int | None, drop_last: bool = False) -> list[int]:
        shares = [
            RankSampler(self.total, self.start, rank, ranks, batch_size, drop_last) for rank in range(ranks)
        ]
        assert len({(share.items, len(share)) for share in shares}) == 1, "all ranks get equal shares"
        count = len(shares[0]) if batches is None else min(batches, len(shares[0]))
        turns = [
            number
            for index in range(count)
            for turn in zip(*(share.batch(index).tolist() for share in shares), strict=True)
            for number in turn
        ]
        self.given += turns
        self.start = min(self.start + ranks * min(count * batch_size, shares[0].items), self.total)
        return turns


@given(
    st.integers(0, 200),
    st.lists(st.tuples(st.integers(1, 9), st.integers(1, 7), st.integers(0, 6)), max_size=5),
    st.integers(1, 9),
    st.integers(1, 7),
)
@example(total=10, legs=[(4, 1, 2)], ranks=3, batch_size=2)
def test_no_item_is_lost_or_repeated_wherever_a_job_is_interrupted(total, legs, ranks, batch_size):
    job = Job(total)
    for leg_ranks, leg_batch, batches in legs:
        job.run(leg_ranks, leg_batch, batches)
    job.run(ranks, batch_size, None)
    assert job.given[:total] == list(range(total)), "each item once, in the order of the epoch"
    repeated = job.given[total:]
    # Repeated items make the shares of all ranks equal at the end of an epoch.
    most = max([ranks, *(leg[0] for leg in legs)])
    assert len(repeated) < most
    assert repeated == [number % total for number in range(total, total + len(repeated))]
    assert job.start == total
    assert job.run(ranks, batch_size, None) == [], "no items after the end"


@given(
    st.integers(0, 200),
    st.lists(st.tuples(st.integers(1, 9), st.integers(1, 7), st.integers(0, 6)), max_size=5),
    st.integers(1, 9),
    st.integers(1, 7),
)
def test_dropping_the_last_batch_leaves_whole_batches_without_repetition(total, legs, ranks, batch_size):
    job = Job(total)
    for leg_ranks, leg_batch, batches in legs:
        job.run(leg_ranks, leg_batch, batches, drop_last=True)
    job.run(ranks, batch_size, None, drop_last=True)
    assert job.given == list(range(len(job.given)))
    assert total - len(job.given) < ranks * batch_size
    assert job.start == len(job.given)


@given(st.integers(1, 200), st.integers(1, 6), st.integers(1, 7), st.integers(1, 5), st.booleans())
def test_batches_of_a_rank_do_not_depend_on_its_workers(total, ranks, batch_size, workers, drop_last):
    """The batches of the workers in turn are the stream of the rank; all batches but the last are whole."""
    share = RankSampler(total, 0, ranks - 1, ranks, batch_size, drop_last)
    by_worker = [[share.batch(index) for index in range(w, len(share), workers)] for w in range(workers)]
    in_turn = [by_worker[index % workers][index // workers] for index in range(len(share))]
    stream = [number for batch in in_turn for number in batch.tolist()]
    assert stream == [(ranks - 1 + ranks * turn) % total for turn in range(share.items)]
    assert [len(batch) for batch in in_turn[:-1]] == [batch_size] * (len(share) - 1 if len(share) else 0)
    assert not drop_last or all(len(batch) == batch_size for batch in in_turn)


def test_the_order_never_changes():
    """A checkpoint must continue with later versions of NumPy and of this toolkit."""
    order = GlobalOrder(parts_of([3, 4, 2, 5]), 7, 2)
    assert order.epoch(1).positions(np.arange(14)).tolist() == [13, 5, 11, 12, 9, 4, 10, 3, 6, 0, 2, 1, 8, 7]
    assert order.fingerprint == "b82bcb0cd2b98abf"


@pytest.mark.parametrize(
    "chosen", [slice(None), slice(5_000, 9_000), slice(None, None, 2), slice(None, None, -1)]
)
def test_items_of_a_view_lie_together_as_in_its_shards(chosen):
    scenes = starstruck_gen.SceneDataset(size=10_000)
    shards = np.searchsorted([4_096, 8_192], scenes.ids[chosen], "right")
    parts = scenes[chosen].stored_parts()
    places = [parts.positions(part) for part in range(len(parts))]
    assert [set(shards[each]) for each in places] == [{shard} for shard in np.unique(shards)]
    assert sorted(np.concatenate(places)) == list(range(len(shards)))


class RowGroups:
    """A data set of one shard, and that shard: row groups of four items each."""

    def __init__(self) -> None:
        self.unpacked: list[int] = []

    def row_groups(self, chosen: np.ndarray) -> list[tuple[RowGroups, int]]:
        return [(self, int(group)) for group in np.unique(chosen // 4)]

    def unpack(self, index: int) -> int:
        self.unpacked.append(index)
        return 10


def test_a_window_is_unpacked_once_and_then_the_next_one():
    data, order = RowGroups(), GlobalOrder(parts_of([4] * 6), 3, 2)
    first, second = (set((order.stored(window) // 4).tolist()) for window in range(2))
    prefetcher = Prefetcher(data, order, turn=0.5)
    prefetcher.enter(0)
    assert first <= set(data.unpacked)
    prefetcher._thread.join()
    prefetcher.enter(0)
    prefetcher.close()
    assert sorted(data.unpacked) == sorted(first | second)
