"""``python -m tactile_sim``: the command line, also where its command is not on the path."""

from __future__ import annotations

from cli.start import tactile_sim

tactile_sim()
