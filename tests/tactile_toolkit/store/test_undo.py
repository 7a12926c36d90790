from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.run import InlineRunner, ProcessRunner
from tactile_toolkit.store import build, open_folder
from tests.tactile_toolkit.toy import toy_plan

IMPOSSIBLE = InputError("no place for the third object")


def make(path, plan, **options):
    return build(open_folder(str(path)), plan, **options)


@pytest.mark.one_at_a_desk
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
