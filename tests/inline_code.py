"""Inline code of a page: check that its commands, options, names and parameters exist."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from itertools import pairwise
from typing import Any

import typer.main

import mnist3d
from tactile_toolkit.errors import MissingExtraError
from tests.pages import expression
from tests.unchanged.record import PACKAGES

__all__ = ["fault"]

_ROOTS = (*(package for package in PACKAGES if "." not in package), "tactile_toolkit")
_COMMAND_LINES = (
    "mnist3d",
    "starstruck",
    "realtouch",
    "tactile_sim",
    "env_assets",
    "tactile_envs",
    "tactile",
)
_EXAMPLES = {"digits": mnist3d.DigitDataset, "digit": mnist3d.DigitRecord}
"""What pages call so."""


def fault(code: str) -> str | None:
    """Return the problem of inline code that names commands or functions of the toolkit."""
    return _fault_of_command(code.split()) or next(_faults_of_names(expression(code)), None)


@cache
def _commands() -> dict[str, dict[str, set[str]]]:
    """Return the options of each command of each command line."""
    groups: dict[str, Any] = {
        name.replace("_", "-"): typer.main.get_command(import_module(f"cli.{name}").app)
        for name in _COMMAND_LINES
    }
    return {
        line: {
            name: {text for each in command.params for text in each.opts}
            for name, command in group.commands.items()
        }
        for line, group in groups.items()
    }


def _fault_of_command(words: list[str]) -> str | None:
    lines = _commands()
    named = words[0] in lines
    rest = words[1:] if named else words
    options = {word.partition("=")[0] for word in rest if word.startswith("--")}
    of_one = [each for name, each in lines.items() if name == words[0] or not named]
    known = {command for each in of_one for command in each}
    if not rest or not (named or options):
        return None
    heads: list[str | None] = [None]
    if not rest[0].startswith("--"):
        heads = [rest[0], *(word for before, word in pairwise(rest) if before == "|")]
        if not named and heads[0] not in known:
            return None  # of other programs
    for head in heads:
        takers = [taken for each in of_one for name, taken in each.items() if head in (None, name)]
        if not any(options <= taken for taken in takers):
            return f"no such command or option: {' '.join([head or '', *sorted(options)])}"
    return None


def _faults_of_names(tree: ast.AST | None) -> Iterator[str]:
    for node in ast.walk(tree) if tree else ():
        try:
            found = _named(node.func if isinstance(node, ast.Call) else node)
        except AttributeError as error:
            yield str(error)
            continue
        except MissingExtraError:
            continue  # checked if the extra is installed
        if not isinstance(node, ast.Call) or found is None:
            continue
        given = [None for each in node.args if not _is_ellipsis(each)]
        signature = inspect.signature(found)
        bind = signature.bind_partial if any(map(_is_ellipsis, node.args)) else signature.bind
        # A method is looked up in its class, so that it takes its object too.
        first = [None] if _is_method(node.func) else []
        try:
            bind(*first, *given, **{each.arg: None for each in node.keywords if each.arg})
        except TypeError as error:
            yield f"{ast.unparse(node)}: {error}"


def _is_ellipsis(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is ...


def _is_method(node: ast.expr) -> bool:
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in _EXAMPLES


def _named(node: ast.AST) -> Any:
    """Return the object of a dotted name of the toolkit; None for other names.

    AttributeError: the name does not exist.
    """
    if isinstance(node, ast.Name):
        if node.id in _ROOTS:
            return import_module(node.id)
        packages = [import_module(name) for name in _ROOTS]
        public = [package for package in packages if node.id in getattr(package, "__all__", ())]
        return getattr(public[0], node.id) if public else _EXAMPLES.get(node.id)
    owner = _named(node.value) if isinstance(node, ast.Attribute) else None
    if owner is None or not isinstance(node, ast.Attribute):
        return None
    try:
        return getattr(owner, node.attr)
    except AttributeError:
        if not inspect.ismodule(owner):
            raise
        try:
            return import_module(f"{owner.__name__}.{node.attr}")
        except ModuleNotFoundError as error:
            if not str(error.name).startswith(owner.__name__):
                return None  # a package of an extra
            raise AttributeError(str(error)) from error
