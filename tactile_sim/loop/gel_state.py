"""A gel in a moving world: what bodies in their poses do to it, from step to step."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tactile_sim.elastic import contact as elastic
from tactile_sim.loop.bodies import Body, PixelGrid, Shape, checked_body, raise_bodies
from tactile_sim.press.elastic_press import MAX_SHARE, SOLVED_M, WholeGel
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import PoseLike, Pressed, as_matrices, inverse_times
from tactile_sim.press.sensors import Sensor, SensorModel, geometry_of
from tactile_sim.user_values import finite_array, shown
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float64, Int32

if TYPE_CHECKING:
    from tactile_sim.elastic.solver import ContactProblem

_SOLVED_IN_LOOP_M = 0.00048  # forces differ by 0.2 to 0.4 % from those of blocks of half the width
_SIDE_STIFFNESS = 0.7  # of a pixel along the surface, next to that across it
_LEAST_M = 1e-9
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3))  # point @ _CROSS @ rotation is the shift of the point
_DEEP = 1.05 * MAX_SHARE  # a stop at the limit gives way a little
_SUDDEN = 0.05  # thicknesses of the gel by which a body may be inside of it at once


class GelWarning(UserWarning):
    """A simulated gel is used where its model does not hold."""


def press_at(
    solids: Body | Sequence[Body],
    object_poses: PoseLike,
    sensor_pose: PoseLike,
    sensor: Sensor | SensorModel | None = None,
    *,
    gel: elastic.Gel | None = None,
) -> Pressed:
    """Return what a gel in its pose feels of bodies in theirs, without a plate and without a history.

    Without ``gel``, the depth map is the bodies, cut off at the surface of the gel at rest, and there are no
    forces.

    Parameters
    ----------
    solids : Mesh, record, trimesh.Trimesh, Pressable or Shape, or a sequence of them
        What the gel may touch; meshes are closed, in metres.
    object_poses, sensor_pose : array_like, shape (n, 4, 4) and (4, 4)
        As for :meth:`GelState.press`.
    sensor : Sensor or SensorModel, optional
        As for :class:`GelState`.
    gel : Gel, optional
        Material and friction of an elastic gel.

    Returns
    -------
    Pressed
        Depth map and image; of an elastic gel also the contact, and the wrench of each body, (n, 6).
        ``sensor_z_m`` is the height of the sensor, behind its gel.

    Raises
    ------
    InputError
        A pose is not rigid, a mesh is not closed, numbers of poses differ, or the contact cannot be solved.
    """
    solids = [*solids] if isinstance(solids, Sequence) else [solids]
    state = GelState(sensor, gel, solved_m=SOLVED_M)
    poses = _poses_in_gel(len(solids), object_poses, sensor_pose)
    bodies = [checked_body(solid) for solid in solids]
    base_m = as_matrices(sensor_pose, "sensor_pose").reshape(4, 4) @ [0.0, 0.0, state.sensor.gel_m, 1.0]
    if gel is None:
        heights_m, _ = raise_bodies(bodies, poses, state.sensor)
        depth_m = state.sensor.gel_m - np.maximum(heights_m, 0.0)
        return Pressed(depth_m, state.sensor.depth_image(depth_m), float(base_m[2]))
    wrenches = state.press_prepared(bodies, poses, range(len(bodies)))
    depth_m = state.depth_m
    image = state.sensor.depth_image(depth_m)
    return Pressed(depth_m, image, float(base_m[2]), (state.contact,), wrenches)


class GelState:
    """An elastic gel that moves among bodies, and remembers where they stick to it.

    Friction follows Kalker (Three-Dimensional Elastic Bodies in Rolling Contact, 1990), step by step: a
    point that sticks is carried by its body, and slips where the traction would exceed friction times
    pressure. Use one state for each gel and environment, and call :meth:`press` at each step.

    A :class:`GelWarning` is issued, once for each body, for a press deeper than half the gel, and for a body
    that is inside of the gel at once, as if it had come from the side.

    Parameters
    ----------
    sensor : Sensor or SensorModel, optional
        Size of the gel, and what images show of it; 320 x 240 pixels of a GelSight Mini by default.
    gel : Gel, optional
        Material and friction of the gel.
    solved_m : float
        Greatest width of the blocks of pixels that are solved as one, metres; at most the thickness of the
        gel.

    Attributes
    ----------
    wrenches : ndarray of float64, shape (n, 6)
        What the last step returned.
    stiffness : ndarray of float64, shape (n, 6, 6)
        About how the wrench of each body changes with its motion (shift, rotation) about the origin, N/m, N
        and N m.

    Raises
    ------
    InputError
        The window is larger than the gel, or arguments have other types.
    """

    def __init__(
        self,
        sensor: Sensor | SensorModel | None = None,
        gel: elastic.Gel | None = None,
        *,
        solved_m: float = _SOLVED_IN_LOOP_M,
    ) -> None:
        self.sensor = geometry_of(sensor)
        self.gel = elastic.Gel() if gel is None else gel
        if not isinstance(self.gel, elastic.Gel):
            raise InputError(f"gel is {shown(gel)}; expected a Gel, such as tactile_sim.Gel()")
        width_m = float(finite_array(solved_m, "solved_m", (), "a width, metres"))
        if not 0.0 < width_m <= self.sensor.gel_m:
            raise InputError(
                f"is {width_m:g} m; expected a number above 0, at most the thickness of the gel, "
                f"{self.sensor.gel_m:g} m",
                field="solved_m",
            )
        self._whole = WholeGel.of(self.sensor, width_m)
        self._grid = PixelGrid.of(self._whole.sensor, self._whole.block_px)
        self._warned: set[tuple[str, Hashable]] = set()
        self.reset()

    def reset(self) -> None:
        """Forget all contacts: the gel is at rest."""
        shape = (len(self._grid.rows_m), len(self._grid.columns_m))
        self._heights_m = np.full(self._whole.sensor.size_px[::-1], -np.inf)
        self._poses: dict[Hashable, Float64] = {}
        self._touching: set[Hashable] = set()
        self._release(shape)
        self.wrenches = np.zeros((0, 6))
        self.stiffness = np.zeros((0, 6, 6))

    def _release(self, shape: tuple[int, int]) -> None:
        from tactile_sim.elastic.solver import Solution

        self._problem: ContactProblem | None = None
        self._solution = Solution(np.zeros((8, *shape)), 0.0, 0.0, 0)
        self._carried_m = np.zeros((2, *shape))

    def press(
        self,
        solids: Sequence[Body],
        object_poses: PoseLike,
        sensor_pose: PoseLike,
        keys: Sequence[Hashable] | None = None,
    ) -> Float64:
        """Move bodies and gel to their poses, and return the wrench of each body on the gel.

        Parameters
        ----------
        solids : sequence of Mesh, record, trimesh.Trimesh, Pressable or Shape
            What the gel may touch. Prepare meshes by :meth:`Pressable.of`: others are looked up by their
            content in each step.
        object_poses : array_like, shape (n, 4, 4), or objects with such a ``matrix``
            Poses of the bodies, metres, in any frame.
        sensor_pose : array_like, shape (4, 4)
            Pose of the gel in that frame: the origin is the middle of its surface at rest, x points to the
            right in the image, y up, z into the gel, towards its camera.
        keys : sequence, optional
            Name of each body, which identifies it from step to step; its index by default. A body that was
            not there in the step before has not moved.

        Returns
        -------
        ndarray of float64, shape (n, 6)
            Force, newtons, and moment about the origin, newton metres, in the frame of the gel.

        Raises
        ------
        InputError
            A pose is not rigid, a mesh is not closed, numbers of poses or keys differ, or the contact cannot
            be solved.
        """
        poses = _poses_in_gel(len(solids), object_poses, sensor_pose)
        names = range(len(solids)) if keys is None else keys
        if len(set(names)) != len(solids):
            raise InputError(f"there are {len(set(names))} different keys for {len(solids)} solids")
        return self.press_prepared([checked_body(solid) for solid in solids], poses, names)

    def press_prepared(
        self, bodies: Sequence[Pressable | Shape], poses: Float64, keys: Sequence[Hashable]
    ) -> Float64:
        """Press as :meth:`press` does; ``poses`` (n, 4, 4) are those in the frame of the gel."""
        from tactile_sim.loop import loop_kernels

        self._heights_m, pixel_owners = raise_bodies(bodies, poses, self._whole.sensor)
        lowest_m = -abs(self._heights_m.max())
        block_px = self._whole.block_px
        heights_m, owners = loop_kernels.to_blocks(self._heights_m, pixel_owners, block_px, lowest_m)
        is_known = [key in self._poses for key in keys]
        before = np.array([self._poses.get(key, pose) for key, pose in zip(keys, poses, strict=True)])
        back = before.reshape(-1, 4, 4) @ np.linalg.inv(poses)
        self._poses = dict(zip(keys, poses, strict=True))
        self.wrenches = np.zeros((len(bodies), 6))
        self.stiffness = np.zeros((len(bodies), 6, 6))
        if heights_m.max() <= 0.0:
            self._release(heights_m.shape)
        else:
            loop_kernels.add_motion(self._carried_m, heights_m, owners, back, *self._grid)
            self._solve(heights_m)
            for body in np.unique(owners[self._solution.fields[0] > 0.0]).tolist():
                self._sum_loads(body, heights_m, owners)
        self._warn(heights_m, owners, back, keys, is_known)
        return self.wrenches

    @property
    def _block_m(self) -> tuple[float, float]:
        width_m, height_m = self._whole.sensor.pixel_m
        return self._whole.block_px * width_m, self._whole.block_px * height_m

    def _solve(self, heights_m: Float64) -> None:
        """Solve the contact with heights of blocks, whose points want to be where they are carried."""
        depth_m = float(heights_m.max())
        below_m = depth_m - heights_m
        motion_m = self._carried_m
        solution = None
        if self._problem is not None:
            solution = self._problem.follow(below_m, depth_m, motion_m)
        if solution is None or not solution.error <= elastic.MAX_RESIDUAL:
            target = (depth_m, False)
            self._problem = elastic.contact_problem(
                below_m, self._block_m, self.gel, self.sensor.gel_m, target, motion_m
            )
            solution = self._problem.solve()
            elastic.require_residual(solution.error, solution.iterations)
        self._solution = solution
        # What sticks is carried by its body, not by the solver's surface, whose tolerances would add up.
        self._carried_m = np.where(solution.fields[7] > 0.0, motion_m, solution.fields[3:5])

    def _sum_loads(self, body: int, heights_m: Float64, owners: Int32) -> None:
        """Write the wrench of a body, and its stiffness: that of a bed of springs, of which some stick.

        Together they are as stiff as a ball in contact, whose force grows with the power 1.5 of its depth.
        """
        fields = self._solution.fields
        rows, columns = np.nonzero((owners == body) & (fields[0] > 0.0))
        grid = self._grid
        points_m = np.stack([grid.columns_m[columns], grid.rows_m[rows], heights_m[rows, columns]], axis=1)
        # Motion of the points (n, 3) by shift and rotation (6,); its transpose sums their forces.
        motion = np.zeros((rows.size, 3, 6))
        motion[:, :, :3] = np.eye(3)
        motion[:, :, 3:] = np.tensordot(points_m, _CROSS, 1)
        matrix = motion.reshape(-1, 6)
        loads_n = fields[:, rows, columns][[1, 2, 0]] * (self._block_m[0] * self._block_m[1])
        self.wrenches[body] = loads_n.T.ravel() @ matrix
        deepest_m = max(float(points_m[:, 2].max()), _LEAST_M)
        springs = np.full((rows.size, 3), 1.5 * self.wrenches[body, 2] / (deepest_m * rows.size))
        springs[:, :2] *= _SIDE_STIFFNESS * fields[7, rows, columns, None]
        self.stiffness[body] = matrix.T @ (springs.reshape(-1, 1) * matrix)

    def _warn(
        self,
        heights_m: Float64,
        owners: Int32,
        back: Float64,
        keys: Sequence[Hashable],
        is_known: Sequence[bool],
    ) -> None:
        """Warn of bodies that are deep in the gel, or are in it at once."""
        gel_m = self.sensor.gel_m
        is_deep = heights_m.max() > _DEEP * gel_m
        touching = {key for key, wrench in zip(keys, self.wrenches, strict=True) if wrench[2] > 0.0}
        for index, key in enumerate(keys):
            is_new = is_known[index] and key not in self._touching
            if key not in touching or not (is_new or is_deep):
                continue
            depths_m = np.where(owners == index, heights_m, -np.inf)
            row, column = np.unravel_index(depths_m.argmax(), depths_m.shape)
            point = np.array([self._grid.columns_m[column], self._grid.rows_m[row], depths_m[row, column], 1])
            deep_m = float(point[2])
            if deep_m > _DEEP * gel_m:
                self.warn_once(
                    "deep",
                    key,
                    f"is {1e3 * deep_m:.2f} mm deep in a gel of {1e3 * gel_m:.2f} mm; expected at most half "
                    "of it, the limit of linear theory; next: put a rigid stop there, or press less",
                )
            risen_m = abs(deep_m - float(back[index, 2] @ point))
            if is_new and deep_m > 2.0 * risen_m + _SUDDEN * gel_m:
                self.warn_once(
                    "sudden",
                    key,
                    f"is {1e3 * deep_m:.2f} mm deep in the gel in its first step there, as if it came from "
                    "the side, where the gel has no face; next: let it come from the front, or put a rigid "
                    "frame around the gel",
                )
        self._touching = touching

    def warn_once(self, reason: str, key: Hashable, message: str) -> None:
        """Issue a :class:`GelWarning` on a body, unless it was issued for the same reason."""
        if (reason, key) not in self._warned:
            self._warned.add((reason, key))
            warnings.warn(f"body {key!r} {message}", GelWarning, stacklevel=4)

    @property
    def depth_m(self) -> Float64:
        """Distance of the surface of the gel from the sensor, metres, (H, W), a ``GelSurface``."""
        surface_m, _ = elastic.surface_of(self._solution.fields[5:7], self._heights_m, self._whole.block_px)
        depth_m: Float64 = self.sensor.gel_m - surface_m[self._whole.window()]
        return depth_m.view(elastic.GelSurface)

    @property
    def contact(self) -> elastic.ElasticContact:
        """Maps of the window, and force and moment of all bodies, of the last step."""
        total = self.wrenches.sum(axis=0).tolist()
        contact = elastic.contact_of(
            self._solution, self._heights_m, self._whole.block_px, tuple(total[:3]), tuple(total[3:])
        )
        return self._whole.shown(contact)


def _poses_in_gel(count: int, object_poses: PoseLike, sensor_pose: PoseLike) -> Float64:
    objects = as_matrices(object_poses, "object_poses").reshape(-1, 4, 4)
    sensors = as_matrices(sensor_pose, "sensor_pose").reshape(-1, 4, 4)
    if len(objects) != count or len(sensors) != 1:
        raise InputError(
            f"there are {len(objects)} object_poses and {len(sensors)} sensor_pose for {count} solids; "
            "expected one for each solid, and one of the sensor"
        )
    return inverse_times(sensors, objects)
