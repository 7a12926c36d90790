"""Command lines given in this process, as tests of what they say and write need them."""

from __future__ import annotations

import os
import sys
from importlib import import_module

__all__ = ["call"]


def call(program: str, *arguments: object) -> int:
    """Run a command line in this process and return its exit code."""
    main = import_module(f"cli.{program.replace('-', '_')}").main
    before = sys.argv
    sys.argv = [program, *map(str, arguments)]
    try:
        main()
    except SystemExit as leave:
        return int(leave.code or 0)
    finally:
        sys.argv = before
        os.environ.pop("TACTILE_TOOLKIT_DEBUG", None)
    return 0
