"""Folders of images without a table, which are classes or splits or neither; tables that cannot be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import realtouch
from tactile_toolkit.errors import InputError
from tests.realtouch.images_of_others import picture


def images(home: Path, *paths: str) -> Path:
    for number, path in enumerate(paths):
        (home / path).parent.mkdir(parents=True, exist_ok=True)
        (home / path).write_bytes(picture(20 * number))
    return home


def imported(home: Path, tmp_path: Path, **options: Any) -> dict[str, Any]:
    """Return the names of images and their labels, by split."""
    realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder", **options))
    found = {}
    for split in sorted(path.name.partition("-")[0] for path in (tmp_path / "out" / "data").iterdir()):
        rounds = realtouch.load(tmp_path / "out", split)
        names = dict(enumerate(rounds.label_names)) | {-1: None}
        found[split] = [(each.id, names[each.label]) for each in rounds]
    return found


@pytest.mark.parametrize(
    ("paths", "found"),
    [
        (
            ("mug/10.png", "mug/2.png", "fork/deep/er/1.JPG", "7.png", ".hidden/a.png", "mug/notes.txt"),
            {"train": [("fork_deep_er_1", "fork"), ("mug_2", "mug"), ("mug_10", "mug")]},
        ),
        (
            ("train/mug/1.png", "train/fork/2.png", "test/mug/3.png"),
            {"test": [("test_mug_3", "mug")], "train": [("train_fork_2", "fork"), ("train_mug_1", "mug")]},
        ),
        (("train/1.png", "test/2.png"), {"test": [("test_2", None)], "train": [("train_1", None)]}),
        (("b.png", "a.png"), {"train": [("a", None), ("b", None)]}),
        (
            ("Glas/1.png", "Müsli/1.png", "mu\u0308de/ß.png"),  # letters and marks decomposed, as on macOS
            {"train": [("Glas_1", "Glas"), ("Müsli_1", "Müsli"), ("müde_ß", "mu\u0308de")]},
        ),
        (("in/1.png", "in/deep/2.png"), {"train": [("in_1", None), ("in_deep_2", None)]}),
        (("train/1.png", "mug/2.png"), {"train": [("mug_2", "mug"), ("train_1", "train")]}),
    ],
)
def test_folders_are_classes_and_splits(paths, found, tmp_path):
    """An image beside the folders of classes is left out and listed."""
    assert imported(images(tmp_path / "home", *paths), tmp_path) == found


def test_images_whose_names_cannot_be_used_are_listed(tmp_path: Path) -> None:
    home = images(tmp_path / "home", "a.png", "b\nc.png")
    (home / "d\udcff.png").write_bytes(picture(9))
    manifest = realtouch.import_touches(
        home, tmp_path / "out", realtouch.ImportSpec("folder", max_left_out=1)
    )
    assert [each.reason for each in manifest.shards[0].skipped] == ["name"] * 2
    assert len(realtouch.load(tmp_path / "out", "train")) == 1


def test_the_number_of_images_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("realtouch.formats.media_files._MAX_IMAGES", 2)
    home = images(tmp_path / "home", "a.png", "b.png", "c.png")
    with pytest.raises(InputError, match="more than 2 images"):
        realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder"))
