"""A folder with a card that tests may change."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def folder(digits_set: Path, tmp_path: Path) -> Path:
    """A copy of a data set of digits."""
    return Path(shutil.copytree(digits_set, tmp_path / "digits"))
