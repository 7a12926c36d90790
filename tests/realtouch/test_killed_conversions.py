"""Conversions that are killed at any moment, and go on to the same bytes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import realtouch
from tactile_toolkit.errors import InputError
from tests.processes import children, printed_by, wait_until_gone
from tests.tactile_toolkit.toy import folder_bytes

REPOSITORY = Path(__file__).resolve().parents[2]

CONVERSIONS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "to-single": ("to_single", "seq", {"frame": "peak"}),
    "resize": ("resize", "seq", {"width": 48, "height": 36}),
    "frames": ("frames", "single", {"kind": "png"}),
    "select": ("select", "single", {"contact": True}),
}

# The interpreter tells an audit hook of every file that is opened, renamed or removed, just before it
# happens: the process ends itself there as `kill -9` would, with nothing closed, flushed or tidied up.
DIES_AT = """
import os, signal, sys
import realtouch
name, source, out = sys.argv[1:4]
options, moment, seen = eval(sys.argv[4]), int(sys.argv[5]), 0
def watch(event, arguments):
    global seen
    if event not in ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir"):
        return
    if not str(arguments[0]).startswith(out) or (event == "open" and not arguments[2] & os.O_CREAT):
        return
    seen += 1
    if seen == moment:
        os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(watch)
getattr(realtouch, name)(source, out, **options)
"""


def convert(name: str, source: Path, out: Path, **more: Any) -> None:
    call, _, options = CONVERSIONS[name]
    getattr(realtouch, call)(str(source), str(out), **options, **more)


def killed(name: str, source: Path, out: Path, moment: int) -> bool:
    """Run a conversion that dies when it touches the folder the ``moment``-th time; False if it ended."""
    call, _, options = CONVERSIONS[name]
    command = [sys.executable, "-W", "error", "-c", DIES_AT]
    command += [call, str(source), str(out), repr(options), str(moment)]
    code = subprocess.run(command, cwd=REPOSITORY, check=False).returncode
    assert code in (0, -signal.SIGKILL)
    return code != 0


def temporaries(folder: Path) -> list[Path]:
    return list(folder.rglob(".writing-*"))


@pytest.fixture(scope="module")
def undisturbed(
    seq_folder: Path, single_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, dict[str, bytes]]:
    folder = tmp_path_factory.mktemp("undisturbed")
    for name, (_, kind, _) in CONVERSIONS.items():
        convert(name, seq_folder if kind == "seq" else single_folder, folder / name)
    return {name: folder_bytes(folder / name) for name in CONVERSIONS}


@pytest.mark.parametrize("name", CONVERSIONS)
def test_killed_again_and_again_it_ends_with_the_same_bytes(
    name: str,
    undisturbed: dict[str, dict[str, bytes]],
    seq_folder: Path,
    single_folder: Path,
    tmp_path: Path,
) -> None:
    source = seq_folder if CONVERSIONS[name][1] == "seq" else single_folder
    out = tmp_path / "out"
    # Each life goes a little further than the one before it: into the manifest, a shard, a record.
    moments = (9, 30, 16) if name == "frames" else (9, 16)
    assert killed(name, source, out, moments[0])
    assert out.is_dir()
    for moment in moments[1:]:
        killed(name, source, out, moment)
    convert(name, source, out)
    assert temporaries(out) == []
    assert folder_bytes(out) == undisturbed[name]
    assert realtouch.verify(str(out)).ok


def test_half_written_pictures_are_removed(
    single_folder: Path, undisturbed: dict[str, dict[str, bytes]], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    moment = 10
    while not [file for file in temporaries(out) if "images" in file.parts]:
        assert killed("frames", single_folder, out, moment)
        moment += 1
    convert("frames", single_folder, out)
    assert temporaries(out) == []
    assert folder_bytes(out) == undisturbed["frames"]


def test_killed_with_its_workers_at_work(
    seq_folder: Path, undisturbed: dict[str, dict[str, bytes]], tmp_path: Path
) -> None:
    """The parent is killed from outside; its workers leave by themselves and write nothing more."""
    out = tmp_path / "out"
    code = "import sys, realtouch; realtouch.resize(sys.argv[1], sys.argv[2], 48, 36, workers=2)"
    process = subprocess.Popen([sys.executable, "-c", code, str(seq_folder), str(out)], cwd=REPOSITORY)
    deadline_s = time.monotonic() + 120
    while not list(out.glob(".pending/*.json")) and process.poll() is None:
        assert time.monotonic() < deadline_s
        time.sleep(0.002)
    workers = children(process.pid)
    process.kill()
    process.wait()
    wait_until_gone(workers)
    convert("resize", seq_folder, out)
    assert temporaries(out) == []
    assert folder_bytes(out) == undisturbed["resize"]


def test_pictures_of_somebody_else_are_never_removed(single_folder: Path, tmp_path: Path) -> None:
    """--overwrite starts a folder of ours again; one that holds other things is left alone."""
    holiday = tmp_path / "images" / "2019" / "beach" / "001.png"
    holiday.parent.mkdir(parents=True)
    holiday.write_bytes(b"sand")
    (tmp_path / "index.csv").write_text("mine")
    before = folder_bytes(tmp_path)
    with pytest.raises(InputError, match="not empty and holds no manifest"):
        realtouch.frames(str(single_folder), str(tmp_path), overwrite=True)
    assert folder_bytes(tmp_path) == before


def test_pictures_that_cannot_be_written_leave_no_trace(single_folder: Path, tmp_path: Path) -> None:
    """A run that fails before its first shard is finished takes its pictures with it."""
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
    assert "cannot write" in printed_by(code, single_folder, out)
    assert not out.exists()
