"""Conversions that are killed at any moment, and continue to the same bytes."""

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

CONVERSIONS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "to-single": ("clips_to_images", "seq", {"frame": "peak"}),
    "resize": ("resize", "seq", {"width": 48, "height": 36}),
    "frames": ("frames", "single", {"kind": "png"}),
    "select": ("select", "single", {"contact": True}),
}


def convert(name: str, source: Path, out: Path, **more: Any) -> None:
    call, _, options = CONVERSIONS[name]
    getattr(realtouch, call)(str(source), str(out), **options, **more)


def _die(call: str, source: str, out: str, options: dict[str, Any], moment: int) -> None:
    """Convert, and end as by ``kill -9``, without closing, flushing or cleaning up.

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
    getattr(realtouch, call)(source, out, **options)


def killed(name: str, source: Path, out: Path, moment: int) -> bool:
    """Run a conversion that dies when it touches the folder the ``moment``-th time; False if it ended."""
    call, _, options = CONVERSIONS[name]
    process = start_forked(_die, call, str(source), str(out), options, moment)
    code = process.end()
    assert code in (0, -signal.SIGKILL), process.err
    return code != 0


def temporaries(folder: Path) -> list[Path]:
    return list(folder.glob(".pending/tmp-*"))


@pytest.fixture(scope="module")
def undisturbed(
    seq_folder: Path, single_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, dict[str, bytes]]:
    folder = tmp_path_factory.mktemp("undisturbed")
    for name, (_, kind, _) in CONVERSIONS.items():
        convert(name, seq_folder if kind == "seq" else single_folder, folder / name)
    return {name: folder_bytes(folder / name) for name in CONVERSIONS}


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", CONVERSIONS)
def test_killed_again_and_again_it_ends_with_the_same_bytes(
    name: str, undisturbed: dict[str, dict[str, bytes]], seq_folder: Path, single_folder: Path, tmp_path: Path
) -> None:
    source = seq_folder if CONVERSIONS[name][1] == "seq" else single_folder
    out = tmp_path / "out"
    # Each process gets a little further than the one before: to the manifest, a shard, a record.
    moments = (9, 30, 16) if name == "frames" else (9, 16)
    assert killed(name, source, out, moments[0])
    assert out.is_dir()
    for moment in moments[1:]:
        killed(name, source, out, moment)
    convert(name, source, out)
    assert temporaries(out) == []
    assert folder_bytes(out) == undisturbed[name]
    assert realtouch.verify(str(out)).ok


@pytest.mark.thorough
def test_half_written_pictures_are_removed(single_folder, undisturbed, tmp_path):
    out = tmp_path / "out"
    moment = 10
    while not temporaries(out):
        assert killed("frames", single_folder, out, moment)
        moment += 1
    convert("frames", single_folder, out)
    assert temporaries(out) == []
    assert folder_bytes(out) == undisturbed["frames"]


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
