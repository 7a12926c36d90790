"""Data sets for environments, made once for all tests, and packed once for each file of tests."""

from pathlib import Path

import pytest

from tests.env_assets.conftest import assets, packages, provider  # noqa: F401


@pytest.fixture(scope="module")
def _shared_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("packed")


@pytest.fixture(autouse=True)
def _cache_of_the_file(_own_cache: None, _shared_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the packed objects of environments, which are named by their content."""
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(_shared_cache))
