"""Resources of a process: cores, a working folder, a home folder."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

import pytest

from cli.options import process_count
from tactile_toolkit import cache
from tactile_toolkit.errors import InputError
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.run.this_process import usable_cores
from tactile_toolkit.store import open_folder


def test_workers_follow_the_cores_that_the_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {3, 5, 7}, raising=False)
    assert (usable_cores(), process_count(0), process_count(9)) == (3, 3, 9)
    monkeypatch.delattr(os, "sched_getaffinity")
    assert usable_cores() == 64
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert usable_cores() == 1


def test_a_deleted_working_folder_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert open_folder(str(tmp_path)).exists()
    for relative in (lambda: open_folder("set"), lambda: list(ProcessRunner(1).run(abs, [1]))):
        with pytest.raises(InputError, match="the working folder was deleted; next: change to a folder"):
            relative()


def test_a_user_without_a_home_has_a_cache_of_his_own(tmp_path, monkeypatch):
    """In the folder for temporary files, which all users share, files of other users are not used."""

    def no_home(_path: Path) -> Path:
        raise RuntimeError

    for name in (cache.CACHE_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "expanduser", no_home)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ours = tmp_path / f"tactile-toolkit-{os.getuid()}"
    for prepare, is_ours in ((lambda: None, True), (lambda: None, True), (lambda: ours.chmod(0o777), False)):
        prepare()
        cache._temporary_cache.cache_clear()
        with pytest.warns(
            RuntimeWarning, match="no home folder is known: the cache is .*TACTILE_TOOLKIT_CACHE"
        ):
            found = cache.cache_folder()
        assert (found == ours) == is_ours
        assert found.parent == tmp_path
        assert stat.S_IMODE(found.stat().st_mode) == 0o700
    cache._temporary_cache.cache_clear()
