"""Sensors whose properties only the tests know, and recordings of their touches.

The project's rasteriser gives heights of solids. Everything else (gel, colours, lens, camera, noise, JPEG)
is implemented in this file, in plain NumPy and SciPy, so that a fit and its reference share no mistake.
Three families of optics::

    taxim      slopes of a gel, coloured by the published calibration of Taxim, with its shadows
    phong      another gel, lit by coloured lamps: Lambert's law, Phong's highlights, light that fades
    published  Taxim with its own gel and window, without a camera; noise of one level
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage, signal

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.press.pressable import Pressable
from tactile_toolkit.mesh import Mesh
from tests.tactile_sim.hidden_recordings import Recording

Family = Literal["taxim", "phong", "published"]
Array = NDArray[Any]

MISTAKES = (
    *("channels", "mesh", "units", "mirrored", "markers"),
    *("saturated", "gel-changed", "too-few", "flat"),
)
"""Mistakes that :meth:`HiddenSensor.record` plants."""

_MARGIN = 0.14  # of the image on each side, which the lens may pull into it
_RAYS = np.linspace(-0.1, 0.1, 4)  # taxim 1.4.1, fan_angle and fan_precision
_AWAY_MM = 3.0  # from a point of the solid, standard deviation of where a digit is touched
_MARKER_MM = 1.6


@dataclass(frozen=True)
class HiddenSensor:
    """Everything that decides the images of a sensor.

    Lengths in mm; ``softness`` multiplies how far the gel is pulled down around a contact, ``contact`` is the
    share of the press above which the gel follows the solid; ``colours`` (3, 3) and ``light`` (3, 6) a
    quadratic field for each colour; ``blur_px``, ``noise`` in levels, ``lens`` the first coefficient of
    radial distortion (in units of half the diagonal), ``jpeg`` a quality or 0 for none; ``lamps`` (L, 8):
    direction, height, colour, fall-off, highlight and its sharpness of each lamp (phong).
    """

    family: Family
    seed: int
    size_px: tuple[int, int]
    pitch_mm: float
    gel_mm: float
    softness: float
    contact: float
    colours: Array
    light: Array
    gamma: float
    blur_px: float
    noise: float
    lens: float
    jpeg: int
    lamps: Array
    press_share: tuple[float, float] = (0.45, 1.0)
    markers: bool = False

    def record(
        self,
        solids: Mapping[int, Mesh],
        touches: int = 20,
        seed: int = 0,
        mistake: str | None = None,
        *,
        at_m: Array | None = None,
        pose_errors: tuple[float, float] = (1e-4, np.radians(0.5)),
    ) -> Recording:
        """Press the sensor onto solids, one after another, and record what it shows.

        ``at_m`` are places on the solids, of which each touch takes one, and goes near it; by default places
        on their surface. ``pose_errors`` are standard deviations of a stated length, metres, and turn.
        """
        rng = np.random.default_rng([self.seed, seed, 11])
        sensor = self
        if mistake == "too-few":
            touches = 3
        if mistake in ("markers", "saturated"):
            changed = {"markers": {"markers": True}, "saturated": {"colours": self.colours * 2.2}}
            sensor = replace(self, **changed[mistake])
        other = replace(draw_sensor(self.seed + 5000, self.family, self.size_px), pitch_mm=self.pitch_mm)
        other = replace(other, lens=self.lens, gel_mm=self.gel_mm)
        ids = np.array([sorted(solids)[n % len(solids)] for n in range(touches)])
        rows: list[tuple[Array, ...]] = []
        for number, solid_id in enumerate(ids):
            of = sensor
            if mistake == "gel-changed" and number >= touches // 2:
                of = other
            rows.append(of._touch(solids[int(solid_id)], rng, at_m, mistake == "flat"))
        depth, clean, images, object_pose, sensor_at, press = map(np.stack, zip(*rows, strict=True))
        flat = np.zeros(sensor._frame_shape)
        background = sensor._camera(sensor._shown(flat, flat))
        backgrounds = np.stack([sensor._noisy(background, rng) for _ in range(3)])
        turn = object_pose[:, 2]
        offset = object_pose[:, :2] - sensor_at[:, :2]
        sensor_m = sensor_at + rng.normal(0, pose_errors[0], sensor_at.shape)
        stated = object_pose + np.column_stack(
            [np.zeros((touches, 2)), rng.normal(0, pose_errors[1], touches)]
        )
        images, ids, sensor_m, stated = _planted(mistake, images, ids, sensor_m, stated)
        return Recording(
            images=images,
            backgrounds=backgrounds,
            object_ids=ids,
            solids=dict(solids),
            sensor_m=sensor_m,
            object_poses=stated,
            depth_m=depth,
            clean=clean,
            true_poses=np.column_stack([offset, turn]),
            press_m=press,
            mm_per_px=self.pitch_mm,
        )

    # ---------------------------------------------------------------- geometry

    @property
    def _frame_shape(self) -> tuple[int, int]:
        """Rows and columns of the computed frame: the image and a margin."""
        width, height = self.size_px
        return height + 2 * self._margins[1], width + 2 * self._margins[0]

    @property
    def _margins(self) -> tuple[int, int]:
        return round(_MARGIN * self.size_px[0]), round(_MARGIN * self.size_px[1])

    @property
    def _mapping(self) -> Array:
        """Where in the frame each pixel of the image looks, rows and columns, shape (2, H, W)."""
        width, height = self.size_px
        row, column = np.mgrid[:height, :width].astype(float)
        middle = np.array([(height - 1) / 2, (width - 1) / 2])
        away = np.stack([row - middle[0], column - middle[1]])
        square = (away**2).sum(axis=0) / (middle**2).sum()
        margins = np.array(self._margins[::-1])
        seen: Array = away * (1 + self.lens * square) + (middle + margins)[:, None, None]
        return seen

    def _seen(self, frame: Array, order: int = 1) -> Array:
        if frame.ndim == 2:
            found: Array = ndimage.map_coordinates(frame, self._mapping, order=order, mode="nearest")
            return found
        return np.stack([self._seen(frame[..., k], order) for k in range(frame.shape[2])], axis=2)

    def _touch(
        self, solid: Mesh, rng: np.random.Generator, at_m: Array | None, flat: bool
    ) -> tuple[Any, ...]:
        width, height = self.size_px
        turn = rng.uniform(-np.pi, np.pi)
        object_m = rng.uniform(-0.01, 0.01, 2)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        places = at_m
        if places is None:
            corners = np.asarray(solid.vertices_m)
            places = corners[corners[:, 2] > 0.5 * corners[:, 2].max()][:, :2]
        place = places[rng.integers(len(places))] + rng.normal(0, _AWAY_MM / 1e3, 2)
        press_mm = self.gel_mm / 2 * rng.uniform(*self.press_share)
        at = rotation @ place + object_m
        if flat:
            at = object_m + np.array([0.0, 0.055 - object_m[1]])
        rows, columns = self._frame_shape
        window = (columns * self.pitch_mm / 1e3, rows * self.pitch_mm / 1e3)
        sensor = tactile_sim.Sensor((columns, rows), window, self.gel_mm / 1e3, self.gel_mm / 2e3)
        base = Pressable.of(solid, check=False)
        stands = tactile_sim.pose(object_m[0], object_m[1], -base.foot_m, turn_rad=turn)
        pressed = tactile_sim.render_touch(base, stands, tactile_sim.pose(*at), sensor, cell_m=(0.2, 0.2))
        surface_mm = 1e3 * (pressed.sensor_z_m - pressed.depth_m)
        across, down = self._margins
        top_mm = surface_mm[down : down + height, across : across + width].max()
        reach_mm = np.minimum(surface_mm - (top_mm - press_mm), press_mm)  # higher points are outside
        into_mm = np.maximum(reach_mm, 0.0)
        gel_mm, contact = self._gel(reach_mm, press_mm)
        clean = self._camera(self._projected(self._shown(gel_mm, contact), gel_mm))
        sensor_at = np.array([*at, (top_mm - press_mm + self.gel_mm) / 1e3])
        pose = np.array([*object_m, turn])
        depth = self._seen(self._projected(into_mm, gel_mm)) / 1e3
        return depth, clean, self._noisy(clean, rng), pose, sensor_at, press_mm / 1e3

    # ---------------------------------------------------------------- gel

    def _gel(self, reach_mm: Array, press_mm: float) -> tuple[Array, Array]:
        """Return how far the surface of the gel is pressed in, mm, and where it touches.

        ``reach_mm`` is how far the solid lies above the gel at rest, negative below it.
        """
        into_mm = np.maximum(reach_mm, 0.0)
        contact = into_mm > self.contact * press_mm
        if self.family == "phong":
            return self._dragged(into_mm), contact
        surface, settings = into_mm.copy(), _taxim()[0]["simulator"]
        # Sigmas are shares of the calibrated image, whose pixels are 0.0295 mm.
        sigmas = np.array(settings["deform_pyramid_sigma_rel"][0]) * 640 * 0.0295
        for sigma in sigmas * self.softness / self.pitch_mm:
            surface = np.where(contact, surface, ndimage.gaussian_filter(surface, sigma, truncate=4))
        last = np.array(settings["deform_final_sigma_rel"])[0] * 640 * 0.0295 / self.pitch_mm
        return ndimage.gaussian_filter(surface, last), contact

    def _dragged(self, into_mm: Array) -> Array:
        """Return the surface of a gel that is pulled down around a contact, and falls off exponentially."""
        surface = into_mm.copy()
        for reach_mm in np.array([1.6, 0.8, 0.4, 0.2]) * self.softness:
            keep = np.exp(-self.pitch_mm / reach_mm)
            soft = surface
            for axis in (0, 1):
                soft = _both_ways(soft, keep, axis)
            surface = np.maximum(into_mm, soft)
        rounded: Array = ndimage.gaussian_filter(surface, 0.12 * self.softness / self.pitch_mm)
        return rounded

    # ---------------------------------------------------------------- light

    def _shown(self, gel_mm: Array, contact: Array) -> Array:
        """Return levels (h, w, 3) of the frame for the surface of the gel, before the camera."""
        down, right = np.gradient(gel_mm, self.pitch_mm)
        if self.family == "phong":
            return self._lamplight(down, right, gel_mm)
        return self._calibrated(down, right, gel_mm, contact.astype(bool))

    def _calibrated(self, down: Array, right: Array, gel_mm: Array, contact: Array) -> Array:
        settings, colours, shadows, background = _taxim()
        rows, columns = gel_mm.shape
        tangent = np.hypot(down, right)
        direction = np.arctan2(down, right) + np.pi
        direction[tangent < 1e-5] = np.pi
        bins = len(colours)
        steep = np.minimum((np.arctan(tangent) * (bins - 1) / (np.pi / 2)).astype(int), bins - 1)
        turned = np.minimum((direction * (bins - 1) / (2 * np.pi) + 1e-6).astype(int), bins - 1)
        width, height = self.size_px
        y, x = np.mgrid[:rows, :columns].astype(float)
        y, x = (y - self._margins[1]) * 480 / height, (x - self._margins[0]) * 640 / width
        place = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=2)
        shade = np.einsum("hwkc,hwk->hwc", colours[steep, turned], place)
        shade = self._shadowed(shade, gel_mm, direction, contact, settings, shadows)
        for name in ("shadow_blur_sigma_rel", "deform_final_sigma_rel"):
            blur = settings["simulator"][name][0] * width
            shade = ndimage.gaussian_filter(shade, (blur, blur, 0))
        behind = np.stack(
            [ndimage.map_coordinates(background[..., k], [y, x], order=1, mode="nearest") for k in range(3)],
            axis=2,
        )
        lit: Array = shade + behind
        return lit

    def _shadowed(
        self, shade: Array, gel_mm: Array, direction: Array, contact: Array, settings: Any, shadows: Array
    ) -> Array:
        """Darken pixels behind the rim of the contact, step by step along a fan of rays."""
        reach = max(round(0.1 / self.pitch_mm), 1)
        rim = np.argwhere(ndimage.binary_dilation(contact, np.ones((3, 3)), reach) & ~contact)
        if not len(rim):
            return shade
        rows, columns = gel_mm.shape
        here = gel_mm[rim[:, 0], rim[:, 1]]
        toward = (direction[rim[:, 0], rim[:, 1]] / settings["simulator"]["discretize_precision"]).astype(int)
        level = np.floor((here - 0.4) / settings["simulator"]["height_precision"]).astype(int) + 6
        held = (level >= 0) & (level < shadows.shape[1])
        rim, here, toward, level = rim[held], here[held], np.minimum(toward[held], 62), level[held]
        dark = shadows[toward, level]  # (n, steps, 3)
        angles = toward[:, None] * 0.1 + _RAYS
        steps = np.arange(1, dark.shape[1] + 1)
        # 1.25 pixels of the calibrated image, in pixels of this frame.
        far = steps * 1.25 * 0.0295 / self.pitch_mm
        at_x = (rim[:, 1, None, None] + np.cos(angles)[..., None] * far).astype(int)
        at_y = (rim[:, 0, None, None] + np.sin(angles)[..., None] * far).astype(int)
        inside = (at_x >= 0) & (at_y >= 0) & (at_x < columns) & (at_y < rows)
        at = np.where(inside, at_y * columns + at_x, 0)
        lower = inside & (gel_mm.ravel()[at] < here[:, None, None])
        flat = shade.reshape(-1, 3).copy()
        values = np.broadcast_to(dark[:, None], (*at.shape, 3))
        for colour in range(3):
            known = lower & np.isfinite(values[..., colour])
            np.minimum.at(flat[:, colour], at[known], values[..., colour][known])
        return flat.reshape(shade.shape)

    def _lamplight(self, down: Array, right: Array, gel_mm: Array) -> Array:
        """Return light of coloured lamps on a matt surface that shines a little (Phong 1975)."""
        rows, columns = gel_mm.shape
        width, height = self.size_px
        y, x = np.mgrid[:rows, :columns].astype(float)
        y, x = (rows / 2 - y) / (height / 2), (x - columns / 2) / (width / 2)
        # Seen from the camera, the gel is a hill where it is pressed in; y of the image points down.
        normal = np.stack([-right, down, np.ones_like(down)], axis=2)
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        shown = np.zeros((rows, columns, 3))
        for direction, elevation, red, green, blue, fall, shine, sharp in self.lamps:
            level, up = np.cos(elevation), np.sin(elevation)
            lamp = np.array([level * np.cos(direction), level * np.sin(direction), up])
            cosine = np.maximum(normal @ lamp, 0)
            mirrored = 2 * cosine[..., None] * normal - lamp
            highlight = shine * np.maximum(mirrored[..., 2], 0) ** sharp
            near = 1 + fall * (x * np.cos(direction) + y * np.sin(direction))
            shown += ((cosine + highlight) * near)[..., None] * np.array([red, green, blue])
        return shown

    # ---------------------------------------------------------------- camera

    def _projected(self, frame: Array, gel_mm: Array) -> Array:
        """Return a map of the gel as a camera at a great distance sees it."""
        return frame

    def _camera(self, shown: Array) -> Array:
        """Return levels (H, W, 3) of the image without noise."""
        if self.family == "published":
            return np.clip(255 * self._seen(shown), 0, 255)
        seen = self._seen(np.maximum(shown, 0) ** self.gamma) @ self.colours.T
        height, width = seen.shape[:2]
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        field = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2) @ self.light.T
        levels = ndimage.gaussian_filter(255 * seen * field, (self.blur_px, self.blur_px, 0))
        if self.markers:
            levels = levels * self._marker_field(height, width)[..., None]
        return np.clip(levels, 0, 255)

    def _marker_field(self, height: int, width: int) -> Array:
        y, x = np.mgrid[:height, :width] * self.pitch_mm
        half_mm = _MARKER_MM / 2
        away = np.hypot((x + 0.4) % _MARKER_MM - half_mm, (y + 0.3) % _MARKER_MM - half_mm)
        dots: Array = 1 - 0.75 / (1 + np.exp((away - 0.28) / 0.04))
        return dots

    def _noisy(self, clean: Array, rng: np.random.Generator) -> Array:
        """Return an image as the camera stores it, uint8."""
        levels = clean + rng.normal(0, self.noise, clean.shape) * (self.noise > 0)
        image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        if not self.jpeg:
            return image
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "JPEG", quality=self.jpeg, subsampling=0)
        return np.asarray(Image.open(buffer))


def draw_sensor(seed: int, family: Family = "taxim", size_px: tuple[int, int] = (320, 240)) -> HiddenSensor:
    """Draw a sensor from wide ranges; the same seed gives the same sensor."""
    rng = np.random.default_rng([seed, len(family)])
    light = np.zeros((3, 6))
    light[:, 0] = 1.0
    light[:, 1:3] = rng.uniform(-0.15, 0.15, (3, 2))
    light[:, 3:] = rng.uniform(-0.12, 0.06, (3, 3))
    mixing = rng.uniform(0, 0.25, (3, 3))
    np.fill_diagonal(mixing, 1.0)
    mixing /= mixing.sum(axis=1, keepdims=True)
    colours = mixing * rng.uniform(0.75, 1.15, (3, 1))
    lamps = np.zeros((0, 8))
    softness = rng.uniform(0.6, 1.5)
    if family == "phong":
        lamps = _lamps(rng)
    made = HiddenSensor(
        family=family,
        seed=seed,
        size_px=size_px,
        pitch_mm=18.88 / size_px[0] * rng.uniform(0.92, 1.08),
        gel_mm=rng.uniform(3.2, 4.75),
        softness=softness,
        contact=rng.uniform(0.4, 0.7),
        colours=colours,
        light=light,
        gamma=rng.uniform(0.9, 1.1),
        blur_px=rng.uniform(0.3, 1.2),
        noise=rng.uniform(1, 3),
        lens=rng.uniform(-0.05, 0.05),
        jpeg=int(rng.choice([0, 85, 92, 97])),
        lamps=lamps,
    )
    if family != "published":
        return made
    exact = {"pitch_mm": 0.0295 * 640 / size_px[0], "gel_mm": 4.25, "softness": 1.0, "contact": 0.6}
    return replace(made, **exact, gamma=1.0, blur_px=0.0, noise=1.0, lens=0.0, jpeg=0, press_share=(1.0, 1.0))


def digits(count: int = 4, seed: int = 5) -> dict[int, Mesh]:
    """Return digits of different classes, by number."""
    return {number: _digit(number, seed) for number in range(count)}


@cache
def _digit(number: int, seed: int) -> Mesh:
    return mnist3d.solidify(SyntheticSource(seed).image(14 * (number % 10) + number // 10).pixels)


def _planted(
    mistake: str | None, images: Array, ids: Array, sensor_m: Array, stated: Array
) -> tuple[Any, ...]:
    """Return images, ids, and poses of the sensor and the solids, with a planted mistake."""
    images, ids, sensor_m, stated = images.copy(), ids.copy(), sensor_m.copy(), stated.copy()
    if mistake == "channels":
        images = np.ascontiguousarray(images[..., ::-1])
    elif mistake == "mesh":
        known = np.unique(ids)
        ids = known[(np.searchsorted(known, ids) + 1) % len(known)]
    elif mistake == "units":
        sensor_m *= 1e3
        stated[:, :2] *= 1e3
    elif mistake == "mirrored":
        sensor_m[:, 0] *= -1
        stated[:, 0] *= -1
    return images, ids, sensor_m, stated


def _lamps(rng: np.random.Generator) -> Array:
    """Return three lamps around the gel, each mostly of one colour, and a dim white one from above."""
    turned = rng.uniform(0, 2 * np.pi)
    rows = []
    for number in range(3):
        colour = rng.uniform(0.0, 0.2, 3)
        colour[number] = rng.uniform(0.7, 1.0)
        direction = turned + number * 2 * np.pi / 3 + rng.normal(0, 0.15)
        place = (direction, rng.uniform(0.45, 0.95))
        rows.append(
            [*place, *(0.55 * colour), rng.uniform(0.0, 0.3), rng.uniform(0, 0.25), rng.uniform(4, 14)]
        )
    rows.append([0.0, np.pi / 2, 0.08, 0.08, 0.08, 0.0, 0.0, 1.0])
    return np.array(rows)


def _both_ways(values: Array, keep: float, axis: int) -> Array:
    """Smooth by an exponential kernel in both directions; values at the edge continue outside."""
    share, coefficients = [1 - keep], [1, -keep]

    def forward(lines: Array) -> Array:
        start = keep * np.take(lines, [0], axis)
        found: Array = signal.lfilter(share, coefficients, lines, axis, start)[0]
        return found

    back = np.flip(forward(np.flip(values, axis)), axis)
    return (forward(values) + back - (1 - keep) * values) / (1 + keep)


@cache
def _taxim() -> tuple[Any, Array, Array, Array]:
    """Return settings, colours (bins, bins, 6, 3), shadows (63, heights, steps, 3) and background."""
    found = find_spec("taxim")
    assert found is not None, "the family 'taxim' needs the extra `sim`"
    assert found.origin is not None
    folder = Path(found.origin).parent / "calib" / "gelsight_mini"
    settings = json.loads((folder / "params.json").read_text())
    tables = np.load(folder / "polycalib.npz", allow_pickle=True)
    # Blue and red are exchanged in the file.
    colours = np.stack([tables[f"grad_{colour}"] / 255 for colour in "bgr"], axis=3)
    lists = np.load(folder / "shadowTable.npz", allow_pickle=True)["shadowTable"][::-1]
    longest = max(len(each) for each in lists.ravel())
    shadows = np.full((lists.shape[1], lists.shape[2], longest, 3), np.inf)
    for colour, direction, level in np.ndindex(lists.shape):
        values = np.asarray(lists[colour, direction, level], float) / 255
        shadows[direction, level, : len(values), colour] = values
    frame = np.load(folder / "dataPack.npz")["f0"][..., ::-1] / 255
    smooth = ndimage.gaussian_filter(frame, (50, 50, 0))
    return settings, colours, shadows, np.where(frame > smooth, smooth, 0.15 * smooth + 0.85 * frame)
