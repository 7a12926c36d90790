"""The table of the commands that all kinds of data sets share."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import typer

from cli import application, checks, contents, exports, hub, pictures, sets
from tactile_toolkit.kind import DatasetKind

Command = Callable[..., None]

_COMMANDS: dict[str, Command | None] = {
    "info": contents.info,
    "verify": checks.verify,
    "validate": checks.validate,
    "show": contents.show,
    "preview": None,
    "card": sets.card,
    "upload": hub.upload,
    "download": hub.download,
    "list": contents.list_sets,
    "merge": sets.merge,
    "split": sets.split,
    "select": sets.select,
    "cache": sets.cache,
    "gallery": pictures.gallery_of_meshes,
    "export": exports.export,
}

_ASK_HUB = ("list",)
"""Commands that ask the Hub without opening one of its names."""


def add_shared(
    app: typer.Typer, kind: DatasetKind, others: Mapping[str, Command | None], **known: object
) -> None:
    """Add the shared commands to the application of a kind.

    ``others`` are the kind's own commands by name, in place of those here; None leaves one out. ``known`` are
    arguments of the commands that are not options.
    """
    for name, function in {**_COMMANDS, **others}.items():
        if function is not None:
            application.command(app, name, asks_hub=name in _ASK_HUB, kind=kind, **known)(function)
