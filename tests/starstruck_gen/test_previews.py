"""Pictures of scenes that have no placements."""

from __future__ import annotations

from functools import cache
from pathlib import Path

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
