"""``python -m tactile_toolkit``: the command ``tactile``, for when it is not on PATH."""

from __future__ import annotations

from cli.start import tactile

tactile()
