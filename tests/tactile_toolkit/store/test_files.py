"""Files of dead writers go, living writers write lost files again, and finished files are on the disk."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tactile_toolkit.errors import StorageError
from tactile_toolkit.run import Part
from tactile_toolkit.store import build, open_folder, verify
from tactile_toolkit.store.files import remove_drafts, write_file
from tests.tactile_toolkit.toy import SCHEMA, toy_plan

NAME = "train-00001-of-00004.parquet"
UNIQUE = "0123456789abcdef0123456789abcdef"


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def killed_writer(code: str, *arguments: object, **environment: str) -> None:
    """Run a writer that is killed in the middle of a file."""
    script = f"import os, signal, sys\n{code}\nos.kill(os.getpid(), signal.SIGKILL)"
    command = [sys.executable, "-c", script, *map(str, arguments)]
    assert subprocess.run(command, env={**os.environ, **environment}, check=False).returncode == -9


_KILLED = """
from pathlib import Path
from tactile_toolkit.store.files import write_file
write_file(Path(sys.argv[1]), lambda stream: (stream.write(b"half"), os.kill(os.getpid(), signal.SIGKILL)))
"""


def test_files_of_a_killed_writer_are_removed(tmp_path):
    killed_writer(_KILLED, tmp_path / NAME)
    (left,) = names(tmp_path)
    assert left.endswith(NAME)
    assert left != NAME
    remove_drafts(tmp_path)
    assert names(tmp_path) == []


def test_only_temporary_files_go(tmp_path):
    (tmp_path / f".writing-{UNIQUE}-{NAME}").touch()
    strange = [".gallery-x", NAME, ".writing-", ".writing-notes.txt", f".writing-{UNIQUE}"]
    for name in strange:
        (tmp_path / name).touch()
    remove_drafts(tmp_path)
    assert names(tmp_path) == sorted(strange)


@pytest.mark.parametrize("times", [1, 5])
def test_a_writer_whose_temporary_file_was_removed_writes_again(tmp_path, times):
    """By any program: no one needs to know which writers are alive on which machine."""
    calls = []

    def fill(stream):
        calls.append(stream.write(b"all of it"))
        if len(calls) <= times:
            remove_drafts(tmp_path)
        return len(calls)

    assert write_file(tmp_path / "mine", fill) == times + 1
    assert (tmp_path / "mine").read_bytes() == b"all of it"
    assert names(tmp_path) == ["mine"]


def test_a_writer_that_always_loses_its_temporary_file_gives_up(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_file(tmp_path / "mine", lambda _: remove_drafts(tmp_path))
    assert names(tmp_path) == []


def test_a_file_in_a_folder_that_cannot_be_searched_is_not_removed(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "is_symlink", refuse)
    with pytest.raises(StorageError, match=r"'.*/data/x': Permission denied"):
        open_folder(str(tmp_path)).remove("data/x")


def test_a_folder_of_temporaries_that_goes_between_two_looks_is_made_again(tmp_path, monkeypatch):
    """Another writer removes the empty folder between two calls of pathlib."""
    make, met = Path.mkdir, []

    def racing(path, *words, **options):
        if path.name == ".pending" and len(met) < 3:
            met.append(path)
            raise FileExistsError(17, "File exists", str(path))
        make(path, *words, **options)

    monkeypatch.setattr(Path, "mkdir", racing)
    open_folder(str(tmp_path)).write_bytes("data/rows", b"all")
    assert (tmp_path / "data" / "rows").read_bytes() == b"all"
    assert len(met) == 3
    assert names(tmp_path) == ["data"]


def test_files_that_are_being_written_are_not_damage(tmp_path):
    """A file that a user is writing, or never finished on another machine, is not part of the set."""
    folder = open_folder(str(tmp_path / "set"))
    build(folder, toy_plan())
    (tmp_path / "set" / ".pending").mkdir()
    (tmp_path / "set" / ".pending" / "tmp-0123abcd").write_bytes(b"half")
    (tmp_path / "set" / "data" / f".writing-otherhost-17.3-0123abcd-{NAME}").write_bytes(b"half")
    assert verify(folder, SCHEMA).ok


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
