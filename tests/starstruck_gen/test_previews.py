"""Pictures of scenes: their places on the sheet, and the places of objects."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import starstruck_gen
from starstruck_gen import SceneSpec
from starstruck_gen.kind import KIND
from starstruck_gen.scene_dataset import SceneSetSpec, generate
from tactile_toolkit.catalog import PreviewSpec


@cache
def crowded() -> SceneSpec:
    """A function, not a constant: its solids are checked by kernels that numba may have to compile."""
    return SceneSpec(stars=(3,), distractors=(5, 5), attempts=12)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("previews") / "scenes"
    generate(SceneSetSpec(crowded(), (("train", 9), ("test", 2)), seed=4), str(out))
    return out


def test_a_published_set_without_placements_is_drawn_from_its_meshes(folder, tmp_path):
    import pyarrow.parquet as pq

    shard = next((folder / "data").glob("train-*.parquet"))
    table = pq.ParquetFile(shard).read(use_threads=False)
    kept = [name for name in table.column_names if name in ("id", "label") or name.startswith("mesh")]
    pq.write_table(table.select(kept), tmp_path / "train.parquet")
    record = starstruck_gen.load(str(tmp_path / "train.parquet"))[0]
    assert not record.has_placements
    (planned,) = KIND.plan_previews(str(tmp_path / "train.parquet"), PreviewSpec(kinds=("sheet",))).pictures
    pixels = planned.draw().astype(int)
    assert pixels.std() > 10
    assert (pixels[..., 0] - pixels[..., 2]).max() < 60  # only stars are yellow


@pytest.mark.thorough
def test_sheets_show_each_scene_in_the_row_of_its_class(tmp_path):
    out = tmp_path / "mixed"
    generate(SceneSetSpec(SceneSpec(), (("train", 12),), seed=1), str(out), ("train",))
    (planned,) = KIND.plan_previews(str(out), PreviewSpec(kinds=("sheet",), per_class=3)).pictures
    assert (planned.name, planned.what) == ("mixed-train-sheet.png", "9 scenes of train from above")
    pixels = planned.draw()
    places = []
    for record in list(starstruck_gen.load(str(out)))[:9]:
        tile = record.picture(140)
        windows = np.lib.stride_tricks.sliding_window_view(pixels, (140,), axis=1)
        rows, columns = np.nonzero((windows[70:] == tile[70].T).all(axis=(2, 3))[: pixels.shape[0] - 140 + 1])
        (place,) = [
            (row, column)
            for row, column in zip(rows, columns, strict=True)
            if np.array_equal(pixels[row : row + 140, column : column + 140], tile)
        ]
        places.append((record.star_count, place))
    tops = {count: {row for each, (row, _) in places if each == count} for count in (1, 2, 3)}
    assert all(len(rows) == 1 for rows in tops.values())
    assert max(tops[1]) < max(tops[2]) < max(tops[3])
