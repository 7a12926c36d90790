"""Random episodes in an environment, and what the records say must be seen in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from env_assets import top_surface

SENSOR_HEIGHT_M = 0.01416
"""Height of what the gel senses (constants of tactile-mnist 0.13.0).

Its width follows from the image: pyrender gives an orthographic camera the aspect of its pixels, so that the
square images of the registered environments show 14.16 x 14.16 mm, not the 18.88 x 14.16 mm of the gel.
"""

PRESS_DEPTH_M = 0.002125
"""How far the gel is pressed into what it meets first."""

CONTACT_HEIGHT_M = 0.001
"""A touch that ends higher than this above the plate has hit an object."""


@dataclass
class Step:
    """One step of a vector environment; fields are lists or arrays over the environments."""

    points: tuple[Any, ...]  # what lay there before the step
    object_poses: Any  # where it lay before the step
    was_done: NDArray[np.bool_]  # whether the step began a new episode
    action: Any
    observation: dict[str, NDArray[Any]]
    reward: NDArray[Any]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: dict[str, Any]


@dataclass
class Rollout:
    """A reset and some random steps."""

    observation: dict[str, NDArray[Any]]
    steps: list[Step] = field(default_factory=list)

    @property
    def observations(self) -> list[dict[str, NDArray[Any]]]:
        return [self.observation, *(step.observation for step in self.steps)]


def roll(env: Any, steps: int, seed: int, actions: Sequence[Any] = ()) -> Rollout:
    """Reset and take steps, random ones or those of a record, everything from one seed."""
    observation, _ = env.reset(seed=seed)
    env.action_space.seed(seed)
    rollout = Rollout(_copied(observation))
    inner = env.unwrapped
    done = np.zeros(env.num_envs, bool)
    for number in range(steps):
        points, poses = inner.current_data_points, inner.current_object_poses_platform_frame
        action = actions[number] if actions else env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)
        rollout.steps.append(
            Step(points, poses, done, action, _copied(observation), reward, terminated, truncated, info)
        )
        done = terminated | truncated
    return rollout


def _copied(observation: dict[str, Any]) -> dict[str, NDArray[Any]]:
    return {name: np.array(value) for name, value in observation.items()}


def expected_depth_m(
    record: Any, object_pose: Any, sensor_position_m: NDArray[Any], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Compute what the sensor measures from the height map of a record.

    Parameters
    ----------
    record : SolidRecord
        What lies in the cell.
    object_pose : Transformation
        Where.
    sensor_position_m : ndarray, shape (3,)
        Where the sensor is; it looks straight down.
    shape : (int, int)
        Rows and columns of the image. Rows grow along -y, columns along x.

    Returns
    -------
    ndarray, shape (rows, columns)
        Distance from the sensor down to the surface, metres.
    """
    rows, columns = shape
    pixel_m = SENSOR_HEIGHT_M / rows
    x = sensor_position_m[0] + (np.arange(columns) + 0.5 - columns / 2) * pixel_m
    y = sensor_position_m[1] - (np.arange(rows) + 0.5 - rows / 2) * pixel_m
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    return sensor_position_m[2] - _heights_m(top_surface(record, 0.0001), object_pose, grid)


def _heights_m(surface: Any, object_pose: Any, points_m: NDArray[Any]) -> NDArray[np.float64]:
    """Look up the surface below points (..., 2) of the cell; 0 where the plate lies bare."""
    turn = Rotation.from_matrix(object_pose.rotation.as_matrix()).as_matrix()[:2, :2]
    local = (points_m - object_pose.translation[:2]) @ turn  # the transpose of `turn` from the left
    window, (rows, columns) = surface, surface.heights_m.shape
    column = np.floor(local[..., 0] / window.pitch_m).astype(int) - window.first_column
    row = np.floor(local[..., 1] / window.pitch_m).astype(int) - window.first_row
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    heights = surface.filled(0.0)[np.where(inside, row, 0), np.where(inside, column, 0)]
    covered = surface.covered[np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside & covered, heights + object_pose.translation[2], 0.0)
