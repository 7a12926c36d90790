"""What all command lines have in common: how they are built, the options of every command, how they end."""

from __future__ import annotations

import contextlib
import errno
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand

from tactile_toolkit.errors import InputError, StorageError, ToolkitError
from tactile_toolkit.printable import printable

__all__ = ["EXIT_FAILED", "EXIT_INTERRUPTED", "command", "new_app", "run"]

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
_EXIT_CLOSED_PIPE = 141
"""128 and the number of SIGPIPE: what a shell tells of `cat`, `grep` and others whose reader left."""

_DEBUG_VARIABLE = "TACTILE_TOOLKIT_DEBUG"
_SETTINGS = {"max_content_width": 100}
"""Help of wide terminals has lines of this length."""

F = TypeVar("F", bound=Callable[..., None])


def _print_version(wanted: bool) -> None:
    if wanted:
        from tactile_toolkit.versions import toolkit_version

        sys.stdout.write(f"tactile-toolkit {toolkit_version()}\n")
        raise typer.Exit


Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
]


@dataclass(frozen=True, slots=True)
class _Everywhere:
    """Options of every command."""

    debug: Debug = False
    version: Version = False


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

    def before_the_command(debug: Debug = False, version: Version = False) -> None:
        if debug:  # given before the command, which has options of its own and does not see this one
            os.environ[_DEBUG_VARIABLE] = "1"

    # Besides its options, this keeps the names of commands even of an application with one command.
    app.callback()(before_the_command)
    return app


class _Command(TyperCommand):
    """A command whose refusals of a value are in plain words, without the library's own in front."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")
            raise


def command(app: typer.Typer, name: str | None = None) -> Callable[[F], F]:
    """Add a function to a command line, by its own name or another one; errors become messages.

    A parameter whose type is a dataclass is a group of options: each field is an option, declared by its type
    and default as a parameter would be, and the function gets the object. Groups may stand behind defaults
    where parameters are keyword-only.
    """

    def add(function: F) -> F:
        # The first paragraph: the library would cut it where a line of the list of commands ends.
        summary = (function.__doc__ or "").partition("\n\n")[0]
        app.command(name, cls=_Command, short_help=summary, context_settings=_SETTINGS)(
            _with_groups(function)
        )
        return function

    return add


def _with_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function that takes the fields of option groups one by one, and those of every command."""
    # Annotations are text: those of a group are names of the group's module, where Typer would not look.
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in groups:
            parameters += _parameters_of(groups[parameter.name])
        else:
            # By keyword only: options without a default may stand behind those with one.
            parameters.append(
                parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=hints[parameter.name])
            )
    parameters += _parameters_of(_Everywhere)
    options = {parameter.name: _option(parameter) for parameter in parameters}

    @wraps(function)
    def call(**values: Any) -> None:
        def taken(group: Any) -> Any:
            return group(**{field.name: values.pop(field.name) for field in fields(group)})

        everywhere = taken(_Everywhere)
        with _errors_reported(everywhere.debug, options):
            function(**{name: taken(group) for name, group in groups.items()}, **values)

    # Typer asks both; two options of one name are refused by `Signature`.
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call


def _option(parameter: inspect.Parameter) -> str:
    """Return an option as users write it."""
    # Typer keeps the first name that is declared in the place of the default.
    declared = getattr(getattr(parameter.annotation, "__metadata__", [None])[0], "default", None)
    return declared if isinstance(declared, str) else f"--{parameter.name.replace('_', '-')}"


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


@contextmanager
def _errors_reported(debug: bool, options: Mapping[str, str]) -> Iterator[None]:
    """Turn the toolkit's errors into messages and exit codes, or let the traceback through."""
    try:
        # Besides taking a second, pyarrow's import of pandas swallows a Ctrl-C that comes during it.
        from tactile_toolkit.run.limits import skip_pandas

        skip_pandas()
        yield
    except (ToolkitError, OSError) as error:
        if debug or os.environ.get(_DEBUG_VARIABLE):
            raise
        if isinstance(error, ToolkitError):
            message, code = _with_option(str(error), options), error.exit_code
        elif error.filename is not None:
            # A path that the system refuses and nobody asked for more about, such as too long a name. As a
            # traceback it would end with 1, which says that a validation failed.
            from tactile_toolkit.store.files import of_the_process

            lack = of_the_process(error) or f"{error.strerror}; next: give another path (--debug says where)"
            message = f"{str(error.filename)!r}: {lack}"
            code = InputError.exit_code
        else:
            raise
        sys.stderr.write(f"error: {printable(message)}\n")
        raise typer.Exit(code) from error
    except KeyboardInterrupt as error:
        said = str(error) or "interrupted; what was finished is kept, the same command goes on from there"
        sys.stderr.write(f"{said}\n")
        raise typer.Exit(EXIT_INTERRUPTED) from error


def _is_lack_of_memory(error: BaseException | None) -> bool:
    """Return whether there was no memory for values, files or libraries, which say so in words alone."""
    while error is not None:
        no_room = isinstance(error, OSError) and error.errno == errno.ENOMEM
        if (
            no_room
            or isinstance(error, MemoryError)
            or (
                isinstance(error, ImportError)
                and re.search("failed to map segment|annot allocate memory", str(error))
            )
        ):
            return True
        error = error.__cause__ or error.__context__
    return False


def _with_option(message: str, options: Mapping[str, str]) -> str:
    """Begin a message about a parameter of the library with the name that it has on the command line."""
    first, space, rest = message.partition(" ")
    name = first.rpartition(".")[2]
    # The library takes metres where people give millimetres: `cell_m` is --cell-mm.
    option = options.get(name) or (options.get(f"{name}m", "") and f"{options[f'{name}m']}, in metres,")
    return f"{option or first}{space}{rest}"


class _Output:
    """A standard stream that ends the command when it takes no more.

    A closed pipe does so quietly, as it ends other tools; a closed stream or a full device with a message.
    Caught here, because rich and click would each end with another exit code, and because the same errors of
    a file, or of a connection to the Hub, mean something else.
    """

    def __init__(self, stream: Any) -> None:
        # Python has none where the caller closed it.
        self._is_closed = stream is None
        self._stream = stream or _nowhere()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if self._is_closed:
            self._end("it is closed", _EXIT_CLOSED_PIPE)
        return int(self._taken(self._stream.write, text))

    def flush(self) -> None:
        self._taken(self._stream.flush)

    def _taken(self, act: Callable[..., Any], *arguments: str) -> Any:
        try:
            return act(*arguments)
        except OSError as error:
            # What is left in the buffer must go somewhere when Python ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if isinstance(error, BrokenPipeError):
                raise SystemExit(_EXIT_CLOSED_PIPE) from error
            self._end(error.strerror or str(error), StorageError.exit_code)

    def _end(self, why: str, code: int) -> NoReturn:
        with contextlib.suppress(SystemExit):  # of a stderr that takes no more either
            sys.stderr.write(
                f"error: the output cannot be written: {why}; next: redirect it to another place\n"
            )
        raise SystemExit(code)


def _nowhere() -> Any:
    return Path(os.devnull).open("w", encoding="utf-8")


def run(app: typer.Typer) -> None:
    """Run a command line, and end the process."""
    # The next files would take the numbers of closed streams, and with them what libraries print.
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    output: Any = _Output(sys.stdout)
    talk: Any = _Output(sys.stderr or _nowhere())
    with redirect_stdout(output), redirect_stderr(talk):
        try:
            _require_text(sys.argv)
            _dispatch(app)
        except (MemoryError, ImportError, OSError) as error:
            wants_traceback = "--debug" in sys.argv or os.environ.get(_DEBUG_VARIABLE)
            if wants_traceback or not _is_lack_of_memory(error):
                raise
            sys.stderr.write(
                "error: there is not enough memory; next: give this command more (`ulimit -v`, or the limit "
                "of the job), or run it with fewer --workers\n"
            )
            raise SystemExit(InputError.exit_code) from error
        finally:
            output.flush()


def _require_text(words: list[str]) -> None:
    """Refuse names that are not UTF-8: data sets hold and print names, and Parquet files cannot be opened."""
    for word in words:
        if word.encode(errors="ignore").decode() != word:
            sys.stderr.write(f"error: {word!r} is not text in UTF-8; next: give another name\n")
            raise SystemExit(InputError.exit_code)


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
    app(prog_name=app.info.name)
