"""A new kind of data set is one short file; everything else follows from its declarations."""

from __future__ import annotations

from pathlib import Path

import datasets
import numpy as np
import pytest

from tactile_toolkit.catalog import PreviewSpec
from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.exchange.upload import check_folder, collect
from tactile_toolkit.run import Part
from tactile_toolkit.store import open_folder, read_manifest
from tests.gallery_files import index_of
from tests.tactile_toolkit import boxes
from tests.tactile_toolkit.toy import folder_bytes

GENERATOR = boxes.BoxGenerator(boxes.BoxSpec(9, seed=4))


@pytest.mark.thorough
def test_generate_resume_parts_verify_card_load_upload_and_forecast(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    view = GENERATOR.forecast(whole)
    assert (view.rows_to_make, view.splits[0]["shards"], whole.exists()) == (9, 5, False)
    made = GENERATOR.generate(whole, workers=2)
    assert (made.complete, len(made.shards)) == (True, 5)
    assert made.split_table()["train"]["rows"] + made.split_table()["train"]["skipped"] == 9
    assert made.skipped_reasons() == {"flat": 1}
    # resume
    (whole / "data" / "train-00002-of-00005.parquet").unlink()
    told: list[int] = []
    GENERATOR.generate(whole, on_progress=lambda progress: told.append(progress.total))
    assert told[0] == 2
    with pytest.raises(SpecMismatchError, match=r"seed is 4 there, 1 was asked for"):
        boxes.BoxGenerator(boxes.BoxSpec(9, seed=1)).generate(whole)
    with pytest.raises(InputError, match="unknown split 'test'"):
        GENERATOR.generate(whole, ("test",))
    with pytest.raises(InputError, match=r"largest_mm of the boxes is 5.0; expected a number above 10"):
        boxes.BoxSpec(largest_mm=5.0)
    # parts
    for index in range(3):
        GENERATOR.generate(tmp_path / "parts", part=Part(index, 3))
    GENERATOR.generate(tmp_path / "parts", finish=True)
    assert folder_bytes(tmp_path / "parts") == folder_bytes(whole)
    # without input
    boxes.KIND.default_set(4, 9).make(str(tmp_path / "default"), "train")
    assert folder_bytes(tmp_path / "default") == folder_bytes(whole)
    assert boxes.KIND.default_set(4, 9).arguments("train") == "--split train --boxes 9 --seed 4"
    # verify, with the card
    folder = open_folder(str(whole))
    assert list(check_folder(folder, boxes.KIND)) == []
    card = (whole / "README.md").read_text(encoding="utf-8")
    assert "| `width_m` | float64 | m | extent along x |" in card
    assert "| left out | 1 flat; `manifest.json` names each |" in card
    # load
    rows = datasets.load_dataset(str(whole), split="train", cache_dir=str(tmp_path / "cache"))
    records = boxes.load(str(whole))
    assert rows["id"] == records.ids.tolist()
    assert rows.features["label"].names == ["box"]
    assert rows["width_m"] == pytest.approx([float(np.ptp(each.vertices_m[:, 0])) for each in records])
    # pictures in notebooks, previews, the card and the gallery
    assert "mm wide" in records[0]._repr_html_()
    assert records._repr_html_().count("<img") == len(records)
    (sheet,) = boxes.KIND.plan_previews(str(whole), PreviewSpec()).pictures
    assert sheet.draw().std() > 10
    assert "![The first boxes from above](previews/boxes.png)" in card
    boxes.KIND.plan_gallery(str(whole)).write(str(tmp_path / "site"))
    (width, *_) = index_of(tmp_path / "site")["measures"]
    assert width["values"] == [round(record.row.value("width_m"), 3) for record in records]
    # upload
    manifest = read_manifest(folder)
    assert manifest is not None
    assert set(folder_bytes(whole)) == set(collect(whole, manifest))


def test_a_forecast_reports_that_the_first_items_give_no_row(tmp_path: Path) -> None:
    from tactile_toolkit.store import Skipped

    class Reluctant(boxes.BoxGenerator):
        least = 10

        def make(self, split, items):
            rows = super().make(split, items)
            return [row if row.id >= self.least else Skipped(row.id, "no", f"not {row.id}") for row in rows]

    spec = boxes.BoxSpec(9)
    found = Reluctant(spec).forecast(tmp_path / "set")
    assert (found.rows_to_make, found.sampled, found.bytes) == (9, 0, 0)
