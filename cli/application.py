"""What all command lines have in common: how they are built, and the words that are understood everywhere."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from typing import Any, TypeVar, get_type_hints

import typer

from cli.failures import DEBUG_VARIABLE, reports_errors

__all__ = ["command", "new_app", "run"]

F = TypeVar("F", bound=Callable[..., None])


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


def command(app: typer.Typer, name: str | None = None) -> Callable[[F], F]:
    """Add a function to a command line, by its own name or another one; errors become messages.

    A parameter whose type is a dataclass is a group of options: each field is an option, declared by its type
    and default as a parameter would be, and the function gets the object. Groups may stand behind defaults
    where parameters are keyword-only.
    """

    def add(function: F) -> F:
        app.command(name)(reports_errors(_with_groups(function)))
        return function

    return add


def _with_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function that takes the fields of option groups one by one."""
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in groups:
            parameters += _parameters_of(groups[parameter.name])
        else:
            parameters.append(
                parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=hints[parameter.name])
            )

    @wraps(function)
    def call(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        function(**values)

    # Typer asks both; two options of one name are refused by `Signature`.
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call


def _parameters_of(group: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in fields(group)
    ]


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

    Building all commands takes a tenth of the half second that a help may take; and going through the group,
    Typer would load pydantic for the group's own options, another 0.2 s.
    """
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    for info in app.registered_commands:
        name = info.name or typer.main.get_command_name(info.callback.__name__ if info.callback else "")
        if name == word:
            command = typer.main.get_command_from_info(
                info, pretty_exceptions_short=False, rich_markup_mode=app.rich_markup_mode
            )
            command.main(sys.argv[2:], prog_name=f"{app.info.name} {word}")
            return
    app()
