"""A scene: its placements, and statistics of sampling."""

from __future__ import annotations

from dataclasses import dataclass

from PIL import Image

from starstruck_gen import placement, scene_drawing, scene_meshes
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.touch import CELL_M


@dataclass(frozen=True, slots=True)
class Scene:
    """Stars and distractors in a cell, and statistics of their placement.

    Attributes
    ----------
    star_count : int
        Number of stars.
    placements : tuple of Placement
        Objects in the order of placing, stars first. Frame: origin at the centre of the cell, z = 0 on the
        plate.
    attempts : tuple of int
        Positions drawn for each object, over all layouts of the scene.
    restarts : int
        How often the scene was started over.
    """

    star_count: int
    placements: tuple[placement.Placement, ...]
    attempts: tuple[int, ...]
    restarts: int

    @property
    def distractor_count(self) -> int:
        """Number of objects that are not stars."""
        return len(self.placements) - self.star_count

    def mesh(self) -> Mesh:
        """Return the mesh: one watertight solid per object, float32 vertices in metres, as they are stored.

        Returns
        -------
        tactile_toolkit.mesh.Mesh
            Arrays ``vertices_m`` and ``faces``, with ``volume_m3`` and ``bounds_m``; its ``to_trimesh()``
            returns the `trimesh.Trimesh` that ``mesh`` of a record is.
        """
        return scene_meshes.build_meshes([self.placements])[0]

    def draw(self, cell_m: tuple[float, float] = CELL_M, px_per_mm: float = 4.0) -> Image.Image:
        """Draw the scene from above, x right and y up, stars in their own colour.

        Parameters
        ----------
        cell_m : tuple of float
            Size of the cell, metres.
        px_per_mm : float
            Scale of the picture, pixels per millimetre.

        Returns
        -------
        PIL.Image.Image
            RGB.

        Raises
        ------
        InputError
            The picture would have no pixel, or more than 6.25 million.
        """
        return scene_drawing.draw_scene(self.placements, cell_m, px_per_mm)
