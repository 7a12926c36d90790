"""``python -m starstruck_gen``: the command line, for when its command is not on PATH."""

from __future__ import annotations

from cli.start import starstruck

starstruck()
