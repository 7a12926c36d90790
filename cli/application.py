"""Basics of all command lines: applications, commands, messages for errors, and exit codes."""

from __future__ import annotations

import errno
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand

from cli.options import DEBUG_VARIABLE, GENERAL, Debug, Version, option_label, with_options
from cli.output import Output
from tactile_toolkit import errors, wording
from tactile_toolkit.value_types import JsonValue

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130

# Line length of the help on wide terminals.
_SETTINGS: dict[str, JsonValue] = {"max_content_width": 100, "help_option_names": ["--help", "-h"]}
# Headings of the help, by type of parameter.
_PANELS = {"argument": "Arguments", "option": "Options"}

F = TypeVar("F", bound=Callable[..., None])


def new_app(name: str, purpose: str) -> typer.Typer:
    """Return an application without commands."""
    # Plain text: rich and its imports (markdown, pygments) would take two thirds of the time of `--help`, and
    # would break long choices and messages to fit its boxes.
    app = typer.Typer(
        name=name,
        help=purpose,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings=_SETTINGS,
    )

    # This also keeps the name of a command that is the only one of its application.
    @app.callback()
    def global_options(debug: Debug = False, version: Version = False) -> None:
        pass

    return app


class _Command(TyperCommand):
    """A command that lists its options by panel and reports errors in plain language."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with self._errors_reported():
            try:
                return super().parse_args(ctx, args)
            except typer.BadParameter as error:
                error.message = error.message.removeprefix("Value error, ")  # of pydantic
                raise

    def invoke(self, ctx: Any) -> object:
        with self._errors_reported():
            return super().invoke(ctx)

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write the help; examples are not wrapped, so that they can be copied."""
        text, *examples = (self.help or "").split("\n\nExample: ")
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(text)
            formatter.write_paragraph()
            indent = " " * formatter.current_indent
            formatter.write("".join(f"{indent}Example: {line}\n" for line in examples))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        panels: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            default_panel = _PANELS[parameter.param_type_name]
            record = parameter.get_help_record(ctx)
            if record is not None:
                panel = getattr(parameter, "rich_help_panel", None) or default_panel
                # Users do not know the names of Python's types.
                name = re.sub(r" <(?:list\[)?str\]?>$|list\[(.*)\](?=>$)", r"\1", record[0])
                # Click puts a default that is described in words into parentheses.
                text = re.sub(r"\[default: \((.*)\)\]$", r"[default: \1]", record[1])
                panels.setdefault(panel, []).append((name, text))
        # Click declares --help itself, after all others and without a panel.
        panels[GENERAL] = [*panels.pop(GENERAL, []), panels["Options"].pop()]
        for panel, records in panels.items():
            if records:
                with formatter.section(panel):
                    formatter.write_dl(records)

    @contextmanager
    def _errors_reported(self) -> Iterator[None]:
        """Turn the toolkit's errors into messages and exit codes, or let the traceback through."""
        try:
            yield
        except (errors.ToolkitError, OSError) as error:
            if os.environ.get(DEBUG_VARIABLE):
                raise
            if isinstance(error, OSError):
                if error.filename is None:
                    raise
                error = errors.InputError.of_system(error)
            message = error.naming(self._option(error.field))
            sys.stderr.write(f"error: {wording.printable(message)}\n")
            raise typer.Exit(error.exit_code) from error
        except KeyboardInterrupt as error:
            sys.stderr.write(f"{str(error) or 'interrupted'}\n")
            raise typer.Exit(EXIT_INTERRUPTED) from error

    def _option(self, field: str) -> str:
        """Return the option of a field, or the field itself if this command has none."""
        names = {parameter.name: option_label(parameter) for parameter in self.params}
        # The library takes metres where people give millimetres: `cell_m` is --cell-mm.
        if f"{field}m" in names:
            return f"{names[f'{field}m']}, in metres,"
        return names.get(field, field)


def command(
    app: typer.Typer, name: str | None = None, *, asks_hub: bool = False, **known: object
) -> Callable[[F], F]:
    """Return a decorator that adds a function as a command, by its own name or another one.

    The default of a parameter declares its option, as in `tactile_toolkit.checked_fields`. A parameter whose
    type is a dataclass is a group of options, and the function gets the object; if it is marked with
    :class:`OptionsOf`, the function gets a dict of the options that were given. The function also gets those
    ``known`` arguments that it has parameters for. All parameters are keyword-only.

    A command with ``--revision`` opens names of the Hub, so it has ``--token`` too. ``asks_hub`` marks others
    that need it.
    """

    def add(function: F) -> F:
        # The whole first paragraph: Typer would cut it to one line of the list of commands.
        text = _with_examples_last(inspect.cleandoc(function.__doc__ or ""))
        summary = text.partition("\n\n")[0]
        settings = {"cls": _Command, "help": text, "short_help": summary, "context_settings": _SETTINGS}
        app.command(name, **settings)(with_options(function, known, asks_hub=asks_hub))  # type: ignore[arg-type]
        return function

    return add


def _with_examples_last(text: str) -> str:
    """Return a help with each of its examples as a paragraph at the end."""
    paragraphs = text.split("\n\n")
    examples = [
        f"Example: {line.strip()}"
        for paragraph in paragraphs
        if paragraph.startswith("Example")
        for line in " ".join(paragraph.split()).partition(": ")[2].split("; ")
    ]
    return "\n\n".join([*(text for text in paragraphs if not text.startswith("Example")), *examples])


def run(app: typer.Typer) -> None:
    """Run a command line, and end the process."""
    # If a standard stream is closed, the next file that is opened would get its number, and with it the text
    # that libraries print.
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    output = Output(sys.stdout)
    with redirect_stdout(output), redirect_stderr(Output(sys.stderr)):
        try:
            _dispatch(app)
        except (MemoryError, ImportError, OSError) as error:
            no_memory = isinstance(error, MemoryError) or getattr(error, "errno", 0) == errno.ENOMEM
            no_memory = no_memory or "failed to map segment" in str(error)  # of a shared library
            if os.environ.get(DEBUG_VARIABLE) or not no_memory:
                raise
            refused = errors.InputError(
                "there is not enough memory",
                next="give this command more (`ulimit -v`, or the limit of the job), or run it with fewer "
                "--workers",
            )
            sys.stderr.write(f"error: {refused}\n")
            raise SystemExit(refused.exit_code) from error
        finally:
            output.flush()


def _dispatch(app: typer.Typer) -> None:
    """Run the command that the first argument names.

    Only this command is built: all commands would take 0.05 s, and for the options of their group, Typer
    would load pydantic, which takes 0.2 s.
    """
    for word in sys.argv[1:]:
        try:
            errors.require_public(word)
            # Names are stored in data sets and printed, and Arrow opens no file whose name is not UTF-8.
            if word.encode(errors="ignore").decode() != word:
                raise errors.InputError(f"{word!r} is not valid UTF-8", next="give another name")
        except errors.InputError as error:
            sys.stderr.write(f"error: {error}\n")
            raise SystemExit(error.exit_code) from None
    word = next(iter(sys.argv[1:]), "")
    for info in app.registered_commands:
        if _name_of(info) == word:
            command = typer.main.get_command_from_info(
                info, pretty_exceptions_short=False, rich_markup_mode=app.rich_markup_mode
            )
            command.main(sys.argv[2:], prog_name=f"{app.info.name} {word}")
            return
    if not any(name.endswith("_COMPLETE") for name in os.environ):
        app = _without_options(app)
    app(prog_name=app.info.name)


def _without_options(app: typer.Typer) -> typer.Typer:
    """Return an application that lists the same commands; building their options would take 0.05 s."""
    listed = new_app(app.info.name or "", app.info.help or "")
    for info in app.registered_commands:
        listed.command(_name_of(info), short_help=info.short_help)(lambda: None)
    return listed


def _name_of(info: Any) -> str:
    return str(info.name or typer.main.get_command_name(info.callback.__name__))
