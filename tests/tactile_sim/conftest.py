"""Scenes to touch, made once for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.small_sets import write_scenes


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three scenes of objects 5 mm high in split train, two in test; no test may change them."""
    return write_scenes(tmp_path_factory.mktemp("few") / "scenes")
