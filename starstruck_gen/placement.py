"""Where one object of a scene stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from starstruck_gen.shapes import STAR

__all__ = ["Placement", "Rejected"]


class Placement(NamedTuple):
    """One object of a scene.

    Frame: origin at the cell's centre, x right, y away from the robot, z up from the plate.

    Attributes
    ----------
    shape : str
        Name of the shape, with the proportions that are not its kind's own in brackets: ``star``,
        ``star(points=6)``; see :func:`starstruck_gen.shapes.shape_key`.
    x_m, y_m : float
        Centre of its circumscribed circle, metres.
    angle_rad : float
        Rotation about z, counter-clockwise, radians.
    radius_m : float
        Circumscribed radius, metres.
    height_m : float
        Height over the plate, metres.
    """

    shape: str
    x_m: float
    y_m: float
    angle_rad: float
    radius_m: float
    height_m: float

    @property
    def is_star(self) -> bool:
        """Whether the object counts."""
        return self.shape.partition("(")[0] == STAR


@dataclass(frozen=True, slots=True)
class Rejected:
    """A position that was drawn and not taken.

    ``blocker`` is the object, the first found, that ``candidate`` would have come too close to; in a layout
    that was given up it is not part of the scene.
    """

    candidate: Placement
    blocker: Placement
    given_up: bool
