"""Data sets of solids as sources of touches."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.catalog.locate import find_shards
from tactile_toolkit.mesh.columns import require_mesh_columns
from tactile_toolkit.mesh.records import SolidDataset
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.touch.schema import class_names


@dataclass(frozen=True)
class SolidSplit:
    """A split of a data set of solids: its files, and the names of its classes."""

    shards: tuple[Shard, ...]
    names: tuple[str, ...]

    @classmethod
    def find(cls, place: str, split: str) -> SolidSplit:
        """Read the footers of a split; InputError for a source without meshes."""
        shards = find_shards(place, split)
        schema = ShardedTable(shards).schema
        require_mesh_columns(schema, place, "mnist3d generate")
        return cls(shards, class_names(schema, place))

    def __len__(self) -> int:
        """Count its objects."""
        return sum(map(len, self.shards))

    def solids(self) -> SolidDataset:
        """Open it."""
        return SolidDataset([ShardedTable(self.shards)], label_names=self.names)
