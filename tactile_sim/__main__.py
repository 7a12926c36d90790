"""``python -m tactile_sim``: the command line, for when its command is not on PATH."""

from __future__ import annotations

from cli.start import tactile_sim

tactile_sim()
