"""What dead writers left goes, what living ones are at stays."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tactile_toolkit.run import system
from tactile_toolkit.store.folder import DataFolder, is_stale, temporary_name
from tests.processes import alive, wait_for_death

HOST = socket.gethostname()
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
    writer = mine.removeprefix(f".writing-{HOST}-").split("-")[0]
    began = writer.split(".")[1]
    former = mine.replace(writer, f"{os.getpid()}.{int(began) - 1}")
    assert is_stale(former)


@pytest.mark.parametrize("has_proc", [True, False])
def test_of_the_dead_and_of_the_living(tmp_path, monkeypatch, has_proc):
    if not has_proc:  # macOS
        monkeypatch.setattr(system, "_has_proc", lambda: False)
        monkeypatch.setattr(system, "_proc_stat", lambda _process: None)
    dead = f".writing-{HOST}-999999999-abc-{NAME}"
    dead_too = f".writing-{HOST}-999999999.17-abc-{NAME}"
    init = f".writing-{HOST}-1-abc-{NAME}"
    mine = temporary_name(NAME)
    elsewhere = f".writing-otherhost-999999999-abc-{NAME}"
    strange = [".writing-", f".writing-{HOST}-notes.txt", ".gallery-x", NAME]
    for name in (dead, dead_too, init, mine, elsewhere, *strange):
        (tmp_path / name).touch()
    DataFolder(str(tmp_path)).remove_stale_files("")
    assert names(tmp_path) == sorted([init, mine, elsewhere, *strange])
