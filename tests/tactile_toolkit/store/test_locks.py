"""One at a time, also where the file system knows no locks of folders."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import pytest

from tactile_toolkit.errors import BusyError
from tactile_toolkit.store.locks import locked

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="asks how a system with the module does it")


@pytest.mark.parametrize("has_locks", [True, False])
def test_a_folder_is_held_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_locks: bool) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    if not has_locks:
        monkeypatch.setattr("fcntl.flock", refuse)
    for _ in range(2):
        with locked(tmp_path), pytest.raises(BusyError), locked(tmp_path, patience_s=0):
            pytest.fail("two hold it")
        assert list(tmp_path.iterdir()) == []


def test_a_folder_that_goes_while_it_is_locked_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "set"
    folder.mkdir()

    def replace(*_: object) -> None:
        folder.rename(tmp_path / "old")
        folder.mkdir()

    monkeypatch.setattr("fcntl.flock", replace)
    with pytest.raises(FileNotFoundError, match="set"), locked(folder):
        pytest.fail("it holds another folder than is there")
