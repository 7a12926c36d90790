"""Presses of the elastic gel of a sensor: the whole gel is solved; an image shows a part, with markers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike

from tactile_sim.elastic.contact import (
    ElasticContact,
    Gel,
    GelLoad,
    pixel_positions_m,
    require_solved,
    solve_unjudged,
)
from tactile_sim.press.press_spec import MAX_FORCE_N, MAX_SLIDE_M, MAX_TWIST_RAD, checked_markers
from tactile_sim.press.sensors import Sensor, checked_size_px
from tactile_sim.user_values import finite_array, read_values, real_array, shown
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import MAX_IMAGE_PIXELS
from tactile_toolkit.value_types import AnyArray, Bool, Float64, UInt8

MAX_SHARE = 0.5
"""Greatest press depth, as a share of the thickness of the gel; there, linear theory is only indicative."""

# Pixels of 64 x 64 images have 0.22 mm. At 80 x 60 blocks of 320 x 240 pixels the depth is off by 2 um.
SOLVED_M = 0.00024
"""Greatest width of blocks of pixels, metres."""

_SAME = 1 + 1e-9  # sides that differ only by rounding
_SLIP_REACH_M = 0.003  # distance at which the slip of a contact has decayed; slides are at most a third
_MAPS = ("pressure_pa", "traction_pa", "displacement_m", "is_contact", "is_stick")
_MARKER_RADIUS = 0.18  # of the distance of two markers: about that of the dots of a GelSight Mini
_MARKER_SHADE = 0.15  # share of the light that a marker reflects


@dataclass(frozen=True, slots=True)
class WholeGel:
    """The whole gel around the window of a sensor.

    Attributes
    ----------
    sensor : Sensor
        The sensor with a window that shows the whole gel, in pixels of the same size.
    block_px : int
        Side of the blocks of pixels that are solved as one.
    beside_px : tuple of int
        How many pixels the gel reaches beyond the window on each side, along x and along y.
    """

    sensor: Sensor
    block_px: int
    beside_px: tuple[int, int]

    @classmethod
    def of(cls, sensor: Sensor, solved_m: float = SOLVED_M) -> WholeGel:
        """Extend a window to the whole gel, a whole number of blocks that are at most ``solved_m`` wide.

        InputError for a window that is larger than the gel, or a gel of too many pixels.
        """
        if any(shown > _SAME * whole for shown, whole in zip(sensor.window_m, sensor.surface_m, strict=True)):
            (shown_x, shown_y), (width_m, height_m) = sensor.window_m, sensor.surface_m
            raise InputError(
                f"the image shows {1e3 * shown_x:.2f} x {1e3 * shown_y:.2f} mm, and the elastic gel has "
                f"{1e3 * width_m:.2f} x {1e3 * height_m:.2f} mm",
                next="use an image of another aspect, such as 4:3, or the full view",
            )
        sides = zip(sensor.surface_m, sensor.window_m, sensor.pixel_m, strict=True)
        least = [max(0, round((surface - window) / 2 / pixel)) for surface, window, pixel in sides]
        block_px = max(1, int(solved_m / max(sensor.pixel_m)))
        while True:
            beside = [_filled(px, more, block_px) for px, more in zip(sensor.size_px, least, strict=True)]
            if None not in beside:
                break
            block_px -= 1
        across, along = (more for more in beside if more is not None)
        width, height = sensor.size_px[0] + 2 * across, sensor.size_px[1] + 2 * along
        if width * height > MAX_IMAGE_PIXELS:
            raise InputError(
                f"the whole gel has {width:,} x {height:,} pixels of the size of those of the window; "
                f"expected at most {MAX_IMAGE_PIXELS:,}",
                next="use a sensor with fewer pixels, or a larger window",
            )
        window_m = (width * sensor.pixel_m[0], height * sensor.pixel_m[1])
        shown = replace(sensor, size_px=(width, height), window_m=window_m)
        return cls(shown, block_px, (across, along))

    def window(self) -> tuple[slice, slice]:
        """Return rows and columns of the window in maps of the whole gel."""
        width, height = self.sensor.size_px
        across, along = self.beside_px
        return slice(along, height - along), slice(across, width - across)

    def press(self, heights_m: Float64, load: GelLoad, out: Float64) -> ElasticContact:
        """Solve a touch of the whole gel, heights in metres; return the contact with maps of the window.

        ``out`` (H, W) gets the distance of its surface from the sensor, metres.
        """
        from tactile_sim.press.press_kernels import show_surface  # numba takes half a second to import

        sensor, (rows, columns) = self.sensor, self.window()
        if heights_m.min() < heights_m.max():
            contact = self.contact(heights_m, load)
        else:
            contact = _plate_contact(load, self)
        corner = (rows.start, columns.start)
        inward_m = np.ascontiguousarray(contact.displacement_m[..., 2:])
        motion_m = _visible_motion(contact, load, sensor)
        show_surface(out, corner, inward_m, motion_m, sensor.pixel_m, sensor.gel_m)
        return replace(self.shown(contact), torque_n_m=_about_axis(contact, sensor))

    def shown(self, contact: ElasticContact) -> ElasticContact:
        """Return a contact with maps of the window instead of the whole gel."""
        window = self.window()
        return replace(contact, **{name: getattr(contact, name)[window].copy() for name in _MAPS})

    def contact(self, heights_m: Float64, load: GelLoad) -> ElasticContact:
        """Press the whole gel to the depth, or to the force, but no deeper than linear theory goes.

        InputError if no solution was found.
        """
        sensor = self.sensor
        under = replace(load, slide_m=_motion_under(load, sensor)[:2])
        solve = partial(
            solve_unjudged, heights_m, sensor.pixel_m, thickness_m=sensor.gel_m, block_px=self.block_px
        )
        contact = solve(under)
        most_m = MAX_SHARE * sensor.gel_m
        if load.depth_m is None and not contact.depth_m <= most_m:
            contact = solve(replace(under, force_n=None, depth_m=most_m))
        require_solved(contact, sensor.gel_m)
        return contact


def _filled(size_px: int, least: int, block_px: int) -> int | None:
    """Return the margin of each side, at least ``least`` pixels, that fills whole blocks; or None."""
    return next((k for k in range(least, least + block_px) if (size_px + 2 * k) % block_px == 0), None)


def read_gel(path: str) -> Gel:
    """Read the properties of a gel from a JSON file; InputError for any other file."""
    return read_values(path, Gel, "the gel")


def _visible_motion(contact: ElasticContact, load: GelLoad, sensor: Sensor) -> Float64:
    """Return the motion along x and y of the visible surface, metres, (H, W, 2).

    In the contact, the shape of the body is visible and moves, even where it slips over the gel; far from
    it, the gel itself; in between, the motion is interpolated.
    """
    from scipy.ndimage import distance_transform_edt  # takes a tenth of a second to import

    rows, columns = contact.is_contact.shape
    width_m, height_m = sensor.pixel_m
    x_m, y_m = pixel_positions_m((rows, columns), (width_m, height_m))
    slide_x_m, slide_y_m, twist_rad = _motion_under(load, sensor)
    body_m = np.empty((rows, columns, 2))
    body_m[..., 0] = slide_x_m - twist_rad * y_m
    body_m[..., 1] = slide_y_m + twist_rad * x_m
    gel_m = contact.displacement_m[..., :2]
    # Beside the contact, the slip of its nearest point, decreasing with the distance.
    away_m, nearest = distance_transform_edt(
        ~contact.is_contact, sampling=(height_m, width_m), return_indices=True
    )
    share = np.square(np.maximum(1.0 - away_m / _SLIP_REACH_M, 0.0))
    moved: Float64 = gel_m + share[..., None] * (body_m - gel_m)[tuple(nearest)]
    return moved


def _motion_under(load: GelLoad, sensor: Sensor) -> tuple[float, float, float]:
    """Return the slide under the middle of the map, to which the turn about the axis adds, and the turn."""
    x_m, y_m, twist_rad = np.append(load.slide_m, load.twist_rad).tolist()
    off_x_m, off_y_m = _off_axis_m(sensor)
    return x_m - twist_rad * off_y_m, y_m + twist_rad * off_x_m, twist_rad


# With a single force, most touches of a set or environment meet only the plate, and share this contact.
@lru_cache(maxsize=4)
def _plate_contact(load: GelLoad, whole: WholeGel) -> ElasticContact:
    return whole.contact(np.zeros(whole.sensor.size_px[::-1]), load)


@lru_cache(maxsize=64)
def plate_z_m(sensor: Sensor, load: GelLoad) -> float:
    """Return the height at which a sensor stops on the bare plate, metres."""
    return sensor.gel_m - _plate_contact(load, WholeGel.of(sensor)).depth_m


def _off_axis_m(sensor: Sensor) -> tuple[float, float]:
    """Return the offset of the middle of a map from the sensor's axis, as pixels are sampled off-centre."""
    return sensor.sample_px[0] * sensor.pixel_m[0], sensor.sample_px[1] * sensor.pixel_m[1]


def _about_axis(contact: ElasticContact, sensor: Sensor) -> tuple[float, float, float]:
    """Convert a torque about the middle of a map to one about the sensor's axis, N m."""
    (x, y, z), (off_x_m, off_y_m) = contact.torque_n_m, _off_axis_m(sensor)
    force_x, force_y, force_z = contact.force_n
    return x + off_y_m * force_z, y - off_x_m * force_z, z + off_x_m * force_y - off_y_m * force_x


def loads_of(load: GelLoad, count: int, sensor: Sensor) -> list[GelLoad]:
    """Return the loads of ``count`` touches, of one with numbers for each or for all.

    InputError for numbers out of range.
    """
    name = "depth_m" if load.force_n is None else "force_n"
    most = {"force_n": MAX_FORCE_N, "depth_m": sensor.gel_m}[name]
    numbers = _numbers(name, getattr(load, name), (count,))
    slides = _numbers("slide_m", load.slide_m, (count, 2))
    twists = _numbers("twist_rad", load.twist_rad, (count,))
    _require(name, (numbers > 0) & (numbers < most), numbers, f"above 0 and below {most:g}")
    _require("slide_m", np.abs(slides) <= MAX_SLIDE_M, slides, f"at most {MAX_SLIDE_M:g} along x and y")
    _require(
        "twist_rad",
        np.abs(twists) <= MAX_TWIST_RAD,
        twists,
        f"at most {MAX_TWIST_RAD:.4g} in either direction",
    )
    return [
        replace(load, **{name: number}, slide_m=(x, y), twist_rad=twist)
        for number, (x, y), twist in zip(numbers.tolist(), slides.tolist(), twists.tolist(), strict=True)
    ]


def _numbers(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Float64:
    """Broadcast finite numbers, of each touch or of all, to a shape; InputError for anything else."""
    array = real_array(value)
    fits = array is not None and array.shape in (shape, shape[1:])
    if array is None or not fits or not np.isfinite(array).all():
        what = "x and y" if len(shape) == 2 else "a number"
        raise InputError(
            f"{name} is {shown(value)}; expected {what}, metres, newtons or radians, for all touches or for "
            f"each of {shape[0]}"
        )
    return np.broadcast_to(array, shape).copy()


def _require(name: str, fits: Bool, numbers: Float64, expected: str) -> None:
    if not np.all(fits):
        first = numbers[~fits].flat[0]
        raise InputError(f"{name} is {first:g}; expected {expected}")


def marker_grid_px(markers: tuple[int, int], size_px: tuple[int, int]) -> Float64:
    """Return the positions of the markers of a gel at rest in the image.

    Parameters
    ----------
    markers : tuple of int
        Columns and rows of markers, evenly spaced, half a step from the edge of the image.
    size_px : tuple of int
        Width and height of the image, pixels.

    Returns
    -------
    ndarray of float64, shape (rows, columns, 2)
        Column and row in pixels, from 0 in the middle of the first pixel.
    """
    grid = zip(checked_markers(markers), checked_size_px(size_px), strict=True)
    across, down = ((np.arange(count) + 0.5) * size / count - 0.5 for count, size in grid)
    return np.stack(np.meshgrid(across, down), axis=-1)


def marker_positions_px(
    displacement_m: Float64,
    window_m: tuple[float, float],
    markers: tuple[int, int],
    size_px: tuple[int, int],
) -> Float64:
    """Return the positions of markers that have moved with the surface of the gel.

    Parameters
    ----------
    displacement_m : ndarray, shape (H, W, 3)
        Displacement of the surface that the image shows, metres: along x, along y, and into the gel.
    window_m : tuple of float
        Width and height of that part of the gel, metres.
    markers : tuple of int
        Columns and rows of markers.
    size_px : tuple of int
        Width and height of the image, pixels; not necessarily W and H.

    Returns
    -------
    ndarray of float64, shape (rows, columns, 2)
        Column and row in pixels; y of the gel is against the rows. Less :func:`marker_grid_px`, this is the
        flow.
    """
    at_rest_px = marker_grid_px(markers, size_px)
    displacement_m = finite_array(
        displacement_m, "displacement_m", (None, None, 3), "an array (H, W, 3), metres"
    )
    window_m = tuple(finite_array(window_m, "window_m", (2,), "width and height, metres").tolist())
    if not min(window_m) > 0:
        raise InputError(f"window_m is {window_m}; expected a width and a height above 0, metres")
    height, width = displacement_m.shape[:2]
    positions = (at_rest_px + 0.5) / size_px * [width, height] - 0.5
    moved_m = _between(displacement_m[..., :2], positions)
    return at_rest_px + moved_m * [size_px[0] / window_m[0], -size_px[1] / window_m[1]]


def _between(values: AnyArray, positions: Float64) -> Float64:
    """Interpolate a map (H, W, k) linearly at columns and rows (..., 2), clamped to the edge."""
    most = np.array(values.shape[1::-1]) - 1
    inside = np.clip(positions, 0, most)
    first = np.minimum(inside.astype(np.int64), np.maximum(most - 1, 0))
    after = np.minimum(first + 1, most)
    across, down = np.moveaxis((inside - first)[..., None], -2, 0)
    upper = (
        values[first[..., 1], first[..., 0]] * (1 - across) + values[first[..., 1], after[..., 0]] * across
    )
    lower = (
        values[after[..., 1], first[..., 0]] * (1 - across) + values[after[..., 1], after[..., 0]] * across
    )
    between: Float64 = upper * (1 - down) + lower * down
    return between


def draw_markers(picture: UInt8, positions_px: Float64) -> UInt8:
    """Return an image (H, W, 3) with dark dots at positions (rows, columns, 2), pixels.

    Their edges are a pixel wide. They do not change with depth or slope.
    """
    rows, columns = positions_px.shape[:2]
    height, width = picture.shape[:2]
    radius = max(_MARKER_RADIUS * min(width / columns, height / rows), 0.5)
    reach = math.ceil(radius + 1)
    light = np.ones((height, width))
    for x, y in positions_px.reshape(-1, 2).tolist():
        left = max(math.floor(x) - reach, 0)
        right = min(math.ceil(x) + reach + 1, width)
        top = max(math.floor(y) - reach, 0)
        bottom = min(math.ceil(y) + reach + 1, height)
        if left >= right or top >= bottom:
            continue
        far = np.hypot(np.arange(left, right)[None, :] - x, np.arange(top, bottom)[:, None] - y)
        covered = np.clip(radius + 0.5 - far, 0, 1)
        part = light[top:bottom, left:right]
        np.minimum(part, 1 - (1 - _MARKER_SHADE) * covered, out=part)
    return np.asarray(np.rint(picture * light[..., None]), np.uint8)
