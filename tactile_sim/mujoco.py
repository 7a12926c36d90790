"""Gels in MuJoCo: what they feel of the geoms of a model, and the forces with which they push back.

Needs the extra ``mujoco``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tactile_sim.elastic.contact import ElasticContact, Gel
from tactile_sim.loop.bodies import SIZES, Shape
from tactile_sim.loop.gel_state import GelState
from tactile_sim.optics.rendering import make_optics
from tactile_sim.press.elastic_press import MAX_SHARE, marker_positions_px
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import Renderer, inverse_times
from tactile_sim.press.sensors import Sensor, SensorModel, geometry_of
from tactile_sim.user_values import finite_array, shown
from tactile_toolkit.errors import InputError, needs_extra
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.value_types import Float64, Int32, UInt8

with needs_extra("a gel in MuJoCo", "mujoco", "mujoco"):
    import mujoco

__all__ = ["GelCallback", "GelSensor", "gel_geom_xml"]

RELAXATION_S = 0.001
"""Time in which the force of a gel relaxes, seconds: without it, bodies of a few grams bounce too high."""

_SHARE = 0.5  # of the change of velocity in a step that counts: Newmark's method without damping
# Stiffness times the square of the step over the mass: with more, bodies do not come to rest.
_STIFFEST = 20.0
_STOP_M = 0.001  # a rigid stop that is thinner than this can be passed in a step


class GelSensor:
    """A gel on a site of a model of MuJoCo.

    The site is the middle of the surface of the gel: x points to the right in the image, y up, z into the
    gel. Pass the sensors to a :class:`GelCallback`, which moves them on in each step.

    Parameters
    ----------
    model, data : MjModel, MjData
        The simulation.
    site : str
        Name of the site.
    sensor : Sensor or SensorModel, optional
        Size of the gel, and what images show of it; 320 x 240 pixels of a GelSight Mini by default.
    gel : Gel, optional
        Material and friction of the gel.
    optics : str or Renderer
        Optics of :attr:`image`: a name of :func:`tactile_sim.make_optics`, or optics, such as ``optics`` of a
        calibrated :class:`SensorModel`.
    geoms : sequence of str, optional
        Names of the geoms that the gel feels; by default all that can collide, but those fixed to it.
    reaction : bool
        Whether the gel pushes the bodies, and they the gel.
    relaxation_s : float
        Time in which forces relax (Kelvin and Voigt), seconds; 0 for an elastic gel.

    Raises
    ------
    InputError
        Arguments have other types, a name is not in the model, or a geom has a type that is not supported.
    MissingExtraError
        MuJoCo is not installed.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        site: str,
        sensor: Sensor | SensorModel | None = None,
        gel: Gel | None = None,
        optics: str | Renderer = "depth",
        *,
        geoms: Sequence[str] | None = None,
        reaction: bool = True,
        relaxation_s: float = RELAXATION_S,
    ) -> None:
        if not (isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData)):
            raise InputError(
                f"model and data are {shown(model)} and {shown(data)}; expected an MjModel and its MjData",
                next="model = mujoco.MjModel.from_xml_path(...); data = mujoco.MjData(model)",
            )
        self.model = model
        self.data = data
        self.state = GelState(sensor, gel)
        self.optics = make_optics(optics) if isinstance(optics, str) else optics
        self.reaction = reaction
        self.relaxation_s = float(finite_array(relaxation_s, "relaxation_s", (), "a time, seconds"))
        if self.relaxation_s < 0.0:
            raise InputError(f"is {relaxation_s:g}; expected at least 0, seconds", field="relaxation_s")
        try:
            self._site = model.site(site).id
            named_geoms = [model.geom(name).id for name in geoms or ()]
        except KeyError as error:
            raise InputError(f"the model has no such site or geom: {error.args[0]}") from None
        self.body_id = int(model.site_bodyid[self._site])
        self._geoms = _geoms_beside(model, self.body_id) if geoms is None else named_geoms
        self._bodies = [_body_of(model, geom) for geom in self._geoms]
        self.keys = [model.geom(geom).name or f"geom {geom}" for geom in self._geoms]
        self.reset()

    def reset(self) -> None:
        """Forget all contacts, as at the start of an episode."""
        self.state.reset()
        self._history: list[Float64] = []
        self.wrenches = np.zeros((len(self._geoms), 6))
        """Wrench of each geom on the gel in its frame, as applied in the last step, N and N m, (n, 6)."""

    @property
    def pose(self) -> Float64:
        """Pose of the gel in the world, (4, 4), metres."""
        poses = _poses_of(self.data.site_xpos[[self._site]], self.data.site_xmat[[self._site]])
        pose: Float64 = poses[0]
        return pose

    @property
    def wrench(self) -> Float64:
        """Force (N) and moment (N m) on the gel in its frame, (6,)."""
        wrench: Float64 = self.wrenches.sum(axis=0)
        return wrench

    @property
    def depth_m(self) -> Float64:
        """Distance of the surface of the gel from the sensor, metres, (H, W)."""
        return self.state.depth_m

    @property
    def contact(self) -> ElasticContact:
        """Maps of pressure, traction and displacement of the gel that the image shows."""
        return self.state.contact

    @property
    def image(self) -> UInt8:
        """Image of the camera behind the gel, (H, W, 3)."""
        sensor = self.state.sensor
        image: UInt8 = self.optics.render(self.depth_m[None], sensor, sensor.size_px)[0]
        return image

    def markers_px(self, markers: tuple[int, int]) -> Float64:
        """Return where markers are, columns and rows of them; see :func:`marker_positions_px`."""
        sensor = self.state.sensor
        return marker_positions_px(self.contact.displacement_m, sensor.window_m, markers, sensor.size_px)

    def move_on(self, *, is_new_step: bool) -> None:
        """Press the gel in the present poses of the data; :class:`GelCallback` does so."""
        geoms = self._geoms
        poses = _poses_of(self.data.geom_xpos[geoms], self.data.geom_xmat[geoms])
        poses = inverse_times(self.pose[None], poses)
        self.state.press_prepared(self._bodies, poses, self.keys)
        if is_new_step or not self._history:
            self._history.insert(0, poses)
            del self._history[3:]
        self._history[0] = poses

    def pushes(self) -> list[Push]:
        """Return the pushes of the geoms that touch the gel, as they are in its present state."""
        step_s = self.model.opt.timestep
        pushes = []
        for index in np.flatnonzero(self.state.wrenches[:, 2] > 0.0).tolist():
            poses = [poses[index] for poses in self._history]
            # Before there is a history, velocities are those of the model.
            twists = [_twist(after, before) / step_s for after, before in pairwise(poses)]
            body = int(self.model.geom_bodyid[self._geoms[index]])
            jacobian = self._jacobian(body)
            twists += [jacobian @ self.data.qvel] * (2 - len(twists))
            pushes.append(Push(self, index, body, jacobian, twists[0], twists[1]))
        return pushes

    def _jacobian(self, body: int) -> Float64:
        """Return the twist of a body relative to the gel by generalised velocities, (6, nv)."""
        pose = self.pose
        parts = np.zeros((2, 2, 3, self.model.nv))
        for part, body_id in zip(parts, (body, self.body_id), strict=True):
            mujoco.mj_jac(self.model, self.data, part[0], part[1], pose[:3, 3], body_id)
        relative: Float64 = pose[:3, :3].T @ (parts[0] - parts[1])
        return relative.reshape(6, -1)


class Push(NamedTuple):
    """A geom that touches a gel.

    Attributes
    ----------
    gel : GelSensor
        The gel.
    geom_index, body : int
        Index of the geom among those that the gel feels, and of its body in the model.
    jacobian : ndarray of float64, shape (6, nv)
        Its twist relative to the gel at the origin, in the frame of the gel.
    twist, twist_before : ndarray of float64, shape (6,)
        Of the last step and of the one before, m/s and rad/s.
    """

    gel: GelSensor
    geom_index: int
    body: int
    jacobian: Float64
    twist: Float64
    twist_before: Float64


class GelCallback:
    """Moves gels on in each step of MuJoCo, and applies their forces.

    Give it to ``mujoco.set_mjcb_control``, and all code that calls ``mj_step`` works; or call it between
    ``mj_step1`` and ``mj_step2``. Set it after models are compiled: MuJoCo compiles none while there is a
    callback. Forces are added to ``data.xfrc_applied``; what others have written there since is taken as
    theirs alone. All gels of a simulation belong into one callback, because their forces are solved for
    together (Newmark's method, implicit in the forces of the gels).

    Parameters
    ----------
    *gels : GelSensor
        The gels, of one simulation.

    Raises
    ------
    InputError
        There are no gels, or they belong to several simulations.
    """

    def __init__(self, *gels: GelSensor) -> None:
        strange = [gel for gel in gels if not isinstance(gel, GelSensor)]
        if strange:
            raise InputError(
                f"a gel is {shown(strange[0])}; expected sensors, as in GelCallback(left, right)"
            )
        if not gels or any(gel.data is not gels[0].data for gel in gels):
            raise InputError(f"there are {len(gels)} gels; expected one or more, of the same model and data")
        self._gels = gels
        self._time_s = -np.inf
        self._users = np.zeros_like(gels[0].data.xfrc_applied)
        self._left = self._users.copy()

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Press the gels in the present poses, and set their forces for the step that follows.

        InputError if a contact cannot be solved, or for the integrator RK4.
        """
        if data is not self._gels[0].data:
            return
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise InputError(
                "the integrator is RK4, which evaluates forces at other times; expected another one"
            )
        if data.time < self._time_s:
            for gel in self._gels:
                gel.reset()
        pushes: list[Push] = []
        for gel in self._gels:
            gel.move_on(is_new_step=data.time > self._time_s)
            if gel.reaction:
                pushes += gel.pushes()
        wrenches = _implicit_wrenches(model, data, pushes)
        for gel in self._gels:
            gel.wrenches = np.zeros_like(gel.wrenches) if gel.reaction else gel.state.wrenches
        self._time_s = data.time
        np.copyto(self._users, data.xfrc_applied, where=data.xfrc_applied != self._left)
        data.xfrc_applied[:] = self._users
        for push, wrench in zip(pushes, wrenches, strict=True):
            push.gel.wrenches[push.geom_index] = wrench
            pose = push.gel.pose
            force, moment = pose[:3, :3] @ wrench[:3], pose[:3, :3] @ wrench[3:]
            for body, sign in ((push.body, -1.0), (push.gel.body_id, 1.0)):
                data.xfrc_applied[body, :3] += sign * force
                arm = pose[:3, 3] - data.xipos[body]
                data.xfrc_applied[body, 3:] += sign * (moment + np.cross(arm, force))
        self._left = data.xfrc_applied.copy()


def _implicit_wrenches(model: mujoco.MjModel, data: mujoco.MjData, pushes: Sequence[Push]) -> Float64:
    """Return the wrenches on gels for the next step, (n, 6).

    With the stiffness K of the contacts and the inverse mass A that they feel, w = F + K (dt (v' - v) / 2 +
    relaxation v'), in which v' = 2 v - u - dt A (w - w_before) is the next twist: u and v, of the last two
    steps, hold all other forces.
    """
    if not pushes:
        return np.zeros((0, 6))
    step_s = model.opt.timestep
    jacobian = np.concatenate([push.jacobian for push in pushes])
    by_mass = np.zeros_like(jacobian)
    mujoco.mj_solveM(model, data, by_mass, jacobian)
    inverse_mass = jacobian @ by_mass.T
    twist, twist_before, force, last = (
        np.concatenate(parts)
        for parts in zip(
            *(
                (
                    push.twist,
                    push.twist_before,
                    push.gel.state.wrenches[push.geom_index],
                    push.gel.wrenches[push.geom_index],
                )
                for push in pushes
            ),
            strict=True,
        )
    )
    elastic = np.zeros_like(inverse_mass)
    damped = np.zeros_like(inverse_mass)
    for number, push in enumerate(pushes):
        block = slice(6 * number, 6 * number + 6)
        stiffness = push.gel.state.stiffness[push.geom_index]
        elastic[block, block] = _SHARE * step_s * stiffness
        damped[block, block] = (_SHARE * step_s + push.gel.relaxation_s) * stiffness
        ratio = step_s**2 * stiffness[2, 2] * inverse_mass[6 * number + 2, 6 * number + 2]
        if ratio > _STIFFEST:
            push.gel.state.warn_once(
                "light",
                push.gel.keys[push.geom_index],
                f"is too light for steps of {1e3 * step_s:g} ms, and may jump; next: use steps of "
                f"{1e3 * step_s * (_STIFFEST / ratio) ** 0.5 / 2:.1g} ms, a heavier body, or a softer gel",
            )
    predicted = 2.0 * twist - twist_before + step_s * inverse_mass @ last
    wrenches = np.linalg.solve(
        np.eye(len(force)) + step_s * damped @ inverse_mass, force - elastic @ twist + damped @ predicted
    ).reshape(-1, 6)
    for push, wrench in zip(pushes, wrenches, strict=True):
        wrench *= wrench[2] > 0.0  # a gel does not pull
        along = float(np.hypot(wrench[0], wrench[1]))
        wrench[:2] *= min(1.0, push.gel.state.gel.friction * wrench[2] / along) if along > 0.0 else 1.0
    return wrenches


def _twist(after: Float64, before: Float64) -> Float64:
    """Return shift of the origin and rotation between two close poses, (6,)."""
    motion = after @ np.linalg.inv(before)
    turn = motion[:3, :3] - motion[:3, :3].T
    return np.array([*motion[:3, 3], turn[2, 1] / 2, turn[0, 2] / 2, turn[1, 0] / 2])


def _poses_of(positions_m: Float64, rotations: Float64) -> Float64:
    poses = np.tile(np.eye(4), (len(positions_m), 1, 1))
    poses[:, :3, :3] = rotations.reshape(-1, 3, 3)
    poses[:, :3, 3] = positions_m
    return poses


def _geoms_beside(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the geoms that can collide and are not fixed to a body."""
    is_fixed = model.body_weldid[model.geom_bodyid] == model.body_weldid[body]
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.flatnonzero(collides & ~is_fixed).tolist()


def _body_of(model: mujoco.MjModel, geom: int) -> Pressable | Shape:
    """Return a geom as the gel feels it: meshes as they are, not their convex hulls."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    if kind == "mesh":
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        first_face, face_count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        vertices_m = model.mesh_vert[first : first + count].astype(np.float64)
        faces: Int32 = model.mesh_face[first_face : first_face + face_count]
        # Meshes of models are often open, which is not seen from outside.
        return Pressable.of(Mesh(vertices_m, faces), check=False)
    if kind not in SIZES:
        raise InputError(
            f"the geom {model.geom(geom).name!r} ({geom}) is of the type {kind}; expected mesh, "
            f"{', '.join(SIZES)}",
            next="name the geoms that the gel feels: geoms=[...]",
        )
    return Shape(kind, tuple(model.geom_size[geom, : SIZES[kind]].tolist()))


def gel_geom_xml(name: str, sensor: Sensor | SensorModel | None = None) -> str:
    """Return the lines of MJCF for a gel, for a body whose z axis points into the gel.

    They are the site, the gel, which is seen and collides with nothing, and a rigid stop at half of its
    thickness, where the linear theory ends.

    Parameters
    ----------
    name : str
        Name of the site; that of the geoms begins with it.
    sensor : Sensor or SensorModel, optional
        Size of the gel; a GelSight Mini by default.

    Returns
    -------
    str
        Lines of XML.
    """
    geometry = geometry_of(sensor)
    width_m, height_m = (side / 2 for side in geometry.surface_m)
    half_m = geometry.gel_m / 2
    stop_m = max(geometry.gel_m * (1 - MAX_SHARE), _STOP_M) / 2
    middle_m = geometry.gel_m * MAX_SHARE + stop_m
    return (
        f'<site name="{name}"/>\n'
        f'<geom name="{name}_gel" type="box" size="{width_m:g} {height_m:g} {half_m:g}" pos="0 0 {half_m:g}" '
        'contype="0" conaffinity="0" mass="0" rgba="0.8 0.8 0.9 0.4"/>\n'
        f'<geom name="{name}_stop" type="box" size="{width_m:g} {height_m:g} {stop_m:g}" '
        f'pos="0 0 {middle_m:g}" mass="0"/>\n'
    )
