"""``python -m tactile_envs``: the command line, also where its command is not on the path."""

from __future__ import annotations

from cli.start import tactile_envs

tactile_envs()
