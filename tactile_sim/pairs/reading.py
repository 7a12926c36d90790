"""Reading a training set: pictures stay encoded in memory and are decoded when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_sim.kind import KIND
from tactile_sim.pairs.rows import SPLITS, decode_depth
from tactile_toolkit.catalog.kinds import require_manifest
from tactile_toolkit.catalog.locate import find_shards
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.parquet import ShardedTable
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.touch.jpeg import decode_image


@dataclass(frozen=True, eq=False)
class Domain:
    """One split: depth images or real touches."""

    table: ShardedTable
    is_depth: bool
    size_px: tuple[int, int]

    def __len__(self) -> int:
        return len(self.table)

    @cached_property
    def labels(self) -> NDArray[np.int64]:
        """Class of each object, shape (n,)."""
        return np.asarray(self.table.column("label"), np.int64)

    @cached_property
    def object_ids(self) -> NDArray[np.int64]:
        """Object of each touch, shape (n,)."""
        return np.asarray(self.table.column("object_id"), np.int64)

    @cached_property
    def contact(self) -> NDArray[np.bool_]:
        """Whether each touch met its object, shape (n,)."""
        return np.asarray(self.table.column("contact"), bool)

    def image(self, row: int) -> NDArray[Any]:
        """Decode a picture: depth float32 (H, W), touches uint8 (H, W, 3); IntegrityError if damaged."""
        group, index = self.table.locate(row)
        data = group.table.column("sensor_image")[index].as_py()["bytes"]
        try:
            image: NDArray[Any] = decode_depth(data) if self.is_depth else decode_image(data)
        except ValueError as error:
            raise IntegrityError(
                f"{group.path!r}, row {row}: {error}", next="run `tactile-sim verify` on the folder"
            ) from error
        if image.shape[1::-1] != self.size_px:
            width, height = image.shape[1::-1]
            raise IntegrityError(
                f"{group.path!r}, row {row}: a picture of {width} x {height} pixels; expected "
                f"{self.size_px[0]} x {self.size_px[1]} as in the manifest",
                next="make the set again",
            )
        return image

    def images(self, rows: Sequence[int] | NDArray[np.int64], pool: Executor | None = None) -> NDArray[Any]:
        """Decode several pictures, on the threads of a pool where one is given."""
        numbers = [int(row) for row in rows]
        return np.stack(list((map if pool is None else pool.map)(self.image, numbers)))


@dataclass(frozen=True, eq=False)
class Pairs:
    """A training set of ``tactile-sim pairs``.

    Attributes
    ----------
    depth, real : Domain
        Depth images and touches, which do not belong together.
    size_px : tuple of int
        Width and height of all pictures, pixels.
    like : str
        Window of the depth images, ``"published"`` or ``"environment"``.
    identity : str
        Names the rows: equal for equal data sets.
    """

    depth: Domain
    real: Domain
    size_px: tuple[int, int]
    like: str
    identity: str

    @classmethod
    def open(cls, folder: str) -> Pairs:
        """Open a folder; InputError for something else or an unfinished one, IntegrityError if damaged."""
        manifest = require_manifest(KIND, DataFolder(folder))
        if manifest.spec.get("operation") != "pairs":
            raise InputError(
                f"{folder!r} is not a training set; expected a folder that `tactile-sim pairs` made"
            )
        try:
            options = manifest.spec["options"]
            (width, height), like = options["size_px"], options["like"]
        except (KeyError, TypeError, ValueError) as error:
            raise IntegrityError(
                f"the specification in {folder!r} does not state size and window of the pictures; "
                "next: make the set again"
            ) from error
        tables = [ShardedTable(find_shards(folder, split)) for split in SPLITS]
        depth, real = (
            Domain(table, split == "depth", (width, height))
            for table, split in zip(tables, SPLITS, strict=True)
        )
        # Content and order of the rows: what a training may continue with.
        checksums = "/".join(record.sha256 for split in SPLITS for record in manifest.shards_of(split))
        return cls(depth, real, (width, height), like, checksums)
