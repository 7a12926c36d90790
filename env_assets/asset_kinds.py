"""Kinds of assets, and opening data sets of them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pyarrow as pa

from tactile_toolkit import mesh, places, read
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, kinds
from tactile_toolkit.mesh import SolidDataset as SolidDataset

KINDS: dict[str, DatasetKind] = {kind.name: kind for kind in kinds() if kind.recipe is not None}
"""Assets that the toolkit can make without any input, by name."""

_ABC = "TimSchneider42/tactile-mnist-abc-dataset-small"

THIRD_PARTY_ASSETS: dict[str, str] = {
    "abc": f"CAD models of the ABC data set; the published selection is {_ABC} on the Hub",
    "minecraft": "items that the package shapes from textures on Mojang's servers, which must not be "
    "redistributed",
}
"""Assets that this toolkit does not make, and where the published ones are from."""

MeshSet = SolidDataset[Any]
"""A data set of meshes of any kind."""


def published_meshes(name: str) -> str | None:
    """Return the data set on the Hub that has the published meshes of a kind; None if there is none."""
    if name == "abc":
        return _ABC
    kind = KINDS.get(name)
    if kind is None or not kind.published:
        return None
    return kind.published[0].repo_id


def open_meshes(shards: tuple[read.Shard, ...], name: str) -> MeshSet:
    """Open the shards of one split as a data set of their kind.

    Raises InputError if they hold no meshes, or meshes of another kind than ``name`` states. The published
    wrench has none of our columns, so meshes of an unknown kind are accepted for it.
    """
    # Imported now: a process that is forked while another thread imports something waits forever for the lock
    # of that import. Arrow imports pandas, if it is there, when it first makes an array of numpy.
    for module in ("pyarrow.parquet", "pyarrow.compute", "trimesh"):
        import_module(module)
    pa.array([0]).to_numpy()
    table = read.ShardedTable(shards)
    mesh.require_mesh_columns(table.schema, name, KINDS["mnist3d"].made_by)
    kind, expected = places.kind_of_rows(table.schema), KINDS.get(name)
    names = read.class_names(table.schema, getattr(kind, "class_names", ()))
    if expected is not None and kind is not expected and (kind is not None or expected.published):
        raise InputError(
            f"{name!r} was expected to hold {expected.nouns}, found "
            f"{getattr(kind, 'nouns', 'other meshes')} (classes {', '.join(names) or 'without names'})",
            next=f"give this data set another name, or give a data set of {expected.nouns}",
        )
    dataset = SolidDataset if kind is None else kind.dataset
    opened: MeshSet = dataset(table, label_names=names)
    return opened
