"""Data sets of drawings: letters, words, pictures by a child."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mnist3d
from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.sources import FolderSource, SyntheticSource
from tactile_toolkit.mesh import Mesh, check_manifold
from tests.command_line import call, program
from tests.mnist3d.drawn_pictures import child, photographed, word


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("words")
    for name, draw in (("li", word), ("house", child), ("10", lambda: word(40))):
        for number in range(5):
            (folder / name).mkdir(exist_ok=True)
            draw().reduce(2).save(folder / name / f"p{number}.png")
    photographed(word()).save(folder / "li" / "photo.jpg")
    return folder


def test_folders_are_classes_and_divide_into_train_and_test(words: Path, tmp_path: Path, capsys: Any) -> None:
    catalog = FolderSource(str(words)).catalog()
    assert catalog.class_names == ("10", "house", "li")
    assert np.bincount(catalog.labels).tolist() == [5, 5, 6]
    out = tmp_path / "set"
    options = ("--source", "folder", "--images", words, "--split", "all", "--vertices", 2_000, "--out", out)
    assert call("mnist3d", "generate", *options) == 0
    printed = capsys.readouterr().out
    assert "10: 4, house: 4, li: 5" in printed
    assert "separate-bodies: 13" in printed
    assert "separate-bodies: join the parts (`tactile export --half-on-base-mm 2`)" in printed
    assert mnist3d.load(out, "train").label_names == ("10", "house", "li")
    rows = [row for split in ("train", "test") for row in mnist3d.load(out, split)]
    assert [len(mnist3d.load(out, split)) for split in ("train", "test")] == [13, 3]
    assert {row.file for row in rows} == {path.relative_to(words).as_posix() for path in words.rglob("*.*")}
    assert all(row.file.startswith(f"{catalog.class_names[row.label]}/") for row in rows)
    # The dots of the letters are kept.
    assert {check_manifold(Mesh.of(row)).bodies for row in rows if row.label == 2} == {5}
    for name, command in (("tactile", "verify"), ("mnist3d", "validate"), ("tactile", "card")):
        assert call(name, command, out) == 0
    card = (out / "README.md").read_text(encoding="utf-8")
    assert "four fifths" in card
    assert "handwritten digits" not in card
    capsys.readouterr()
    assert call("mnist3d", "generate", *options[:4], "--split", "printed_train", "--out", out) == 2
    assert "expected train, test or all" in capsys.readouterr().err


def test_folders_of_digits_stay_digits(tmp_path: Path) -> None:
    for label in "17":
        (tmp_path / "mine" / label).mkdir(parents=True)
        Image.fromarray(SyntheticSource().image(0).pixels).save(tmp_path / "mine" / label / "a.png")
    source = FolderSource(str(tmp_path / "mine"))
    assert source.catalog().class_names == tuple("0123456789")
    assert source.catalog().labels.tolist() == [1, 7]
    assert "classes" not in source.fingerprint()
    generate(DigitSetSpec(source, mnist3d.SolidSpec(target_vertices=2_000)), str(tmp_path / "set"))
    digits = mnist3d.load(tmp_path / "set", "train")
    assert sorted(row.file or "" for row in digits) == ["1/a.png", "7/a.png"]


def test_other_sources_store_no_names_of_files(tmp_path: Path) -> None:
    spec = DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=2_000), limit=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    (digit,) = mnist3d.load(tmp_path / "set", "test")
    assert digit.file is None
    assert "name: file" not in (tmp_path / "set" / "README.md").read_text(encoding="utf-8")


def test_pictures_that_are_added_need_another_command_which_works(words, tmp_path, capsys):
    old, new = tmp_path / "old", tmp_path / "new"
    for folder in (old, new):
        for name in ("10", "house", "li"):
            (folder / name).mkdir(parents=True)
    word().save(old / "li" / "a.png")
    word(30).save(new / "li" / "b.png")

    def make(folder: Path) -> int:
        out = tmp_path / f"{folder.name}-set"
        options = ("--source", "folder", "--images", folder, "--vertices", 2_000, "--out", out)
        return call("mnist3d", "generate", *options)

    assert (make(old), make(new), make(old)) == (0, 0, 0)
    word(30).save(old / "li" / "b.png")
    capsys.readouterr()
    assert make(old) == 2
    assert "next: to add pictures" in (printed := capsys.readouterr().err)
    assert "tactile merge OLD NEW --out BOTH" in printed
    sets = (tmp_path / "old-set", tmp_path / "new-set")
    both = tmp_path / "both"
    assert call("tactile", "merge", *sets, "--out", both) == 0
    assert [row.file for row in mnist3d.load(both, "train")] == ["li/a.png", "li/b.png"]


def test_select_writes_the_chosen_rows_only(tmp_path: Path, capsys: Any) -> None:
    spec = DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=2_000), per_class=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    out = tmp_path / "some"
    assert call("tactile", "select", tmp_path / "set", "--labels", "3,5", "--out", out) == 0
    whole, some = mnist3d.load(tmp_path / "set", "test"), mnist3d.load(out, "test")
    chosen = [row for row in whole if row.label in (3, 5)]
    assert [row.id for row in some] == [row.id for row in chosen]
    assert all(np.array_equal(a.vertices_m, b.vertices_m) for a, b in zip(some, chosen, strict=True))
    assert call("tactile", "verify", out) == 0
    assert call("tactile", "select", tmp_path / "set", "--out", tmp_path / "no") == 2
    assert "expected filters such as --ids" in capsys.readouterr().err


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("setting", [("HF_HUB_OFFLINE", "1"), ("HF_ENDPOINT", "http://127.0.0.1:9")])
def test_a_dry_upload_needs_no_network(setting: tuple[str, str], tmp_path: Path, capsys: Any) -> None:
    spec = DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=2_000), limit=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    # The client reads its settings on import.
    command = program("tactile", "upload", tmp_path / "set", "YOU/digits", "--dry-run", "--json")
    settings = {**os.environ, "HF_HOME": str(tmp_path / "hf"), "HF_TOKEN": "", setting[0]: setting[1]}
    done = subprocess.run(command, env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["exists"] is None
    assert {"README.md", "manifest.json"} < set(document["to_send"])
    assert document["bytes_to_send"] == document["bytes"] > 10_000
    assert "note: no connection to the Hub" in done.stderr
    # A damaged folder is named before any request to the Hub.
    (tmp_path / "set" / "README.md").write_text("no card", encoding="utf-8")
    assert call("tactile", "upload", tmp_path / "set", "YOU/digits", "--dry-run") == 3
    assert "README.md" in capsys.readouterr().err
