"""A folder with a card, made once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.solid_spec import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource


@pytest.fixture(scope="package")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two splits of digits, not to be changed."""
    folder = tmp_path_factory.mktemp("cards") / "digits"
    spec = DigitSetSpec(SyntheticSource(), SolidSpec(target_vertices=2_000), per_class=1)
    generate(spec, str(folder), ("test", "holdout"))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of them."""
    return Path(shutil.copytree(made, tmp_path / "digits"))
