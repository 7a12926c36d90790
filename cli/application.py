"""What all command lines have in common: how they are built, the options of every command, how they end."""

from __future__ import annotations

import errno
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import typer
from typer.core import TyperCommand

from tactile_toolkit import __version__, store
from tactile_toolkit.checked_fields import OptionText, Rule, check_value, metavar_of, rule_of, text
from tactile_toolkit.errors import (
    InputError,
    SpecMismatchError,
    StorageError,
    ToolkitError,
    require_public,
)
from tactile_toolkit.wording import printable

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
# 128 and the number of SIGPIPE: what a shell reports of `cat`, `grep` and others whose reader left.
_EXIT_CLOSED_PIPE = 141

_DEBUG_VARIABLE = "TACTILE_TOOLKIT_DEBUG"
# Help of wide terminals has lines of this length.
_SETTINGS = {"max_content_width": 100}

F = TypeVar("F", bound=Callable[..., None])


@dataclass(frozen=True, slots=True)
class OptionsOf:
    """Marks a parameter as the options of a specification, of which a command gets a dict of those given.

    ``Annotated[dict[str, Any], OptionsOf(WrenchSpec)]`` serves specifications with defaults that follow from
    other fields, and commands that must know what was given.
    """

    spec: type


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"tactile-toolkit {__version__}\n")
        raise typer.Exit


def _show_tracebacks(wanted: bool) -> None:
    if wanted:
        os.environ[_DEBUG_VARIABLE] = "1"


def _use_token(token: str) -> str:
    """Hand a token to libraries and worker processes."""
    os.environ["HF_TOKEN"] = token
    return token


# Eager ones count whatever is wrong with others.
Debug = Annotated[
    bool,
    typer.Option("--debug", callback=_show_tracebacks, is_eager=True, help="Show the traceback of an error."),
]
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
]
_TOKEN = text(metavar="TOKEN", read=_use_token, help="Token of the Hugging Face Hub, in place of HF_TOKEN.")


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
            usual = "Options" if parameter.param_type_name == "option" else "Arguments"
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
            if os.environ.get(_DEBUG_VARIABLE):
                raise
            if isinstance(error, ToolkitError):
                # What differs is a field of the manifest, which need not be an option of this command.
                is_of_folder = isinstance(error, SpecMismatchError)
                message = str(error) if is_of_folder else self._with_option(str(error))
                code = error.exit_code
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
        app.command(name, **settings)(_with_options(function, known))  # type: ignore[arg-type]
        return function

    return add


def _with_options(function: Callable[..., None], known: Mapping[str, Any]) -> Callable[..., None]:
    """Return a function that takes the fields of option groups one by one."""
    # Annotations are text: those of a group are names of the group's module, where Typer would not look.
    hints = get_type_hints(function, include_extras=True)
    taken = inspect.signature(function).parameters
    groups = {name: _group(hints[name], each) for name, each in taken.items() if name not in known}

    @wraps(function)
    def call(context: typer.Context, **values: Any) -> None:
        # Besides taking a second, pyarrow's import of pandas swallows a Ctrl-C that comes during it.
        from tactile_toolkit.run import skip_pandas

        skip_pandas()
        arguments = {name: value for name, value in known.items() if name in taken}
        for name, group in groups.items():
            held = {each.name: values[each.name] for each in group}
            if is_dataclass(hints[name]):
                arguments[name] = hints[name](**held)
            elif _mark(hints[name]) is not None:
                arguments[name] = {each: held[each] for each in held if _is_given(context, each)}
            else:
                arguments[name] = values[name]
        function(**arguments)

    # Typer asks both; two options of one name are refused by `Signature`.
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    options = [each for group in groups.values() for each in group]
    eager = {"debug": Debug, "version": Version}
    everywhere = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=hint)
        for name, hint in eager.items()
    ]
    parameters = [context, *options, _parameter("token", _TOKEN), *everywhere]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {
        name: each.annotation for name, each in inspect.signature(call).parameters.items()
    }
    return call


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _mark(hint: Any) -> OptionsOf | None:
    return next((each for each in get_args(hint)[1:] if isinstance(each, OptionsOf)), None)


def _group(hint: Any, parameter: inspect.Parameter) -> list[inspect.Parameter]:
    """Return what a parameter of a function takes from the command line: itself, or the fields of a group."""
    mark = _mark(hint)
    group: Any = hint if mark is None else mark.spec
    if not is_dataclass(group):
        return [_parameter(parameter.name, parameter.default)]
    found = []
    for each in fields(group):
        rule = rule_of(each)
        if rule is not None and "help" in rule.option:
            found.append(_parameter(each.name, each, is_optional=mark is not None))
    return found


def _parameter(name: str, declared: Field[Any], *, is_optional: bool = False) -> inspect.Parameter:
    """Return a parameter as Typer takes it; an ``is_optional`` one needs no value."""
    rule: Any = rule_of(declared)
    text: OptionText = rule.option
    default = None if declared.default is MISSING and is_optional else declared.default
    shown: Any = default
    kind: Any = rule.kind
    if "read" in text:
        # What is read of a text has a default of another type, which Typer would convert.
        kind = str
        shown = default if default is MISSING else str(default) if isinstance(default, (str, Path)) else None
    elif rule.choices:
        kind = Literal[rule.choices]
    if rule.choices and isinstance(default, tuple):  # Typer takes lists of enumerations, but not of literals
        kind = list[StrEnum("Choice", [(word, word) for word in rule.choices])]  # type: ignore[misc]
    elif "several" in text:
        kind = list[kind]
    kind = kind | None if shown is None else kind
    shown = inspect.Parameter.empty if shown is MISSING else shown
    hint = Annotated[kind, _declaration(name, rule, default)]
    # By keyword only: options without a default may stand behind those with one.
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=shown, annotation=hint)


def _declaration(name: str, rule: Rule, default: Any) -> Any:
    """Return the argument or option by which Typer takes the value of a field."""
    text = rule.option
    names = text.get("name", f"--{name.replace('_', '-')}").split()
    label = text.get("metavar", name) if "argument" in text else names[0].partition("/")[0]
    metavar = None if rule.kind is bool or (rule.choices and "read" not in text) else metavar_of(name, rule)
    if rule.kind is bool and default and "/" not in names[0]:
        names = [f"{names[0]}/--no-{names[0][2:]}"]

    def check(context: typer.Context, value: Any) -> Any:
        """Return the one spelling of a value that was given; InputError where it does not fit."""
        if not _is_given(context, name):
            return default
        expected = rule.expected.removeprefix("None or ")  # that is to leave the option out
        if "read" in text:
            value = list(map(text["read"], value)) if "several" in text else text["read"](value)
        return check_value(replace(rule, expected=expected), value, label)

    settings: dict[str, Any] = {
        "help": text.get("help"),
        "metavar": metavar,
        "show_default": text.get("shown") or True,
        "rich_help_panel": text.get("panel"),
        "callback": check,
    }
    return typer.Argument(**settings) if "argument" in text else typer.Option(*names, **settings)


class _Output:
    """A standard stream that ends the command when it takes no more: a closed pipe quietly, as other tools.

    Caught here, because click would end with another exit code, and because the same errors of a file, or of
    a connection to the Hub, mean something else.
    """

    def __init__(self, stream: Any) -> None:
        # Python has none where the caller closed it.
        self._stream = stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
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
            with suppress(SystemExit):  # of a stderr that takes no more either
                sys.stderr.write(
                    f"error: the output cannot be written: {error.strerror}; next: redirect it to "
                    "another place\n"
                )
            raise SystemExit(StorageError.exit_code) from error


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
            if os.environ.get(_DEBUG_VARIABLE) or not is_full:
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
