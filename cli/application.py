"""What all command lines have in common: how they are built, and the words that are understood everywhere."""

from __future__ import annotations

import os
import sys

import typer

from cli.failures import DEBUG_VARIABLE

__all__ = ["new_app", "run"]


def new_app(name: str, purpose: str) -> typer.Typer:
    """Return an application without commands.

    ``--version`` and ``--debug`` are not options of it: :func:`run` understands them.
    """
    app = typer.Typer(
        name=name,
        help=purpose,
        epilog="--version prints the version; --debug, at any place, shows the traceback of an error.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        add_completion=False,
    )
    app.callback()(_no_options)
    return app


def _no_options() -> None:
    """Keep the names of commands on the command line, even of an application with one command."""


def run(app: typer.Typer) -> None:
    """Run a command line; ``--debug`` is understood at any place, ``--version`` at the first."""
    if "--debug" in sys.argv[1:]:
        os.environ[DEBUG_VARIABLE] = "1"
        sys.argv = [argument for argument in sys.argv if argument != "--debug"]
    if sys.argv[1:2] == ["--version"]:
        from tactile_toolkit.versions import toolkit_version

        sys.stdout.write(f"tactile-toolkit {toolkit_version()}\n")
        raise SystemExit(0)
    _dispatch(app)


def _dispatch(app: typer.Typer) -> None:
    """Call the command that the first word names.

    Going through the group, Typer would load pydantic for the group's own options before a command's
    ``--help``, which takes 0.2 s of the half second that a help may take.
    """
    group = typer.main.get_command(app)
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    command = getattr(group, "commands", {}).get(word)
    if command is None:
        group()
    else:
        command.main(sys.argv[2:], prog_name=f"{app.info.name} {word}")
