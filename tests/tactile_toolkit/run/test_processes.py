"""Workers: the script of the caller is not run again, and exceptions of tasks are passed on."""

from __future__ import annotations

import errno
import multiprocessing
import operator
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from tactile_toolkit.errors import (
    HubError,
    InputError,
    IntegrityError,
    ItemError,
    MissingExtraError,
    ToolkitError,
)
from tactile_toolkit.run import RayRunner, skip_pandas
from tactile_toolkit.run.runners import ProcessRunner
from tests.forked import run_forked
from tests.processes import PATIENCE_S, alive

REPOSITORY = Path(__file__).resolve().parents[3]

UNGUARDED = """
print("started")
import math
from tactile_toolkit.run.runners import ProcessRunner
print(sorted(ProcessRunner(2).run(math.sqrt, [1.0, 4.0, 9.0])))
"""


@pytest.mark.thorough
def test_a_script_without_a_guard_runs_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    for command in ([str(script)], ["-c", UNGUARDED]):
        done = subprocess.run(
            [sys.executable, *command], cwd=REPOSITORY, capture_output=True, text=True, check=False
        )
        assert done.stdout == "started\n[1.0, 2.0, 3.0]\n", done.stderr


def test_a_worker_of_another_program_starts_no_workers() -> None:
    """Its processes would be children of a daemonic process, which may have none."""
    code = """
        import math, multiprocessing as mp
        from tactile_toolkit.errors import InputError
        from tactile_toolkit.run.runners import ProcessRunner
        mp.current_process()._config['daemon'] = True
        try: list(ProcessRunner(2).run(math.sqrt, [1.0]))
        except InputError as error: print(error)
        """
    assert "a worker of another program (daemonic), which may start no processes" in run_forked(code)


def fails(path: str) -> None:
    with Path(path).open("a") as stream:
        stream.write("tried\n")
    message = "of the task"
    raise ZeroDivisionError(message)


def test_exceptions_of_tasks_are_raised_and_not_retried(tmp_path: Path) -> None:
    """The exception has the traceback of the worker."""
    tries = tmp_path / "tries"
    with pytest.raises(ZeroDivisionError, match="of the task") as raised:
        list(ProcessRunner(2).run(fails, [str(tries)]))
    assert tries.read_text() == "tried\n"
    assert "in fails\n    raise ZeroDivisionError" in raised.value.__notes__[0]


@pytest.mark.thorough
def test_workers_need_no_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some containers have no /dev/shm, where semaphores and shared memory live."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("_multiprocessing.SemLock", refuse)
    monkeypatch.setattr("_posixshmem.shm_open", refuse)
    assert sorted(ProcessRunner(2).run(operator.neg, range(5))) == [-4, -3, -2, -1, 0]


def unpicklable(_: int) -> object:
    return lambda: None


class OddError(Exception):
    """Can be pickled, but not unpickled."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} and {two}")


def odd(_: int) -> None:
    raise OddError("one", "two")


def process_of(_: int) -> int:
    return os.getpid()


class Missing:
    """Cannot be unpickled by a worker, like objects of a missing module."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __reduce__(self) -> tuple[object, ...]:
        return import_module, ("nowhere_to_be_found",)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("function", "task", "error", "words"),
    [
        (unpicklable, 1, (AttributeError, pickle.PicklingError), "pickle.*lambda"),
        (odd, 1, ToolkitError, "^OddError: one and two\n"),
        (process_of, Missing(1), ModuleNotFoundError, "nowhere_to_be_found"),
        (lambda _: None, 1, (AttributeError, pickle.PicklingError), "pickle.*lambda"),
        (process_of, threading.Lock(), TypeError, "cannot pickle.*lock"),
    ],
)
def test_objects_that_cannot_be_pickled_are_named_once(function, task, error, words, capfd):
    with pytest.raises(error, match=words):
        list(ProcessRunner(1).run(function, [task]))  # type: ignore[arg-type]
    assert capfd.readouterr() == ("", "")


def large(size: int) -> bytes:
    return bytes(size)


def size_of(content: bytes) -> int:
    return len(content)


@pytest.mark.thorough
def test_tasks_and_answers_may_be_larger_than_a_pipe_holds() -> None:
    assert [len(answer) for answer in ProcessRunner(2).run(large, [10_000_000] * 4)] == [10_000_000] * 4
    assert list(ProcessRunner(2).run(size_of, [bytes(10_000_000)] * 4)) == [10_000_000] * 4


def waits(path: str) -> None:
    """Interrupt this process; with a path, also leave a file with its id there, and wait."""
    os.kill(os.getpid(), signal.SIGINT)  # Ctrl-C reaches the workers, too; only the caller decides
    if path:
        Path(path, str(os.getpid())).touch()
        time.sleep(PATIENCE_S)


@pytest.mark.thorough
def test_an_iterator_that_is_closed_stops_the_work(tmp_path: Path) -> None:
    results = ProcessRunner(2).run(waits, ["", *[str(tmp_path)] * 3])
    assert next(results) is None
    while len(list(tmp_path.iterdir())) < 2:
        time.sleep(0.01)
    assert isinstance(results, Generator)
    results.close()
    assert not any(alive(int(file.name)) for file in tmp_path.iterdir())
    assert len(list(tmp_path.iterdir())) == 2


def test_pyarrow_misses_no_package_but_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[str] = []

    def look(_values: list[int]) -> None:
        for name in ("pandas", "wave"):
            with suppress(ModuleNotFoundError):
                found.append(find_spec(name).name)  # type: ignore[union-attr]

    for name in ("pandas", "wave"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr("pyarrow.array", look)
    skip_pandas()
    assert found == ["wave"]
    found.clear()
    look([])
    assert found == ["pandas", "wave"]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    "error",
    [
        InputError("what"),
        ItemError("no-ink", "what"),
        IntegrityError("what"),
        HubError("what"),
        MissingExtraError("a plot", "matplotlib", "pictures"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_cross_the_border_of_a_process(error: Exception) -> None:
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), vars(copy)) == (type(error), str(error), vars(error))


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(("finished", "doomed"), [(2, 1), (1, 2), (5, 2)])
def test_no_task_is_lost_when_workers_die_while_their_parent_is_busy(finished: int, doomed: int) -> None:
    results = []
    for result in ProcessRunner(2).run(operator.neg, range(8)):
        results.append(result)
        if len(results) == finished:
            workers = multiprocessing.active_children()[:doomed]
            for worker in workers:
                worker.kill()
            # The parent learns of it when it continues.
            while any(worker.is_alive() for worker in workers):
                time.sleep(0.01)
    assert sorted(results) == [-number for number in reversed(range(8))]


def begins(folder: Path, dies_first: bool) -> None:
    """Die at the first attempt, or wait until the other task has been started twice."""
    begun = folder / str(dies_first)
    with begun.open("a") as stream:
        stream.write("begun\n")
    other = folder / "True"
    if dies_first and len(begun.read_text().split()) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    while not (other.exists() and len(other.read_text().split()) == 2):
        time.sleep(0.01)


@pytest.mark.thorough
def test_a_worker_that_dies_takes_no_other_with_it(tmp_path: Path) -> None:
    assert list(ProcessRunner(2).run(partial(begins, tmp_path), [False, True])) == [None, None]
    assert (tmp_path / "False").read_text().split() == ["begun"]
    assert (tmp_path / "True").read_text().split() == ["begun"] * 2


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray_the_extra_is_named() -> None:
    with pytest.raises(MissingExtraError, match=r"a Ray cluster needs the package 'ray'.*extra `ray`"):
        RayRunner()
