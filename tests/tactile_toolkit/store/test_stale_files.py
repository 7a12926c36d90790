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
from tactile_toolkit.run import system
from tactile_toolkit.run.processes import InlineRunner
from tactile_toolkit.run.system import machine_name
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import FORSAKEN_S, DataFolder, atomic_file, is_stale, temporary_name
from tactile_toolkit.store.verify import verify
from tests.processes import alive, wait_for_death
from tests.tactile_toolkit.toy import SCHEMA, toy_plan

REPOSITORY = Path(__file__).resolve().parents[3]

HERE = machine_name()
NAME = "train-00001-of-00004.parquet"


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def zombie_that_wrote(folder) -> subprocess.Popen[bytes]:
    """Start a writer that is killed in the middle of a file; nobody asks for its exit status."""
    code = """
import os, signal, sys
from pathlib import Path
from tactile_toolkit.store.folder import atomic_file
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
        DataFolder(str(tmp_path)).remove_stale_files("")
        assert names(tmp_path) == []
    finally:
        process.wait()


def test_of_a_writer_whose_number_another_process_has_now(tmp_path):
    mine = temporary_name(NAME)
    assert not is_stale(mine)
    writer = mine.removeprefix(f".writing-{HERE}-").split("-")[0]
    began = writer.split(".")[1]
    former = mine.replace(writer, f"{os.getpid()}.{int(began) - 1}")
    assert is_stale(former)


@pytest.mark.parametrize("has_proc", [True, False])
def test_of_the_dead_and_of_the_living(tmp_path, monkeypatch, has_proc):
    if not has_proc:  # macOS
        monkeypatch.setattr(system, "_has_proc", lambda: False)
        monkeypatch.setattr(system, "_proc_stat", lambda _process: None)
    dead = f".writing-{HERE}-999999999-abc-{NAME}"
    dead_too = f".writing-{HERE}-999999999.17-abc-{NAME}"
    init = f".writing-{HERE}-1-abc-{NAME}"
    mine = temporary_name(NAME)
    elsewhere = f".writing-otherhost-999999999-abc-{NAME}"
    strange = [".writing-", f".writing-{HERE}-notes.txt", ".gallery-x", NAME]
    for name in (dead, dead_too, init, mine, elsewhere, *strange):
        (tmp_path / name).touch()
    DataFolder(str(tmp_path)).remove_stale_files("")
    assert names(tmp_path) == sorted([init, mine, elsewhere, *strange])


def test_of_writers_elsewhere_after_an_age(tmp_path):
    """By the clock of the file system: a file of an hour from now is young, whatever clock is wrong."""
    young, old, ahead = (f".writing-{host}-999999999.17-abc-{NAME}" for host in ("a-7", "b", "c"))
    rebooted = f".writing-{HERE.rpartition('-')[0]}-0123456789ab-1-abc-{NAME}"
    for name, age_s in ((young, FORSAKEN_S - 60), (old, FORSAKEN_S), (rebooted, FORSAKEN_S), (ahead, -3600)):
        (tmp_path / name).touch()
        written_s = (tmp_path / name).stat().st_mtime - age_s
        os.utime(tmp_path / name, (written_s, written_s))
    DataFolder(str(tmp_path)).remove_stale_files("")
    assert names(tmp_path) == sorted([young, ahead])
    DataFolder(str(tmp_path)).remove_stale_files("", forsaken_s=-7200)
    assert names(tmp_path) == []


WRITE_AND_CLEAN = """
import sys
from pathlib import Path
from tactile_toolkit.cache import DiskCache
from tactile_toolkit.store.folder import DataFolder, atomic_file
folder = Path(sys.argv[1])
with atomic_file(folder / "theirs") as stream:
    stream.write(b"half")
    DataFolder(str(folder)).remove_stale_files("")
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
        DataFolder(str(tmp_path)).remove_stale_files("")
        assert DiskCache(tmp_path, 1 << 20).write("here", 1, lambda cached: cached.write(b"1"))
        assert len(list(tmp_path.glob(".writing-*"))) == 2
    inside.communicate("\n")
    assert inside.returncode == 0
    assert names(tmp_path) == ["here", "kept", "mine", "theirs"]


def test_what_is_being_written_is_no_damage(tmp_path):
    """A file that somebody writes, or never finished on another machine, is not one of the set."""
    folder = DataFolder(str(tmp_path / "set"))
    build(folder, toy_plan(), InlineRunner())
    for name in (temporary_name(NAME), f".writing-otherhost-17.3-0123abcd-{NAME}"):
        (tmp_path / "set" / "data" / name).write_bytes(b"half")
    assert verify(folder, SCHEMA).ok
    (tmp_path / "set" / "data" / "notes.txt").write_bytes(b"x")
    assert [finding.file for finding in verify(folder, SCHEMA).findings] == ["data/notes.txt"]


_COPIED = """
from tactile_toolkit.exchange.local_copy import LocalCopy
there.write_bytes("data/a", b"content")
copy = LocalCopy(there)
"""
_WRITTEN = """
writing = there.writing("reports/a")
writing.__enter__().write(b"half")
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
    with DataFolder("memory://store/set").writing("reports/a") as stream:
        assert len(names(tmp_path)) == 2, "what this process is writing, and the user's file"
        stream.write(b"content")
    assert names(tmp_path) == ["tactile-toolkit-notes"]
