"""Loading Starstruck: typed, lazy, without copies."""

from __future__ import annotations

from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.kind import KIND
from starstruck_gen.placement import Placement
from starstruck_gen.scene import Scene
from tactile_toolkit.catalog.locate import find_shards
from tactile_toolkit.catalog.published import place_of
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.records import RecordStream, SolidRecord, open_solids
from tactile_toolkit.read.columns import column_names
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.wording import counted


class SceneRecord(SolidRecord):
    """One scene; fields are loaded on first use.

    Frame of the mesh: origin at the cell's centre, x right, y away from the robot, z up, objects standing on
    z = 0; metres. Data sets without our columns (the published one) give ``id``, ``label``, ``star_count``
    and the mesh; what is not stored raises :class:`~tactile_toolkit.errors.InputError`.
    """

    __slots__ = ()

    @property
    def star_count(self) -> int:
        """Number of stars; in data sets that do not store it, that of the published class."""
        return int(self._row.required("star_count")) if self._row.has("star_count") else self.label + 1

    @property
    def distractor_count(self) -> int:
        """Number of objects that are not stars; InputError where it is not stored."""
        return int(self._required("distractor_count"))

    @property
    def has_placements(self) -> bool:
        """Whether the data set stores what stands where; the published one does not."""
        return self._row.has("placements")

    @property
    def placements(self) -> tuple[Placement, ...]:
        """Objects in the order of placing, stars first; InputError where they are not stored."""
        return self._once(
            "placements", lambda: tuple(Placement(**entry) for entry in self._required("placements"))
        )

    @property
    def seed(self) -> int:
        """Seed of the scene: with the specification and the star count it makes the scene again."""
        return int(self._required("seed"))

    @property
    def scene(self) -> Scene:
        """The scene: what stands where, and what it took to place it."""
        attempts = tuple(int(count) for count in self._required("attempts"))
        return Scene(self.star_count, self.placements, attempts, int(self._required("restarts")))

    def _required(self, name: str) -> Any:
        if not self._row.has(name):
            raise InputError(
                f"this data set stores no {name!r}", next="use one written by `starstruck generate`"
            )
        return self._row.required(name)

    def __repr__(self) -> str:
        return f"SceneRecord(id={self.id}, label={self.label}, star_count={self.star_count})"

    def _repr_html_(self) -> str:
        """Show the scene from above in a notebook."""
        from tactile_toolkit.pictures.render import relief
        from tactile_toolkit.pictures.writing import figure_html

        if not self.has_placements:
            return figure_html(relief(self.vertices_m, self.faces), repr(self))
        caption = f"scene {self.id}: {self.star_count} stars, {self.distractor_count} distractors"
        return figure_html(self._drawn(2.0), caption)

    def _tile_html(self) -> str:
        from tactile_toolkit.pictures.render import relief_tile_html
        from tactile_toolkit.pictures.writing import TILE_STYLE, figure_html

        caption = f"{counted(self.star_count, 'stars')}, id {self.id}"
        if not self.has_placements:
            return relief_tile_html(self.vertices_m, self.faces, caption)
        return figure_html(self._drawn(0.8), caption, TILE_STYLE)

    def _drawn(self, px_per_mm: float) -> NDArray[np.uint8]:
        from starstruck_gen.picture import draw_scene

        # A record does not know its specification; the published cell is what most were made for.
        return np.asarray(draw_scene(self.placements, (0.12, 0.12), px_per_mm))


class SceneMeshDataset(RecordDataset[SceneRecord]):
    """A lazy sequence of :class:`SceneRecord`; see :class:`tactile_toolkit.read.dataset.RecordDataset`."""

    record_class = SceneRecord
    things = "scenes"

    @property
    def star_counts(self) -> NDArray[np.int64]:
        """Number of stars of each row, shape (len,); loads no mesh. As :attr:`SceneRecord.star_count`."""
        tables = [table for table in self._tables if len(table)]
        stored = ["star_count" in column_names(table.schema) for table in tables]
        if all(stored) and stored:
            return self.int_column("star_count")
        # Joined sets may differ: the published one stores no such column.
        if any(stored):
            return np.array([record.star_count for record in self], dtype=np.int64)
        return self.labels + 1


@overload
def load(
    name: str, split: str | None = None, *, streaming: Literal[False] = False, revision: str | None = None
) -> SceneMeshDataset: ...
@overload
def load(
    name: str, split: str | None = None, *, streaming: Literal[True], revision: str | None = None
) -> RecordStream[SceneRecord]: ...
@overload
def load(
    name: str, split: str | None = None, *, streaming: bool = False, revision: str | None = None
) -> SceneMeshDataset | RecordStream[SceneRecord]: ...
def load(
    name: str, split: str | None = None, *, streaming: bool = False, revision: str | None = None
) -> SceneMeshDataset | RecordStream[SceneRecord]:
    """Open a data set of scenes.

    Parameters
    ----------
    name : str
        A folder written by ``starstruck generate``, a Parquet file, or a repository of the Hub with the
        columns of Starstruck: ``USER/NAME``, or ``starstruck`` for the published one.
    split : str, optional
        Split to open; only its shards are fetched. May be left out where there is only one.
    streaming : bool
        Give an iterable that reads as it goes and keeps nothing, instead of a data set with random access.
    revision : str, optional
        Branch, tag or commit of a Hub repository.

    Returns
    -------
    SceneMeshDataset or RecordStream
        No row is read until it is asked for.

    Raises
    ------
    InputError
        No such folder or split, several splits and none named, or the columns are not those of Starstruck.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """
    shards = find_shards(place_of(name), split, revision=revision, streaming=streaming)
    return open_solids(shards, name, SceneMeshDataset, KIND, streaming=streaming)
