"""Parts of a data set as jobs of an array: real processes, killed, concurrent, and of other versions."""

from __future__ import annotations

import importlib.metadata
from functools import partial
from pathlib import Path

from tests import command_line
from tests.tactile_toolkit.toy import folder_bytes

REPOSITORY = Path(__file__).resolve().parents[2]
SCENES = ("generate", "--scenes", "train=3000,test=20", "-w", "1", "--out")


given = partial(command_line.call, "starstruck")


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
