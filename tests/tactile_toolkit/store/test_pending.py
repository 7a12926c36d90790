from __future__ import annotations

from dataclasses import replace

import pytest

from tactile_toolkit.errors import InputError, StorageError
from tactile_toolkit.run import Part
from tactile_toolkit.store import Manifest, build, open_folder, read_manifest, verify
from tactile_toolkit.store.manifest import write_manifest
from tests.tactile_toolkit.toy import folder_bytes, make, toy_plan


@pytest.fixture
def interrupted(tmp_path):
    """A folder with the first two of four shards of train."""
    plan = toy_plan(("train",))
    broken = replace(plan.tasks[2], error=StorageError("stop"))
    with pytest.raises(StorageError, match="stop"):
        make(tmp_path / "set", replace(plan, tasks=(*plan.tasks[:2], broken)))
    return tmp_path / "set"


def indices(manifest, split="train"):
    return [record.shard.index for record in manifest.shards_of(split)]


def test_manifest_so_far_counts_finished_shards_of_an_unfinished_run(interrupted, tmp_path):
    folder = open_folder(str(interrupted))
    assert indices(read_manifest(folder)) == []
    so_far = Manifest.so_far(folder)
    assert not so_far.complete
    assert indices(so_far) == [0, 1]
    assert so_far.split_table()["train"]["rows"] == 9
    before = folder_bytes(interrupted)
    Manifest.so_far(folder)
    assert folder_bytes(interrupted) == before
    assert made_by(interrupted, toy_plan(("train",))) == [2, 3]
    make(tmp_path / "whole", toy_plan(("train",)))
    assert folder_bytes(interrupted) == folder_bytes(tmp_path / "whole")


def test_manifest_so_far_is_the_manifest_of_a_finished_run(tmp_path):
    assert Manifest.so_far(open_folder(str(tmp_path))) is None
    manifest = make(tmp_path / "set", toy_plan())
    assert Manifest.so_far(open_folder(str(tmp_path / "set"))) == manifest


def made_by(path, plan, **options):
    """Make a plan, and return the shards that this run made."""
    told = []
    build(open_folder(str(path)), plan, on_progress=told.append, **options)
    return [progress.record.shard.index for progress in told if progress.record is not None]


@pytest.mark.parametrize("overwrite", [False, True])
def test_the_same_command_takes_up_records_whose_manifest_is_gone(interrupted, tmp_path, overwrite):
    (interrupted / "manifest.json").unlink()
    assert made_by(interrupted, toy_plan(("train",)), overwrite=overwrite) == [2, 3]
    make(tmp_path / "whole", toy_plan(("train",)))
    assert folder_bytes(interrupted) == folder_bytes(tmp_path / "whole")


def test_records_of_another_command_are_not_taken_up(interrupted):
    (interrupted / "manifest.json").unlink()
    before = folder_bytes(interrupted)
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"not empty and holds no manifest\.json \(found 'data'\)"):
            made_by(interrupted, toy_plan(("train",), spec={"seed": 2}), overwrite=overwrite)
    assert folder_bytes(interrupted) == before


def test_reused_shards_have_the_recorded_content(interrupted, tmp_path):
    """Another set was begun in the folder, and left a file of the same name and size."""
    (interrupted / "manifest.json").unlink()
    shard = interrupted / "data" / "train-00001-of-00004.parquet"
    content = shard.read_bytes()
    shard.write_bytes(content.replace(b"PAR1", b"PAR2", 1))
    assert made_by(interrupted, toy_plan(("train",)), part=Part(2, 4)) == [2], "that run took them up"
    assert made_by(interrupted, toy_plan(("train",))) == [1, 3]
    make(tmp_path / "whole", toy_plan(("train",)))
    assert folder_bytes(interrupted) == folder_bytes(tmp_path / "whole")


@pytest.mark.parametrize(("kept", "count"), [((), "0 of 6"), (("test",), "4 of 6")])
def test_an_unfinished_set_is_verified_as_such(interrupted, kept, count):
    """The run would make both splits; shards that another run has finished count."""
    if not kept:
        (interrupted / "manifest.json").unlink()
        for path in (interrupted / ".pending").iterdir():
            path.unlink()
    for split in kept:
        make(interrupted, toy_plan((split,)))
    folder = open_folder(str(interrupted))
    manifest = read_manifest(folder)
    if manifest is None:
        write_manifest(folder, toy_plan().new_manifest())
    (finding,) = verify(folder).findings
    assert finding.problem == f"not finished: {count} shards; the same command continues"


def test_damage_of_an_unfinished_set_is_named_beside(interrupted):
    shard = interrupted / "data" / "train-00001-of-00004.parquet"
    shard.write_bytes(shard.read_bytes().replace(b"PAR1", b"PAR2", 1))
    first, second = verify(open_folder(str(interrupted))).findings
    assert first.problem == "not finished: 2 of 4 shards; the same command continues"
    assert (second.file, second.problem[:6]) == ("data/train-00001-of-00004.parquet", "sha256")
