"""The kind of rows, by their columns, and the refusal of other kinds."""

from __future__ import annotations

import shlex

import pyarrow as pa

from tactile_toolkit import mesh, read
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, kinds


def kind_of_rows(schema: pa.Schema) -> DatasetKind | None:
    """Return the kind of rows by a column that only it has, or of meshes by the published class names."""
    names = read.column_names(schema)
    for kind in kinds():
        if any(name.partition(".")[0] in kind.columns for name in names):
            return kind
    if mesh.FACES not in names:
        return None
    classes = read.class_names(schema, ())
    known = (kind for kind in kinds() if kind.published and kind.class_names)
    return next((kind for kind in known if kind.class_names == classes), None)


def require_kind(found: DatasetKind, kind: DatasetKind, name: str, command: str = "") -> None:
    """Refuse a data set of another kind; the message names the command or function for it.

    Raises
    ------
    InputError
        The two kinds are not opened by the same package.
    """
    if found.package == kind.package:
        return
    raise wrong_kind(found, name, command_or_load(kind, command), kind.content)


def wrong_kind(found: DatasetKind, name: str, asked: str, content: str) -> InputError:
    """Return the error for data of a kind; ``asked``, a command or function, is for other ``content``."""
    next_step = f"use {found.package}.load({name!r})"
    command = asked.partition(" ")[2]
    if command:
        next_step = f"run `{found.command} {found.command_like(command)} {shlex.quote(name)}`"
    return InputError(f"{name!r} holds {found.content}; `{asked}` is for {content}", next=next_step)


def command_or_load(kind: DatasetKind, command: str) -> str:
    """Return a command of a kind as it was given, or without one ``load`` of its package."""
    if command:
        return f"{kind.command} {command}"
    return f"{kind.package}.load"
