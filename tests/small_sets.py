"""Small data sets that many tests read. Each worker makes them once, and no test may change them."""

from __future__ import annotations

from pathlib import Path

import pytest

import mnist3d
import starstruck_gen
from mnist3d.sources.synthetic import SyntheticSource


@pytest.fixture(scope="session")
def digits_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten digits in each of the splits test and holdout."""
    folder = tmp_path_factory.mktemp("small") / "digits"
    spec = mnist3d.DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=2_000), per_class=1)
    mnist3d.generate(spec, folder, ("test", "holdout"))
    return folder


def write_scenes(folder: Path, seed: int = 0) -> Path:
    """Write three scenes in split train and two in test."""
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 3), ("test", 2)), seed=seed)
    starstruck_gen.generate(spec, folder)
    return folder


@pytest.fixture(scope="session")
def scenes_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty scenes in split train, nine in test."""
    folder = tmp_path_factory.mktemp("small") / "scenes"
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 30), ("test", 9))), folder)
    return folder
