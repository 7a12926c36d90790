"""Exclusive locks, also on file systems without locks of folders; waiting is limited."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tactile_toolkit.cache import LOCKS, cache_folder
from tactile_toolkit.errors import BusyError
from tactile_toolkit.places import open_place
from tactile_toolkit.store import Progress, build, locked, locks, open_folder
from tactile_toolkit.store.locks import LOCK_FILE
from tests.processes import records_so_far
from tests.tactile_toolkit.hub.sets import BIG, CONTENT, SHARD, fetch, script, two_sets
from tests.tactile_toolkit.toy import folder_bytes, toy_plan

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


def test_a_folder_that_goes_while_it_is_locked_is_not_there(tmp_path, monkeypatch):
    folder = tmp_path / "set"
    folder.mkdir()

    def replace(*_: object) -> None:
        folder.rename(tmp_path / "old")
        folder.mkdir()

    monkeypatch.setattr("fcntl.flock", replace)
    with pytest.raises(FileNotFoundError, match="set"), locked(folder):
        pytest.fail("it holds another folder than is there")


_HOLD = """
import sys
from pathlib import Path
from tactile_toolkit.store.locks import locked
with locked(Path(sys.argv[1]), shared=sys.argv[2] == "shared"):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextlib.contextmanager
def held(path: Path, how: str = "alone", *, is_stopped: bool = True) -> Iterator[subprocess.Popen[str]]:
    """Let another process hold a lock, stopped as by Ctrl-Z, or at work."""
    program = [sys.executable, "-c", _HOLD, str(path), how]
    with subprocess.Popen(
        program, cwd=Path(__file__).parents[3], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        if is_stopped:
            process.send_signal(signal.SIGSTOP)
            os.waitpid(process.pid, os.WUNTRACED)
        try:
            yield process
        finally:
            process.kill()


class Clock:
    """A clock that advances while a process waits; an event happens ``after_s`` seconds."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 0.0
        self.then: tuple[float, Callable[[], object]] | None = None
        monkeypatch.setattr(locks, "time", self)

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        if self.then is not None and self.now_s > self.then[0]:
            self.then[1]()
            self.then = None
            time.sleep(0.05)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


needs_list = pytest.mark.skipif(not Path("/proc/locks").exists(), reason="asks Linux who holds a lock")


@pytest.mark.one_at_a_desk
@needs_list
@pytest.mark.parametrize("how", ["alone", "shared"])
@pytest.mark.parametrize("is_patient", [False, True])
def test_the_message_names_the_stopped_process(tmp_path, clock, how, is_patient):
    with held(tmp_path, how) as process:
        who = rf"process {process.pid} on {socket.gethostname()} \(`python\S*`\), which was stopped, holds "
        said = rf"^{who}.*, and has done so for 60 s; next: continue it \(kill -CONT {process.pid}\), or end"
        with pytest.raises(BusyError, match=said), locked(tmp_path, is_patient=is_patient):
            pytest.fail("two hold it")
        assert 60 <= clock.now_s < 61
    with locked(tmp_path, patience_s=0):
        pass


@pytest.mark.thorough
@needs_list
def test_patient_runs_wait_for_a_working_process(tmp_path: Path, clock: Clock) -> None:
    with held(tmp_path, is_stopped=False) as process:
        who = rf"^process {process.pid} on .* holds .*; next: wait until it has ended"
        with pytest.raises(BusyError, match=who), locked(tmp_path):
            pytest.fail("two hold it")
        clock.then = clock.now_s + 200, process.kill
        with locked(tmp_path, is_patient=True):
            assert clock.then is None


def test_without_locks_of_folders_the_holder_is_noted(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", refuse)
    said = (
        rf"process {os.getpid()} on {socket.gethostname()} .*, or remove '.*\.lock' if no process is at work"
    )
    with locked(tmp_path), pytest.raises(BusyError, match=said), locked(tmp_path, patience_s=0):
        pytest.fail("two hold it")
    (tmp_path / LOCK_FILE).write_text("what is this")  # of a process that was just killed
    with pytest.raises(BusyError, match=r"^another process holds "), locked(tmp_path, patience_s=0):
        pytest.fail("it is held")


def stopped_beside(place: Path, moment: str) -> BusyError:
    """Make a set while a stopped process holds its lock, since before the first shard or after the last."""
    with contextlib.ExitStack() as stack:

        def stop(progress: Progress) -> None:
            if progress.done == (0 if moment == "before" else progress.total):
                stack.enter_context(held(place))

        with pytest.raises(BusyError) as caught:
            build(open_folder(str(place)), toy_plan(), on_progress=stop)
        return caught.value


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
@needs_list
@pytest.mark.parametrize(("moment", "finished"), [("before", 0), ("after", 6)])
def test_a_run_beside_a_stopped_one_ends(tmp_path: Path, clock: Clock, moment: str, finished: int) -> None:
    """The error comes after a minute, not after two, and no shards are lost."""
    assert "which was stopped, holds" in str(stopped_beside(tmp_path / "set", moment))
    assert 60 <= clock.now_s < 61
    assert len(records_so_far(tmp_path / "set")) == finished
    build(open_folder(str(tmp_path / "set")), toy_plan())
    build(open_folder(str(tmp_path / "whole")), toy_plan())
    assert folder_bytes(tmp_path / "set") == folder_bytes(tmp_path / "whole")


@pytest.mark.thorough
@needs_list
def test_a_stopped_reader_keeps_no_other_from_reading(tmp_path: Path, clock: Clock) -> None:
    build(open_folder(str(tmp_path)), toy_plan())
    (shard, *_) = open_place(str(tmp_path)).shards("train")
    lock = cache_folder() / LOCKS / shard.digest[:2]
    lock.parent.mkdir(parents=True)
    with held(lock):
        with pytest.warns(RuntimeWarning, match=r"which was stopped, holds .*locks.*stops waiting for it"):
            assert shard.block(0, 0).table["id"].to_pylist() == [0, 1, 2]
        assert shard.block(1, 0).table["id"].to_pylist() == [3, 4]
    assert 60 <= clock.now_s < 61, "for the second group of rows it was not waited"


@needs_list
def test_a_stopped_download_keeps_no_other_waiting(tmp_path: Path, clock: Clock) -> None:
    with two_sets(tmp_path / "root") as server:
        cache = tmp_path / "hf" / "hub"
        digest = hashlib.sha256(CONTENT).hexdigest()
        lock = cache / ".locks" / "datasets--someone--big" / f"{digest}.lock"
        lock.parent.mkdir(parents=True)
        with held(lock) as process:
            code, kind, words = fetch(server, tmp_path, script(BIG))
            assert (code, kind) == (2, "BusyError")
            assert f"process {process.pid} on " in words
            assert "which was stopped, holds" in words
        assert 60 <= clock.now_s < 62
        assert Path(fetch(server, tmp_path, script(BIG))[0], SHARD).read_bytes() == CONTENT


# As in the C library of Windows: a lock on bytes of an open file, for one holder, until its process ends.
_MSVCRT = """
import errno, fcntl, os, struct, types
from tactile_toolkit.store import locks
def locking(handle, mode, count):
    kind = fcntl.F_UNLCK if mode == 0 else fcntl.F_WRLCK
    start = os.lseek(handle, 0, os.SEEK_CUR)
    try:
        fcntl.fcntl(handle, fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", kind, os.SEEK_SET, start, count, 0))
    except BlockingIOError:
        raise PermissionError(errno.EACCES, "Permission denied") from None
windows = {"msvcrt": types.SimpleNamespace(locking=locking, LK_NBLCK=2, LK_UNLCK=0)}
locks._module = windows.get
"""


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl

    if not hasattr(fcntl, "F_OFD_SETLK"):
        pytest.skip("asks Linux for locks that belong to an open file")
    monkeypatch.setattr(locks, "_module", locks._module)  # so that it is restored
    exec(_MSVCRT, {})


@pytest.mark.parametrize("name", ["", "file"])
def test_on_windows_an_open_file_is_locked(tmp_path: Path, windows: None, name: str) -> None:
    place = tmp_path / name
    for shared in (False, True):  # shared locks do not exist there
        with locked(place, shared=shared):
            with (
                pytest.raises(BusyError, match="holds") as caught,
                locked(place, patience_s=0, shared=shared),
            ):
                pytest.fail("two hold it")
            if not name:
                assert f"process {os.getpid()} on {socket.gethostname()}" in str(caught.value)
            assert "or remove" not in str(caught.value)
        assert [each.name for each in tmp_path.iterdir()] == [name] * bool(name)


def test_on_windows_a_killed_process_leaves_no_lock(tmp_path: Path, windows: None) -> None:
    program = [sys.executable, "-c", _MSVCRT + _HOLD, str(tmp_path), "alone"]
    with subprocess.Popen(
        program, cwd=Path(__file__).parents[3], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        with pytest.raises(BusyError, match=f"process {process.pid} "), locked(tmp_path, patience_s=0):
            pytest.fail("two hold it")
        process.kill()
    assert (tmp_path / LOCK_FILE).exists(), "it leaves the file"
    with locked(tmp_path, patience_s=0):
        pass
    assert list(tmp_path.iterdir()) == []
