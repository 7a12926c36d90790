"""``python -m realtouch``: the command line, also where its command is not on the path."""

from __future__ import annotations

from cli.start import realtouch

realtouch()
