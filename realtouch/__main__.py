"""``python -m realtouch``: the command line, for when its command is not on PATH."""

from __future__ import annotations

from cli.start import realtouch

realtouch()
