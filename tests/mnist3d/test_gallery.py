from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import mnist3d
from mnist3d.digit_options import SolidSpec, SplitSpec
from mnist3d.digit_previews import plan_gallery
from mnist3d.digit_records import REPORT_FILE
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.catalog import RowFilter
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read import Shard
from tests.gallery_browser import browser, opened
from tests.gallery_files import column, content_of, index_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("gallery") / "digits"
    spec = mnist3d.DigitSetSpec(
        source=SyntheticSource(count=200, seed=3),
        solid=SolidSpec(target_vertices=2_000),
        split=SplitSpec(0, "digit", (("train", 2), ("test", 1))),
    )
    mnist3d.generate(spec, str(out), ("train", "test"), workers=1)
    return out


def measure(index: dict, title: str) -> list[float | None]:
    return next(entry for entry in index["measures"] if entry["title"] == title)["values"]


def test_the_page_shows_every_digit_with_its_report(folder, tmp_path):
    site = plan_gallery(str(folder)).write(str(tmp_path / "site"))
    assert (site.items, site.splits) == (30, {"train": 20, "test": 10})
    index = index_of(tmp_path / "site")
    assert index["title"] == "3D digits · digits"
    expected = [(split, record) for split in ("train", "test") for record in mnist3d.load(str(folder), split)]
    assert index["ids"] == [str(record.id) for _, record in expected]
    assert column(index, "Split") == [[split] for split, _ in expected]
    assert column(index, "Class") == [[str(record.label)] for _, record in expected]
    assert column(index, "Writer") == [[str(record.writer)] for _, record in expected]
    report = Shard(str(folder / REPORT_FILE)).read().to_pylist()
    found = {(row["split"], row["id"]): row for row in report}
    rows = [found[split, record.id] for split, record in expected]
    assert column(index, "Print warnings") == [row["warnings"] or ["none"] for row in rows]
    assert measure(index, "Thinnest wall") == [round(row["thinnest_wall_mm"], 2) for row in rows]
    assert measure(index, "Volume") == [round(row["volume_mm3"]) for row in rows]
    notes = dict(content_of(tmp_path / "site", 0)["notes"])
    size_mm = np.ptp(expected[0][1].vertices_m, axis=0) * 1000
    assert notes["Size"] == " x ".join(f"{side:.1f}" for side in size_mm) + " mm"


def test_a_set_without_a_report_is_inspected(folder, tmp_path):
    bare = tmp_path / "bare"
    shutil.copytree(folder / "data", bare / "data")
    plan_gallery(str(folder), RowFilter("test")).write(str(tmp_path / "a"))
    plan_gallery(str(bare), RowFilter("test")).write(str(tmp_path / "b"))
    of_report, inspected = index_of(tmp_path / "a"), index_of(tmp_path / "b")
    assert inspected["facets"] == of_report["facets"]
    for told, seen in zip(of_report["measures"], inspected["measures"], strict=True):
        assert seen["values"] == pytest.approx(told["values"], rel=1e-3, abs=0.02)


def test_digits_that_cannot_be_shown_are_named(folder, tmp_path):
    with pytest.raises(InputError, match="no split 'holdout'"):
        plan_gallery(str(folder), RowFilter("holdout"))
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copy / "data" / "test-00000-of-00001.parquet").unlink()
    with pytest.raises(IntegrityError):
        plan_gallery(str(copy), RowFilter("test")).write(str(tmp_path / "site"))
    assert not (tmp_path / "site").exists()


@pytest.mark.browser
def test_a_digit_in_the_browser_is_that_digit(folder, tmp_path):
    with browser() as chromium:
        plan_gallery(str(folder), RowFilter("test")).write(str(tmp_path / "site"))
        records = mnist3d.load(str(folder), "test")
        place = int(np.flatnonzero(records.labels == 1)[0])
        with opened(chromium, tmp_path / "site", width=900, height=620, link=f"#item-{place}") as found:
            found.stage()
            found.page.get_by_role("button", name="From above").click()
            seen = found.stage()
            rows, columns = np.nonzero((seen[..., 0] - seen[..., 2]) > 40)
            width_mm, height_mm, _ = np.ptp(records[place].vertices_m, axis=0) * 1000
            shape = (np.ptp(columns) + 1) / (np.ptp(rows) + 1)
            assert shape == pytest.approx(width_mm / height_mm, rel=0.08)
            facts = found.page.locator("#facts").inner_text()
            assert f"{records[place].volume_m3 * 1e9:,.0f} mm³" in facts
            assert "Thinnest wall" in facts
            assert f"{width_mm:.1f} x {height_mm:.1f}" in facts
