"""Poses of solids and sensors: rotations and translations as matrices (4, 4), metres."""

from __future__ import annotations

import math
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import InputError

_RIGID = 1e-6  # greatest error of the entries of a rotation


class HasMatrix(Protocol):
    """A pose of another library, such as those of `realtouch` and `tactile-mnist`."""

    @property
    def matrix(self) -> ArrayLike:
        """Rotation and translation, shape (4, 4) or (n, 4, 4), metres."""


PoseLike: TypeAlias = ArrayLike | HasMatrix
"""One pose or several, as matrices or as objects that have them."""


def turn_quaternion(angle_rad: float) -> tuple[float, float, float, float]:
    """Return a rotation about z as quaternion x, y, z, w."""
    cosine, sine = cosine_sine(angle_rad / 2)
    return (0.0, 0.0, sine, cosine)


def pose(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, *, turn_rad: float = 0.0) -> Float64:
    """Return an upright pose: a position, and a rotation about z.

    Parameters
    ----------
    x_m, y_m, z_m : float
        Position of its origin, metres, cell frame: origin at the middle of the plate, x right, y away, z up.
    turn_rad : float
        Rotation about z, radians, counter-clockwise seen from above.

    Returns
    -------
    ndarray of float64, shape (4, 4)
        From its own frame to the cell frame. The same bytes on every machine.

    Raises
    ------
    InputError
        A number is not finite.
    """
    for name, value in (("x_m", x_m), ("y_m", y_m), ("z_m", z_m), ("turn_rad", turn_rad)):
        if not (isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)):
            raise InputError(f"{name} of a pose is {value!r}; expected a finite number")
    cosine, sine = cosine_sine(float(turn_rad))
    rows = [[cosine, -sine, 0.0, x_m], [sine, cosine, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]]
    return np.array(rows, np.float64)


def as_matrices(value: PoseLike, name: str) -> Float64:
    """Return poses as matrices, shape (4, 4) or (n, 4, 4).

    InputError, which begins with ``name``, for anything that is not a rigid motion.
    """
    found = getattr(value, "matrix", value)
    try:
        matrices = np.asarray(found, np.float64)
    except (TypeError, ValueError):
        matrices = np.empty(0)
    if matrices.ndim not in (2, 3) or matrices.shape[-2:] != (4, 4) or not len(matrices):
        shape: object = type(value).__name__
        if isinstance(found, (np.ndarray, list, tuple)):
            shape = np.shape(found)
        raise InputError(
            f"{name} is {shape}; expected a pose: a matrix of shape (4, 4), or several, (n, 4, 4)"
        )
    if not np.isfinite(matrices).all():
        raise InputError(f"{name} holds NaN or infinite numbers; expected a pose of finite numbers")
    turn = matrices[..., :3, :3]
    square = (turn[..., :, None, :] * turn[..., None, :, :]).sum(axis=-1)
    rigid = np.abs(square - np.eye(3)).max() <= _RIGID and (np.linalg.det(turn) > 0).all()
    if not rigid or np.abs(matrices[..., 3, :] - [0, 0, 0, 1]).max() > _RIGID:
        raise InputError(
            f"{name} is not a rigid pose; expected a rotation and a translation, no mirror and no scale"
        )
    return matrices


def pose_product(one: Float64, other: Float64) -> Float64:
    """Return ``one @ other`` of matrices (n, 4, 4) with a fixed order of sums, unlike `@`."""
    parts = [one[:, :, k, None] * other[:, None, k, :] for k in range(4)]
    return ((parts[0] + parts[1]) + parts[2]) + parts[3]


def inverse_times(one: Float64, other: Float64) -> Float64:
    """Return the inverses of poses ``one`` times poses ``other``, shape (n, 4, 4)."""
    inverse = np.zeros_like(one)
    inverse[:, :3, :3] = one[:, :3, :3].swapaxes(1, 2)
    x, y, z = (one[:, k, :3] * one[:, k, 3:] for k in range(3))
    inverse[:, :3, 3], inverse[:, 3, 3] = -((x + y) + z), 1.0
    return pose_product(inverse, other)
