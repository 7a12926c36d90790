"""Conversion of the declared fields of functions and specifications to options of Typer."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_type_hints

import typer

from tactile_toolkit import __version__, run
from tactile_toolkit.checked_fields import Rule, check_value, metavar_of, rule_of, text

DEBUG_VARIABLE = "TACTILE_TOOLKIT_DEBUG"
"""Environment variable; if it is set, errors show their traceback."""


Given: TypeAlias = dict[str, Any]
"""The options that a user gave, by the name of their field."""


@dataclass(frozen=True, slots=True)
class OptionsOf:
    """Marks a parameter as the options of a specification; the command gets those that were given.

    ``Annotated[Given, OptionsOf(WrenchSpec)]`` is for specifications whose defaults follow from other fields,
    and for commands that must know which options were given.
    """

    spec: type


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"tactile-toolkit {__version__}\n")
        raise typer.Exit


def _show_tracebacks(wanted: bool) -> None:
    if wanted:
        os.environ[DEBUG_VARIABLE] = "1"


def _use_token(token: str) -> str:
    """Hand a token to libraries and worker processes."""
    os.environ["HF_TOKEN"] = token
    return token


# Eager options are handled first, even if other options are invalid.
Debug = Annotated[
    bool,
    typer.Option("--debug", callback=_show_tracebacks, is_eager=True, help="Show the traceback of an error."),
]


Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
]


_TOKEN = text(metavar="TOKEN", read=_use_token, help="Token of the Hugging Face Hub, instead of HF_TOKEN.")


def with_options(
    function: Callable[..., None], known: Mapping[str, object], *, asks_hub: bool = False
) -> Callable[..., None]:
    """Return a function for Typer, which takes each field of an option group as an option.

    One that may ask the Hub has ``--token``: each with ``--revision``, and others if ``asks_hub``.
    """
    # Annotations are strings. Those of a group name types of its own module, where Typer would not look.
    hints = get_type_hints(function, include_extras=True)
    taken = inspect.signature(function).parameters
    groups = {name: _group(hints[name], each) for name, each in taken.items() if name not in known}

    @wraps(function)
    def call(context: typer.Context, **values: object) -> None:
        # pyarrow would import pandas, which takes a second and swallows a Ctrl-C.
        run.skip_pandas()
        arguments = {name: value for name, value in known.items() if name in taken}
        for name, group in groups.items():
            fields_of = {each.name: values[each.name] for each in group}
            if is_dataclass(hints[name]):
                arguments[name] = hints[name](**fields_of)
            elif _mark(hints[name]) is not None:
                arguments[name] = {each: fields_of[each] for each in fields_of if _is_given(context, each)}
            else:
                arguments[name] = values[name]
        function(**arguments)

    # Typer reads the signature and the annotations. `Signature` refuses two options of one name.
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    options = [each for group in groups.values() for each in group]
    eager = {"debug": Debug, "version": Version}
    global_options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=hint)
        for name, hint in eager.items()
    ]
    token = []
    if asks_hub or any(each.name == "revision" for each in options):
        token = [_parameter("token", _TOKEN)]
    parameters = [context, *options, *token, *global_options]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {
        name: each.annotation for name, each in inspect.signature(call).parameters.items()
    }
    return call


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _mark(hint: object) -> OptionsOf | None:
    return next((each for each in get_args(hint)[1:] if isinstance(each, OptionsOf)), None)


def _group(hint: object, parameter: inspect.Parameter) -> list[inspect.Parameter]:
    """Return the options of a parameter of a function: the parameter itself, or the fields of its group."""
    mark, group = _mark(hint), hint
    if mark is not None:
        group = mark.spec
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
    default = declared.default
    if default is MISSING and is_optional:
        default = None
    shown = _shown_default(rule, default)
    kind: Any = _typer_type(rule, default)
    if shown is None:
        kind |= None
    hint = Annotated[kind, _declaration(name, rule, default)]
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
    text, is_argument = rule.option, "argument" in rule.option
    names = text.get("name", f"--{name.replace('_', '-')}").split()
    label = names[0].partition("/")[0]
    if is_argument:
        label = text.get("metavar", name)
    metavar: str | None = metavar_of(name, rule)
    if rule.kind is bool or (rule.choices and "read" not in text):  # Typer lists the choices
        metavar = None
    if rule.kind is bool and default and "/" not in names[0]:
        names = [f"{names[0]}/--no-{names[0][2:]}"]

    def check(context: typer.Context, value: Any) -> Any:
        """Return the normalized value of a given option, or the default; InputError if it is not valid."""
        if not _is_given(context, name):
            return default
        expected = rule.expected.removeprefix("None or ")  # None is an option that is left out
        if "read" in text and "several" in text:
            value = list(map(text["read"], value))
        elif "read" in text:
            value = text["read"](value)
        return check_value(replace(rule, expected=expected), value, label)

    def complete(incomplete: str) -> list[str]:
        """Return the words that shells offer, beside values of other forms."""
        return [word for word in text.get("complete", ()) if word.startswith(incomplete)]

    settings: dict[str, Any] = {
        "help": text.get("help"),
        "metavar": metavar,
        "show_default": text.get("shown") or True,
        "rich_help_panel": text.get("panel"),
        "callback": check,
    }
    if "complete" in text:
        settings["autocompletion"] = complete
    if is_argument:
        return typer.Argument(**settings)
    return typer.Option(*names, **settings)
