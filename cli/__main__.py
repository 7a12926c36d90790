"""``python -m cli mnist3d generate``: a command, for when the commands are not on PATH."""

from __future__ import annotations

import sys

from cli import start

_PROGRAMS = ("env-assets", "mnist3d", "realtouch", "starstruck", "tactile", "tactile-envs", "tactile-sim")

program = "".join(sys.argv[1:2])
if program not in _PROGRAMS:
    problem = f"{program!r} is no command" if program else "no command is named"
    sys.stderr.write(
        f"error: {problem}; expected one of {', '.join(_PROGRAMS)}; next: python -m cli tactile --help\n"
    )
    sys.exit(2)  # as `cli.application` for wrong input
del sys.argv[1]
getattr(start, program.replace("-", "_"))()
