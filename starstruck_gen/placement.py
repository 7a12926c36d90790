"""An object of a scene."""

from __future__ import annotations

from typing import NamedTuple

from starstruck_gen.outlines import STAR


class Placement(NamedTuple):
    """One object of a scene.

    Frame: origin at the cell's centre, x right, y away from the robot, z up from the plate.

    Attributes
    ----------
    shape : str
        Name of the shape, with the proportions that are not its kind's own in brackets: ``star``,
        ``star(points=6)``; the ``key`` of a :class:`starstruck_gen.Shape`.
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
