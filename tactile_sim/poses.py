"""Rigid poses as matrices, with sines that have the same bytes on every machine."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.errors import InputError

Matrix = NDArray[np.float64]

_SLACK = 1e-6


def turn_quaternion(angle_rad: float) -> tuple[float, float, float, float]:
    """Return a turn about z as quaternion x, y, z, w."""
    cosine, sine = cosine_sine(angle_rad / 2)
    return (0.0, 0.0, sine, cosine)


def pose(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, *, turn_rad: float = 0.0) -> Matrix:
    """Return the pose of something that stands upright.

    Parameters
    ----------
    x_m, y_m, z_m : float
        Where its origin lies, metres, cell frame: origin at the middle of the plate, x right, y away, z up.
    turn_rad : float
        Turn about z, radians, counter-clockwise seen from above.

    Returns
    -------
    ndarray of float64, shape (4, 4)
        From its own frame to the cell frame. The same bytes on every machine.

    Raises
    ------
    InputError
        A number that is not finite.
    """
    for name, value in (("x_m", x_m), ("y_m", y_m), ("z_m", z_m), ("turn_rad", turn_rad)):
        if not (isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)):
            raise InputError(f"{name} of a pose is {value!r}; expected a finite number")
    cosine, sine = cosine_sine(float(turn_rad))
    rows = [[cosine, -sine, 0.0, x_m], [sine, cosine, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]]
    return np.array(rows, np.float64)


def as_matrices(value: Any, name: str) -> Matrix:
    """Return poses as matrices, shape (4, 4) or (n, 4, 4).

    Takes such arrays, and whatever has them as ``matrix`` or ``as_matrix()``: the poses of `realtouch`, of
    `tactile-mnist` and of scipy. Raises InputError for anything that moves no solid body.
    """
    found: Any = value
    # scipy's transforms have `as_matrix()`, those of the published package an attribute `matrix`.
    if not isinstance(value, np.ndarray):
        if hasattr(value, "as_matrix"):
            found = value.as_matrix()
        elif hasattr(value, "matrix"):
            found = value.matrix
    try:
        matrices = np.asarray(found, np.float64)
    except (TypeError, ValueError):
        matrices = np.empty(0)
    if matrices.ndim not in (2, 3) or matrices.shape[-2:] != (4, 4) or not len(matrices):
        shape = np.shape(found) if isinstance(found, (np.ndarray, list, tuple)) else type(value).__name__
        raise InputError(
            f"{name} is {shape}; expected a pose: a matrix of shape (4, 4), or several, (n, 4, 4)"
        )
    if not np.isfinite(matrices).all():
        raise InputError(f"{name} holds NaN or infinite numbers; expected a pose of finite numbers")
    turn = matrices[..., :3, :3]
    square = (turn[..., :, None, :] * turn[..., None, :, :]).sum(axis=-1)
    rigid = np.abs(square - np.eye(3)).max() <= _SLACK and (np.linalg.det(turn) > 0).all()
    if not rigid or np.abs(matrices[..., 3, :] - [0, 0, 0, 1]).max() > _SLACK:
        raise InputError(
            f"{name} is not a rigid pose; expected a rotation and a translation, no mirror and no scale"
        )
    return matrices


def product(one: Matrix, other: Matrix) -> Matrix:
    """Return ``one @ other`` of matrices (n, 4, 4) in a stated order of sums, which `@` does not have."""
    parts = [one[:, :, k, None] * other[:, None, k, :] for k in range(4)]
    return ((parts[0] + parts[1]) + parts[2]) + parts[3]


def inverse_times(one: Matrix, other: Matrix) -> Matrix:
    """Return the inverses of poses ``one`` times poses ``other``, shape (n, 4, 4)."""
    inverse = np.zeros_like(one)
    inverse[:, :3, :3] = one[:, :3, :3].swapaxes(1, 2)
    x, y, z = (one[:, k, :3] * one[:, k, 3:] for k in range(3))
    inverse[:, :3, 3], inverse[:, 3, 3] = -((x + y) + z), 1.0
    return product(inverse, other)
