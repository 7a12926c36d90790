"""Pictures of a conversion that is killed at any moment: it continues to the same bytes."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

import realtouch
from tests.forked import run_forked, start_forked
from tests.tactile_toolkit.toy import folder_bytes


def _die(source: str, out: str, moment: int) -> None:
    """Write pictures, and end as by ``kill -9``, without closing, flushing or cleaning up.

    The interpreter informs an audit hook of every file that is opened, renamed or removed, just before it
    happens.
    """
    seen = 0

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal seen
        if event not in ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir"):
            return
        if not str(arguments[0]).startswith(out) or (event == "open" and not arguments[2] & os.O_CREAT):
            return
        seen += 1
        if seen == moment:
            os.kill(os.getpid(), signal.SIGKILL)

    warnings.simplefilter("error")
    sys.addaudithook(watch)
    realtouch.frames(source, out)


def killed(source: Path, out: Path, moment: int) -> bool:
    """Write pictures until the folder is touched for the ``moment``-th time; False if that never happens."""
    process = start_forked(_die, str(source), str(out), moment)
    code = process.end()
    assert code in (0, -signal.SIGKILL), process.err
    return code != 0


@pytest.mark.thorough
def test_killed_again_and_again_it_ends_with_the_same_bytes(single_folder: Path, tmp_path: Path) -> None:
    realtouch.frames(single_folder, tmp_path / "whole")
    again, half = tmp_path / "again", tmp_path / "half"
    for moment in (9, 30, 16):  # each gets further than the one before: to the manifest, a shard, a record
        assert killed(single_folder, again, moment)
    moment = 10
    while not list(half.glob(".pending/tmp-*")):  # a picture of which a part was written
        assert killed(single_folder, half, moment)
        moment += 1
    for out in (again, half):
        realtouch.frames(single_folder, out)
        assert not list(out.glob(".pending/tmp-*"))
        assert folder_bytes(out) == folder_bytes(tmp_path / "whole")


def test_pictures_that_cannot_be_written_leave_no_trace(single_folder: Path, tmp_path: Path) -> None:
    """A run that fails before its first shard is finished removes its pictures."""
    code = (
        "import resource, signal, sys, realtouch\n"
        "from tactile_toolkit.errors import StorageError\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (6_000, resource.RLIM_INFINITY))\n"
        "try:\n"
        "    realtouch.frames(sys.argv[1], sys.argv[2], 'png')\n"
        "except StorageError as error:\n"
        "    print(error)\n"
    )
    out = tmp_path / "out"
    assert "cannot write" in run_forked(code, single_folder, out)
    assert not out.exists()
