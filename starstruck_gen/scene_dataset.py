"""Loading Starstruck: typed and lazy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from starstruck_gen import kind, placement, prisms, scene_drawing
from starstruck_gen.scene import Scene
from tactile_toolkit import catalog, mesh, pictures, places, read, touch
from tactile_toolkit.array_types import Int64, UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count


class SceneRecord(pictures.DrawnSolid):
    """One scene; fields are loaded on first use.

    Frame of the mesh: origin at the centre of the cell, x right, y away from the robot, z up, objects on
    z = 0; metres. Data sets without our columns (the published one) have ``id``, ``label``, ``star_count``
    and the mesh; other fields raise :class:`~tactile_toolkit.errors.InputError`.
    """

    __slots__ = ()
    is_faceted = True

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

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the number of stars."""
        return with_count(self.star_count, "stars")

    @property
    def notes(self) -> list[tuple[str, str]]:
        """Size and seed."""
        return [*super().notes, ("Seed", str(self.seed))] if self.has_placements else super().notes

    @property
    def details(self) -> str:
        """Text below a large picture."""
        if not self.has_placements:
            return super().details
        return f"{super().details}, {with_count(self.distractor_count, 'distractors')}"

    @property
    def legend(self) -> str:
        """Meaning of the colours of a picture."""
        return "stars are yellow" if self.has_placements else "it is not stored which objects are stars"

    @property
    def cell_m(self) -> tuple[float, float]:
        """Width and depth of the cell, metres: those of the specification, or larger if the scene is.

        Rows without a manifest beside them are taken to have the published cell.
        """
        width_m, depth_m = self.row.group.once("cell_m", partial(_stored_cell_m, self.row))
        # Twice the distance of the farthest corner, and a margin.
        reach_m = 2.05 * np.abs(self.vertices_m[:, :2]).max(axis=0)
        return max(width_m, float(reach_m[0])), max(depth_m, float(reach_m[1]))

    @property
    def extent_m(self) -> float:
        """Longer side of what a picture shows, metres."""
        return max(self.cell_m) if self.has_placements else super().extent_m

    @property
    def parts(self) -> list[tuple[int, str]]:
        """Runs of triangles of stars and of other objects.

        Without placements, all objects are others. Empty if the triangles are not those of the declared
        objects.
        """
        if not self.has_placements:
            return [(len(self.faces), "other")]
        runs = [
            (len(prisms.prism(placed.shape).faces), "main" if placed.is_star else "other")
            for placed in self.placements
        ]
        return runs if sum(count for count, _ in runs) == len(self.faces) else []

    def picture(self, width_px: float) -> UInt8:
        """Draw the cell from above, stars in their own colour; without placements, the mesh in relief."""
        if not self.has_placements:
            return super().picture(width_px)
        px_per_mm = width_px / self.extent_m / mesh.MM_PER_M
        return np.asarray(scene_drawing.draw_scene(self.placements, self.cell_m, px_per_mm))

    def cutout(self, width_px: float) -> UInt8:
        """Draw the objects with opacity, (H, W, 4); without placements, the mesh in relief, (H, W, 2)."""
        if not self.has_placements:
            return super().cutout(width_px)
        return scene_drawing.without_plate(self.picture(width_px))


def _stored_cell_m(row: read.Row) -> tuple[float, float]:
    """Return the cell of the specification beside the file of a row; without one, the published cell."""
    manifest = catalog.manifest_beside(row)
    made_by = {} if manifest is None else manifest.spec.get("source_spec", manifest.spec) or {}
    with catalog.specification_read(row.path):
        width_m, depth_m = made_by.get("scene", {}).get("cell_m", touch.CELL_M)
    return width_m, depth_m


class SceneMeshDataset(mesh.SolidDataset[SceneRecord]):
    """A lazy sequence of :class:`SceneRecord`; see :class:`tactile_toolkit.read.RecordDataset`."""

    record_class = SceneRecord
    things = "scenes"

    @property
    def star_counts(self) -> Int64:
        """Number of stars of each row, shape (len,); loads no mesh. As :attr:`SceneRecord.star_count`."""
        return self._integers("star_count", lambda: self.labels + 1, lambda scene: scene.star_count)


load = places.loader(kind.KIND, SceneMeshDataset, mesh.RecordStream[SceneRecord])
