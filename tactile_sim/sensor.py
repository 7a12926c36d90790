"""The sensor: its gel, its camera, and which window of the gel an image shows."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_sim.sensor_parts import FlatGel
from tactile_toolkit import checked_fields, touch
from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError

MESA_SAMPLE_PX = (-0.125, -0.375)
"""Sample position of a pixel in the published environments with Mesa 22.3.6 (llvmpipe, 4 samples): the first
of its samples, in pixels from the centre, x right and y up. It depends on the graphics driver."""

_SURFACE_M = (0.01888, 0.01416)  # tactile-mnist 0.13.0, GELSIGHT_MINI_SENSOR_SURFACE_SIZE
GEL_M = 0.00425
"""Thickness of the gel, metres (tactile-mnist 0.13.0, GELSIGHT_MINI_GEL_THICKNESS_MM)."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """A camera behind a gel that is pressed onto objects.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the image, pixels.
    window_m : tuple of float
        Width and height of the window that the image shows, metres; width along x of the gel's frame, height
        along y.
    gel_m : float
        Thickness of the gel, metres: what lies deeper does not touch it.
    press_m : float
        Distance from the sensor to the highest point under the gel where the sensor stops, metres; less than
        the thickness. The point is then pressed into the gel by ``gel_m - press_m``; in `tactile-mnist`
        0.13.0, both lengths are half of the thickness.
    sample_px : tuple of float
        Where in a pixel the surface is sampled, pixels from its centre, x right and y up.
    surface_m : tuple of float
        Width and height of the whole gel, metres, whose middle is that of the window. A window that is larger
        counts as part of the gel.

    Raises
    ------
    InputError
        A number is not finite or not positive, or the press is deeper than the gel.
    """

    size_px: tuple[int, int]
    window_m: tuple[float, float] = real(_SURFACE_M, above=0, most=1, many=2)
    gel_m: float = real(GEL_M, above=0, most=0.1)
    press_m: float = real(touch.PRESS_DEPTH_M, above=0)
    sample_px: tuple[float, float] = real((0.0, 0.0), -0.5, 0.5, many=2)
    surface_m: tuple[float, float] = real(_SURFACE_M, above=0, most=1, many=2)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", checked_size_px(self.size_px))
        check_fields(self, "the sensor")
        if not self.press_m < self.gel_m:
            raise InputError(
                f"press_m of the sensor is {self.press_m!r}; expected less than gel_m, {self.gel_m!r}"
            )

    @property
    def pixel_m(self) -> tuple[float, float]:
        """Width and height of a pixel, metres."""
        return self.window_m[0] / self.size_px[0], self.window_m[1] / self.size_px[1]


def checked_size_px(size_px: object) -> tuple[int, int]:
    """Return width and height of an image as Python's own integers, pixels; InputError for anything else."""
    size = checked_fields.to_builtin(size_px)
    if not (
        isinstance(size, tuple) and len(size) == 2 and checked_fields.is_integer(*size) and min(size) >= 1
    ):
        raise InputError(f"size of the image is {size_px!r}; expected width and height in whole pixels")
    if size[0] * size[1] > touch.MAX_IMAGE_PIXELS:
        raise InputError(
            f"size of the image is {size[0]} x {size[1]}; expected at most {touch.MAX_IMAGE_PIXELS:,} pixels"
        )
    return size


def full_view(width_px: int = 320, height_px: int = 240) -> Sensor:
    """Return a GelSight Mini that shows its whole surface, whatever the aspect of the image.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels. With an aspect other than 4:3 the image is squashed, like the published
        synthetic sets of 64 x 64 pixels.

    Returns
    -------
    Sensor
        18.88 x 14.16 mm; pixels are sampled at their centres.
    """
    return Sensor((width_px, height_px))


def center_view(width_px: int = 64, height_px: int = 64) -> Sensor:
    """Return the sensor as the published environments show it.

    Their orthographic camera (pyrender 0.1.50) takes the width of its window from the aspect of its pixels:
    an image of 64 x 64 pixels shows 14.16 x 14.16 mm, and only an image of 4:3 shows all 18.88 x 14.16 mm.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels.

    Returns
    -------
    Sensor
        Height 14.16 mm, square pixels sampled at :data:`MESA_SAMPLE_PX`. Another graphics driver may sample
        elsewhere: ``dataclasses.replace(sensor, sample_px=...)``.
    """
    width, height = checked_size_px((width_px, height_px))
    return Sensor((width, height), (_SURFACE_M[1] * width / height, _SURFACE_M[1]), sample_px=MESA_SAMPLE_PX)


def sensor_of_model(model: FlatGel, window: str, size_px: tuple[int, int]) -> Sensor:
    """Return a sensor of another model that shows a window in an image of this size, pixels.

    ``"full"`` is the sensing area, whatever the aspect of the image; ``"center"`` the largest part of it with
    square pixels. Pixels are sampled at their centres.
    """
    sides_mm = (model.width_mm, model.height_mm)
    surface_m = (model.width_mm / 1e3, model.height_mm / 1e3)
    if window == "center":
        pitch_mm = min(side_mm / side_px for side_mm, side_px in zip(sides_mm, size_px, strict=True))
        sides_mm = (pitch_mm * size_px[0], pitch_mm * size_px[1])
    window_m = (sides_mm[0] / 1e3, sides_mm[1] / 1e3)
    return Sensor(size_px, window_m, model.gel_mm / 1e3, model.press_m, surface_m=surface_m)


def sensor_of_window(window: str, size_px: tuple[int, int]) -> Sensor:
    """Return the sensor that shows a window, ``"center"`` or ``"full"``, in an image of this size, pixels."""
    if window == "full":
        return full_view(*size_px)
    return center_view(*size_px)
