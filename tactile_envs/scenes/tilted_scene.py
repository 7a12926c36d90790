"""Touches by tilted sensors, in numba kernels: meshes are seen along the axis of a sensor.

A sensor is tilted by at most 45 degrees: its window sees only a few cells of the grid of a mesh.
"""

from __future__ import annotations

import math
from functools import partial

import gymnasium as gym
import numpy as np
import trimesh

from env_assets.mesh_view import LazyMesh
from tactile_envs import config, episode_kernels, mesh_pool, motion, object_sets
from tactile_envs.config import Config
from tactile_envs.scenes import mesh_scene, scene
from tactile_envs.touch_kernels import (
    EDGE_PX,
    PADDING,
    Cells,
    Pool,
    SensorReadings,
    Setting,
    Workspace,
    draw_touch,
    fill,
    highest_of,
    observe_and_slip,
    raise_within,
    write_edge,
)
from tactile_toolkit.errors import InputError
from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float32, Float64, Int64

_TURN, _TURNED = "sensor_target_rot_rel", "sensor_rot"

# tactile-mnist 0.13.0: thickness of the plate, and from how many widths of it sensors look.
_PLATE_M, _PLATES_AWAY = 0.002, 2.0
_ROUNDING_RAD = 1e-6


class TiltedScene(mesh_scene.MeshScene):
    """Objects in cells, touched by sensors that actions turn as well.

    A sensor comes down along its own axis. It sees the objects, and the plate up to its edges. Parameters are
    those of :class:`tactile_envs.scenes.mesh_scene.MeshScene`.
    """

    def __init__(
        self, config: Config, records: object_sets.Objects, num_envs: int, threads: int, camera: scene.Camera
    ) -> None:
        super().__init__(config, records, num_envs, threads, camera)
        widest_rad = config.max_distance(config.angular_velocity, config.angular_acceleration)
        self._limits = np.array([widest_rad, config.max_tilt_angle])
        box = partial(trimesh.creation.box, (*config.cell_size, _PLATE_M))
        self._plate = mesh_pool.MeshPool.packed([LazyMesh(0, 0, box)], config.max_tilt_angle)
        self._far_m = _PLATES_AWAY * max(config.cell_size)
        self.action_parts[_TURN] = gym.spaces.Box(-np.ones(3, np.float32), np.ones(3, np.float32))
        self.observation_parts[_TURNED] = gym.spaces.Box(-np.ones(6, np.float32), np.ones(6, np.float32))

    @property
    def _most_tilt_rad(self) -> float:
        return self.config.max_tilt_angle

    @property
    def contacts(self) -> None:
        """Not known: the plate under a tilted sensor is pressed in like an object."""
        return

    def _aim_at_start(self, rows: motion.Rows, rng: np.random.Generator) -> None:
        self._targets[rows] = 0.0
        angles = np.zeros((3, self.num_envs))
        if self.config.randomize_initial_sensor_pose:
            # Drawn for all cells, one after the other, and positions in single precision, as published.
            drawn = rng.random((self.num_envs, 5))
            low_m, high_m = self._motion.low_m[:2], self._motion.high_m[:2]
            positions_m = low_m + (high_m - low_m) * drawn[:, :2]
            self._targets[rows, :2] = np.asarray(positions_m[rows], np.float32)
            angles = drawn.T[2:] * [[self.config.max_tilt_angle], [2 * math.pi], [2 * math.pi]]
            angles[1:] -= math.pi
        self._axes[rows] = _axes_of(*angles)[rows]

    def _aim_as_given(self, row: int, start: motion.SensorStart) -> None:
        tilt_rad = math.acos(max(-1.0, min(start.axes[2, 2], 1.0)))
        most_rad = self.config.max_tilt_angle
        if tilt_rad > most_rad + _ROUNDING_RAD:
            raise InputError(
                f"option 'initial_sensor_target_pose' tilts sensor {row} by {tilt_rad:.4f} rad; expected at "
                f"most max_tilt_angle, {most_rad:.4f}"
            )
        self._targets[row] = start.position_m
        self._axes[row] = start.axes

    def checked_action(self, action: config.Action) -> config.Action:
        """Return the arrays of an action; InputError or ValueError if it cannot be used."""
        return {**super().checked_action(action), _TURN: motion.require_move(action, _TURN, self.num_envs)}

    def aim(self, action: config.Action, rows: motion.Rows) -> Float32:
        """Set the targets of some sensors from an action; return the costs of actions, shape (n,)."""
        costs = super().aim(action, rows)
        axes = self._axes.copy()
        episode_kernels.turn(action[_TURN], self._limits, self.config.action_regularization, axes, costs)
        self._axes[rows] = axes[rows]
        return costs

    def touch(self, rows: motion.Rows, rng: np.random.Generator, steps: Int64) -> scene.Readings:
        """Touch in some cells, and let their objects slip."""
        readings = super().touch(rows, rng, steps)
        axes = self._axes[rows].transpose(0, 2, 1)[:, 1:].reshape(-1, 6)
        turned = np.clip(axes, -1, 1).astype(np.float32)
        return scene.Readings({**readings.observation, _TURNED: turned}, readings.info)

    def _press(self, cells: Cells, drift: Float64, *, has_depth: bool) -> SensorReadings:
        setting = Setting(self._toucher.window, self._motion.numbers, drift)
        pools = (self._pool.arrays, self._plate.arrays, self._far_m)

        def press(begin: int, end: int, workspace: Workspace, readings: SensorReadings) -> None:
            touch_tilted(begin, end, setting, pools, cells, workspace, readings)

        return self._toucher.shared(len(cells.numbers), press, with_depth=has_depth)


def _axes_of(tilt: Float64, towards: Float64, spin: Float64) -> Float64:
    """Return axes (n, 3, 3), in columns, of sensors that are spun, then tilted in a direction; radians."""
    x = np.cos(towards)
    y = np.sin(towards)
    level = np.zeros(len(tilt))
    z = np.stack([np.sin(tilt) * x, np.sin(tilt) * y, np.cos(tilt)], axis=1)
    down = np.stack([np.cos(tilt) * x, np.cos(tilt) * y, -np.sin(tilt)], axis=1)
    across = np.stack([-y, x, level], axis=1)
    cosine, sine = np.cos(spin)[:, None], np.sin(spin)[:, None]
    return np.stack([cosine * down + sine * across, cosine * across - sine * down, z], axis=2)


@compiled
def touch_tilted(
    begin: int,
    end: int,
    setting: Setting,
    pools: tuple[Pool, Pool, float],
    cells: Cells,
    workspace: Workspace,
    readings: SensorReadings,
) -> None:
    """Press tilted sensors along their axes, and let the objects slip, for environments ``begin`` to ``end``.

    ``pools`` are that of the objects; that of the plate under them, one mesh with its upper side at height 0;
    and how far below the target of a sensor it sees, metres. Sensors are moved along their z axes until the
    gel is pressed in. The rest is as for :func:`tactile_envs.touch_kernels.touch`.
    """
    heights = workspace[0]
    pool, plate, far_m = pools
    window, axes, sensors, objects = setting.window, cells.axes, cells.sensors, cells.objects
    view, pose = np.empty((3, 4)), np.empty((3, 4))
    for i in range(begin, end):
        cosine, sine = math.cos(objects[i, 2]), math.sin(objects[i, 2])
        pose[:, :] = 0.0
        pose[0, 0] = pose[1, 1] = pose[2, 2] = 1.0
        fill(heights, -far_m)
        pose[2, 3] = -plate[3][0, 12]
        _look(view, window, axes[i], sensors[i], pose)
        raise_mesh(plate, 0, view, workspace)
        pose[0, 0], pose[0, 1], pose[0, 3] = cosine, -sine, objects[i, 0]
        pose[1, 0], pose[1, 1], pose[1, 3] = sine, cosine, objects[i, 1]
        pose[2, 3] = 0.0
        _look(view, window, axes[i], sensors[i], pose)
        raise_mesh(pool, cells.numbers[i], view, workspace)
        highest = highest_of(heights, workspace[1])
        readings.is_bare[i] = False  # the plate under a tilted sensor is drawn like an object
        # Distance along its axis at which the sensor reaches its least height.
        least_m = (window[5] - sensors[i, 2]) / axes[i, 2, 2]
        draw_touch(i, readings, heights, highest, window, least_m)
        observed_m = max(highest + window[3] + cells.lifts[i], least_m)
        for axis in range(3):
            sensors[i, axis] += axes[i, axis, 2] * observed_m
        observe_and_slip(i, cosine, sine, setting, cells, readings.positions)


@part
def _look(view: Float64, window: Float64, axes: Float64, sensor: Float64, pose: Float64) -> None:
    """Write the affine map of a mesh to columns, rows and heights, metres, shape (3, 4).

    ``axes`` (3, 3) and ``sensor`` (3,) are those of a sensor, and ``pose`` (3, 4) that of the mesh.
    """
    for row in range(3):
        for column in range(4):
            total = 0.0
            for k in range(3):
                along = pose[k, column]
                if column == 3:
                    along -= sensor[k]
                total += axes[k, row] * along
            view[row, column] = total
    for row in range(2):
        for column in range(4):
            view[row, column] *= window[0]
        view[row, 3] += window[1 + row]


@part
def raise_mesh(pool: Pool, number: int, view: Float64, workspace: Workspace) -> None:
    """Raise pixels to the nearest triangle of mesh ``number`` at each of them.

    Heights are metres towards the sensor; samples of pixels are at integers. ``view`` (3, 4) gives column,
    row and height of a point x, y, z, 1 of the mesh.
    """
    affine = (
        (view[0, 0], view[0, 1], view[0, 2], view[0, 3]),
        (view[1, 0], view[1, 1], view[1, 2], view[1, 3]),
        (view[2, 0], view[2, 1], view[2, 2], view[2, 3]),
    )
    corners = _window_in_grid(workspace[0], pool[3][number], view)
    edges = workspace[5]
    # Four around the foot, four around the top, and four upright ones.
    for edge in range(12):
        side = edge & 3
        begin = side + 4 * (edge >> 2 == 1)
        end = side + 4
        if edge < 8:
            end = ((side + 1) & 3) + 4 * (edge >> 2)
        edges[0, edge], edges[1, edge] = corners[begin, 0], corners[begin, 1]
        write_edge(edges, edge, corners[end, 0], corners[end, 1])
    raise_within(pool, number, 12, affine, workspace)


@part
def _window_in_grid(heights: Float32, grid: Float64, view: Float64) -> Float64:
    """Return corners (8, 2) of the part of a mesh's box that the window sees, from the corner of its grid on.

    The first four are at the height of its foot, the others at that of its top.
    """
    rows = heights.shape[0]
    columns = heights.shape[1] - PADDING
    corners = np.empty((8, 2))
    per_area = 1.0 / (view[0, 0] * view[1, 1] - view[0, 1] * view[1, 0])
    for corner in range(8):
        side = corner & 3
        height_m = grid[12] * (corner >> 2)
        column = columns - 1.0 + EDGE_PX if side == 1 or side == 2 else -EDGE_PX
        row = rows - 1.0 + EDGE_PX if side >= 2 else -EDGE_PX
        over = column - view[0, 3] - view[0, 2] * height_m
        along = row - view[1, 3] - view[1, 2] * height_m
        corners[corner, 0] = (view[1, 1] * over - view[0, 1] * along) * per_area - grid[6]
        corners[corner, 1] = (view[0, 0] * along - view[1, 0] * over) * per_area - grid[7]
    return corners
