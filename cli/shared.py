"""The table of the commands that all kinds of data sets share."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import typer

from cli.application import command
from cli.checks import validate, verify
from cli.contents import info, list_sets, show
from cli.exports import export
from cli.galleries import gallery_of_meshes
from cli.hub import download, upload
from cli.merge_and_split import merge, select, split
from cli.upkeep import cache, card
from tactile_toolkit.kind import DatasetKind

Command = Callable[..., None]

_COMMANDS: dict[str, Command | None] = {
    "info": info,
    "verify": verify,
    "validate": validate,
    "show": show,
    "preview": None,
    "card": card,
    "upload": upload,
    "download": download,
    "list": list_sets,
    "merge": merge,
    "split": split,
    "select": select,
    "cache": cache,
    "gallery": gallery_of_meshes,
    "export": export,
}

_LOCAL = ("cache",)
"""Commands that never ask the Hub."""


def add_shared(
    app: typer.Typer, kind: DatasetKind, others: Mapping[str, Callable[..., None] | None], **known: object
) -> None:
    """Add the shared commands to the application of a kind.

    ``others`` are the kind's own commands by name, in place of those here; None leaves one out. ``known`` are
    arguments of the commands that are no options.
    """
    for name, function in {**_COMMANDS, **others}.items():
        if function is not None:
            command(app, name, asks_hub=name not in _LOCAL, kind=kind, **known)(function)
