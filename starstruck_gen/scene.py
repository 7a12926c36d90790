"""A scene: what stands where, as JSON and as a picture from above."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import msgspec
import numpy as np

from starstruck_gen.placement import Placement
from starstruck_gen.shapes import outline
from tactile_toolkit import store
from tactile_toolkit.arithmetic import cosine_sine, moved
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh

if TYPE_CHECKING:
    from PIL.Image import Image


_Positive: TypeAlias = Annotated[float, msgspec.Meta(gt=0)]


class _StoredPlacement(msgspec.Struct):
    shape: str
    x_m: float
    y_m: float
    angle_rad: float
    radius_m: _Positive
    height_m: _Positive


class _StoredScene(msgspec.Struct):
    star_count: store.Count
    placements: list[_StoredPlacement]
    attempts: list[store.Count]
    restarts: store.Count


@dataclass(frozen=True, slots=True)
class Scene:
    """Stars and distractors in a cell, and statistics of their placement.

    Attributes
    ----------
    star_count : int
        Number of stars.
    placements : tuple of Placement
        Objects in the order of placing: stars first. Frame: origin at the cell's centre, z = 0 on the plate.
    attempts : tuple of int
        Positions drawn for each object, over all layouts of the scene.
    restarts : int
        How often the scene was started over.
    """

    star_count: int
    placements: tuple[Placement, ...]
    attempts: tuple[int, ...]
    restarts: int

    @property
    def distractor_count(self) -> int:
        """Number of objects that are not stars."""
        return len(self.placements) - self.star_count

    def mesh(self) -> Mesh:
        """Return the mesh, metres: one watertight solid per object, float32 vertices as they are stored.

        Returns
        -------
        tactile_toolkit.mesh.mesh.Mesh
            Arrays ``vertices_m`` and ``faces``, with ``volume_m3`` and ``bounds_m``; its ``to_trimesh()`` is
            the `trimesh.Trimesh` that ``mesh`` of a record is.
        """
        from starstruck_gen.placement import build_meshes

        return build_meshes([self.placements])[0]

    def draw(self, cell_m: tuple[float, float] = (0.12, 0.12), px_per_mm: float = 4.0) -> Image:
        """Draw the scene from above, x right and y up, stars in their own colour.

        Parameters
        ----------
        cell_m : tuple of float
            Size of the cell, metres.
        px_per_mm : float
            Scale of the picture.

        Returns
        -------
        PIL.Image.Image
            RGB.

        Raises
        ------
        InputError
            When the picture would have no pixel, or more than 100 million.
        """
        return draw_scene(self.placements, cell_m, px_per_mm)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "star_count": self.star_count,
            "placements": [placement._asdict() for placement in self.placements],
            "attempts": list(self.attempts),
            "restarts": self.restarts,
        }

    def to_json(self) -> str:
        """Return the scene as JSON; numbers come back exactly.

        Raises
        ------
        InputError
            When a number is not finite: JSON has no such number.
        """
        try:
            return json.dumps(self.to_dict(), indent=1, allow_nan=False)
        except ValueError as error:
            raise InputError(
                f"a scene with a number that is not finite cannot be written as JSON: {self!r}"
            ) from error

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Scene:
        """Rebuild a scene from :meth:`to_dict`.

        Raises
        ------
        InputError
            When a field is missing or cannot be (a number that is not finite, a radius below 0), or the stars
            are not as many as declared.
        """
        try:
            stored = msgspec.convert(values, _StoredScene)
        except (msgspec.ValidationError, OverflowError) as error:
            raise InputError(f"not a scene: {error}; expected what Scene.to_json writes") from error
        placements = tuple(Placement(*msgspec.structs.astuple(each)) for each in stored.placements)
        for placement in placements:
            outline(placement.shape)  # refuses a shape that is not known
            if not all(map(math.isfinite, placement[1:])):
                raise InputError(f"not a scene: {placement} holds a number that is not finite")
        scene = cls(stored.star_count, placements, tuple(stored.attempts), stored.restarts)
        stars = [placement.is_star for placement in scene.placements]
        if sum(stars) != scene.star_count or not all(stars[: scene.star_count]):
            raise InputError(
                f"a scene declares star_count {scene.star_count} and places {sum(stars)}; expected as many "
                "stars as declared, before all distractors"
            )
        if len(scene.attempts) != len(scene.placements):
            found = f"{len(scene.attempts)} attempts for {len(scene.placements)} placements"
            raise InputError(f"a scene has {found}; expected one each")
        return scene

    @classmethod
    def from_json(cls, text: str) -> Scene:
        """Rebuild a scene from :meth:`to_json`.

        Raises
        ------
        InputError
            When the text is not JSON or not a scene.
        """
        try:
            values = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"a scene must be JSON: {error}") from error
        return cls.from_dict(values)


STAR = (214, 140, 20)
DISTRACTOR = (92, 110, 132)
# Scenes are drawn so many times larger and averaged: smooth edges.
_SUPERSAMPLING = 4

_PLATE = (245, 243, 238)
_EDGE = (40, 40, 40)
# 300 MB at three bytes each.
_MOST_PIXELS = 100_000_000  # while drawing, so larger than the picture by _SUPERSAMPLING**2


def draw_scene(placements: Iterable[Placement], cell_m: tuple[float, float], px_per_mm: float) -> Image:
    """Draw what stands on a plate; InputError where the picture would have no pixel, or too many.

    See :meth:`starstruck_gen.scene.Scene.draw`.
    """
    from PIL import Image

    sides = np.round(np.array(cell_m) * 1e3 * px_per_mm)
    most = _MOST_PIXELS // _SUPERSAMPLING**2
    if not (np.isfinite(sides).all() and sides.min() >= 1 and sides.prod() <= most):
        raise InputError(f"a picture of {sides[0]:g} x {sides[1]:g} pixels; expected 1 to {most:,} pixels")
    width, height = sides.astype(int).tolist()
    picture = Image.new("RGB", (width * _SUPERSAMPLING, height * _SUPERSAMPLING), _PLATE)
    for placement in placements:
        _paint_object(picture, placement, px_per_mm * 1e3 * _SUPERSAMPLING)
    return picture.resize((width, height), Image.Resampling.LANCZOS)


def _paint_object(picture: Image, placement: Placement, px_per_m: float) -> None:
    """Paint an object where it stands, with its edge; ``px_per_m`` is the scale of the larger picture."""
    from PIL import Image, ImageDraw

    c, s = cosine_sine(placement.angle_rad)
    rings = []
    for ring in outline(placement.shape):
        turned = moved(ring, np.array([[c, s], [-s, c]]))
        standing_m = placement.radius_m * turned + (placement.x_m, placement.y_m)
        rings.append(standing_m * px_per_m * (1.0, -1.0) + np.array(picture.size) / 2)
    # A mask keeps holes open: what stands inside one must stay visible. It is as large as the object.
    low, high = (
        np.clip((rings[0].min(axis=0), rings[0].max(axis=0) + 2), 0, picture.size).astype(int).tolist()
    )
    mask = Image.new("L", (high[0] - low[0], high[1] - low[1]))
    for number, edge_px in enumerate(rings):
        ImageDraw.Draw(mask).polygon((edge_px - low).ravel().tolist(), fill=0 if number else 255)
    picture.paste(STAR if placement.is_star else DISTRACTOR, (*low, *high), mask)
    for edge_px in rings:
        ImageDraw.Draw(picture).polygon(edge_px.ravel().tolist(), outline=_EDGE, width=_SUPERSAMPLING)
