"""One look at one solid, for the command line and for trying things."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_sim.generation import GenerateSpec, noisy
from tactile_sim.optics import make_optics
from tactile_sim.plan import generator, on_object
from tactile_sim.poses import Matrix, pose
from tactile_sim.pressing import Pressable, press
from tactile_toolkit.mesh.mesh import MeshLike
from tactile_toolkit.touch.contact import RENDERED_CONTACT_M

# On a surface as large as the cell they are two millimetres apart.
_POINTS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One touch.

    Attributes
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
    sensor_z_m : float
        Height of the sensor, metres.
    contact : float
        Share of the picture in which the gel touches the object; 0 where it met the plate alone.
    bounds_m : ndarray of float64, shape (2, 2)
        Least, then greatest x and y of the object as it stands, metres, cell frame.
    """

    picture: NDArray[np.uint8]
    sensor_z_m: float
    contact: float
    bounds_m: NDArray[np.float64]


def look(mesh: MeshLike, spec: GenerateSpec, at_m: tuple[float, float] | None, turn_rad: float = 0.0) -> Look:
    """Press the gel onto a solid on the plate, turned about z; errors as of ``press``.

    ``at_m`` is where the gel goes, x and y from the solid's own origin, metres. None puts the solid under the
    gel, wherever its origin is: by a point of it that is nearest to its middle as seen from above.
    """
    optics = make_optics(spec.optics, spec.weights)
    sensor = spec.sensor(optics)
    solid = Pressable.of(mesh, layer_m=spec.layer_m)
    stands = pose(z_m=-solid.foot_m, turn_rad=turn_rad)
    if at_m is None:
        stands[:2, 3] = -_middle_m(solid, stands)
    pressed = press(solid, stands, pose(*(at_m or (0.0, 0.0))), sensor)
    # Noise is drawn as for round 0 of an object 0, so that a look is the same each time.
    pictures = optics.render(pressed.depth_m[None], sensor, spec.size_px)
    picture = noisy(spec, pictures, "look", 0, 0)[0]
    is_object = pressed.sensor_z_m - pressed.depth_m >= RENDERED_CONTACT_M
    touched = float((is_object & (pressed.depth_m < sensor.gel_m)).mean())
    return Look(picture, pressed.sensor_z_m, touched, _bounds_m(solid, stands))


def _middle_m(solid: Pressable, stands: Matrix) -> NDArray[np.float64]:
    """Return a point of the solid as near to its middle as may be, shape (2,): a ring has none there."""
    points_m = on_object(_POINTS, solid, np.tile(stands, (_POINTS, 1, 1)), generator("look"))
    away_m = points_m - _bounds_m(solid, stands).mean(axis=0)
    nearest: NDArray[np.float64] = points_m[np.argmin((away_m**2).sum(axis=1))]
    return nearest


def _bounds_m(solid: Pressable, stands: Matrix) -> NDArray[np.float64]:
    corners_m = solid.vertices_m @ stands[:2, :3].T + stands[:2, 3]
    return np.array([corners_m.min(axis=0), corners_m.max(axis=0)])
