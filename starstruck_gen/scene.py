"""A scene: what stands where."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from starstruck_gen.placement import Placement
from starstruck_gen.shapes import outline
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.wording import is_whole, plain_number

if TYPE_CHECKING:
    from PIL.Image import Image


_LONGEST_SHOWN = 80


@dataclass(frozen=True, slots=True)
class Scene:
    """Stars and distractors on a cell, and what it took to place them.

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
        from starstruck_gen.picture import draw_scene

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
        given: object = values  # JSON may hold anything
        if not isinstance(given, Mapping):
            _refuse("found", given, "an object such as Scene.to_json writes")
        try:
            scene = cls(
                placements=tuple(
                    _placement(entry, f"placements[{i}]") for i, entry in enumerate(values["placements"])
                ),
                attempts=tuple(_count(f"attempts[{i}]", n) for i, n in enumerate(values["attempts"])),
                star_count=_count("star_count", values["star_count"]),
                restarts=_count("restarts", values["restarts"]),
            )
        except (KeyError, TypeError) as error:
            raise InputError(
                f"not a scene: field {error} is missing or wrong; expected what Scene.to_json writes"
            ) from error
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


def _placement(values: Any, where: str) -> Placement:
    if not isinstance(values, Mapping):
        _refuse(f"{where} is", values, f"an object with {', '.join(Placement._fields)}")
    if not isinstance(values["shape"], str):
        _refuse(f"shape of {where} is", values["shape"], "a name such as 'star'")
    outline(values["shape"])  # refuses a shape that is not known
    numbers = {}
    for name in Placement._fields[1:]:
        number = numbers[name] = plain_number(values[name], float)
        positive = name in ("radius_m", "height_m")
        if not isinstance(number, float) or not math.isfinite(number) or (positive and number <= 0):
            _refuse(f"{name} of {where} is", values[name], f"a {'positive' if positive else 'finite'} number")
    return Placement(shape=values["shape"], **numbers)


def _count(what: str, value: Any) -> int:
    number: int = plain_number(value)
    if not is_whole(number) or number < 0:
        _refuse(f"{what} is", value, "an integer from 0")
    return number


def _refuse(what: str, found: object, expected: str) -> NoReturn:
    text = repr(found)
    shown = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
    raise InputError(f"not a scene: {what} {shown}; expected {expected}")
