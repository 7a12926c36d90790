"""``python -m env_assets``: the command line, also where its command is not on the path."""

from __future__ import annotations

from cli.start import env_assets

env_assets()
