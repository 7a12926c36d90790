"""One look at one solid, for the command line and for trying things."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_sim.generation import GenerateSpec, noisy
from tactile_sim.optics import make_optics
from tactile_sim.poses import pose
from tactile_sim.pressing import Pressable, press
from tactile_toolkit.mesh.mesh import MeshLike

__all__ = ["Look", "look"]


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A picture (H, W, 3), uint8; the height of the sensor, metres; the share of the picture in contact."""

    picture: NDArray[np.uint8]
    sensor_z_m: float
    contact: float


def look(mesh: MeshLike, spec: GenerateSpec, x_m: float, y_m: float, *, turn_rad: float = 0.0) -> Look:
    """Press the gel onto a solid that stands at the origin, turned about z; errors as of ``press``."""
    optics = make_optics(spec.optics, spec.weights)
    sensor = spec.sensor(optics)
    solid = Pressable.of(mesh, layer_m=spec.layer_m)
    pressed = press(solid, pose(z_m=-solid.foot_m, turn_rad=turn_rad), pose(x_m, y_m), sensor)
    # Noise is drawn as for round 0 of an object 0, so that a look is the same each time.
    pictures = optics.render(pressed.depth_m[None], sensor, spec.size_px)
    picture = noisy(spec, pictures, "look", 0, 0)[0]
    return Look(picture, pressed.sensor_z_m, float((pressed.depth_m < sensor.gel_m).mean()))
