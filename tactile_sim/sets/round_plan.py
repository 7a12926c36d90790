"""Plan of a round: positions of the gel and poses of the object, and random numbers by key."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np

from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import pose, pose_product, turn_quaternion
from tactile_sim.sets.set_options import TouchPlan
from tactile_toolkit import arithmetic, touch
from tactile_toolkit.value_types import Float64

REACH_M = (0.0385, 0.0405)
"""Greatest distance of the gel from the middle of the cell along x and y, metres: half the cell less
``CELL_PADDING`` of `tactile-mnist` 0.13.0."""

_MARGIN_M = 0.01  # tactile-mnist 0.13.0, object_placement_margin
_SHIFT_M = 1e-3  # tactile-mnist 0.13.0, translation_perturbation_scale
_SHIFT_RAD = 5e-2  # tactile-mnist 0.13.0, rotation_perturbation_scale


def rng_key(*words: str | int) -> int:
    """Return 128 bits that depend only on these words."""
    return int.from_bytes(hashlib.sha256("/".join(map(str, words)).encode()).digest()[:16], "little")


def keyed_rng(*words: str | int) -> np.random.Generator:
    """Return a generator of random numbers that depend only on these words.

    It is counter-based, so that it has no state to hand on.
    """
    return np.random.Generator(np.random.Philox(key=rng_key(*words)))


@dataclass(frozen=True, slots=True, eq=False)
class RoundPlan:
    """One round: T touches of one object, and T + 1 poses of it.

    Attributes
    ----------
    positions_m : ndarray of float64, shape (T, 2)
        Where the gel goes, metres, cell frame.
    object_position_m : ndarray of float64, shape (T + 1, 3)
        Position of the object at each touch, and after its last shift; metres, cell frame.
    object_quaternion : ndarray of float64, shape (T + 1, 4)
        Its orientation then: x, y, z, w.
    object_poses : ndarray of float64, shape (T + 1, 4, 4)
        The same as matrices.
    """

    positions_m: Float64
    object_position_m: Float64
    object_quaternion: Float64
    object_poses: Float64


def plan_round(plan: TouchPlan, solid: Pressable, split: str, object_id: int, number: int) -> RoundPlan:
    """Draw one round of at least one touch; it depends only on plan, split, object and round number.

    Parameters
    ----------
    plan : TouchPlan
        How often and where objects are touched.
    solid : Pressable
        The object.
    split : str
        Split of the object.
    object_id : int
        Its id.
    number : int
        Number of the round, from 0.

    Returns
    -------
    RoundPlan
        Places of the gel and poses of the object.
    """
    rng = keyed_rng(plan.seed, split, object_id, number)
    angle_rad = plan.turn_rad * (2.0 * rng.random() - 1.0)
    # Drawn in any case, so that the touches of a round do not depend on how the object lies.
    x_m, y_m = _lying_position(plan, solid, angle_rad, rng.random(2))
    positions = lies = None
    if plan.touch_table is not None:
        positions, lies = plan.touch_table.of(object_id, number)
    if lies is None:
        drawn = rng.normal(size=(plan.touches_of(object_id, number), 3))
        lies = _shifted(drawn, x_m, y_m, angle_rad, perturb=plan.perturb)
    else:
        lies = np.concatenate([lies, lies[-1:]])  # its pose after the last touch is not known
    z_m = 0.0 - solid.foot_m  # not -foot_m, which is -0.0 for a foot of 0: other bytes
    matrices = np.array([pose(x_m, y_m, z_m, turn_rad=turned_rad) for x_m, y_m, turned_rad in lies.tolist()])
    quaternions = [turn_quaternion(turned_rad) for turned_rad in lies[:, 2].tolist()]
    if positions is None:
        positions = _positions(plan, solid, matrices, rng)
    return RoundPlan(positions, matrices[:, :3, 3].copy(), np.array(quaternions), matrices)


def _shifted(drawn: Float64, x_m: float, y_m: float, angle_rad: float, *, perturb: bool) -> Float64:
    """Return x, y and turn of the object at each touch and after the last, shape (T + 1, 3)."""
    lies = [(x_m, y_m, angle_rad)]
    scale = np.array([_SHIFT_M, _SHIFT_M, _SHIFT_RAD]) * perturb
    for dx_m, dy_m, turned_rad in (drawn * scale).tolist():
        cosine, sine = arithmetic.cosine_sine(angle_rad)
        x_m = x_m + (cosine * dx_m - sine * dy_m)
        y_m = y_m + (sine * dx_m + cosine * dy_m)
        angle_rad += turned_rad
        lies.append((x_m, y_m, angle_rad))
    return np.array(lies)


def _lying_position(
    plan: TouchPlan, solid: Pressable, angle_rad: float, drawn: Float64
) -> tuple[float, float]:
    if plan.object_placement == "middle":
        return 0.0, 0.0
    cosine, sine = arithmetic.cosine_sine(angle_rad)
    x, y, _ = solid.vertices_m.T
    position = []
    for axis, turned in enumerate((cosine * x - sine * y, sine * x + cosine * y)):
        low = -touch.CELL_M[axis] / 2 + _MARGIN_M - float(turned.min())
        high = touch.CELL_M[axis] / 2 - _MARGIN_M - float(turned.max())
        share = float(drawn[axis])
        if low > high:  # larger than the cell: in its middle
            low = high = (low + high) / 2
        position.append(low + (high - low) * share)
    return position[0], position[1]


def _positions(plan: TouchPlan, solid: Pressable, poses: Float64, rng: np.random.Generator) -> Float64:
    reach: Float64 = np.array(REACH_M)
    if plan.positions == "cell":
        return (2.0 * rng.random((plan.touches, 2)) - 1.0) * reach
    if plan.positions == "grid":
        # The smallest square that holds them; its last row may be short.
        columns = math.isqrt(plan.touches - 1) + 1
        rows = -(-plan.touches // columns)
        number = np.arange(plan.touches)
        shares: Float64 = np.stack(
            [(number % columns + 0.5) / columns, (number // columns + 0.5) / rows], axis=1
        )
        return (2.0 * shares - 1.0) * reach
    return np.clip(on_object(plan.touches, solid, poses, rng), -reach, reach)


def on_object(touches: int, solid: Pressable, poses: Float64, rng: np.random.Generator) -> Float64:
    """Choose points of the faces that look up, evenly over their area as seen from above.

    One for each of the first poses of the solid; x and y, metres, cell frame, shape (touches, 2).
    """
    a, b, c = (solid.vertices_m[solid.faces[:, corner], :2] for corner in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    ends = np.cumsum(np.maximum(area, 0.0))  # cumsum adds one after another, in a stated order
    drawn = rng.random((touches, 3))
    face = np.minimum(np.searchsorted(ends, drawn[:, 0] * ends[-1], side="right"), len(ends) - 1)
    # Two numbers lie in a square; folding its far half back gives the triangle, evenly.
    folded = np.where((drawn[:, 1:].sum(axis=1) > 1)[:, None], 1 - drawn[:, 1:], drawn[:, 1:])
    point = a[face] + folded[:, :1] * (b[face] - a[face]) + folded[:, 1:] * (c[face] - a[face])
    local = np.tile(np.eye(4), (touches, 1, 1))
    local[:, :2, 3] = point
    return pose_product(poses[:touches], local)[:, :2, 3]
