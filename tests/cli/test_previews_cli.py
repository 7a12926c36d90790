"""``tactile preview`` of data sets of three kinds and of files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tactile_toolkit.mesh import Mesh, write_mesh
from tests.command_line import call
from tests.realtouch import factories


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = factories.seq_rows([factories.make_round(index, 3, (64, 48)) for index in range(2)])
    return factories.write_set(tmp_path_factory.mktemp("clips"), {"train": rows}, "seq")


@pytest.mark.thorough
def test_pictures_are_those_of_the_dry_run(
    digits_set: Path, scenes_set: Path, clips: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, names in (
        ((digits_set, "--draw", "sheet", "--split", "test"), ["digits-test-sheet.png"]),
        ((scenes_set, "--ids", "0,5", "--split", "train"), ["scenes-train-sheet.png"]),
        ((clips, "--draw", "grid"), [f"{clips.name}-train-round-0-grid.png"]),
    ):
        assert call("tactile", "preview", *arguments, "--dry-run", "--json") == 0
        document = json.loads(capsys.readouterr().out)
        assert [picture["file"] for picture in document["pictures"]] == names
        assert document["folder"] == "previews"
        assert call("tactile", "preview", *arguments, "--dry-run") == 0
        assert "would write" in capsys.readouterr().out
        assert not (tmp_path / "previews" / names[0]).exists()
        assert call("tactile", "preview", *arguments) == 0
        assert f"previews/{names[0]}: " in capsys.readouterr().out
        assert (tmp_path / "previews" / names[0]).read_bytes().startswith(b"\x89PNG")
    assert len(list((tmp_path / "previews").iterdir())) == 3


@pytest.mark.thorough
def test_one_picture_goes_into_the_file_that_is_named(
    scenes_set: Path, clips: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    corners = np.array([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], np.int32)
    write_mesh(tmp_path / "part.stl", Mesh(corners, faces))
    assert call("tactile", "preview", "part.stl", "--out", "a.png", "--json") == 0
    (picture,) = json.loads(capsys.readouterr().out)["pictures"]
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (picture["width"], picture["height"])
    assert (picture["file"], picture["bytes"]) == ("a.png", (tmp_path / "a.png").stat().st_size)
    assert call("tactile", "preview", scenes_set, "--ids", 3, "--out", "b.png", "--quiet") == 0
    assert capsys.readouterr().out == ""
    assert call("tactile", "preview", clips) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"part.stl", "a.png", "b.png", "touches.png"}
    assert call("tactile", "preview", clips, "--draw", "all", "--out", "c.png") == 2
    assert "2 pictures; next: give a folder" in capsys.readouterr().err
