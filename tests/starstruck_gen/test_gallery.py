from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import starstruck_gen
from starstruck_gen.scene_card import plan_gallery
from tactile_toolkit.catalog import RowFilter
from tests.gallery_browser import browser, opened
from tests.gallery_files import column, content_of, files_of, index_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("gallery") / "stars"
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 12), ("test", 6)))
    starstruck_gen.generate(spec, str(out), ("train", "test"), workers=1)
    return out


def test_scenes_are_filtered_by_their_objects(folder, tmp_path):
    site = plan_gallery(str(folder)).write(str(tmp_path / "site"))
    assert (site.items, site.splits) == (18, {"train": 12, "test": 6})
    index = index_of(tmp_path / "site")
    expected = [record for split in ("train", "test") for record in starstruck_gen.load(str(folder), split)]
    assert index["ids"] == [str(record.id) for record in expected]
    assert column(index, "Stars") == [[str(record.star_count)] for record in expected]
    assert column(index, "Distractors") == [[str(record.distractor_count)] for record in expected]
    shapes = [sorted({placement.shape for placement in record.placements}) for record in expected]
    assert column(index, "Shapes") == shapes
    for number, record in enumerate(expected):
        parts = content_of(tmp_path / "site", number)["mesh"]["parts"]
        assert [paint for _, paint in parts].count("main") == record.star_count
        assert sum(faces for faces, _ in parts) == len(record.faces)


def test_thumbnails_show_stars_on_clear_paper(folder, tmp_path):
    plan_gallery(str(folder), RowFilter("test")).write(str(tmp_path / "site"))
    for number, record in enumerate(starstruck_gen.load(str(folder), "test")):
        content = (files_of(tmp_path / "site") / "thumbs" / f"{number:06d}.png").read_bytes()
        pixels = np.asarray(Image.open(io.BytesIO(content))).astype(int)
        assert pixels.shape == (144, 144, 4)
        clear = (pixels[..., 3] == 0).mean()
        assert 0.5 < clear < 0.99
        star = record.placements[0]
        x, y = round(72 + 1200 * star.x_m), round(72 - 1200 * star.y_m)
        red, _, blue, opaque = pixels[y, x]
        assert (red - blue > 60, opaque) == (True, 255)
        # The plate does not show as a light rim around the objects.
        half = pixels[(pixels[..., 3] > 40) & (pixels[..., 3] < 200)]
        assert np.median(half[:, :3].mean(axis=1)) < 150


def test_the_published_set_has_no_placements_and_is_shown_too(folder, tmp_path):
    import pyarrow.parquet as pq

    (tmp_path / "bare").mkdir()
    (source,) = (folder / "data").glob("test-*.parquet")
    table = pq.ParquetFile(source).read(use_threads=False)
    pq.write_table(
        table.select(["id", "label", "mesh.vertices", "mesh.faces"]), tmp_path / "bare" / "test.parquet"
    )
    site = plan_gallery(str(tmp_path / "bare")).write(str(tmp_path / "site"))
    assert site.splits == {"test": 6}
    index = index_of(tmp_path / "site")
    assert column(index, "Distractors") == [["unknown"]] * 6
    assert column(index, "Shapes") == [[]] * 6
    assert column(index, "Stars") == [[str(number % 3 + 1)] for number in range(6)]
    mesh = content_of(tmp_path / "site", 0)["mesh"]
    assert mesh["parts"] == [[mesh["face_count"], "other"]]  # no object has the colour of stars
    assert (files_of(tmp_path / "site") / "thumbs" / "000005.png").stat().st_size > 200


@pytest.mark.browser
def test_stars_and_others_have_their_own_paint(folder, tmp_path):
    with browser() as chromium:
        plan_gallery(str(folder), RowFilter("test")).write(str(tmp_path / "site"))
        scenes = list(starstruck_gen.load(str(folder), "test"))
        place = max(range(6), key=lambda number: scenes[number].distractor_count)
        with opened(chromium, tmp_path / "site", width=900, height=620, link=f"#item-{place}") as found:
            seen = found.stage()
            assert ((seen[..., 0] - seen[..., 2]) > 40).mean() > 0.005  # amber
            assert ((seen[..., 2] - seen[..., 0]) > 20).mean() > 0.005  # slate
            stars = found.page.get_by_role("group", name="Stars", include_hidden=True)
            counts = stars.locator(".number").all_text_contents()
            assert counts == ["2", "2", "2"]
