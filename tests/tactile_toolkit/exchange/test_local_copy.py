"""A copy on this machine: whole, gone with its object, and given up at the first failure."""

from __future__ import annotations

from pathlib import Path

import pytest

from tactile_toolkit.exchange.local_copy import LocalCopy
from tactile_toolkit.store.folder import DataFolder
from tests.tactile_toolkit.toy import folder_bytes


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(200):
        file = tmp_path / "set" / "data" / f"{number:03d}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(str(number))
    (tmp_path / "set" / ".hidden").touch()
    return tmp_path / "set"


def test_a_copy_is_whole_and_goes_with_its_object(folder: Path) -> None:
    copy = LocalCopy(DataFolder(str(folder)))
    root = copy.root
    (folder / ".hidden").unlink()
    assert folder_bytes(root) == folder_bytes(folder)
    del copy
    assert not root.exists()


def test_the_first_failure_ends_the_copying(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def copy_out(_: DataFolder, path: str, __: Path) -> None:
        asked.append(path)
        raise OSError(path)

    monkeypatch.setattr(DataFolder, "copy_out", copy_out)
    with pytest.raises(OSError, match="000"):
        LocalCopy(DataFolder(str(folder)))
    assert len(asked) < 50
