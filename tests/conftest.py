"""What all tests share: a cache folder of their own, and no network."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[1].parent / "shared"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(cache / "toolkit"))
    monkeypatch.setenv("HF_HOME", str(cache / "hf"))
    monkeypatch.setenv("HF_DATASETS_CACHE", str(cache / "hf" / "datasets"))


@pytest.fixture
def shared() -> Path:
    """Folder of real input beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("real input is not here: the folder ../shared beside the repository is absent")
    return SHARED
