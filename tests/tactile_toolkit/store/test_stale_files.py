"""What dead writers left goes, what living ones are at stays."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tactile_toolkit.cache import DiskCache
from tactile_toolkit.run.processes import InlineRunner
from tactile_toolkit.store.build import build
from tactile_toolkit.store.files import atomic_file, remove_abandoned
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.verify import verify
from tests.processes import alive, wait_for_death
from tests.tactile_toolkit.toy import SCHEMA, toy_plan

REPOSITORY = Path(__file__).resolve().parents[3]
NAME = "train-00001-of-00004.parquet"
UNIQUE = "0123456789abcdef0123456789abcdef"


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def zombie_that_wrote(folder) -> subprocess.Popen[bytes]:
    """Start a writer that is killed in the middle of a file; its exit status is not read."""
    code = """
import os, signal, sys
from pathlib import Path
from tactile_toolkit.store.files import atomic_file
with atomic_file(Path(sys.argv[1])) as stream:
    stream.write(b"half")
    stream.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    process = subprocess.Popen([sys.executable, "-c", code, str(folder / NAME)])
    wait_for_death(process.pid)
    assert not alive(process.pid)
    assert Path(f"/proc/{process.pid}").exists()
    return process


def test_of_a_writer_whose_parent_has_not_noticed_its_death(tmp_path):
    """In a container the first process may take its time to clear up after those whose parent was killed."""
    process = zombie_that_wrote(tmp_path)
    try:
        (left,) = names(tmp_path)
        assert left.endswith(NAME)
        remove_abandoned(tmp_path)
        assert names(tmp_path) == []
    finally:
        process.wait()


def test_of_the_dead_and_of_the_living(tmp_path):
    """Also in the process that writes, and in another thread of it."""
    (tmp_path / f".writing-{UNIQUE}-{NAME}").touch()
    (tmp_path / f".writing-{UNIQUE}-folder").mkdir()
    strange = [".gallery-x", NAME, ".writing-", ".writing-notes.txt", f".writing-{UNIQUE}"]
    for name in strange:
        (tmp_path / name).touch()
    with atomic_file(tmp_path / "mine") as stream:
        stream.write(b"half")
        remove_abandoned(tmp_path)
        assert len(names(tmp_path)) == 6
    assert names(tmp_path) == sorted(["mine", *strange])


def test_a_file_that_is_removed_before_it_is_held_is_made_again(tmp_path, monkeypatch):
    from tactile_toolkit.store import files

    held, seen = files._held, []

    def removed_first(path):
        seen.append(path)
        if len(seen) == 1:
            path.unlink()
        return held(path)

    monkeypatch.setattr(files, "_held", removed_first)
    with atomic_file(tmp_path / "mine") as stream:
        stream.write(b"all of it")
    assert len(seen) == 2
    assert (tmp_path / "mine").read_bytes() == b"all of it"
    assert names(tmp_path) == ["mine"]


WRITE_AND_CLEAN = """
import sys
from pathlib import Path
from tactile_toolkit.cache import DiskCache
from tactile_toolkit.store.files import atomic_file, remove_abandoned
folder = Path(sys.argv[1])
with atomic_file(folder / "theirs") as stream:
    stream.write(b"half")
    remove_abandoned(folder)
    DiskCache(folder, 1 << 20).write("kept", 1, lambda cached: cached.write(b"1"))
    print(len(list(folder.glob(".writing-*"))), flush=True)
    sys.stdin.readline()
"""


@pytest.mark.parametrize("proc", [[], ["--mount-proc"]], ids=["with the host's /proc", "with its own /proc"])
def test_of_containers_that_share_a_host_name(tmp_path, proc):
    """Processes are numbered by each for itself: what is number 2 there is another process, or none, here."""
    apart = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child", *proc]
    if shutil.which("unshare") is None or subprocess.run([*apart, "true"], check=False).returncode:
        pytest.skip("this system gives no process namespaces")
    inside = subprocess.Popen(
        [*apart, sys.executable, "-c", WRITE_AND_CLEAN, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=REPOSITORY,
    )
    with atomic_file(tmp_path / "mine") as stream:
        stream.write(b"half")
        assert inside.stdout.readline() == "2\n"
        remove_abandoned(tmp_path)
        assert DiskCache(tmp_path, 1 << 20).write("here", 1, lambda cached: cached.write(b"1"))
        assert len(list(tmp_path.glob(".writing-*"))) == 2
    inside.communicate("\n")
    assert inside.returncode == 0
    assert names(tmp_path) == ["here", "kept", "mine", "theirs"]


def test_a_folder_of_temporaries_that_goes_between_two_looks_is_made_again(tmp_path, monkeypatch):
    """Another writer removes it, empty as it is, between the attempt of pathlib and its look at it."""
    make, met = Path.mkdir, []

    def racing(path, *words, **options):
        if path.name == ".pending" and len(met) < 3:
            met.append(path)
            raise FileExistsError(17, "File exists", str(path))
        make(path, *words, **options)

    monkeypatch.setattr(Path, "mkdir", racing)
    DataFolder(str(tmp_path)).write_bytes("data/rows", b"all")
    assert (tmp_path / "data" / "rows").read_bytes() == b"all"
    assert len(met) == 3
    assert names(tmp_path) == ["data"]


def test_what_is_being_written_is_no_damage(tmp_path):
    """A file that a user writes, or never finished on another machine, is not one of the set."""
    folder = DataFolder(str(tmp_path / "set"))
    build(folder, toy_plan(), InlineRunner())
    (tmp_path / "set" / ".pending").mkdir()
    (tmp_path / "set" / ".pending" / "tmp-0123abcd").write_bytes(b"half")
    (tmp_path / "set" / "data" / f".writing-otherhost-17.3-0123abcd-{NAME}").write_bytes(b"half")
    assert verify(folder, SCHEMA).ok
    (tmp_path / "set" / "data" / "notes.txt").write_bytes(b"x")
    assert [finding.file for finding in verify(folder, SCHEMA).findings] == ["data/notes.txt"]


_COPIED = """
from tactile_toolkit.exchange.upload import local_copy
from tactile_toolkit.store.files import scratch_folder
there.write_bytes("data/a", b"content")
scratch = scratch_folder()
copy = local_copy(there, scratch.__enter__() / "copy")
"""
_WRITTEN = """
def fill(stream):
    stream.write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
there.write("reports/a", fill)
"""
_TO_STORE = """
import os, signal
from tactile_toolkit.store.folder import DataFolder
there = DataFolder("memory://store/set")
{what}
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("what", [_WRITTEN, _COPIED])
def test_what_a_killed_writer_to_a_store_left_on_this_machine_goes_with_the_next(tmp_path, monkeypatch, what):
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    (tmp_path / "tactile-toolkit-notes").write_text("mine")
    code = _TO_STORE.format(what=what)
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == -9
    assert len(names(tmp_path)) == 2
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def fill(stream):
        assert len(names(tmp_path)) == 2, "what this process is writing, and the user's file"
        stream.write(b"content")

    DataFolder("memory://store/set").write("reports/a", fill)
    assert names(tmp_path) == ["tactile-toolkit-notes"]
