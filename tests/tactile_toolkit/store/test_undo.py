from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.run import InlineRunner, ProcessRunner
from tactile_toolkit.store import DataFolder, build
from tests.tactile_toolkit.toy import folder_bytes, toy_plan

IMPOSSIBLE = InputError("no place for the third object")


def make(path, plan, **options):
    return build(DataFolder(str(path)), plan, **options)


def failing(plan, *shards):
    """The plan with some tasks that cannot be done."""
    tasks = [
        replace(task, error=IMPOSSIBLE) if number in shards else task
        for number, task in enumerate(plan.tasks)
    ]
    return replace(plan, tasks=tuple(tasks))


@pytest.mark.parametrize("runner", [InlineRunner(), ProcessRunner(2)], ids=["inline", "processes"])
def test_run_that_finished_nothing_leaves_no_folder(tmp_path, runner):
    with pytest.raises(InputError, match="third object"):
        make(tmp_path / "set", toy_plan(error=IMPOSSIBLE), workers=runner)
    assert not (tmp_path / "set").exists()


def test_folder_that_was_there_stays_and_takes_another_specification(tmp_path):
    with pytest.raises(InputError, match="third object"):
        make(tmp_path, toy_plan(error=IMPOSSIBLE))
    assert list(tmp_path.iterdir()) == []
    assert make(tmp_path, toy_plan(spec={"seed": 9})).complete


def test_finished_split_is_as_before_when_another_cannot_be_made(tmp_path):
    make(tmp_path / "set", toy_plan(("test",)))
    before = folder_bytes(tmp_path / "set")
    with pytest.raises(InputError, match="third object"):
        make(tmp_path / "set", toy_plan(("train",), error=IMPOSSIBLE))
    assert folder_bytes(tmp_path / "set") == before


def test_ctrl_c_before_the_first_shard_leaves_nothing(tmp_path):
    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "set", toy_plan(), on_progress=stop)
    assert not (tmp_path / "set").exists()


def test_what_ended_a_run_is_what_is_reported(tmp_path, monkeypatch):
    """Not that the disk lets nothing be tidied up then."""
    left = tmp_path / "set" / ".pending" / "tmp-0123456789abcdef0123456789abcdef"

    def stop(progress):
        left.parent.mkdir(exist_ok=True)
        left.touch()

        def refuse(*_, **__):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        for name in ("unlink", "rename", "replace", "iterdir", "glob"):
            monkeypatch.setattr(Path, name, refuse)
        raise IMPOSSIBLE

    for overwrite in (False, True):
        with monkeypatch.context(), pytest.raises(InputError, match="third object"):
            make(tmp_path / "set", toy_plan(), on_progress=stop, overwrite=overwrite)
        monkeypatch.undo()
        make(tmp_path / "set", toy_plan())


def test_finished_shards_are_kept_and_guarded(tmp_path):
    plan = toy_plan()
    make(tmp_path / "whole", plan)
    with pytest.raises(InputError, match="third object"):
        make(tmp_path / "set", failing(plan, 2))
    kept = folder_bytes(tmp_path / "set")
    assert sorted(name for name in kept if name.startswith("data/")) == [
        f"data/train-{index:05d}-of-00004.parquet" for index in range(2)
    ]
    with pytest.raises(SpecMismatchError, match="--overwrite"):
        make(tmp_path / "set", toy_plan(spec={"seed": 9}))
    assert folder_bytes(tmp_path / "set") == kept
    make(tmp_path / "set", plan)
    assert folder_bytes(tmp_path / "set") == folder_bytes(tmp_path / "whole")


def test_failing_again_keeps_what_an_earlier_run_finished(tmp_path):
    plan = toy_plan()
    for wrong in ((1, 2, 3, 4, 5), (1, 2, 3, 4, 5), (2,)):
        with pytest.raises(InputError, match="third object"):
            make(tmp_path / "set", failing(plan, *wrong))
        assert (tmp_path / "set" / "data" / "train-00000-of-00004.parquet").exists()
        assert (tmp_path / "set" / "manifest.json").exists()
    make(tmp_path / "set", plan)
    make(tmp_path / "whole", plan)
    assert folder_bytes(tmp_path / "set") == folder_bytes(tmp_path / "whole")
