"""A new kind of data set is one short file: the rest follows from what it says."""

from __future__ import annotations

from pathlib import Path

import datasets
import pytest

from tactile_toolkit.errors import SpecMismatchError
from tactile_toolkit.exchange.upload import check_folder, collect
from tactile_toolkit.run.parts import Finish, Part
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest
from tests.tactile_toolkit import boxes
from tests.tactile_toolkit.toy import folder_bytes

SPEC = boxes.BoxSpec(9)


def test_it_is_one_file_of_under_sixty_lines() -> None:
    lines = Path(boxes.__file__).read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if line.strip()]) < 60


def test_generate_resume_parts_verify_card_load_upload_and_preview(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    made = boxes.generate(SPEC, whole, workers=2)
    assert (made.complete, made.split_table()["train"]["rows"], len(made.shards)) == (True, 9, 5)
    # resume
    (whole / "data" / "train-00002-of-00005.parquet").unlink()
    told: list[int] = []
    boxes.generate(SPEC, whole, on_progress=lambda progress: told.append(progress.total))
    assert told[0] == 2
    with pytest.raises(SpecMismatchError, match=r"options\.seed is 0 there, 1 was asked for"):
        boxes.generate(boxes.BoxSpec(9, seed=1), whole)
    # parts
    for index in range(3):
        boxes.generate(SPEC, tmp_path / "parts", workers=Part(index, 3))
    boxes.generate(SPEC, tmp_path / "parts", workers=Finish())
    assert folder_bytes(tmp_path / "parts") == folder_bytes(whole)
    # verify, with the card
    folder = DataFolder(str(whole))
    assert list(check_folder(boxes.KIND, folder)) == []
    card = (whole / "README.md").read_text(encoding="utf-8")
    assert "width_m" in card
    assert (whole / "previews" / "tables.png").read_bytes().startswith(b"\x89PNG")
    # load
    rows = datasets.load_dataset(str(whole), split="train", cache_dir=str(tmp_path / "cache"))
    assert rows["id"] == list(range(9))
    # upload
    manifest = read_manifest(folder)
    assert manifest is not None
    assert set(folder_bytes(whole)) == {file.path for file in collect(whole, manifest)}
