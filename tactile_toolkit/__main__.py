"""``python -m tactile_toolkit``: the command ``tactile``, also where it is not on the path."""

from __future__ import annotations

from cli.start import tactile

tactile()
