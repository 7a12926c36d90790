"""``python -m mnist3d``: the command line, also where its command is not on the path."""

from __future__ import annotations

from cli.start import mnist3d

mnist3d()
