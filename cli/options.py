"""Options: those that several commands share, and how declared fields become options of Typer."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_args, get_type_hints

import typer

from cli.output import Sink
from tactile_toolkit import __version__, places, run, store
from tactile_toolkit.checked_fields import Rule, integer, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import alternatives

if TYPE_CHECKING:
    from tactile_toolkit.sets import DataSet

data_set = lazy("tactile_toolkit.sets:DataSet")  # imports pyarrow

JOB = "Job options"
"""Panel of the help for options that decide how the work is done, not what is made."""
DEBUG_VARIABLE = "TACTILE_TOOLKIT_DEBUG"
"""Environment variable; if it is set, errors show their traceback."""
UserOptions: TypeAlias = dict[str, Any]
"""The options that a user gave, by the name of their field."""


def parse_local_path(text: str | Path) -> Path:
    """Read a local path: ``~`` is the home folder, and addresses such as ``s3://...`` are refused.

    ``Path`` alone would turn ``//`` into ``/``, so that an address would become a local folder.
    """
    if "://" in str(text):
        raise InputError(
            f"{str(text)!r} is a remote address; expected a local path",
            next="give a path of this machine",
        )
    return store.expanded(text)


def _runner_name(words: str) -> str:
    name, equals, address = words.partition("=")
    if name not in ("processes", "ray") or (equals and (name != "ray" or not address)):
        raise InputError(f"{words!r} is not a runner; expected processes, ray, or ray=HOST:PORT")
    return words


def parse_path(text: str | Path) -> str:
    """Read a folder or file, local (``~`` is the home folder) or in a store (``s3://BUCKET/FOLDER``)."""
    path = store.local_path(str(text))
    return store.open_folder(str(text)).root if path is None else str(path)


def argument(metavar: str, help: str, **option: Any) -> Any:
    """Declare a positional argument."""
    return text(option.pop("default", MISSING), argument=True, metavar=metavar, help=help, **option)


def out_folder(default: Any = MISSING) -> Any:
    """Declare the folder that a command writes, on this machine or in an object store."""
    return text(default, name="--out -o", metavar="DIR", read=parse_path, help="Folder to write.")


def local_out_folder(default: str) -> Any:
    """Declare the folder that a command writes on this machine."""
    return text(Path(default), name="--out -o", metavar="DIR", read=parse_local_path, help="Folder to write.")


NAME = argument(
    "NAME", "Data set: a folder, a Parquet file, a short name (`tactile list`), USER/NAME on the Hub, s3://."
)
FOLDER = argument("DIR", "Folder of a data set.", read=parse_path)
WORKERS = integer(
    0, name="--workers -w", panel=JOB, help="Number of workers; 0 means one per processor core."
)
DRY_RUN = switch(False, panel=JOB, help="Print what would be made, and write nothing.")
OVERWRITE = switch(False, panel=JOB, help="Replace what another run left in the folder.")
SOURCE = "Source"
"""Panel of the help for options of how a data set is opened."""
GENERAL = "General"
"""Panel of the help for options that every command has."""
REVISION = text(metavar="REV", panel=SOURCE, help="Branch, tag or commit of a Hub data set.")
CONFIG = text(metavar="NAME", panel=SOURCE, help="Configuration, if the card of the data set has several.")
KIND = text(
    metavar="KIND",
    panel=SOURCE,
    complete=("mnist3d", "starstruck", "realtouch", "tactile_sim", "episodes", "wrench"),
    help="Kind of the rows, such as mnist3d or starstruck, where their columns do not tell it.",
)


INCOMPLETE = switch(False, panel=SOURCE, help="Use the finished shards of an unfinished data set.")


@dataclass(frozen=True, slots=True)
class NameOptions:
    """Options of all commands that open a data set by its name."""

    revision: str | None = REVISION
    config_name: str | None = CONFIG

    def open(self, sink: Sink, name: str, *, allow_incomplete: bool = True) -> places.Place:
        """Open a data set by its name; print a note if it is unfinished, and not refused for that."""
        place = places.open_place(
            name, revision=self.revision, config=self.config_name, allow_incomplete=allow_incomplete
        )
        if allow_incomplete and place.unfinished:
            sink.info(f"note: {place.name} is unfinished: {place.unfinished}")
        return place


@dataclass(frozen=True, slots=True)
class SourceOptions(NameOptions):
    """Options of commands for which an unfinished data set is an error unless it is allowed."""

    allow_incomplete: bool = INCOMPLETE

    def open_source(self, sink: Sink, name: str) -> places.Place:
        """Open a data set by its name; reading an unfinished one is an error unless it is allowed."""
        return self.open(sink, name, allow_incomplete=self.allow_incomplete)


@dataclass(frozen=True, slots=True)
class AnySourceOptions(SourceOptions):
    """Options of such commands that take data sets of any kind."""

    kind: str | None = KIND

    def open_set(self, sink: Sink, name: str) -> DataSet:
        """Open a data set of some kind by its name."""
        place = self.open_source(sink, name)
        opened: DataSet = data_set(place, place.choose_kind(self.kind))
        return opened


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of all commands that write a data set folder: how this is done."""

    workers: int = WORKERS
    runner: str = text(
        "processes",
        panel=JOB,
        metavar="processes|ray[=HOST:PORT]",
        read=_runner_name,
        help="Where the work is done: on this machine, or on a Ray cluster (--workers 0: all its cores).",
    )
    part: str | None = text(
        panel=JOB,
        metavar="K/N|auto[/N]",
        help="Make every N-th shard only, from the K-th on, as one job of an array; auto: as Slurm or "
        "Kubernetes number this job.",
    )
    finish: bool = switch(
        False, panel=JOB, help="Complete the data set that all parts have made, or name the missing shards."
    )
    repair: bool = switch(
        False, panel=JOB, help="Check the content of finished shards, and make damaged ones again."
    )
    overwrite: bool = OVERWRITE

    def run_keywords(self) -> store.RunKeywords:
        """Return these options as keywords of the functions that write data sets."""
        keywords: store.RunKeywords = {
            "workers": process_count(self.workers),
            "finish": self.finish,
            "check": self.repair,
            "overwrite": self.overwrite,
        }
        if self.runner != "processes":
            keywords["workers"] = run.runner_for(self.workers, self.runner)
        if self.part is not None:
            keywords["part"] = self.part
        return keywords

    def given(self) -> dict[str, object]:
        """Return the options that apply to the shards of a data set, where they are given."""
        names = ("runner", "part", "finish", "repair")
        return {name: getattr(self, name) != getattr(RunOptions(), name) for name in names}


@dataclass(frozen=True, slots=True)
class GenerateOptions(RunOptions):
    """Options of all commands that make a data set from nothing or from one of another kind."""

    dry_run: bool = DRY_RUN


def process_count(workers: int) -> int:
    """Return the number of processes for ``--workers``; 0 means one per processor core."""
    return workers or run.usable_cores()


def refuse(values: Mapping[str, object], what: str) -> None:
    """Refuse the first option that has a value, as it has no effect on ``what`` (InputError)."""
    for name, value in values.items():
        if value:
            raise InputError(f"has no effect on {what}", next="leave it out", field=name)


@dataclass(frozen=True, slots=True)
class FileJobOptions:
    """Options of commands that write other files than data sets."""

    workers: int = WORKERS
    overwrite: bool = OVERWRITE
    dry_run: bool = DRY_RUN


@dataclass(frozen=True, slots=True)
class OptionsOf:
    """Marks a parameter as the options of a specification; the command gets those that were given.

    ``Annotated[UserOptions, OptionsOf(WrenchSpec)]`` is for specifications whose defaults follow from other
    fields, and for commands that must know which options were given.
    """

    spec: type


def _print_version(is_given: bool) -> None:
    if is_given:
        sys.stdout.write(f"tactile-toolkit {__version__}\n")
        raise typer.Exit


def _show_tracebacks(is_given: bool) -> None:
    if is_given:
        os.environ[DEBUG_VARIABLE] = "1"


def _use_token(token: str) -> str:
    """Hand a token to libraries and worker processes."""
    os.environ["HF_TOKEN"] = token
    return token


# Eager options are handled first, even if other options are invalid.
Debug = Annotated[
    bool,
    typer.Option(
        "--debug",
        callback=_show_tracebacks,
        is_eager=True,
        rich_help_panel=GENERAL,
        help="Show the traceback of an error.",
    ),
]
Version = Annotated[
    bool,
    typer.Option(
        "--version",
        callback=_print_version,
        is_eager=True,
        rich_help_panel=GENERAL,
        help="Print the version and exit.",
    ),
]
_TOKEN = text(
    metavar="TOKEN",
    panel=SOURCE,
    read=_use_token,
    help="Token of the Hugging Face Hub, instead of HF_TOKEN.",
)


def with_options(
    function: Callable[..., None], known: Mapping[str, object], *, asks_hub: bool = False
) -> Callable[..., None]:
    """Return a function for Typer, which takes each field of an option group as an option.

    One that may ask the Hub has ``--token``: each with ``--revision``, and others if ``asks_hub``.
    """
    # Annotations are strings. Those of a group name types of its own module, where Typer would not look.
    hints = get_type_hints(function, include_extras=True)
    taken = inspect.signature(function).parameters
    groups = {name: _group(hints[name], taken[name]) for name in taken if name not in known}
    options = [option for group in groups.values() for option in group]

    @wraps(function)
    def call(context: typer.Context, **values: object) -> None:
        # Without pandas, whose import takes a second and swallows a Ctrl-C.
        run.prepare_command(quiet=values.get("quiet") is True)
        _refuse_without_effect(context, options)
        arguments = {name: value for name, value in known.items() if name in taken}
        for name, group in groups.items():
            group_values = {option.name: values[option.name] for option in group}
            if is_dataclass(hints[name]):
                arguments[name] = hints[name](**group_values)
            elif _mark(hints[name]) is not None:
                arguments[name] = {key: group_values[key] for key in group_values if _is_given(context, key)}
            else:
                arguments[name] = values[name]
        function(**arguments)

    # Typer reads the signature and the annotations. `Signature` refuses two options of one name.
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    eager = {"debug": Debug, "version": Version}
    global_options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=hint)
        for name, hint in eager.items()
    ]
    token = []
    if asks_hub or "revision" in {option.name for option in options}:
        token = [_parameter("token", _TOKEN)]
    parameters = [context, *options, *token, *global_options]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call


def option_label(parameter: Any) -> str:
    """Return the name of an option, or the placeholder of an argument, for messages."""
    if parameter.param_type_name == "argument":
        return str(parameter.metavar or parameter.name).upper()
    return str(parameter.opts[0])


def _refuse_without_effect(context: typer.Context, options: Iterable[inspect.Parameter]) -> None:
    """Refuse a given option whose declared need is not met; InputError names both."""
    labels = {parameter.name: option_label(parameter) for parameter in context.command.params}
    for option in options:
        needs = get_args(option.annotation)[2].option.get("needs")
        if not needs or not _is_given(context, option.name):
            continue
        field, _, words = needs.partition("=")
        value = context.params[field]
        words_given = list(map(str, value if isinstance(value, (list, tuple)) else [value or ""])) or [""]
        is_met = bool(value)
        if words and (not value or isinstance(value, (str, list, tuple))):  # not what a text was read as
            is_met = not {*words.split("|")}.isdisjoint(words_given)
        if not is_met:
            known = [word for word in words.split("|") if word]
            what = " ".join(["has no effect without", labels[field], *filter(None, [alternatives(known)])])
            if words and value:
                shown = ", ".join(words_given)
                what = f"has no effect with {labels[field]} {shown}; expected {alternatives(known)}"
            needed = next(parameter for parameter in context.command.params if parameter.name == field)
            # The first of several forms, such as `256x256|prusa-mk4`; a switch has none.
            example = known[0] if known else str(needed.metavar or "").partition("|")[0]
            step = f"add {labels[field]} {example}".rstrip()
            raise InputError(what, next=f"{step}, or leave it out", field=option.name)


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _mark(hint: object) -> OptionsOf | None:
    return next((mark for mark in get_args(hint)[1:] if isinstance(mark, OptionsOf)), None)


def _group(hint: object, parameter: inspect.Parameter) -> list[inspect.Parameter]:
    """Return the options of a parameter of a function: the parameter itself, or the fields of its group."""
    mark = _mark(hint)
    group = hint
    if mark is not None:
        group = mark.spec
    if not is_dataclass(group):
        return [_parameter(parameter.name, parameter.default)]
    options = []
    for field in fields(group):
        rule = Rule.of(field)
        if rule is not None and "help" in rule.option:
            options.append(_parameter(field.name, field, is_optional=mark is not None))
    return options


def _parameter(name: str, declared: Field[Any], *, is_optional: bool = False) -> inspect.Parameter:
    """Return a parameter as Typer takes it; an ``is_optional`` one needs no value."""
    rule: Any = Rule.of(declared)
    default = declared.default
    if default is MISSING and is_optional:
        default = None
    shown = _shown_default(rule, default)
    kind: Any = _typer_type(rule, default)
    if shown is None:
        kind |= None
    hint = Annotated[kind, _declaration(name, rule, default), rule]
    # Keyword-only, because an option without a default may follow one with a default.
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=shown, annotation=hint)


def _shown_default(rule: Rule, default: object) -> Any:
    """Return the default for Typer: text, if the value is read from text."""
    if default is MISSING:
        return inspect.Parameter.empty
    # Typer would convert a default of another type.
    if "read" in rule.option and default is not None:
        return str(default) if isinstance(default, (str, Path)) else None
    return default


def _typer_type(rule: Rule, default: object) -> Any:
    """Return the type by which Typer reads a value."""
    kind: Any = rule.kind
    if "read" in rule.option:
        kind = str
    elif rule.choices:
        kind = Literal[rule.choices]
    if rule.choices and isinstance(default, tuple):  # Typer takes lists of enumerations, but not of literals
        return list[StrEnum("Choice", [(word, word) for word in rule.choices])]  # type: ignore[misc]
    if "several" in rule.option:
        return list[kind]
    return kind


def _declaration(name: str, rule: Rule, default: object) -> Any:
    """Return the argument or option by which Typer takes the value of a field."""
    option = rule.option
    names = option.get("name", f"--{name.replace('_', '-')}").split()
    metavar: str | None = rule.metavar(name)
    if rule.kind is bool or (rule.choices and "read" not in option):  # Typer lists the choices
        metavar = None
    if rule.kind is bool and default and "/" not in names[0]:
        names = [f"{names[0]}/--no-{names[0][2:]}"]

    def check(context: typer.Context, value: Any) -> Any:
        """Return the normalized value of a given option, or the default; InputError if it is not valid."""
        if not _is_given(context, name):
            return default
        expected = rule.expected.removeprefix("None or ")  # None is an option that is left out
        if "read" in option and "several" in option:
            value = list(map(option["read"], value))
        elif "read" in option:
            value = option["read"](value)
        return replace(rule, expected=expected).checked(value, name)

    def complete(incomplete: str) -> list[str]:
        """Return the words that shells offer, beside values of other forms."""
        return [word for word in option.get("complete", ()) if word.startswith(incomplete)]

    settings: dict[str, Any] = {
        "help": option.get("help"),
        "metavar": metavar,
        "show_default": option.get("shown") or True,
        "rich_help_panel": option.get("panel"),
        "callback": check,
    }
    if "complete" in option:
        settings["autocompletion"] = complete
    if "argument" in option:
        return typer.Argument(**settings)
    return typer.Option(*names, **settings)
