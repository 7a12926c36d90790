"""One touch of one solid, without a data set around it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tactile_sim.poses import pose
from tactile_sim.pressable import Pressable
from tactile_sim.random_numbers import keyed_rng
from tactile_sim.round_plan import on_object
from tactile_sim.round_press import press_round
from tactile_sim.touch_spec import GenerateSpec
from tactile_toolkit import touch
from tactile_toolkit.array_types import Float64, UInt8
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.mesh import MeshLike

# On a surface as large as the cell they are two millimetres apart.
_POINTS = 4096
_SHOWN = ("force_n", "torque_nm", "press_depth_m", "slide_m", "twist_rad", "marker_flow_px")


@dataclass(frozen=True, slots=True, eq=False)
class TouchPreview:
    """One touch.

    Attributes
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        The image.
    sensor_z_m : float
        Height of the sensor, metres.
    contact : float
        Share of the image in which the gel touches the object; 0 if it touches only the plate.
    bounds_m : ndarray of float64, shape (2, 2)
        Least, then greatest x and y of the object in its pose, metres, cell frame.
    forces : dict
        ``force_n``, ``torque_nm``, ``press_depth_m``, ``slide_m`` and ``twist_rad`` of an elastic gel, and
        ``marker_flow_px`` if it has markers, as lists and numbers; empty for other gels. See
        :class:`tactile_sim.SyntheticRound`.
    """

    picture: UInt8
    sensor_z_m: float
    contact: float
    bounds_m: Float64
    forces: JsonDict = field(default_factory=dict)


def preview_touch(
    mesh: MeshLike, spec: GenerateSpec, at_m: tuple[float, float] | None, turn_rad: float = 0.0
) -> TouchPreview:
    """Press the gel once onto a solid that stands on the plate.

    Parameters
    ----------
    mesh : Mesh, record or trimesh.Trimesh
        A closed mesh, metres.
    spec : GenerateSpec
        What the touch looks like; its plan is not used.
    at_m : tuple of float or None
        Where the gel goes, x and y from the solid's own origin, metres. None puts the solid
        under the gel with the point that is nearest to its middle, as seen from above.
    turn_rad : float
        Rotation of the solid about z, radians.

    Returns
    -------
    TouchPreview

    Raises
    ------
    InputError
        As :func:`tactile_sim.render_touch`.
    """
    solid = Pressable.of(mesh, layer_m=spec.layer_m)
    stands = pose(z_m=-solid.foot_m, turn_rad=turn_rad)
    x_m, y_m = at_m or (0.0, 0.0)
    if at_m is None:
        # A ring has no point in its middle.
        points_m = on_object(_POINTS, solid, np.tile(stands, (_POINTS, 1, 1)), keyed_rng("look"))
        away_m = points_m - _bounds_m(solid, stands).mean(axis=0)
        stands[:2, 3] = -points_m[np.argmin((away_m**2).sum(axis=1))]
    # Noise and slides are drawn as for round 0 of object 0, so that they are the same each time.
    made = press_round(spec, solid, stands[None], pose(x_m, y_m)[None], ("look", 0, 0))
    sensor_z_m, depth_m = float(np.ravel(made.pressed.sensor_z_m)[0]), made.pressed.depth_m[0]
    is_contact = depth_m < made.sensor.gel_m
    if made.pressed.contacts:
        is_contact = made.pressed.contact.is_contact
    touched = float((is_contact & (sensor_z_m - depth_m >= touch.RENDERED_CONTACT_M)).mean())
    forces = {name: made.further[name][0].tolist() for name in _SHOWN if name in made.further}
    return TouchPreview(made.images[0], sensor_z_m, touched, _bounds_m(solid, stands), forces)


def _bounds_m(solid: Pressable, stands: Float64) -> Float64:
    corners_m = solid.vertices_m @ stands[:2, :3].T + stands[:2, 3]
    return np.array([corners_m.min(axis=0), corners_m.max(axis=0)])
