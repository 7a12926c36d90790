"""Sources of solids to touch: data sets, mesh files, meshes in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np

from tactile_sim.given_solids import GivenSolid, GivenSolids, Meshes, given_solids
from tactile_sim.touch_table import TouchTable
from tactile_toolkit import mesh, places, read, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

_SHOWN_IDS = 5

Records: TypeAlias = "mesh.SolidDataset[mesh.SolidRecord]"
"""Solids of a data set."""

Solids: TypeAlias = "Records | GivenSolids"
"""Solids of a split, of either source."""

Opener: TypeAlias = Callable[[places.Name], places.Place]
"""Opens a data set by its name."""


def solids_of(
    source: places.Name | places.Place | Meshes, unit: str | None, open_place: Opener
) -> tuple[str, Mapping[str, Solids], str]:
    """Return name and splits of a data set, mesh files or meshes, and a note if it is unfinished."""
    if isinstance(source, places.Place):
        place = source
    else:
        given = given_solids(source, unit)
        if given is not None:
            return "the source", given, ""
        assert not isinstance(source, Mapping), "meshes in memory are given solids"
        place = open_place(source)
    mesh.refuse_unit(unit, place.name)
    place.require_meshes("tactile-sim generate").require_complete()
    return place.name, {split: open_split(place, split) for split in place.splits}, place.unfinished


def open_split(place: places.Place, split: str) -> Records:
    """Open a split of a data set of solids; InputError for a source without meshes."""
    table = read.ShardedTable(place.shards(split))
    mesh.require_mesh_columns(table.schema, place.name, "mnist3d generate")
    return mesh.SolidDataset(table, label_names=read.class_names(table.schema, touch.CLASS_NAMES, place.name))


def content_fingerprint(shard: read.Shard) -> JsonDict:
    """Return JSON values that identify a file by all of its bytes, for sources of moderate size."""
    with shard.stored() as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
    return {"file": shard.path.rpartition("/")[2], "rows": len(shard), "sha256": digest}


def fingerprints(solids: Solids) -> list[JsonDict]:
    """Return JSON values that identify the solids of a split."""
    if isinstance(solids, GivenSolids):
        return solids.fingerprints()
    return list(map(content_fingerprint, solids.files))


def title(solid: mesh.SolidRecord | GivenSolid) -> str:
    """Return the name of a solid in messages."""
    if isinstance(solid, GivenSolid):
        return f"object {solid.id} ({solid.name})"
    return f"object {solid.id}"


def mesh_of(solid: mesh.SolidRecord | GivenSolid) -> mesh.Mesh:
    """Return the mesh of a solid; InputError if its file cannot be used."""
    if isinstance(solid, GivenSolid):
        return solid.mesh()
    return mesh.as_mesh(solid)


def require_known_objects(name: str, splits: Mapping[str, Solids], given: TouchTable) -> None:
    """Refuse given touches of objects that no split holds (InputError)."""
    if given.object_id is None:
        return
    unknown = np.setdiff1d(given.object_id, np.concatenate([each.column("id") for each in splits.values()]))
    if len(unknown):
        shown = ", ".join([*map(str, unknown[:_SHOWN_IDS]), "..."][: len(unknown)])
        raise InputError(
            f"touches of objects {shown} are given, but {name} holds no such id", next="correct `object_id`"
        )
