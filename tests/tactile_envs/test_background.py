"""Work in the background ends when the process that started it ends, in any way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tactile_envs.object_sets import start_background
from tactile_toolkit.run.runners import ProcessRunner
from tests.processes import PATIENCE_S, alive, wait_until_gone

REPOSITORY = Path(__file__).resolve().parents[2]

SCRIPT = """
import sys, time
from pathlib import Path
from tactile_envs.object_sets import start_background
from tests.tactile_envs.test_background import note_and_wait
start_background(note_and_wait, sys.argv[1])
while not Path(sys.argv[1]).exists():
    time.sleep(0.01)
print("noted", flush=True)
time.sleep(float(sys.argv[2]))
"""


def note_and_wait(path: str) -> None:
    """Write down the id of this process, and wait."""
    draft = Path(f"{path}.draft")
    draft.write_text(str(os.getpid()))
    draft.replace(path)
    sys.stderr.write("progress\n")
    time.sleep(PATIENCE_S)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("end", [signal.SIGKILL, None, signal.SIGINT])
def test_it_ends_with_the_process_that_started_it(end, tmp_path):
    note, wait_s = tmp_path / "note", 0 if end is None else PATIENCE_S
    starter = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(note), str(wait_s)],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert starter.stdout is not None
    assert starter.stdout.readline() == "noted\n"
    if end is not None:
        starter.send_signal(end)
    _, told = starter.communicate(timeout=PATIENCE_S)
    assert "progress" not in told
    assert "background" not in told
    wait_until_gone([int(note.read_text())])


def test_it_is_not_reached_by_ctrl_c_and_runs_at_low_priority(tmp_path):
    note = tmp_path / "note"
    start_background(note_and_wait, str(note))
    while not note.exists():
        time.sleep(0.01)
    number = int(note.read_text())
    assert os.getsid(number) != os.getsid(0)
    assert os.getpriority(os.PRIO_PROCESS, number) > os.getpriority(os.PRIO_PROCESS, 0)
    os.kill(number, signal.SIGINT)
    assert alive(number)
    os.kill(number, signal.SIGKILL)


def test_its_errors_are_lines(capfd):
    start_background(ProcessRunner, 0)
    told = ""
    while "\n" not in told:
        told += capfd.readouterr().err
        time.sleep(0.01)
    assert told == "in the background: the number of workers is 0; expected at least 1\n"
