"""A hand in MuJoCo: two fingers with gels that pinch a flat solid and lift it off a support that yields.

Needs the extra ``mujoco``.
"""

from __future__ import annotations

import warnings

import numpy as np

from tactile_sim.elastic.contact import Gel
from tactile_sim.loop.gel_state import GelWarning
from tactile_sim.mujoco import GelCallback, GelSensor, gel_geom_xml
from tactile_sim.press.pressing import Renderer
from tactile_sim.press.sensors import Sensor, SensorModel
from tactile_toolkit.errors import needs_extra
from tactile_toolkit.mesh import Mesh, MeshLike
from tactile_toolkit.value_types import Float64

with needs_extra("a hand in MuJoCo", "mujoco", "mujoco"):
    import mujoco

FINGERS = ("left", "right")
"""Names of the fingers, and of their gels."""
GRAVITY_M_S2 = 9.81
STEP_S = 0.002
"""Step of the simulation, seconds."""
UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation that turns the z axis of a flat solid to x, along which the fingers close."""
_STIFFNESS_N_M = 2000.0  # of the drive that lifts the hand
_GAP_M = 0.0005  # between gel and solid before the fingers close
_MODEL = """
<mujoco><option timestep="{step_s}" integrator="implicitfast" gravity="0 0 -{gravity}"/>
<visual><headlight ambient=".5 .5 .5"/><global offwidth="320" offheight="320"/></visual>
<asset><texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="8"/></asset>
<worldbody><light pos=".1 -.2 .5"/><body name="hand"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass=".3" diaginertia="1e-4 1e-4 1e-4"/>{fingers}</body></worldbody>
<actuator><position joint="lift" kp="{stiffness}" dampratio="1"/><motor joint="left"/><motor joint="right"/>
</actuator></mujoco>"""
_FINGER = """
<body name="{name}" pos="{x_m} 0 0" xyaxes="0 {side} 0 0 0 1">
<joint name="{name}" type="slide" axis="0 0 -1" damping="30"/>{gel}
<geom type="box" size=".0095 .0071 .003" pos="0 0 .0075" mass=".05" contype="0" conaffinity="0"
rgba=".3 .3 .35 1"/></body>"""


class Hand:
    """Two fingers that close along x onto a solid between them, with a gel each.

    The frame of the world begins in the middle between the fingers, z up. A support carries the solid as far
    as :meth:`move` says; its weight is on the gels when it is gone.

    Parameters
    ----------
    solid : Mesh, record or trimesh.Trimesh
        What is lifted, metres.
    pose : ndarray of float64, shape (4, 4)
        Its pose before it is touched.
    mass_kg : float
        Its mass.
    sensor : Sensor or SensorModel, optional
        As for :class:`~tactile_sim.mujoco.GelSensor`.
    gel : Gel, optional
        Material and friction of both gels.
    optics : str or Renderer
        Optics of the images.

    Attributes
    ----------
    model, data : MjModel, MjData
        The simulation; bodies are ``hand``, ``left``, ``right`` and ``solid``.
    gels : tuple of GelSensor
        The left gel and the right one.
    """

    def __init__(
        self,
        solid: MeshLike,
        pose: Float64,
        mass_kg: float,
        sensor: Sensor | SensorModel | None = None,
        gel: Gel | None = None,
        optics: str | Renderer = "depth",
    ) -> None:
        mesh = Mesh.of(solid)
        placed_m = mesh.vertices_m @ pose[:3, :3].T + pose[:3, 3]
        fingers = "".join(
            _FINGER.format(name=name, x_m=x_m, side=side, gel=gel_geom_xml(name, sensor))
            for name, x_m, side in zip(
                FINGERS, (placed_m[:, 0].min() - _GAP_M, placed_m[:, 0].max() + _GAP_M), (-1, 1), strict=True
            )
        )
        spec = mujoco.MjSpec.from_string(
            _MODEL.format(step_s=STEP_S, gravity=GRAVITY_M_S2, stiffness=_STIFFNESS_N_M, fingers=fingers)
        )
        spec.add_mesh(name="solid", uservert=placed_m.ravel(), userface=mesh.faces.ravel())
        body = spec.worldbody.add_body(name="solid", gravcomp=1.0)
        body.add_freejoint()
        kind = mujoco.mjtGeom.mjGEOM_MESH
        body.add_geom(name="solid", type=kind, meshname="solid", mass=mass_kg, rgba=[0.85, 0.55, 0.25, 1])
        for name in FINGERS:
            # MuJoCo collides convex hulls, and that of a digit is wider than its stroke.
            spec.add_exclude(bodyname1=name, bodyname2="solid")
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.gels = tuple(
            GelSensor(self.model, self.data, name, sensor, gel, optics, geoms=["solid"]) for name in FINGERS
        )
        mujoco.mj_forward(self.model, self.data)
        self._first_pose = pose
        self._callback = GelCallback(*self.gels)
        self._solid = self.model.body("solid").id
        self._hand_kg = self.model.body_subtreemass[self.model.body("hand").id]

    def move(self, grip_n: float, lifted_m: float, share: float) -> None:
        """Move on by one step of :data:`STEP_S`.

        Parameters
        ----------
        grip_n : float
            Force of each finger, newtons.
        lifted_m : float
            Height to which the hand is driven, metres.
        share : float
            Share of the weight that the support still carries, 0 to 1.
        """
        self.model.body_gravcomp[self._solid] = share
        self.data.ctrl[:] = lifted_m + self._hand_kg * GRAVITY_M_S2 / _STIFFNESS_N_M, grip_n, grip_n
        mujoco.mj_step1(self.model, self.data)
        with warnings.catch_warnings():
            # Between two damped fingers, solids of 2 g come to rest.
            warnings.filterwarnings("ignore", ".* is too light", GelWarning)
            self._callback(self.model, self.data)
        mujoco.mj_step2(self.model, self.data)

    @property
    def is_holding(self) -> bool:
        """Whether both gels touch the solid."""
        return all(gel.wrench[2] > 0.0 for gel in self.gels)

    @property
    def solid_pose(self) -> Float64:
        """Pose of the solid in the world, (4, 4), metres, at the time of the state of the gels."""
        motion = np.eye(4)
        motion[:3, :3] = self.data.xmat[self._solid].reshape(3, 3)
        motion[:3, 3] = self.data.xpos[self._solid]
        pose: Float64 = motion @ self._first_pose
        return pose
