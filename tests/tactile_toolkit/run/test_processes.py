"""Workers: the caller's script is left alone, and a task's own exception is nobody else's business."""

from __future__ import annotations

import errno
import multiprocessing.synchronize
import operator
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tactile_toolkit.errors import HubError, InputError, IntegrityError, ItemError, MissingExtraError
from tactile_toolkit.run.processes import ProcessRunner
from tests.command_line import call
from tests.processes import printed_by

REPOSITORY = Path(__file__).resolve().parents[3]

UNGUARDED = """
print("started")
import math
from tactile_toolkit.run.processes import ProcessRunner
print(sorted(ProcessRunner(2).run(math.sqrt, [1.0, 4.0, 9.0])))
"""


def test_a_script_without_a_guard_runs_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    for command in ([str(script)], ["-c", UNGUARDED]):
        done = subprocess.run(
            [sys.executable, *command], cwd=REPOSITORY, capture_output=True, text=True, check=False
        )
        assert done.stdout == "started\n[1.0, 2.0, 3.0]\n", done.stderr


def fails(path: str) -> None:
    with Path(path).open("a") as stream:
        stream.write("tried\n")
    message = "of the task"
    raise ZeroDivisionError(message)


def test_an_exception_of_a_task_is_raised_as_it_is_and_not_retried(tmp_path: Path) -> None:
    tries = tmp_path / "tries"
    with pytest.raises(ZeroDivisionError, match="of the task"):
        list(ProcessRunner(2).run(fails, [str(tries)]))
    assert tries.read_text() == "tried\n"


def test_a_system_without_shared_memory_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("_multiprocessing.SemLock", refuse)
    command = ("generate", "--split", "train", "--scenes", "2", "--out", tmp_path / "out", "--workers")
    assert call("starstruck", *command, 2) == 2
    shown = " ".join(capsys.readouterr().err.split())
    assert "error: worker processes need shared memory" in shown
    assert "Read-only file system; next: make it writable, or run the same command with --workers 1" in shown
    assert not (tmp_path / "out" / "manifest.json").exists()
    assert call("starstruck", *command, 1) == 0


def test_workers_and_command_lines_do_without_pandas() -> None:
    code = """
import sys
from tactile_toolkit.run.limits import skip_pandas
skip_pandas()
import pyarrow as pa
pa.array([1, 2]), pa.Table.from_pylist([{"x": "a"}])
assert "pandas" not in sys.modules
import pandas  # whoever wants it has it
"""
    printed_by(code)


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


@pytest.mark.parametrize("finished", [1, 2, 5])
def test_no_task_is_lost_when_a_worker_dies_while_its_parent_is_busy(finished: int) -> None:
    results = []
    for result in ProcessRunner(2).run(operator.neg, range(8)):
        results.append(result)
        if len(results) == finished:
            workers = multiprocessing.active_children()
            workers[0].kill()
            # With one of them all go; the parent learns of it when it goes on.
            while any(worker.is_alive() for worker in workers):
                time.sleep(0.01)
    assert sorted(results) == [-number for number in reversed(range(8))]
