"""``python -m tactile_envs``: the command line, for when its command is not on PATH."""

from __future__ import annotations

from cli.start import tactile_envs

tactile_envs()
