"""What all command lines have in common: how they are built, the options of every command, how they end."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand

from cli.declared_options import DEBUG_VARIABLE, Debug, Version, with_options
from cli.streams import _Output
from tactile_toolkit import store
from tactile_toolkit.errors import (
    InputError,
    SpecMismatchError,
    ToolkitError,
    require_public,
)
from tactile_toolkit.shown_text import printable

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130

# Help of wide terminals has lines of this length.
_SETTINGS = {"max_content_width": 100}
# Headings of the help.
_PANELS = {"argument": "Arguments", "option": "Options"}

F = TypeVar("F", bound=Callable[..., None])


def new_app(name: str, purpose: str) -> typer.Typer:
    """Return an application without commands."""
    # Plain text: rich, with the markdown and pygments that its help imports, takes two thirds of the time of
    # `--help`, and breaks long choices and messages to fit its boxes.
    app = typer.Typer(
        name=name,
        help=purpose,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings=_SETTINGS,
    )

    # Besides its options, this keeps the names of commands even of an application with one command.
    @app.callback()
    def before_the_command(debug: Debug = False, version: Version = False) -> None:
        pass

    return app


class _Command(TyperCommand):
    """A command with its options by panel, which refuses values in plain words."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with self._errors_reported():
            try:
                return super().parse_args(ctx, args)
            except typer.BadParameter as error:
                error.message = error.message.removeprefix("Value error, ")
                raise

    def invoke(self, ctx: Any) -> Any:
        with self._errors_reported():
            return super().invoke(ctx)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        panels: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            usual = _PANELS[parameter.param_type_name]
            record = parameter.get_help_record(ctx)
            if record is not None:
                panels.setdefault(getattr(parameter, "rich_help_panel", None) or usual, []).append(record)
        for panel, records in panels.items():
            with formatter.section(panel):
                formatter.write_dl(records)

    @contextmanager
    def _errors_reported(self) -> Iterator[None]:
        """Turn the toolkit's errors into messages and exit codes, or let the traceback through."""
        try:
            yield
        except (ToolkitError, OSError) as error:
            if os.environ.get(DEBUG_VARIABLE):
                raise
            if isinstance(error, ToolkitError):
                message, code = str(error), error.exit_code
                # What differs there is a field of the manifest, which need not be an option of this command.
                if not isinstance(error, SpecMismatchError):
                    message = self._with_option(message)
            elif error.filename is not None:
                reason = store.resource_shortage(error) or f"{error.strerror}; next: give another path"
                message, code = f"{str(error.filename)!r}: {reason}", InputError.exit_code
            else:
                raise
            sys.stderr.write(f"error: {printable(message)}\n")
            raise typer.Exit(code) from error
        except KeyboardInterrupt as error:
            usual = "interrupted; what was finished is kept, the same command continues from there"
            sys.stderr.write(f"{str(error) or usual}\n")
            raise typer.Exit(EXIT_INTERRUPTED) from error

    def _with_option(self, message: str) -> str:
        """Begin a message about a parameter of the library with the name that it has on the command line."""
        options = {parameter.name or "": parameter.opts[0] for parameter in self.params}
        first, space, rest = message.partition(" ")
        name = first.rpartition(".")[2]
        # The library takes metres where people give millimetres: `cell_m` is --cell-mm.
        option = options.get(name) or (options.get(f"{name}m", "") and f"{options[f'{name}m']}, in metres,")
        return f"{option or first}{space}{rest}"


def command(app: typer.Typer, name: str | None = None, **known: Any) -> Callable[[F], F]:
    """Add a function to a command line, by its own name or another one; errors become messages.

    The default of a parameter declares its option, as in `tactile_toolkit.checked_fields`. A parameter whose
    type is a dataclass is a group of options, and the function gets the object; marked with
    :class:`OptionsOf` it gets a dict of the options that were given. Of what is ``known``, the function gets
    what it has parameters for. All parameters are keyword-only.
    """

    def add(function: F) -> F:
        # The first paragraph: the library would cut it where a line of the list of commands ends.
        summary = (function.__doc__ or "").partition("\n\n")[0]
        settings = {"cls": _Command, "short_help": summary, "context_settings": _SETTINGS}
        app.command(name, **settings)(with_options(function, known))  # type: ignore[arg-type]
        return function

    return add


def run(app: typer.Typer) -> None:
    """Run a command line, and end the process."""
    # The next files would take the numbers of closed streams, and with them what libraries print.
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    output: Any = _Output(sys.stdout)
    info: Any = _Output(sys.stderr)
    with redirect_stdout(output), redirect_stderr(info):
        try:
            _dispatch(app)
        except (MemoryError, ImportError, OSError) as error:
            is_full = isinstance(error, MemoryError) or getattr(error, "errno", 0) == errno.ENOMEM
            is_full = is_full or "failed to map segment" in str(error)  # of a library
            if os.environ.get(DEBUG_VARIABLE) or not is_full:
                raise
            sys.stderr.write(
                "error: there is not enough memory; next: give this command more (`ulimit -v`, or the limit "
                "of the job), or run it with fewer --workers\n"
            )
            raise SystemExit(InputError.exit_code) from error
        finally:
            output.flush()


def _dispatch(app: typer.Typer) -> None:
    """Call the command that the first word names.

    Building all commands takes a tenth of the half second that a help may take; and going through the group,
    Typer would load pydantic for the group's own options, another 0.2 s.
    """
    for word in sys.argv[1:]:
        try:
            require_public(word)
            # Data sets hold and print names, and Parquet files of others cannot be opened.
            if word.encode(errors="ignore").decode() != word:
                raise InputError(f"{word!r} is not text in UTF-8", next="give another name")
        except InputError as error:
            sys.stderr.write(f"error: {error}\n")
            raise SystemExit(error.exit_code) from None
    word = next(iter(sys.argv[1:]), "")
    for info in app.registered_commands:
        name = info.name or typer.main.get_command_name(info.callback.__name__ if info.callback else "")
        if name == word:
            command = typer.main.get_command_from_info(
                info, pretty_exceptions_short=False, rich_markup_mode=app.rich_markup_mode
            )
            command.main(sys.argv[2:], prog_name=f"{app.info.name} {word}")
            return
    app(prog_name=app.info.name)
