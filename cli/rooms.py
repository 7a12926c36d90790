"""What commands that all command lines share ask of the room that they stand for."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import Manifest
    from tactile_toolkit.store.shards import Finding

__all__ = ["Room"]


@dataclass(frozen=True, slots=True)
class Room:
    """A kind of data set, its modules imported when they are needed.

    Parameters
    ----------
    command : str
        Name of the command line: ``mnist3d``, ``starstruck`` or ``realtouch``.
    """

    command: str

    @property
    def python_name(self) -> str:
        """Package whose ``load`` opens such data sets."""
        return "starstruck_gen" if self.command == "starstruck" else self.command

    @property
    def makes(self) -> str:
        """Commands that make such folders, for messages."""
        return "realtouch select" if self.command == "realtouch" else f"{self.command} generate"

    def write_card(self, folder: DataFolder) -> None:
        """Write card and picture of a folder.

        Raises
        ------
        InputError
            When the folder holds no data set of this kind, or one that is not finished.
        """
        manifest = self.manifest_of(folder)
        if self.command == "realtouch":
            from realtouch.card import write_card as write_touch_card

            write_touch_card(folder, manifest)
            return
        required = self.required(manifest, folder)
        if self.command == "mnist3d":
            from mnist3d.card import write_card as write_digit_card

            write_digit_card(folder, required)
        else:
            from starstruck_gen.card import write_card as write_scene_card

            write_scene_card(folder, required)

    def manifest_of(self, folder: DataFolder) -> Manifest | None:
        """Read the manifest of a folder; None where it has none.

        Raises
        ------
        InputError
            When it is of another kind, or its run is not finished.
        IntegrityError
            When the manifest is damaged.
        """
        from cli.unfinished import unfinished_words
        from tactile_toolkit.errors import InputError
        from tactile_toolkit.store.manifest import read_manifest

        manifest = read_manifest(folder)
        self.refuse_other_kind(manifest, folder.address())
        if manifest is not None and not manifest.complete:
            what, next_step = unfinished_words(folder, "the same command")
            message = f"{what} {folder.address()!r} is not finished; next: {next_step}"
            raise InputError(message)
        return manifest

    def refuse_other_kind(self, manifest: Manifest | None, where: str) -> None:
        """Refuse a data set that another room made; one without a manifest is nobody's.

        Raises
        ------
        InputError
            It is of another kind.
        """
        from tactile_toolkit.errors import InputError

        if manifest is None or manifest.kind == self.command:
            return
        message = (
            f"{where!r} holds a data set of kind {manifest.kind!r}; expected one of {self.command!r}; next: "
            "use the command of that kind"
        )
        raise InputError(message)

    def loading_lines(
        self, manifest: Manifest | None, name: str, split: str, revision: str | None = None
    ) -> tuple[str, str]:
        """Return an import and a call that open a split of a data set of this kind.

        Parameters
        ----------
        manifest : Manifest or None
            Its manifest; plain pictures have an index only, which `datasets` opens.
        name, split, revision : str
            What to open.
        """
        further = f", revision={_quoted(revision)}" if revision else ""
        given = f"{_quoted(name)}, split={_quoted(split)}{further}"
        if manifest is not None and manifest.spec.get("operation") == "frames":
            return "import datasets", f"datasets.load_dataset({given})"
        return f"import {self.python_name}", f"{self.python_name}.load({given})"

    def required(self, manifest: Manifest | None, folder: DataFolder) -> Manifest:
        """Return a manifest that has to be there.

        Raises
        ------
        InputError
            When there is none.
        """
        from tactile_toolkit.errors import InputError
        from tactile_toolkit.store.manifest import MANIFEST_FILE

        if manifest is None:
            message = (
                f"no {MANIFEST_FILE} in {folder.address()!r}; next: give the folder of a data set, such as "
                f"one made by `{self.makes}`"
            )
            raise InputError(message)
        return manifest

    def check(self, folder: DataFolder) -> Iterable[Finding]:
        """List everything that is wrong with a folder: files, rows, columns, ids, pictures, card."""
        from tactile_toolkit.cards.checks import check_card
        from tactile_toolkit.store.shards import Finding
        from tactile_toolkit.store.verify import verify

        if self.command == "realtouch":
            from realtouch.integrity.verify import verify as verify_touches

            found = verify_touches(folder.address(), quick=True).findings
            if found:
                return [Finding(damage.file, f"({damage})") for damage in found]
            return check_card(folder)
        manifest = self.required(self.manifest_of(folder), folder)
        return verify(folder, self.schema(manifest), card=True).findings

    def schema(self, manifest: Manifest) -> Any:
        """Return the Arrow schema that every shard must have; None where it follows from a source."""
        if self.command == "mnist3d":
            from mnist3d.rows import mesh_schema

            return mesh_schema()
        if self.command == "starstruck":
            from starstruck_gen.rows import scene_schema

            names = tuple(str(count) for count in manifest.spec["scene"]["stars"])
            return scene_schema(names)
        return None


def _quoted(text: str) -> str:
    # A JSON string is one of Python too.
    return json.dumps(text, ensure_ascii=False)
