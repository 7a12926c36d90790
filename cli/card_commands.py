"""``card``: write the data card of a folder and the picture that it shows."""

from __future__ import annotations

import typer

from cli.application import command
from cli.options import Folder
from cli.output import Sink
from tactile_toolkit.kind import DatasetKind

__all__ = ["add_card"]


def add_card(app: typer.Typer, kind: DatasetKind) -> None:
    """Add the command ``card`` to a command line."""

    @command(app)
    def card(folder: Folder, sink: Sink) -> None:
        """Write the data card (README.md) of a folder anew, with the picture that it shows, and check it.

        All numbers are those of the data; loading lines say FOLDER until the folder is uploaded.
        """
        from tactile_toolkit.cards.card import CARD_FILE
        from tactile_toolkit.cards.checks import check_card
        from tactile_toolkit.cards.pictures import PREVIEW_FOLDER
        from tactile_toolkit.catalog.kinds import finished_manifest, require_manifest
        from tactile_toolkit.errors import IntegrityError
        from tactile_toolkit.store.folder import DataFolder

        place = DataFolder(str(folder))
        manifest_of = require_manifest if kind.needs_manifest else finished_manifest
        kind.write_card(place, manifest_of(kind, place))
        findings = check_card(place)
        if findings:
            message = f"{findings[0].file} of {str(folder)!r}: {findings[0].problem}"
            raise IntegrityError(message)
        pictures = [
            f"{PREVIEW_FOLDER}/{name}" for name in place.names(PREVIEW_FOLDER) if name.endswith(".png")
        ]
        sink.document({"folder": str(folder), "card": CARD_FILE, "previews": pictures})
        sink.line(f"{folder}: wrote {', '.join([CARD_FILE, *pictures])}; all of it matches the data")
