"""Errors on the command line: one or two lines on stderr and an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import typer

from tactile_toolkit.errors import ToolkitError

__all__ = ["DEBUG_VARIABLE", "EXIT_FAILED", "EXIT_INTERRUPTED", "reports_errors"]

DEBUG_VARIABLE = "TACTILE_TOOLKIT_DEBUG"
EXIT_FAILED = 1
EXIT_INTERRUPTED = 130

P = ParamSpec("P")
R = TypeVar("R")


def reports_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Turn the toolkit's errors into messages and exit codes; ``--debug`` lets the traceback through."""

    @wraps(command)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            # Besides taking a second, pyarrow's import of pandas swallows a Ctrl-C that comes during it.
            from tactile_toolkit.run.limits import skip_pandas

            skip_pandas()
            return command(*args, **kwargs)
        except ToolkitError as error:
            if os.environ.get(DEBUG_VARIABLE):
                raise
            sys.stderr.write(f"error: {error}\n")
            raise typer.Exit(error.exit_code) from error
        except KeyboardInterrupt as error:
            sys.stderr.write("interrupted; what was finished is kept, the same command goes on from there\n")
            raise typer.Exit(EXIT_INTERRUPTED) from error
        except BrokenPipeError as error:
            # The reader of our output left (`| head`): not an error, and nothing more can be written.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(EXIT_FAILED) from error

    return guarded
