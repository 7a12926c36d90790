"""Loading Starstruck: typed and lazy."""

from __future__ import annotations

import numpy as np

from starstruck_gen import kind, placement, scene_drawing
from starstruck_gen.scene import Scene
from tactile_toolkit import mesh, pictures, places, read, touch
from tactile_toolkit.array_types import Int64, UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count


class SceneRecord(mesh.SolidRecord):
    """One scene; fields are loaded on first use.

    Frame of the mesh: origin at the centre of the cell, x right, y away from the robot, z up, objects on
    z = 0; metres. Data sets without our columns (the published one) have ``id``, ``label``, ``star_count``
    and the mesh; other fields raise :class:`~tactile_toolkit.errors.InputError`.
    """

    __slots__ = ()

    @property
    def star_count(self) -> int:
        """Number of stars; that of the published class if it is not stored."""
        return self.row.integer("star_count") if self.row.has("star_count") else self.label + 1

    @property
    def distractor_count(self) -> int:
        """Number of objects that are not stars; InputError if it is not stored."""
        return self._stated("distractor_count").integer("distractor_count")

    @property
    def has_placements(self) -> bool:
        """Whether the data set stores placements; the published one does not."""
        return self.row.has("placements")

    @property
    def placements(self) -> tuple[placement.Placement, ...]:
        """Objects in the order of placing, stars first; InputError if they are not stored."""
        return self._once(
            "placements",
            lambda: tuple(
                placement.Placement(**entry) for entry in self._stated("placements").required("placements")
            ),
        )

    @property
    def seed(self) -> int:
        """Seed of the scene: specification, star count and seed make the scene again."""
        return self._stated("seed").integer("seed")

    @property
    def scene(self) -> Scene:
        """The scene: its placements, and statistics of sampling."""
        attempts = tuple(int(count) for count in self._stated("attempts").required("attempts"))
        return Scene(self.star_count, self.placements, attempts, self._stated("restarts").integer("restarts"))

    def _stated(self, name: str) -> read.Row:
        """Return the row; InputError if the data set has no such column."""
        if not self.row.has(name):
            raise InputError(
                f"this data set stores no {name!r}", next="use one written by `starstruck generate`"
            )
        return self.row

    def __repr__(self) -> str:
        return f"SceneRecord(id={self.id}, label={self.label}, star_count={self.star_count})"

    def _repr_html_(self) -> str:
        """Show the scene from above in a notebook."""
        if not self.has_placements:
            return pictures.figure_html(pictures.relief(self.vertices_m, self.faces), repr(self))
        stars, others = with_count(self.star_count, "stars"), with_count(self.distractor_count, "distractors")
        return pictures.figure_html(self._drawn(2.0), f"scene {self.id}: {stars}, {others}")

    def tile_html(self) -> str:
        """Return HTML of a small picture with a caption, for notebooks."""
        caption = f"{with_count(self.star_count, 'stars')}, id {self.id}"
        if not self.has_placements:
            return pictures.relief_tile_html(self.vertices_m, self.faces, caption)
        return pictures.figure_html(self._drawn(0.8), caption, pictures.TILE_STYLE)

    def _drawn(self, px_per_mm: float) -> UInt8:
        # A record does not know its specification; most scenes have the published cell.
        return np.asarray(scene_drawing.draw_scene(self.placements, touch.CELL_M, px_per_mm))


class SceneMeshDataset(mesh.SolidDataset[SceneRecord]):
    """A lazy sequence of :class:`SceneRecord`; see :class:`tactile_toolkit.read.RecordDataset`."""

    record_class = SceneRecord
    things = "scenes"

    @property
    def star_counts(self) -> Int64:
        """Number of stars of each row, shape (len,); loads no mesh. As :attr:`SceneRecord.star_count`."""
        return self._integers("star_count", lambda: self.labels + 1, lambda scene: scene.star_count)


load = places.loader(kind.KIND, SceneMeshDataset, mesh.RecordStream[SceneRecord])
