"""Compiled kernels: when they are compiled again, and by which of several processes."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

_CALLEE = """
from typing import NamedTuple
from tactile_toolkit.kernels import compiled

class Shift{added}(NamedTuple):
    x: int

SHIFT = Shift{added}(1)

@compiled
def moved(shift):
    return shift.x

@compiled
def part(x):
    return x + {added}
"""
_CALLER = """
from tactile_toolkit import kernels
from made_up_kernels import callee as parts

@kernels.compiled("(int64,)")
def first(x):
    return parts.part(x) * 2

@kernels.compiled("(int64,)")
def second(x):
    return x - 1
"""

pytestmark = pytest.mark.thorough  # each interpreter compiles what it calls


def write_kernels(folder: Path, added: int) -> None:
    package = folder / "made_up_kernels"
    package.mkdir(exist_ok=True)
    (package / "__init__.py").touch()
    (package / "callee.py").write_text(_CALLEE.format(added=added))
    (package / "caller.py").write_text(_CALLER)


def start(folder: Path, code: str, **extra: str) -> subprocess.Popen[str]:
    variables = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    variables["PYTHONPATH"] = os.pathsep.join([str(folder), *sys.path])
    variables["TACTILE_TOOLKIT_CACHE"] = str(folder / "cache")
    command = [sys.executable, "-B", "-c", textwrap.dedent(code)]
    pipes = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE if "TACTILE_TOOLKIT_QUIET" in extra else None,
    }
    return subprocess.Popen(command, env=variables | extra, text=True, **pipes)  # type: ignore[call-overload, no-any-return]


def printed(folder: Path, code: str, **extra: str) -> str:
    with start(folder, code, **extra) as process:
        text, _ = process.communicate()
    assert process.returncode == 0
    return text.strip()


def test_a_kernel_is_compiled_again_when_a_file_behind_it_changes(tmp_path: Path) -> None:
    code = """
        from made_up_kernels import callee, caller
        print(caller.first(3), callee.moved(callee.SHIFT))
        """
    write_kernels(tmp_path, 1)
    assert printed(tmp_path, code) == "8 1"
    # The cached kernel refers to a class that no longer exists.
    write_kernels(tmp_path, 5)
    assert printed(tmp_path, code) == "16 1"


@pytest.fixture
def first_is_busy(tmp_path: Path) -> Iterator[Path]:
    """A folder of kernels, while another process compiles the first of them."""
    write_kernels(tmp_path, 1)
    held = """
        import time
        from tactile_toolkit import cache, store
        (cache.cache_folder() / cache.LOCKS).mkdir(parents=True)
        with store.locked(cache.cache_folder() / cache.LOCKS / "made_up_kernels.caller.first"):
            print("held", flush=True)
            time.sleep(600)
        """
    with start(tmp_path, held) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline().strip() == "held"
            yield tmp_path
        finally:
            other.kill()


def test_a_kernel_with_types_that_another_process_compiles_is_left_to_it(first_is_busy: Path) -> None:
    code = """
        from tactile_toolkit import kernels
        kernels.prepare("made_up_kernels.caller")
        from made_up_kernels import caller
        print(len(caller.first.signatures), caller.second.signatures)
        """
    begun_s = time.monotonic()
    assert printed(first_is_busy, code) == "0 [(int64,)]"
    assert time.monotonic() - begun_s < 60  # the time that a process waits for a lock


def test_kernels_with_types_are_ready_and_are_those_of_the_first_call(tmp_path: Path) -> None:
    write_kernels(tmp_path, 1)
    code = """
        from tactile_toolkit import kernels
        kernels.prepare("made_up_kernels.caller")
        from made_up_kernels import caller
        print(caller.first.signatures, caller.first(3), len(caller.first.signatures))
        """
    assert printed(tmp_path, code) == "[(int64,)] 8 1"
    called = (
        "from made_up_kernels.caller import second; print(second(3), sum(second.stats.cache_hits.values()))"
    )
    assert printed(tmp_path, called) == "2 1"


_SLOW = """
import time
from numba import extending
from tactile_toolkit import kernels

def pause():
    return None

@extending.overload(pause)
def pause_compiled():
    time.sleep(1.2)  # while it is compiled
    return lambda: None

@kernels.compiled
def first(x):
    pause()
    return x

@kernels.compiled
def second(x):
    pause()
    return x
"""


@pytest.mark.parametrize(("quiet", "notes"), [("", 1), ("1", 0)])
def test_what_takes_so_long_is_said_once(tmp_path: Path, quiet: str, notes: int) -> None:
    write_kernels(tmp_path, 1)
    (tmp_path / "made_up_kernels" / "slow.py").write_text(_SLOW)
    code = "from made_up_kernels import slow; slow.first(1); slow.second(1)"
    for expected in (notes, 0):
        processes = [start(tmp_path, code, TACTILE_TOOLKIT_QUIET=quiet) for _ in range(2)]
        lines = "".join(process.communicate()[1] for process in processes).splitlines()
        assert [line[:28] for line in lines] == ["note: functions are compiled"] * expected


def test_users_take_what_an_administrator_has_compiled(tmp_path: Path) -> None:
    write_kernels(tmp_path, 1)
    (tmp_path / "home").mkdir()
    shared = tmp_path / "shared"
    code = """
        import os, tempfile
        def try_folder(dir, check=tempfile.TemporaryFile):
            if {is_user} and not dir.startswith(os.environ["XDG_CACHE_HOME"]):
                raise PermissionError
            return check(dir=dir)
        tempfile.TemporaryFile = try_folder  # by which numba learns whether it can write
        from made_up_kernels import callee, caller
        print(caller.first(3), sum(caller.first.stats.cache_hits.values()))
        """
    folders = {"NUMBA_CACHE_DIR": str(shared), "XDG_CACHE_HOME": str(tmp_path / "home")}
    assert printed(tmp_path, code.format(is_user=False), **folders) == "8 0"
    assert printed(tmp_path, code.format(is_user=True), **folders) == "8 1"
    write_kernels(tmp_path, 5)  # another version
    assert printed(tmp_path, code.format(is_user=True), **folders) == "16 0"
