"""``python -m env_assets``: the command line, for when its command is not on PATH."""

from __future__ import annotations

from cli.start import env_assets

env_assets()
