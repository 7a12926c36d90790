"""Finished shards are synced to the disk; all other tests skip that."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from tactile_toolkit.run import Part
from tactile_toolkit.store import build, open_folder
from tests.tactile_toolkit.toy import toy_plan

LINKS = Path("/proc/self/fd")


@pytest.mark.skipif(not LINKS.is_dir(), reason="asks Linux which file a handle is of")
def test_each_file_and_the_folder_of_its_name_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, folders = Counter[int](), Counter[str]()

    def fsync(handle: int) -> None:
        path = LINKS.joinpath(str(handle)).readlink()
        if path.is_dir():
            folders[path.name] += 1
        else:
            assert path.parent.name == ".pending", "under its name a file appears when it is on the disk"
            files[os.fstat(handle).st_ino] += 1

    monkeypatch.setattr(os, "fsync", fsync)
    place = tmp_path / "set"
    build(open_folder(str(place)), toy_plan(), part=Part(0, 1))
    written = [path for path in place.rglob("*") if path.is_file()]
    assert len(written) == 6 * 3 + 1, "rows, report rows and record of each shard, and a manifest"
    assert files == {path.stat().st_ino: 1 for path in written}
    assert folders == {"data": 6, ".pending": 12, "set": 1}
    files.clear()
    folders.clear()
    build(open_folder(str(place)), toy_plan(), finish=True)
    new = [place / "manifest.json", place / "reports" / "toy.parquet"]
    assert files == {path.stat().st_ino: 1 for path in new}
    assert folders == {"reports": 1, "set": 1}
