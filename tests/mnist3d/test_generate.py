from __future__ import annotations

import json
import pickle
import signal

import numpy as np
import pyarrow.parquet as pq
import pytest

import mnist3d
from mnist3d.digit_generation import DigitGenerator, DigitSetSpec, generate
from mnist3d.digit_options import SPLITS, SolidSpec, SplitSpec
from mnist3d.digit_records import digit_schema
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError
from tactile_toolkit.generation import plan_build
from tactile_toolkit.store import open_folder, verify
from tests.command_line import call
from tests.mnist3d.sources import BLANK, FULL, UNREADABLE, FlawedSource
from tests.processes import PATIENCE_S, start_held
from tests.tactile_toolkit.toy import folder_bytes

COARSE = SolidSpec(target_vertices=2_000)  # as many as a lattice gives; decimation to fewer takes longer


@pytest.fixture(scope="module")
def flawed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flawed") / "set"
    manifest = generate(DigitSetSpec(FlawedSource(), COARSE), str(folder))
    return folder, manifest


def test_every_digit_is_a_row_or_skipped_with_its_reason(flawed):
    folder, manifest = flawed
    rows = {split: entry["rows"] + entry["skipped"] for split, entry in manifest.split_table().items()}
    # Three digits per class: one each for train, test and holdout, none for the printed splits.
    assert rows == {"train": 10, "test": 10, "holdout": 10}
    skipped = {item.id: item for record in manifest.shards for item in record.skipped}
    assert {number: item.reason for number, item in skipped.items()} == {
        BLANK: "no-ink",
        FULL: "all-ink",
        UNREADABLE: "unreadable",
    }
    assert f"digit {BLANK} of source 'flawed'" in skipped[BLANK].message
    ids = np.concatenate([mnist3d.load(str(folder), split).ids for split in rows])
    assert sorted(ids.tolist()) == sorted(set(range(30)) - set(skipped))
    assert verify(open_folder(str(folder)), digit_schema()).ok
    written = json.loads((folder / "manifest.json").read_text())
    assert written["skipped"] == {"all-ink": 1, "no-ink": 1, "unreadable": 1}


def test_failures_do_not_move_other_digits(flawed, tmp_path):
    folder, _ = flawed
    plan = plan_build(DigitGenerator(DigitSetSpec(FlawedSource(), COARSE)))
    for split in ("train", "test", "holdout"):
        planned = [i for task in plan.tasks if task.shard.split == split for i in task.items]
        made = mnist3d.load(str(folder), split).ids.tolist()
        assert made == [i for i in planned if i not in (BLANK, FULL, UNREADABLE)]


def test_report_has_a_row_per_digit_in_the_order_of_the_data(flawed):
    folder, manifest = flawed
    report = pq.read_table(folder / "reports" / "printability.parquet").to_pandas()
    for split in manifest.splits:
        digits = mnist3d.load(str(folder), split)
        rows = report[report.split == split]
        assert rows.id.tolist() == digits.ids.tolist()
        np.testing.assert_allclose(rows.volume_mm3 * 1e-9, digits.volumes_m3, rtol=1e-12)
        heights = [float(np.ptp(digit.vertices_m[:, 2])) * 1000 for digit in digits]
        np.testing.assert_allclose(rows.size_z_mm, heights, rtol=1e-6)
    assert report.is_solid.all()


def test_empty_selections_are_named(tmp_path):
    with pytest.raises(InputError, match=r"no digits to make for printed_test.*--split"):
        generate(DigitSetSpec(FlawedSource(), COARSE), str(tmp_path / "set"), ("printed_test",))
    assert not (tmp_path / "set").exists()
    with pytest.raises(InputError, match="unknown split 'validation'"):
        generate(DigitSetSpec(FlawedSource(), COARSE), str(tmp_path / "set"), ("validation",))
    with pytest.raises(InputError, match=r"limit of .* is 0"):
        DigitSetSpec(FlawedSource(), limit=0)


def test_shard_sizes_follow_from_the_split_alone():
    plan = plan_build(DigitGenerator(DigitSetSpec(SyntheticSource())))
    counts = {split: [t.size for t in plan.tasks if t.shard.split == split] for split in SPLITS}
    assert {split: sum(sizes) for split, sizes in counts.items()} == {
        "train": 11_480,
        "test": 1_000,
        "holdout": 500,
        "printed_train": 500,
        "printed_test": 100,
    }
    assert all(max(sizes) <= 128 for sizes in counts.values())
    assert len(counts["train"]) == 90
    alone = plan_build(DigitGenerator(DigitSetSpec(SyntheticSource())), ("test",))
    among_all = [task for task in plan.tasks if task.shard.split == "test"]
    assert [task.shard for task in alone.tasks] == [task.shard for task in among_all]
    for one, other in zip(alone.tasks, among_all, strict=True):
        assert one.items.tolist() == other.items.tolist()
        assert one.function.args == other.function.args


COMMAND = (
    *("generate", "--split-sizes", "train=1,test=1,holdout=1", "--limit"),
    *("2", "--vertices", "2000", "--quiet"),
)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    folder = tmp_path_factory.mktemp("unbroken") / "set"
    assert call("mnist3d", *COMMAND, "--workers", 1, "--out", folder) == 0
    return folder_bytes(folder)


@pytest.mark.thorough
@pytest.mark.parametrize(("blow", "workers"), [(signal.SIGINT, 1), (signal.SIGKILL, 2)])
def test_interrupted_run_continues_to_the_same_bytes(unbroken, tmp_path, workers, blow):
    folder = tmp_path / "set"
    words = (*COMMAND, "--workers", workers, "--out", folder)
    process = start_held("mnist3d", 1, tmp_path / "held", *words)
    process.send_signal(blow)
    _, words = process.communicate(timeout=PATIENCE_S)
    if blow == signal.SIGINT:
        assert process.returncode == 130
        assert b"the same command continues" in words
        assert not list(folder.rglob(".writing-*"))
    else:
        assert process.returncode == -signal.SIGKILL
    assert not json.loads((folder / "manifest.json").read_text())["complete"]
    kept = {f: f.stat().st_mtime_ns for f in (folder / "data").glob("[!.]*.parquet")}
    assert kept
    assert call("mnist3d", *COMMAND, "--workers", workers, "--out", folder) == 0
    assert folder_bytes(folder) == unbroken
    finished = [f for f, when in kept.items() if f.stat().st_mtime_ns == when]
    assert finished, "a finished shard was made again"


@pytest.mark.thorough
def test_writer_splits_share_no_writer(tmp_path):
    spec = DigitSetSpec(SyntheticSource(count=700), COARSE, SplitSpec(by="writer"), limit=2)
    generate(spec, str(tmp_path / "set"))
    homes = [set(mnist3d.load(str(tmp_path / "set"), split).writers.tolist()) for split in SPLITS]
    assert sum(map(len, homes)) == len(set().union(*homes)) > 0


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(("per_class", "splits", "rows"), [(1, ("train", "test"), 20), (None, SPLITS, 100)])
def test_real_digits_in_the_layout_of_hwd(shared, tmp_path, per_class, splits, rows):
    from mnist3d.sources.digit_arrays import HwdPlusSource

    layout = shared / "digits" / "hwd_layout"
    source = HwdPlusSource(str(layout / "Images(500x500).npy"), str(layout / "WriterInfo.npy"), 1)
    manifest = generate(DigitSetSpec(source, per_class=per_class), str(tmp_path / "set"), splits)
    assert sum(entry["rows"] for entry in manifest.split_table().values()) == rows
    assert manifest.skipped_reasons() == {}
    report = pq.read_table(tmp_path / "set" / "reports" / "printability.parquet").to_pandas()
    assert report.is_solid.all()
    assert report.size_z_mm.between(6.0, 8.2).all()
    assert report.vertices.between(4_000, 6_500).mean() > 0.9
    size = sum(entry["bytes"] for entry in manifest.split_table().values())
    assert size / rows <= 60_000


def test_a_task_takes_along_its_own_ids_only():
    spec = DigitSetSpec(SyntheticSource(count=100_000), split=SplitSpec(sizes=(("train", 9_000),)))
    task = plan_build(DigitGenerator(spec), ("train",)).tasks[3]
    assert task.items.base is not None  # a view of the ids of the split
    assert len(pickle.dumps(task)) < 8 * task.size + 2_000
