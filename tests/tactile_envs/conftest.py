"""Data sets for environments, made once for all tests."""

from tests.env_assets.conftest import assets, packages, provider  # noqa: F401
