"""The sensor as a record: what it sees of the gel, and where in a pixel it looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch.contact import PRESS_DEPTH_M
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS
from tactile_toolkit.wording import is_whole, plain

CELL_M = (0.12, 0.12)
"""Width and depth of the plate that objects lie on, metres (`tactile-mnist` 0.13.0, ``CELL_SIZE``)."""

_SURFACE_M = (0.01888, 0.01416)  # tactile-mnist 0.13.0, GELSIGHT_MINI_SENSOR_SURFACE_SIZE
_GEL_M = 0.00425  # tactile-mnist 0.13.0, GELSIGHT_MINI_GEL_THICKNESS_MM

MESA_SAMPLE_PX = (-0.125, -0.375)
"""Where a pixel of the published environments looks, with Mesa 22.3.6 (llvmpipe, 4 samples): the first of its
samples, pixels from the centre, x right and y up. It belongs to the graphics driver."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """A camera behind a gel that is pressed onto things.

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
        Where in a pixel the surface is looked at, pixels from its centre, x right and y up.

    Raises
    ------
    InputError
        A number that cannot be: not finite, not positive, a press deeper than the gel.
    """

    size_px: tuple[int, int]
    window_m: tuple[float, float] = real(_SURFACE_M, above=0, most=1, many=2)
    gel_m: float = real(_GEL_M, above=0, most=0.1)
    press_m: float = real(PRESS_DEPTH_M, above=0)
    sample_px: tuple[float, float] = real((0.0, 0.0), -0.5, 0.5, many=2)

    def __post_init__(self) -> None:
        size = plain(self.size_px)
        if not (isinstance(size, tuple) and len(size) == 2 and is_whole(*size) and min(size) >= 1):
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
        return {
            "size_px": list(self.size_px),
            "window_m": list(self.window_m),
            "gel_m": self.gel_m,
            "press_m": self.press_m,
            "sample_px": list(self.sample_px),
        }


def as_sensor(width_px: int = 320, height_px: int = 240) -> Sensor:
    """Return a GelSight Mini that shows its whole surface, whatever the shape of the image.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels. With another aspect than 4:3 the picture is squashed, as the published
        synthetic sets of 64 x 64 pixels are.

    Returns
    -------
    Sensor
        18.88 x 14.16 mm; pixels look at their centres.
    """
    # The window stays, whatever the aspect: so are the published 64 x 64 pictures made.
    return Sensor((width_px, height_px))


def as_environment(width_px: int = 64, height_px: int = 64) -> Sensor:
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


PRESETS = {"as-sensor": as_sensor, "as-environment": as_environment}
"""Functions that give a sensor for a width and a height in pixels, by the names of the command line."""
