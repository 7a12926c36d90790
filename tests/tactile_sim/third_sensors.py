"""A third kind of hidden sensors: an elastic layer that near lamps light and a camera near it sees.

The gel rises around a contact, as it keeps its volume.
Rows of lamps stand around the gel. Their light falls off with the square of the distance, shadows are marched
along its rays, and slopes light each other. The camera is a pinhole whose image is stored as JPEG 4:2:0.
The white balance may wander from frame to frame, and prints may be smaller than their meshes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

import tactile_sim
from tactile_toolkit.mesh import Mesh
from tests.tactile_sim.hidden_recordings import Recording
from tests.tactile_sim.hidden_sensors import Array, HiddenSensor

VARIANTS = ("base", "far", "diodes", "mutual", "wander", "shrunk", "all")
"""One effect of each: none, a camera far away, diodes, which are discs that face the middle,
inter-reflection, white balance, small prints; and the last three of them together."""

_POINTS_MM = (-5.0, 0.0, 5.0)  # of a row of lamps, from its middle
_SHADOW_MM = np.geomspace(0.15, 9.0, 20)  # distances at which rays to the lamps are tested
_PENUMBRA = 0.08
_MUTUAL_MM = 2.0
_LEVELS = 48  # heights at which rays of the camera are tested


@dataclass(frozen=True)
class ThirdSensor(HiddenSensor):
    """Properties of the sensor and of the prints; lengths in mm.

    ``mutual`` is the share of light that slopes receive from each other, ``wander`` the standard deviation of
    the gains of a frame, and ``shrinkage`` that of the prints. Lamps are points, or discs with the radius
    ``lamp_mm``. Their light falls off with the power ``lobe`` of the cosine of the angle to where they face.
    """

    camera_mm: float = 36.0
    poisson_ratio: float = 0.48
    skin_mm: float = 0.08
    mutual: float = 0.0
    wander: float = 0.0
    shrinkage: float = 0.0
    lamp_mm: float = 0.0
    lobe: float = 0.0

    def record(
        self, solids: Mapping[int, Mesh], touches: int = 20, seed: int = 0, *args: Any, **options: Any
    ) -> Recording:
        """Record touches of prints, and state their meshes; see :meth:`HiddenSensor.record`."""
        prints = {
            key: replace(solid, vertices_m=solid.vertices_m * (1 - self.shrinkage))
            for key, solid in solids.items()
        }
        return replace(super().record(prints, touches, seed, *args, **options), solids=dict(solids))

    def _gel(self, reach_mm: Array, press_mm: float) -> tuple[Array, Array]:
        block_px = max(1, 2 * (round(0.24 / self.pitch_mm) // 2))
        rows, columns = (side // block_px * block_px for side in reach_mm.shape)
        load = tactile_sim.GelLoad(
            depth_m=press_mm / 1e3, gel=tactile_sim.Gel(poisson_ratio=self.poisson_ratio, friction=0.0)
        )
        pressed = tactile_sim.solve_contact(
            reach_mm[:rows, :columns] / 1e3,
            self.pitch_mm / 1e3,
            load,
            thickness_m=self.gel_mm / 1e3,
            block_px=block_px,
        )
        more = [(0, side - inner) for side, inner in zip(reach_mm.shape, (rows, columns), strict=True)]
        gel_mm = np.pad(1e3 * pressed.displacement_m[..., 2], more, mode="edge")
        return ndimage.gaussian_filter(gel_mm, self.skin_mm / self.pitch_mm), reach_mm > 0

    def _places(self, gel_mm: Array) -> tuple[Array, Array]:
        """Return x and y of the pixels of the frame, mm, from the middle, y upwards."""
        rows, columns = gel_mm.shape
        row, column = np.mgrid[:rows, :columns]
        return (column - (columns - 1) / 2) * self.pitch_mm, ((rows - 1) / 2 - row) * self.pitch_mm

    def _shown(self, gel_mm: Array, contact: Array) -> Array:
        down, right = np.gradient(gel_mm, self.pitch_mm)
        normal = np.stack([-right, down, np.ones_like(down)], axis=2)
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        x, y = self._places(gel_mm)
        shown = np.full((*gel_mm.shape, 3), 0.06)
        for direction, height, red, green, blue, distance, *_ in self.lamps:
            for along in _POINTS_MM:
                lamp_x = distance * np.cos(direction) - along * np.sin(direction)
                lamp_y = distance * np.sin(direction) + along * np.cos(direction)
                to = np.stack([lamp_x - x, lamp_y - y, height - gel_mm], axis=2)
                far = np.linalg.norm(to, axis=2)
                light = np.maximum((normal * to).sum(axis=2), 0) * (self.gel_mm + distance) ** 2 / far**3
                ahead = to[..., 0] * np.cos(direction) + to[..., 1] * np.sin(direction)
                light = light * np.maximum(ahead / far, 0) ** self.lobe * self._lit(gel_mm, to)
                shown += light[..., None] * np.array([red, green, blue]) / len(_POINTS_MM)
        if self.mutual:
            tilt = 1 - normal[..., 2:]
            sigma = _MUTUAL_MM / self.pitch_mm
            near = ndimage.gaussian_filter(shown * tilt, (sigma, sigma, 0))
            around = ndimage.gaussian_filter(shown, (sigma, sigma, 0))
            shown = shown + self.mutual * (near + 2 * tilt * around)
        return shown

    def _lit(self, gel_mm: Array, to: Array) -> Array:
        """Return the share of the light of a lamp that no other part of the gel keeps off."""
        row, column = np.mgrid[: gel_mm.shape[0], : gel_mm.shape[1]].astype(float)
        level = np.hypot(to[..., 0], to[..., 1])
        above = np.full_like(gel_mm, -np.inf)
        for far in _SHADOW_MM[self.pitch_mm < _SHADOW_MM]:
            share = np.minimum(far / level, 1)
            steps = share[..., None] * to / self.pitch_mm
            at = np.stack([row - steps[..., 1], column + steps[..., 0]])
            along = ndimage.map_coordinates(gel_mm, at, order=1, mode="nearest")
            above = np.maximum(above, (along - gel_mm - share * to[..., 2]) / far)
        if self.lamp_mm:
            return np.asarray(np.clip(0.5 - above * level / (2 * self.lamp_mm), 0, 1))
        return np.asarray(np.clip(1 - above / _PENUMBRA, 0, 1))

    def _projected(self, frame: Array, gel_mm: Array) -> Array:
        """Return a map as the pinhole sees it: what is pressed in is nearer, and looks larger."""
        middle = (np.array(gel_mm.shape) - 1)[:, None, None] / 2
        away = np.mgrid[: gel_mm.shape[0], : gel_mm.shape[1]] - middle

        def seen(values: Array, height_mm: Any) -> Array:
            at = away * (1 - height_mm / self.camera_mm) + middle
            found: Array = ndimage.map_coordinates(values, at, order=1, mode="nearest")
            return found

        # The ray of a pixel meets the gel where it first comes below the surface.
        levels = np.linspace(gel_mm.max(), min(gel_mm.min(), 0.0), _LEVELS)
        height_mm = np.full(gel_mm.shape, levels[-1])
        for level in levels[::-1]:
            height_mm = np.where(seen(gel_mm, level) >= level, level, height_mm)
        for _ in range(2):
            height_mm = np.clip(seen(gel_mm, height_mm), height_mm, height_mm + levels[0] - levels[1])
        if frame.ndim == 2:
            return seen(frame, height_mm)
        return np.stack([seen(frame[..., k], height_mm) for k in range(3)], axis=2)

    def _noisy(self, clean: Array, rng: np.random.Generator) -> Array:
        levels = clean * (1 + np.clip(rng.normal(0, self.wander, 3), -2 * self.wander, 2 * self.wander))
        levels = np.rint(levels + rng.normal(0, self.noise, clean.shape))
        buffer = io.BytesIO()
        image = Image.fromarray(np.clip(levels, 0, 255).astype(np.uint8))
        image.save(buffer, "JPEG", quality=self.jpeg, subsampling=2)
        return np.asarray(Image.open(buffer))


def draw_third(seed: int, variant: str = "base", size_px: tuple[int, int] = (160, 120)) -> ThirdSensor:
    """Draw a sensor; seeds from 100 on are for judging, and have other ranges than those for development."""
    judging = seed >= 100
    rng = np.random.default_rng([seed, 63])
    light = np.zeros((3, 6))
    light[:, 0] = 1.0
    light[:, 3:] = rng.uniform(-0.1, 0.0, (3, 3))
    turned = rng.uniform(0, 2 * np.pi)
    lamps = []
    for number in range(3):
        colour = rng.uniform(0.0, 0.2, 3)
        colour[number] = rng.uniform(0.7, 1.0)
        direction = turned + number * 2 * np.pi / 3 + rng.normal(0, 0.1)
        lamps.append([direction, rng.uniform(5.0, 8.0), *(0.42 * colour), rng.uniform(14.5, 15.5), 0.0, 1.0])
    of_all = variant == "all"
    return ThirdSensor(
        family="third",  # type: ignore[arg-type]  # not one of those that `draw_sensor` draws
        seed=seed,
        size_px=size_px,
        pitch_mm=18.88 / size_px[0] * rng.uniform(0.93, 1.07),
        gel_mm=rng.uniform(3.4, 4.6),
        softness=1.0,
        contact=0.5,
        colours=np.eye(3),
        light=light,
        gamma=rng.uniform(0.9, 1.1),
        blur_px=rng.uniform(0.3, 0.9),
        noise=rng.uniform(1.0, 2.5),
        lens=rng.uniform(-0.04, 0.04),
        jpeg=int(rng.integers(90, 97) if judging else rng.integers(88, 96)),
        lamps=np.array(lamps),
        camera_mm=1e6 if variant == "far" else float(rng.uniform(34, 38) if judging else rng.uniform(33, 40)),
        poisson_ratio=float(rng.uniform(0.46, 0.495) if judging else rng.uniform(0.45, 0.49)),
        skin_mm=float(rng.uniform(0.06, 0.12)),
        mutual=0.25 * (variant == "mutual" or of_all) * float(rng.uniform(0.7, 1.3)),
        wander=0.03 * (variant == "wander" or of_all),
        shrinkage=0.005 * (variant == "shrunk" or of_all),
        lamp_mm=0.7 * (variant == "diodes"),
        lobe=1.5 * (variant == "diodes"),
    )
