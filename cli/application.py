"""What all command lines have in common: how they are built, the options of every command, how they end."""

from __future__ import annotations

import contextlib
import errno
import inspect
import os
import re
import sys
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

from tactile_toolkit.checked_fields import Rule, check_value, metavar_of, rule_of
from tactile_toolkit.errors import InputError, StorageError, ToolkitError
from tactile_toolkit.printable import printable

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
_EXIT_CLOSED_PIPE = 141
"""128 and the number of SIGPIPE: what a shell tells of `cat`, `grep` and others whose reader left."""

_DEBUG_VARIABLE = "TACTILE_TOOLKIT_DEBUG"
_SETTINGS = {"max_content_width": 100}
"""Help of wide terminals has lines of this length."""

F = TypeVar("F", bound=Callable[..., None])
Former = Mapping[str, tuple[str, Callable[[str], str] | None]]
"""Spellings of an earlier version, with those of now and what converts their values."""


@dataclass(frozen=True, slots=True)
class OptionsOf:
    """Marks a parameter as the options of a specification, of which a command gets a dict of those given.

    ``Annotated[dict[str, Any], OptionsOf(WrenchSpec)]`` serves specifications with defaults that follow from
    other fields, and commands that must know what was given. ``with_retired`` takes fields without help, too:
    former options, which stand in the file of ``--config`` now.
    """

    spec: type
    with_retired: bool = False


def _print_version(wanted: bool) -> None:
    if wanted:
        from tactile_toolkit.versions import toolkit_version

        sys.stdout.write(f"tactile-toolkit {toolkit_version()}\n")
        raise typer.Exit


Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Token = Annotated[
    str | None,
    typer.Option("--token", metavar="TOKEN", help="Token of the Hugging Face Hub, in place of HF_TOKEN."),
]
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
]


@dataclass(frozen=True, slots=True)
class _Everywhere:
    """Options of every command."""

    token: Token = None
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
    """A command with its options by panel, which takes former spellings and refuses values in plain words."""

    former: Former

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, list(self._renewed(args)))
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")
            raise

    def _renewed(self, args: list[str]) -> Iterator[str]:
        """Give arguments their spelling of now; former ones work for one version, with a warning."""
        words = iter(args)
        for word in words:
            name, equals, value = word.partition("=")
            now, convert = self.former.get(name, ("", None))
            if not now:
                yield word
                if word == "--":  # all that follows are names
                    yield from words
                continue
            if convert is not None:
                now = f"{now}={convert(value if equals else next(words, ''))}"
                equals = value = ""
            _warn(f"{name} is deprecated; next: write {now}")
            yield f"{now}{equals}{value}"

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


def _warn(text: str) -> None:
    sys.stderr.write(f"warning: {printable(text)}\n")


@dataclass(frozen=True, slots=True)
class _Taken:
    """A parameter of the command line: as Typer sees it, as users write it, and what it takes."""

    parameter: inspect.Parameter
    option: str
    rule: Rule | None = None
    default: Any = None
    is_retired: bool = False

    @property
    def name(self) -> str:
        return self.parameter.name


def command(app: typer.Typer, name: str | None = None, former: Former | None = None) -> Callable[[F], F]:
    """Add a function to a command line, by its own name or another one; errors become messages.

    A parameter whose type is a dataclass is a group of options, and the function gets the object; marked with
    :class:`OptionsOf` it gets a dict of the options that were given. Fields and defaults of parameters may be
    declared as in `tactile_toolkit.checked_fields`, or in Typer's own way where several commands share them.
    Groups may stand behind defaults where parameters are keyword-only.

    ``former`` maps spellings of an earlier version to those of now, and to what converts their values.
    """

    def add(function: F) -> F:
        call, spellings = _with_groups(function)
        kind = type("_Command", (_Command,), {"former": {**spellings, **(former or {})}})
        # The first paragraph: the library would cut it where a line of the list of commands ends.
        summary = (function.__doc__ or "").partition("\n\n")[0]
        app.command(name, cls=kind, short_help=summary, context_settings=_SETTINGS)(call)
        return function

    return add


def _with_groups(function: Callable[..., None]) -> tuple[Callable[..., None], Former]:
    """Return a function that takes the fields of option groups one by one, and former spellings of these."""
    # Annotations are text: those of a group are names of the group's module, where Typer would not look.
    hints = get_type_hints(function, include_extras=True)
    groups = {
        each.name: _group(each.name, hints[each.name], each.default)
        for each in inspect.signature(function).parameters.values()
    }
    taken = [each for group in groups.values() for each in group] + _group("", _Everywhere, None)
    options = {each.name: each.option for each in taken}

    @wraps(function)
    def call(context: typer.Context, **values: Any) -> None:
        with _errors_reported(values["debug"], options):
            if values["token"] is not None:
                os.environ["HF_TOKEN"] = values["token"]
            given = {each.name for each in taken if _was_given(context, each.name)}
            for each in taken:
                if each.rule is not None:
                    is_given = each.name in given
                    values[each.name] = _checked(each, values[each.name]) if is_given else each.default
            function(**{name: _argument(hints[name], group, values, given) for name, group in groups.items()})

    # Typer asks both; two options of one name are refused by `Signature`.
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    parameters = [context, *(each.parameter for each in taken)]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    ruled = ((each.option, each.rule.option) for each in taken if each.rule is not None)
    return call, {was: (now, None) for now, text in ruled for was in text.get("was", "").split()}


def _was_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _checked(taken: _Taken, value: Any) -> Any:
    """Return the one spelling of a value that was given; InputError where it does not fit."""
    if taken.is_retired:
        _warn(f"{taken.option} is deprecated; next: write {taken.name} = {value} into the file of --config")
    rule: Any = taken.rule
    read = rule.option.get("read")
    rule = replace(rule, expected=rule.expected.removeprefix("None or "))  # that is to leave the option out
    return check_value(rule, value if read is None else read(value), taken.option)


def _argument(hint: Any, group: list[_Taken], values: Mapping[str, Any], given: Container[str]) -> Any:
    """Return what a function gets for a parameter: a group of options, those that were given, or a value."""
    held = {each.name: values[each.name] for each in group}
    if is_dataclass(hint):
        return hint(**held)  # type: ignore[operator]
    if _mark(hint) is not None:
        return {name: value for name, value in held.items() if name in given}
    return next(iter(held.values()))


def _mark(hint: Any) -> OptionsOf | None:
    return next((each for each in get_args(hint)[1:] if isinstance(each, OptionsOf)), None)


def _group(name: str, hint: Any, default: Any) -> list[_Taken]:
    """Return what a parameter of a function takes from the command line: itself, or the fields of a group."""
    mark = _mark(hint)
    group: Any = mark.spec if mark is not None else hint
    if not is_dataclass(group):
        return [_taken(name, hint, default)]
    # Specifications name types that only checkers of types import; Typer's own declarations are all there.
    is_ruled = all(rule_of(each) is not None for each in fields(group))
    hints = {} if is_ruled or mark is not None else get_type_hints(group, include_extras=True)
    found = []
    for each in fields(group):
        rule = rule_of(each)
        if rule is None and get_origin(hints.get(each.name)) is Annotated:
            found.append(_taken(each.name, hints[each.name], each.default))
        elif rule is not None and ("help" in rule.option or (mark is not None and mark.with_retired)):
            found.append(_taken(each.name, None, each, is_optional=mark is not None))
    return found


def _taken(name: str, hint: Any, declared: Any, *, is_optional: bool = False) -> _Taken:
    """Return one parameter; ``declared`` is its default, or a field of `checked_fields`."""
    option = f"--{name.replace('_', '-')}"
    rule = rule_of(declared) if isinstance(declared, Field) else None
    if rule is None:
        # Typer keeps the first name that is declared in the place of the default.
        first = getattr(getattr(hint, "__metadata__", [None])[0], "default", None)
        return _Taken(_parameter(name, hint, declared), first if isinstance(first, str) else option)
    default = None if declared.default is MISSING and is_optional else declared.default
    names = rule.option.get("name", option).split()
    # What is read of a text has a default of another type, which Typer would convert.
    shown = None if "read" in rule.option and default is not MISSING else default
    parameter = _parameter(name, _annotation(name, names, shown, rule), shown)
    return _Taken(parameter, names[0].split("/")[0], rule, default, "help" not in rule.option)


def _parameter(name: str, hint: Any, default: Any) -> inspect.Parameter:
    default = inspect.Parameter.empty if default is MISSING else default
    # By keyword only: options without a default may stand behind those with one.
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _annotation(name: str, names: list[str], default: Any, rule: Rule) -> Any:
    """Return the type and the option by which Typer takes the value of a field."""
    text, metavar = rule.option, None
    kind: Any = str if "read" in text else rule.kind
    if rule.choices:
        kind = Literal[rule.choices]
        if isinstance(default, tuple):  # Typer takes lists of enumerations, but not of literals
            words: Any = StrEnum("Choice", [(word, word) for word in rule.choices])  # type: ignore[misc]
            kind = list[words]
    elif kind is bool:
        names = [f"{names[0]}/--no-{names[0][2:]}"] if default and "/" not in names[0] else names
    else:
        metavar = metavar_of(name, rule)
    declared = typer.Option(
        *names,
        help=text.get("help"),
        metavar=metavar,
        show_default=text.get("shown") or True,
        rich_help_panel=text.get("panel"),
        autocompletion=text.get("complete"),
        hidden="help" not in text,
    )
    return Annotated[kind | None if default is None else kind, declared]


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

            lack = of_the_process(error) or f"{error.strerror}; next: give another path (--debug shows where)"
            message = f"{str(error.filename)!r}: {lack}"
            code = InputError.exit_code
        else:
            raise
        sys.stderr.write(f"error: {printable(message)}\n")
        raise typer.Exit(code) from error
    except KeyboardInterrupt as error:
        said = str(error) or "interrupted; what was finished is kept, the same command continues from there"
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
    info: Any = _Output(sys.stderr or _nowhere())
    with redirect_stdout(output), redirect_stderr(info):
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
