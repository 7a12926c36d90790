"""What the parts of one data set agree on: a file that the first of them writes and no other changes."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.fields import json_fields
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.shards import PENDING_FOLDER, ShardName

__all__ = ["PARTS_FILE", "MissingPartsError", "PartsEndedError", "PartsPlan", "array_text", "read_parts_plan"]

PARTS_FILE = f"{PENDING_FOLDER}/plan.json"
"""Is there from the first part on until the set is finished."""

_SETTLES_S = 5.0
"""How long a plan may take to be whole on file systems that cannot give a name to a file that is."""


@dataclass(frozen=True)
class PartsPlan:
    """How many parts make which shards of which specification, by which versions."""

    parts: int
    shards: Mapping[str, int]
    kind: str
    toolkit_version: str
    libraries: Mapping[str, str]
    spec: Mapping[str, Any]

    def identity(self) -> dict[str, Any]:
        """Return JSON values that decide the rows and their bytes."""
        libraries = {"libraries": dict(self.libraries)}
        return {"kind": self.kind, "toolkit_version": self.toolkit_version, **libraries, **self.spec}

    def division(self) -> dict[str, Any]:
        """Return JSON values that decide which part makes which shards."""
        return {"parts": self.parts, "shards_planned": dict(self.shards)}

    def is_covered_by(self, shards: Iterable[ShardName]) -> bool:
        """Tell whether all of its shards are among these."""
        return not Counter(self.shards) - Counter(shard.split for shard in shards)

    def to_json(self) -> bytes:
        """Return the content of the file."""
        values = {
            **self.division(),
            "kind": self.kind,
            "toolkit_version": self.toolkit_version,
            "libraries": dict(self.libraries),
            "spec": self.spec,
        }
        return (json.dumps(values, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def from_json(cls, content: bytes, where: str) -> PartsPlan:
        """Parse the content of the file; IntegrityError when it is not one."""
        fields = json_fields(content, where)
        shards, libraries = fields.inside("shards_planned"), fields.inside("libraries")
        return cls(
            fields.number("parts", least=1),
            {split: shards.number(split, least=1) for split in shards.values},
            fields.text("kind"),
            fields.text("toolkit_version"),
            {name: libraries.text(name) for name in libraries.values},
            fields.mapping("spec"),
        )


def read_parts_plan(folder: DataFolder) -> PartsPlan | None:
    """Read what the parts agreed on; None where none are at work, IntegrityError where it is damaged."""
    deadline_s = time.monotonic() + _SETTLES_S
    while folder.exists(PARTS_FILE):
        try:
            return PartsPlan.from_json(folder.read_bytes(PARTS_FILE), folder.address(PARTS_FILE))
        except IntegrityError as error:
            if time.monotonic() > deadline_s:
                message = (
                    f"{folder.address(PARTS_FILE)!r}, what the parts agreed on, is damaged ({error}); "
                    "nothing was made; next: remove that file and give the parts again"
                )
                raise IntegrityError(message) from error
            time.sleep(0.2)
    return None


class PartsEndedError(InputError):
    """What a part is at work on was finished, or started again, by somebody else."""


class MissingPartsError(IntegrityError):
    """Parts of a data set that cannot be finished yet.

    ``shards`` is how many are missing of ``planned``; ``array`` are the parts that make them, as Slurm writes
    numbers of an array, and ``parts`` how many there are in all; None where the folder is not made in parts.
    """

    def __init__(self, where: str, shards: int, planned: int, array: str, parts: int | None) -> None:
        found = f"{shards:,} of {planned:,} shards of {where!r} are not finished"
        if parts is None:
            cure = "; next: run the same command without --finish"
        else:
            cure = (
                f"; they are those of {'part' if array.isdigit() else 'parts'} {array} of {parts:,}; next: "
                f"give these again (Slurm: --array={array}), then --finish"
            )
        super().__init__(found + cure)
        self.shards, self.planned, self.array, self.parts = shards, planned, array, parts
        self._where = where

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild from what it says, so that the error crosses process borders."""
        return (MissingPartsError, (self._where, self.shards, self.planned, self.array, self.parts))


def array_text(numbers: Iterable[int]) -> str:
    """Write numbers as Slurm takes them for ``--array``: ``3,17,40-44``."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ",".join(str(first) if first == last else f"{first}-{last}" for first, last in runs)
