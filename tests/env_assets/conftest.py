"""Data sets for environments, made once for all tests."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.env_assets import factories
from tests.realtouch.conftest import held_out, seq_folder, seq_rows, truth  # noqa: F401

# OpenGL reads this on its first import, which other tests do before an environment is made.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")


@pytest.fixture(scope="session")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a provider."""
    root = tmp_path_factory.mktemp("assets")
    factories.write_assets(root)
    return root


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The published package; warnings during its import are ignored."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = pytest.importorskip("tactile_mnist", reason="tactile-mnist (extra `oracle`) is not installed")
    with pytest.MonkeyPatch.context() as patch:
        # Otherwise it keeps statistics of data sets in the home folder of the user.
        patch.setattr(found.util, "CACHE_BASE_DIR", tmp_path_factory.mktemp("statistics"))
        yield found


@pytest.fixture
def provider(assets: Path) -> Any:
    """A provider of these assets."""
    import env_assets

    return env_assets.AssetProvider(assets)
