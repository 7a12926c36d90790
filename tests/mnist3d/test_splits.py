from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mnist3d.digit_options import PUBLISHED_SIZES, SPLITS, SplitSpec
from mnist3d.sources import DigitCatalog, digit_source
from mnist3d.sources.digit_source import NO_WRITER, plan_splits
from tactile_toolkit.errors import InputError


def catalog(labels, writers=None, ids=None) -> DigitCatalog:
    labels = np.asarray(labels, np.int64)
    ids = np.arange(len(labels), dtype=np.int64) if ids is None else np.asarray(ids, np.int64)
    writers = np.full(len(labels), NO_WRITER, np.int64) if writers is None else np.asarray(writers, np.int64)
    return DigitCatalog(ids, labels, writers)


def hwd_catalog() -> DigitCatalog:
    ids = np.arange(13_580)
    return catalog((ids % 140) // 14, ids // 140)


def test_published_sizes_are_exact_for_a_source_like_hwd():
    plan = plan_splits(hwd_catalog(), SplitSpec())
    assert {split: len(plan.ids[split]) for split in SPLITS} == {
        "train": 11_480,
        "test": 1_000,
        "holdout": 500,
        "printed_train": 500,
        "printed_test": 100,
    }
    for split, size in PUBLISHED_SIZES.items():
        assert np.bincount(plan.labels[split]).tolist() == [size] * 10


catalogs = st.builds(
    lambda labels, step, first: catalog(labels, ids=first + step * np.arange(len(labels))),
    st.lists(st.integers(0, 9), max_size=300),
    st.integers(1, 1000),
    st.integers(0, 10**12),
)


@given(source=catalogs, seed=st.integers(0, 2**32))
def test_plans_partition_the_ids(source, seed):
    plan = plan_splits(source, SplitSpec(seed))
    ids = np.concatenate([plan.ids[split] for split in SPLITS])
    assert sorted(ids.tolist()) == source.ids.tolist()
    label_of = dict(zip(source.ids.tolist(), source.labels.tolist(), strict=True))
    for split in SPLITS:
        assert [label_of[i] for i in plan.ids[split].tolist()] == plan.labels[split].tolist()


@given(count=st.integers(0, 1357))
def test_small_sources_keep_the_proportions(count):
    plan = plan_splits(catalog([4] * count), SplitSpec())
    sizes = [len(plan.ids[split]) for split in SPLITS]
    assert sum(sizes) == count
    for rank, (split, size) in enumerate(zip(SPLITS, sizes, strict=True)):
        quota = count * PUBLISHED_SIZES[split] / 1358
        assert size >= int(quota) - (rank == 0) * 4
        assert size <= max(1, int(quota) + 1)
    if count < len(SPLITS):
        assert sizes == [1] * count + [0] * (len(SPLITS) - count)
    else:
        assert min(sizes) >= 1


@given(source=catalogs, seed=st.integers(0, 99), per_class=st.integers(1, 20), limit=st.integers(1, 60))
def test_per_class_and_limit_only_shorten(source, seed, per_class, limit):
    plan = plan_splits(source, SplitSpec(seed))
    for split in SPLITS:
        whole = plan.rows(split).tolist()
        some = plan.rows(split, per_class)
        label_of = dict(zip(plan.ids[split].tolist(), plan.labels[split].tolist(), strict=True))
        counts = np.bincount([label_of[i] for i in some.tolist()] or [0], minlength=10)
        wanted = np.minimum(np.bincount(plan.labels[split], minlength=10), per_class)
        assert counts.tolist() == wanted.tolist() or not len(some)
        assert [i for i in whole if i in set(some.tolist())] == some.tolist()
        assert plan.rows(split, per_class, limit).tolist() == some.tolist()[:limit]
        assert plan.rows(split, None, limit).tolist() == whole[:limit]


def test_rows_mix_the_classes():
    labels = plan_splits(hwd_catalog(), SplitSpec()).labels["train"][:200]
    assert np.bincount(labels, minlength=10).min() >= 8


def test_custom_sizes():
    spec = SplitSpec(sizes=(("train", 8), ("test", 2)))
    plan = plan_splits(hwd_catalog(), spec)
    assert [len(plan.ids[split]) for split in SPLITS] == [80, 20, 0, 0, 0]
    with pytest.raises(InputError, match=r"ask for 10 digits per class, the source has 9 of class 3"):
        plan_splits(catalog([3] * 9), spec)
    assert SplitSpec(sizes=(("test", 10**9),)).sizes == (("test", 10**9),)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"by": "Writer"},
            "by of the division into splits is 'Writer'; expected None or one of digit, writer, none",
        ),
        ({"seed": -1}, "seed of the division into splits is -1; expected an integer"),
        ({"seed": 1.5}, "seed of the division into splits is 1.5"),
        ({"sizes": "train"}, "sizes of the division into splits is 'train'; expected SPLIT=N once per split"),
        ({"sizes": {"train": True}}, "is {'train': True}; expected each of train"),
        ({"sizes": [("train", 3), ("train", 4)]}, "once at most"),
        ({"sizes": [("validation", 3)]}, "expected each of train, .* once at most"),
        ({"sizes": [("test", -1)]}, "'test', -1.*an integer from 0 to 1,000,000,000, such as"),
        ({"sizes": [("test", 10**9 + 1)]}, "'test', 1000000001.*an integer from 0"),
    ],
)
def test_impossible_divisions_are_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        SplitSpec(**wrong)


@given(counts=st.lists(st.integers(1, 40), min_size=5, max_size=60), seed=st.integers(0, 1000))
def test_no_writer_is_in_two_splits(counts, seed):
    writers = np.repeat(np.arange(len(counts)) * 7, counts)
    source = catalog(np.arange(len(writers)) % 10, writers)
    plan = plan_splits(source, SplitSpec(seed, by="writer"))
    homes = {split: set(writers[plan.ids[split]].tolist()) for split in SPLITS}
    assert sum(map(len, homes.values())) == len(counts)
    assert set().union(*homes.values()) == set(writers.tolist())
    assert all(homes.values())
    assert sum(len(plan.ids[split]) for split in SPLITS) == len(writers)


def listed_plan(source: DigitCatalog, seed: int) -> dict[str, list[int]]:
    """Plan with lists, one id at a time, as the division by digit is defined."""

    def ordered(ids: list[int], stream: int) -> list[int]:
        keys = [int(digit_source._keys(np.asarray([each]), seed, stream)[0]) for each in ids]
        return [each for _, each in sorted(zip(keys, ids, strict=True))]

    rows: dict[str, list[int]] = {split: [] for split in SPLITS}
    for label in range(10):
        pairs = zip(source.ids.tolist(), source.labels.tolist(), strict=True)
        members = ordered([each for each, its in pairs if its == label], 0)
        sizes = digit_source._usual_sizes(len(members), PUBLISHED_SIZES)
        for split in SPLITS:
            rows[split] += members[: sizes[split]]
            members = members[sizes[split] :]
    return {split: ordered(ids, 1) for split, ids in rows.items()}


@given(source=catalogs, seed=st.integers(0, 2**32))
def test_plans_of_arrays_and_of_lists_are_equal(source, seed):
    plan = plan_splits(source, SplitSpec(seed))
    assert {split: plan.ids[split].tolist() for split in SPLITS} == listed_plan(source, seed)


def test_unknown_writers_cannot_be_split():
    with pytest.raises(InputError, match=r"need the writer of every digit.*--writer-column"):
        plan_splits(catalog([1, 2, 3]), SplitSpec(by="writer"))
