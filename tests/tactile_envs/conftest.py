"""Data sets for environments, made once for all tests."""

from __future__ import annotations

import pytest

from tests.env_assets.conftest import assets, packages, provider  # noqa: F401


@pytest.fixture(autouse=True)
def plain_ids() -> None:
    """Take the plain ids back: in this process `tactile-mnist` may have been imported by hand meanwhile."""
    pytest.importorskip("gymnasium", reason="gymnasium (extra `native`) is not installed")
    import tactile_envs

    tactile_envs.register()
