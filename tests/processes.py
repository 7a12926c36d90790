"""Processes that tests start, hold and kill, and their state in the system (Linux)."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from contextlib import suppress
from pathlib import Path

PATIENCE_S = 3_600
"""Time to wait for expected events: no test may fail because the machine is busy."""

_HELD = """
import importlib, sys, time
from pathlib import Path
from cli import runs
name, shards, marker = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
make_with_progress = runs.make_with_progress

def held(sink, what, nouns, make, *others):
    finished = []
    def stand_still(on_progress, **options):
        def hold(progress):
            on_progress(progress)
            finished.extend([progress] * (progress.record is not None))
            if len(finished) == shards:
                marker.touch()
                while not marker.with_name(f"{marker.name}.go").exists():
                    time.sleep(0.05)
        return make(on_progress=hold, **options)
    return make_with_progress(sink, what, nouns, stand_still, *others)

runs.make_with_progress = held
sys.argv = [name, *sys.argv[4:]]
importlib.import_module(f"cli.{name}").main()
"""


def printed_by(code: str, *words: object, **environment: str) -> str:
    """Run code in an interpreter of its own, at the root of the repository; return what it printed.

    Its stderr is shown if it ends with an error.
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, words)],
        cwd=Path(__file__).parents[1],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def start_held(command_line: str, shards: int, marker: Path, *words: object) -> subprocess.Popen[bytes]:
    """Start a command that makes data and pauses after a number of shards; wait until it pauses.

    With 0 shards, it pauses before the first. It continues when there is a file of the marker's name with
    ``.go`` behind it.
    """
    program = [sys.executable, "-c", _HELD, command_line, str(shards), str(marker), *map(str, words)]
    process = subprocess.Popen(program, cwd=Path(__file__).parents[1], stderr=subprocess.PIPE)
    while not marker.exists():
        assert process.poll() is None, process.communicate()[1].decode()
        time.sleep(0.01)
    return process


def children(pid: int) -> list[int]:
    """List the children of a process."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def alive(pid: int) -> bool:
    """Return whether a process is running; zombies are not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until_gone(processes: list[int]) -> None:
    """Wait until processes have ended by themselves, as they must soon after their parent was killed."""
    deadline_s = time.monotonic() + 60
    while any(alive(pid) for pid in processes) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not [pid for pid in processes if alive(pid)]


def records_so_far(folder: Path) -> list[str]:
    """Return the names of the records of finished shards of an unfinished set.

    ``Path.glob`` would fail if their folder is removed meanwhile, as it may be while a set is made.
    """
    with suppress(FileNotFoundError):
        return [path.name for path in (folder / ".pending").iterdir() if path.suffix == ".json"]
    return []
