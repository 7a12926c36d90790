"""The sensor as a record, and where it is: what it sees of the gel, and rigid poses as matrices."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch.contact import PRESS_DEPTH_M
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS
from tactile_toolkit.wording import is_integer, plain

CELL_M = (0.12, 0.12)
"""Width and depth of the plate that objects lie on, metres (`tactile-mnist` 0.13.0, ``CELL_SIZE``)."""

_SURFACE_M = (0.01888, 0.01416)  # tactile-mnist 0.13.0, GELSIGHT_MINI_SENSOR_SURFACE_SIZE
_GEL_M = 0.00425  # tactile-mnist 0.13.0, GELSIGHT_MINI_GEL_THICKNESS_MM

MESA_SAMPLE_PX = (-0.125, -0.375)
"""Where a pixel of the published environments looks, with Mesa 22.3.6 (llvmpipe, 4 samples): the first of its
samples, pixels from the centre, x right and y up. It belongs to the graphics driver."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """A camera behind a gel that is pressed onto objects.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the image, pixels.
    window_m : tuple of float
        Width and height of what the image shows, metres; width along x of the gel's frame, height along y.
    gel_m : float
        Thickness of the gel, metres: what lies deeper does not touch it.
    press_m : float
        How far the highest point under the gel is pressed into it, metres; less than the thickness.
    sample_px : tuple of float
        Where in a pixel the surface is sampled, pixels from its centre, x right and y up.

    Raises
    ------
    InputError
        An invalid number: not finite, not positive, a press deeper than the gel.
    """

    size_px: tuple[int, int]
    window_m: tuple[float, float] = real(_SURFACE_M, above=0, most=1, many=2)
    gel_m: float = real(_GEL_M, above=0, most=0.1)
    press_m: float = real(PRESS_DEPTH_M, above=0)
    sample_px: tuple[float, float] = real((0.0, 0.0), -0.5, 0.5, many=2)

    def __post_init__(self) -> None:
        size = plain(self.size_px)
        if not (isinstance(size, tuple) and len(size) == 2 and is_integer(*size) and min(size) >= 1):
            raise InputError(
                f"size of the image is {self.size_px!r}; expected width and height in whole pixels"
            )
        if size[0] * size[1] > MAX_IMAGE_PIXELS:
            raise InputError(
                f"size of the image is {size[0]} x {size[1]}; expected at most {MAX_IMAGE_PIXELS:,} pixels"
            )
        object.__setattr__(self, "size_px", size)
        check_fields(self, "the sensor")
        if not self.press_m < self.gel_m:
            raise InputError(
                f"press_m of the sensor is {self.press_m!r}; expected less than gel_m, {self.gel_m!r}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        values = asdict(self).items()
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values}


def full_view(width_px: int = 320, height_px: int = 240) -> Sensor:
    """Return a GelSight Mini that shows its whole surface, whatever the shape of the image.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels. With another aspect than 4:3 the picture is squashed, as the published
        synthetic sets of 64 x 64 pixels are.

    Returns
    -------
    Sensor
        18.88 x 14.16 mm; pixels are sampled at their centres.
    """
    # The window stays, whatever the aspect: so are the published 64 x 64 pictures made.
    return Sensor((width_px, height_px))


def center_view(width_px: int = 64, height_px: int = 64) -> Sensor:
    """Return the sensor as the published environments show it.

    Their orthographic camera (pyrender 0.1.50) takes the width of its window from the aspect of its pixels:
    an image of 64 x 64 pixels shows 14.16 x 14.16 mm and only one of 4:3 the whole 18.88 x 14.16 mm.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels.

    Returns
    -------
    Sensor
        Height 14.16 mm, square pixels, which look at :data:`MESA_SAMPLE_PX`; another graphics driver may
        look elsewhere: ``dataclasses.replace(sensor, sample_px=...)``.
    """
    checked = Sensor((width_px, height_px))
    width, height = checked.size_px
    return Sensor(checked.size_px, (_SURFACE_M[1] * width / height, _SURFACE_M[1]), sample_px=MESA_SAMPLE_PX)


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
