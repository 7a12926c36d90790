"""Command lines that run in this process, or in another process."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any
from unittest import mock

from typer.testing import CliRunner, Result

__all__ = ["alone", "call", "program", "run"]


def alone() -> Any:
    """Commands use one process unless workers are requested, because each worker imports all modules."""
    return mock.patch.object(os, "cpu_count", return_value=1)


def call(program: str, *arguments: object) -> int:
    """Run a command line in this process, without workers unless requested, and return its exit code."""
    main = import_module(f"cli.{program.replace('-', '_')}").main
    before = sys.argv
    sys.argv = [program, *map(str, arguments)]
    try:
        with alone():
            main()
    except SystemExit as leave:
        return int(leave.code or 0)
    finally:
        sys.argv = before
        os.environ.pop("TACTILE_TOOLKIT_DEBUG", None)
    return 0


def run(program: str, *arguments: object) -> Result:
    """Run a command line in this process, without workers unless requested, and return what it printed."""
    app = import_module(f"cli.{program.replace('-', '_')}").app
    with alone():
        return CliRunner().invoke(app, list(map(str, arguments)))


def program(name: str, *arguments: object) -> list[str]:
    """Return the arguments with which another interpreter runs a command line."""
    script = f"import sys; sys.argv[0] = {name!r}; from cli.{name.replace('-', '_')} import main; main()"
    return [sys.executable, "-c", script, *map(str, arguments)]
