from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mnist3d
from tests import command_line

SMALL = ("--split", "test", "--per-class", "1", "--vertices", "2000", "--workers", "1")


call = command_line.call


def test_generate_ends_with_a_summary_and_a_next_step_or_with_one_document(tmp_path, capsys):
    out = tmp_path / "digits"
    assert call("mnist3d", "generate", *SMALL, "--out", out) == 0
    printed = capsys.readouterr()
    assert "test" in printed.out
    assert "made 10 digits" in printed.out
    assert str(out) in printed.out
    assert "next: tactile verify" in printed.out
    assert "making digits: 10 of 10" in printed.err
    assert call("mnist3d", "generate", *SMALL, "--out", out, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    (split,) = document["splits"]
    assert (split["split"], split["rows"]) == ("test", 10)
    assert split["label"] == {str(digit): 1 for digit in range(10)}
    assert document["complete"] is True
    assert document["spec"]["solid"]["target_vertices"] == 2000


def test_info(digits_set, capsys):
    assert call("tactile", "info", digits_set) == 0
    assert "solid.target_vertices = 2000" in capsys.readouterr().out
    assert call("tactile", "info", digits_set, "--json") == 0
    assert json.loads(capsys.readouterr().out)["splits"][0]["rows"] == 10


def test_validate_a_folder(digits_set, capsys):
    assert call("mnist3d", "validate", digits_set, "--split", "test") == 0
    assert "10 of 10 meshes are valid" in capsys.readouterr().out
    assert call("mnist3d", "validate", digits_set, "--split", "test", "--limit", 3, "--json") == 0
    (document,) = json.loads(capsys.readouterr().out)
    assert (document["checked"], document["failed"]) == (3, 0)
    assert len(document["meshes"]) == 3
    assert document["meshes"][0]["status"] == "NoError"


@pytest.mark.parametrize("kind", ["stl", "glb"])
def test_validate_files_of_anyone(tmp_path, capsys, kind):
    import trimesh

    good, bad = tmp_path / f"good.{kind}", tmp_path / f"open.{kind}"
    scale = 0.001 if kind == "glb" else 1.0  # glTF is in metres
    box = trimesh.creation.box((30 * scale, 20 * scale, 10 * scale))
    box.export(good)
    box.update_faces(np.arange(len(box.faces)) > 0)
    box.export(bad)
    assert call("mnist3d", "validate", good) == 0
    # glTF has y up (section 3.4): its 20 mm stand, and its 10 mm lie.
    size = "30.0 x 10.0 x 20.0" if kind == "glb" else "30.0 x 20.0 x 10.0"
    assert size in capsys.readouterr().out
    assert call("mnist3d", "validate", good, bad) == 1
    printed = capsys.readouterr().out
    assert "1 of 2 meshes are valid" in printed
    assert call("mnist3d", "validate", bad, "--json") == 1
    (document,) = json.loads(capsys.readouterr().out)
    assert document["meshes"][0]["name"] == bad.name
    assert document["meshes"][0]["is_solid"] is False
    assert document["meshes"][0]["thinnest_wall_mm"] is None


@pytest.mark.thorough
def test_real_pictures_in_a_folder(shared, tmp_path, capsys):
    arguments = ("mnist3d", "generate", "--source", "folder", "--images", shared / "digits" / "png", *SMALL)
    assert call(*arguments, "--out", tmp_path / "digits") == 0
    digits = mnist3d.load(str(tmp_path / "digits"), "test")
    assert np.bincount(digits.labels).tolist() == [1] * 10
    assert set(digits.writers.tolist()) <= {1, 2, 4, 5, 6}


@pytest.mark.thorough
def test_real_mnist(shared, tmp_path):
    arguments = ("mnist3d", "generate", "--source", "mnist", "--images", shared / "mnist", *SMALL)
    assert call(*arguments, "--out", tmp_path / "digits", "--quiet") == 0
    assert len(mnist3d.load(str(tmp_path / "digits"), "test")) == 10


def test_the_next_step_names_a_split_that_has_rows(tmp_path, capsys):
    options = ("--split-sizes", "train=0,test=1", "--vertices", "2000", "--workers", "1")
    assert call("mnist3d", "generate", *options, "--limit", 1, "--out", tmp_path / "set") == 0
    assert 'split="test"' in capsys.readouterr().out


def pictures(folder: Path, *greys: int) -> Path:
    """Pages for label 3: a stroke if the grey level is 0, otherwise a single grey level."""
    (folder / "3").mkdir(parents=True)
    for number, grey in enumerate(greys):
        page = np.full((120, 120), grey or 255, np.uint8)
        page[30:90, 50:70] = grey
        Image.fromarray(page).save(folder / "3" / f"{number}.png")
    return folder


def test_generate_counts_the_digits_made(tmp_path, capsys):
    source = ("--source", "folder", "--images", pictures(tmp_path / "some", 0, 255, 0), "--vertices", 2000)
    sizes = ("--split", "test", "--split-sizes", "test=3", "--workers", 1)
    assert call("mnist3d", "generate", *source, *sizes, "--out", tmp_path / "set") == 0
    assert "made 2 digits in" in capsys.readouterr().out
    assert json.loads((tmp_path / "set" / "manifest.json").read_text())["skipped"] == {"no-ink": 1}
    assert call("mnist3d", "generate", *source, *sizes, "--out", tmp_path / "set") == 0
    assert "nothing was left to make" in capsys.readouterr().out


@pytest.fixture(scope="module")
def own_pictures(tmp_path_factory) -> Path:
    """Six strokes of one class, five of another."""
    root = tmp_path_factory.mktemp("pictures") / "mine"
    for label, count in {1: 6, 7: 5}.items():
        (root / str(label)).mkdir(parents=True)
        for number in range(count):
            picture = np.full((120, 120), 255, np.uint8)
            picture[20:100, 40 + 2 * number : 60 + 2 * number] = 0
            Image.fromarray(picture).save(root / str(label) / f"{number}.png")
    return root


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("asked", "rows"),
    [
        ((), {"train": 11}),
        (("--per-class", 2), {"train": 4}),
        (("--split-by", "none", "--split", "train"), {"train": 11}),
        (("--split-sizes", "train=2,test=1"), {"train": 4, "test": 2}),
        (("--split", "all", "--limit", 1), {"train": 1, "test": 1}),
        (("--split", "test"), {"test": 2}),
    ],
    ids=str,
)
def test_pictures_of_ones_own_are_divided_where_that_is_asked_for(
    own_pictures, tmp_path, capsys, asked, rows
):
    source = ("--source", "folder", "--images", own_pictures, "--vertices", 2000, "--workers", 1)
    assert call("mnist3d", "generate", *source, "--dry-run", "--json", "--out", tmp_path / "set", *asked) == 0
    splits = json.loads(capsys.readouterr().out)["splits"]
    assert {each["split"]: each["rows"] for each in splits} == rows
