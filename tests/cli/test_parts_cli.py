"""Parts of a data set as jobs of an array: real processes, killed, concurrent, and of other versions."""

from __future__ import annotations

import importlib.metadata
import signal
import subprocess
from functools import partial
from pathlib import Path

import pytest

from tests import command_line
from tests.processes import start_held
from tests.tactile_toolkit.toy import folder_bytes

REPOSITORY = Path(__file__).resolve().parents[2]
SCENES = ("generate", "--scenes", "train=3000,test=20", "-w", "1", "--out")


def start(*words: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command_line.program("starstruck", *words),
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    said, talked = process.communicate()
    return process.returncode, said, talked


given = partial(command_line.call, "starstruck")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """Three shards of train, one of test."""
    place = tmp_path_factory.mktemp("whole") / "scenes"
    assert given(*SCENES, place, "-q") == 0
    return folder_bytes(place)


@pytest.mark.thorough
def test_a_killed_part_is_named_given_again_and_nothing_differs(tmp_path, whole, monkeypatch, capfd):
    """An array of four is submitted, one job is killed, and submitted again as part of an array of Slurm."""
    place = tmp_path / "scenes"

    def job(index: int, **array: str) -> int:
        for name, value in {"ID": str(index), **array}.items():
            monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", value)
        return given(*SCENES, place, "--part", "auto", "-q")

    assert [job(index, COUNT="4", MIN="0", MAX="3") for index in (0, 2, 3)] == [0, 0, 0]
    # State after a job was killed: a partial file without a record.
    killed = start_held("starstruck", 1, tmp_path / "marker", *SCENES, place, "--part", "1/4")
    killed.kill()
    killed.communicate()
    (place / ".pending" / "train-00001-of-00003.json").unlink()
    capfd.readouterr()
    assert given(*SCENES, place, "--finish") == 3
    said, talked = capfd.readouterr()
    assert said == "--array=1\n"
    assert "1 of 4 shards" in talked
    assert "part 1 of 4; next: give these (--part auto/4; Slurm: --array=1), then --finish" in talked
    assert job(1, COUNT="1", MIN="1", MAX="1") == 0
    assert given(*SCENES, place, "--finish", "-q") == 0
    assert folder_bytes(place) == whole


@pytest.mark.thorough
def test_messages_about_a_run_that_was_stopped_before_its_first_shard(tmp_path):
    process = start_held("starstruck", 0, tmp_path / "marker", *SCENES, tmp_path / "scenes", "-q")
    process.send_signal(signal.SIGINT)
    _, talked = process.communicate()
    assert process.returncode == 130
    assert talked == b"interrupted; finished parts are kept, and the same command continues from them\n"
    assert not (tmp_path / "scenes").exists()


def test_a_job_with_other_versions_is_refused(tmp_path, monkeypatch, capfd):
    place = tmp_path / "scenes"
    assert given(*SCENES, place, "--part", "3/4", "-q") == 0
    (tmp_path / "other" / "numpy-9.9.dist-info").mkdir(parents=True)
    (tmp_path / "other" / "numpy-9.9.dist-info" / "METADATA").write_text("Name: numpy\nVersion: 9.9\n")
    before = folder_bytes(place)
    here = importlib.metadata.version("numpy")
    monkeypatch.syspath_prepend(tmp_path / "other")
    assert given(*SCENES, place, "--part", "0/4") == 2
    assert f"libraries.numpy is '{here}' there, '9.9' was asked for" in capfd.readouterr().err
    assert folder_bytes(place) == before
