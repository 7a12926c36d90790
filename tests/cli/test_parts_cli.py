"""Parts of a data set as jobs of an array, of which one has other versions of libraries."""

from __future__ import annotations

import importlib.metadata

from tests.command_line import call
from tests.tactile_toolkit.toy import folder_bytes

SCENES = ("generate", "--scenes", "train=3000,test=20", "-w", "1", "--out")


def test_a_job_with_other_versions_is_refused(tmp_path, monkeypatch, capfd):
    place = tmp_path / "scenes"
    assert call("starstruck", *SCENES, place, "--part", "3/4", "-q") == 0
    (tmp_path / "other" / "numpy-9.9.dist-info").mkdir(parents=True)
    (tmp_path / "other" / "numpy-9.9.dist-info" / "METADATA").write_text("Name: numpy\nVersion: 9.9\n")
    before = folder_bytes(place)
    here = importlib.metadata.version("numpy")
    monkeypatch.syspath_prepend(tmp_path / "other")
    assert call("starstruck", *SCENES, place, "--part", "0/4") == 2
    assert f"libraries.numpy is '{here}' there, '9.9' was asked for" in capfd.readouterr().err
    assert folder_bytes(place) == before
