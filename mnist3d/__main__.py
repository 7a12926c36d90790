"""``python -m mnist3d``: the command line, also where its command is not on the path."""

from __future__ import annotations

from cli.mnist3d import main

main()
