"""Reads depth from images of a sensor: colours to slopes, Poisson integration, and a second regression.

The networks are trained on touches that the twin itself renders, of the solids of its calibration in random
places, sizes and depths and of balls, cones and ridges, with the noise of the sensor, and on the recordings.
The second one also states how far off it is likely to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from tactile_sim.sensor_parts import DepthReading
from tactile_sim.taxim_kernels import blur
from tactile_sim.twin import gel, network
from tactile_sim.twin.fitting import Fit, shrunk
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.gel_kernels import sample_relief
from tactile_sim.twin.relief import Relief
from tactile_sim.twin.twin import Twin, TwinOptics, in_size_of, resized_depth
from tactile_toolkit.array_types import Float32, Float64, Int64, UInt8

_WIDTHS = {"full": 160, "fast": 80}  # pixels of the images that are read
_TOUCHES = 240
_PER_TOUCH = 3000  # pixels that the networks see of each
_NETWORKS = ((11, 24, 24, 4), (36, 48, 48, 4), (36, 48, 48, 4))
"""Sizes of the layers: from colours, and twice from these and what was found around."""
_STEPS = (500, 1500, 1500)
_BLURS = (0.01, 0.03, 0.09)  # of the width
_DULL_MM = 0.02  # less depth is taken for no contact
_SMOOTH = np.array([0.01, 0.01, 0.01], np.float32)  # mm per pixel, and mm; below this, the loss is round
_REPEATED = 3  # how often the recordings are seen for each time of a rendered touch
_PRIMITIVE = 0.35  # share of touches of balls, cones and ridges


def reader_shapes() -> dict[str, tuple[int, ...]]:
    """Return the shapes of the weights of a reader by name."""
    shapes: dict[str, tuple[int, ...]] = {}
    for mode in _WIDTHS:
        for stage, sizes in enumerate(_NETWORKS):
            name = f"{mode}_{stage}"
            shapes |= {f"{name}_mean": sizes[:1], f"{name}_scale": sizes[:1]}
            for layer, (wide, narrow) in enumerate(pairwise(sizes)):
                shapes |= {f"{name}_w{layer}": (wide, narrow), f"{name}_b{layer}": (narrow,)}
    return shapes


def read_depth(twin: Twin, images: UInt8, *, fast: bool = False) -> DepthReading:
    """Read the depth of images (N, H, W, 3) of the sensor."""
    mode = "fast" if fast else "full"
    shrink = _shrink(twin, mode)
    background = shrunk(twin.background, shrink)
    depths, errors = [], []
    for image in in_size_of(twin, images):
        change = shrunk(image.astype(np.float32), shrink) - background
        depth_mm, error_mm = _read(twin.reader, mode, change)
        depths.append(depth_mm)
        errors.append(error_mm)
    size_px = (images.shape[2], images.shape[1])
    scale = np.float32(1e-3)
    return DepthReading(
        resized_depth(np.stack(depths) * scale, size_px), resized_depth(np.stack(errors) * scale, size_px)
    )


def _shrink(twin: Twin, mode: str) -> int:
    return max(1, round(twin.size_px[0] / _WIDTHS[mode]))


def _read(reader: Mapping[str, Float32], mode: str, change: Float32) -> tuple[Float32, Float32]:
    last = len(_NETWORKS) - 1
    found = network.network_output(reader, f"{mode}_{last}", _given(reader, mode, change, last))
    depth_mm, width = np.moveaxis(found.reshape(*change.shape[:2], -1)[..., 2:], 2, 0)
    return np.where(depth_mm > _DULL_MM, depth_mm, 0), np.exp(np.clip(width, -8, 2))


def _given(reader: Mapping[str, Float32], mode: str, change: Float32, stage: int) -> Float32:
    """Return what the network of a stage is given, (H W, inputs)."""
    colours = given = _colours(change)
    for earlier in range(stage):
        found = network.network_output(reader, f"{mode}_{earlier}", given)
        given = _surroundings(colours, found.reshape(*change.shape[:2], -1))
    return given


def _colours(change: Float32) -> Float32:
    """Return what slopes are read from: changes of colours, sharp and blurred, and the place; (H W, 11)."""
    rows, columns, _ = change.shape
    soft = _blurred(change, _BLURS[0] * columns)
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    place = np.stack([x, y, x * x, x * y, y * y], axis=-1).astype(np.float32)
    return np.concatenate([change, soft, place], axis=-1).reshape(-1, 11)


def _surroundings(colours: Float32, found: Float32) -> Float32:
    """Return what is known of each pixel, of what surrounds it, and of the image, after a network.

    Of a pixel: colours, and what was ``found``, (H, W, 4), slopes, depth and its width, and the surface that
    slopes integrate to.
    """
    rows, columns, _ = found.shape
    surface = integrated(found[..., :2])
    level = (surface - np.float32(np.percentile(surface, 90)))[..., None]
    change = colours[:, 3:6].reshape(rows, columns, 3)
    known = np.concatenate([change, found, level], axis=-1)
    whole = np.array([level.min(), level.mean(), found[..., 2].max(), np.abs(change).max()], np.float32)
    parts = [known[..., 3:], np.broadcast_to(whole, (rows, columns, len(whole)))]
    parts += [_blurred(known, share * columns) for share in _BLURS[1:]]
    return np.concatenate([colours, np.concatenate(parts, axis=-1).reshape(len(colours), -1)], axis=1)


def _blurred(image: Float32, sigma_px: float) -> Float32:
    rows, columns, many = image.shape
    plane = image.reshape(rows, columns * many).astype(np.float64)
    across, down = gel.half_kernel(sigma_px, columns), gel.half_kernel(sigma_px, rows)
    blur(plane, across, down, many, np.zeros(plane.shape, np.bool_), plane)
    return plane.reshape(image.shape).astype(np.float32)


def integrated(slopes: Float32) -> Float32:
    """Return the surface (H, W) whose slopes (H, W, 2), per pixel along x and y upwards, fit best.

    Poisson's equation with free edges, by the cosine transform (Agrawal, Raskar and Chellappa, ECCV 2006).
    """
    rows, columns, _ = slopes.shape
    along_x, along_y = slopes[..., 0], -slopes[..., 1]
    middle_x = (along_x[:, 1:] + along_x[:, :-1]) / 2
    middle_y = (along_y[1:] + along_y[:-1]) / 2
    bend = np.zeros((rows, columns), np.float32)
    bend[:, :-1] += middle_x
    bend[:, 1:] -= middle_x
    bend[:-1] += middle_y
    bend[1:] -= middle_y
    waves = (
        2 * np.cos(np.pi * np.arange(columns) / columns) + 2 * np.cos(np.pi * np.arange(rows) / rows)[:, None]
    )
    waves = (waves - 4).astype(np.float32)
    waves[0, 0] = 1
    turned = scipy.fft.dctn(bend, norm="ortho") / waves
    turned[0, 0] = 0
    return np.asarray(scipy.fft.idctn(turned, norm="ortho"), np.float32)


def train_reader(twin: Twin, fit: Fit, seed: int = 0) -> dict[str, Float32]:
    """Return the weights of the networks of a twin."""
    rng = np.random.default_rng(seed)
    held: dict[str, list[_Sample]] = {mode: [] for mode in _WIDTHS}
    for image, depth_mm, repeated in _samples(twin, fit, rng):
        for mode, kept in held.items():
            shrink = _shrink(twin, mode)
            depth = shrunk(depth_mm, shrink)
            pixels = rng.permutation(depth.size)[: _PER_TOUCH * repeated]
            targets = np.concatenate([_true_slopes(depth, twin, shrink), depth[..., None]], axis=-1)
            change = shrunk(image, shrink) - shrunk(twin.background, shrink)
            kept.append(_Sample(change, pixels, targets.reshape(-1, 3)[pixels]))
    reader: dict[str, Float32] = {}
    for mode, kept in held.items():
        for stage in range(len(_NETWORKS)):
            reader |= _trained(reader, mode, stage, kept, rng)
    return reader


class _Sample(NamedTuple):
    """How an image differs from the background, and slopes and depth at some of its pixels."""

    change: Float32
    pixels: Int64
    targets: Float32


def _trained(
    reader: Mapping[str, Float32], mode: str, stage: int, held: list[_Sample], rng: np.random.Generator
) -> dict[str, Float32]:
    """Train the network of a stage with what those before it find."""
    sizes = _NETWORKS[stage]
    given = np.empty((sum(len(each.pixels) for each in held), sizes[0]), np.float32)
    first = 0
    for each in held:  # in place: parts and the whole would take twice the memory
        given[first : first + len(each.pixels)] = _given(reader, mode, each.change, stage)[each.pixels]
        first += len(each.pixels)
    targets = np.concatenate([each.targets for each in held])
    return network.trained(f"{mode}_{stage}", given, targets, sizes, _loss_slope, rng, _STEPS[stage])


def _loss_slope(found: Float32, targets: Float32) -> Float32:
    """Return derivatives of absolute errors, and of the likelihood of a Laplace distribution's width."""
    left = found[:, :3] - targets
    width = np.clip(found[:, 3:], -8, 2)
    sharp = left / np.sqrt(left * left + _SMOOTH**2)
    right = np.float32(0.1) * (1 - np.abs(left[:, 2:]) * np.exp(-width))
    return np.concatenate([sharp, right], axis=1)


def _true_slopes(depth_mm: Float32, twin: Twin, shrink: int) -> Float32:
    """Return the slopes of the gel, mm per pixel along x and y upwards, shape (H, W, 2)."""
    rows, columns = depth_mm.shape
    pitch_m = 2 * twin.half_m / [columns, rows]
    shape = twin.shape.copy()
    shape[Fitted.LENS] = 0.0  # depth is as it is seen
    soft = 1e3 * gel.gel_surface(depth_mm.astype(np.float64) / 1e3, pitch_m, shape)
    down, across = np.gradient(soft)
    return np.stack([across, -down], axis=-1).astype(np.float32)


def _samples(twin: Twin, fit: Fit, rng: np.random.Generator) -> Iterator[tuple[Float32, Float32, int]]:
    """Yield images, depth in mm, and how often each is seen, of recordings and of rendered touches."""
    presses, left = [], []
    for touch in np.flatnonzero(fit.used).tolist():
        depth_m = fit.indentation(touch, fit.poses[touch], fit.shape)
        presses.append(float(depth_m.max()))
        image = fit.recordings.images[touch].astype(np.float32)
        yield image, (1e3 * depth_m).astype(np.float32), _REPEATED
        left.append(image - fit.background - fit.rendered(touch, fit.poses[touch], fit.shape))
    optics, reliefs = TwinOptics(twin), list(fit.reliefs.values())
    for number in range(_TOUCHES):
        relief = reliefs[rng.integers(len(reliefs))]
        if rng.random() < _PRIMITIVE:
            relief = _primitive(rng)
        margin = gel.margin_px(twin.size_px[0])
        reach_m = _pressed(twin, relief, rng, presses, margin)
        clean = twin.background + optics.response(reach_m, margin=margin)
        reach_m = gel.seen_through(reach_m, twin.pitch_m, float(twin.shape[Fitted.LENS]), margin)
        # What the fit leaves of real images: their noise, and what the twin does not render.
        noise = left[number % len(left)]
        image = np.clip(np.rint(clean + noise[:: rng.choice([1, -1]), :: rng.choice([1, -1])]), 0, 255)
        yield image.astype(np.float32), (1e3 * reach_m).astype(np.float32), 1


def _pressed(
    twin: Twin, relief: Relief, rng: np.random.Generator, presses: list[float], margin: int
) -> Float64:
    """Return how far a relief reaches into the gel, metres, at a random place near its top, with a margin."""
    rows, columns = np.nonzero(relief.heights_m > relief.top_m - 0.0015)
    chosen = rng.integers(len(rows))
    corner = relief.corner
    middle_m = corner[:2] + [columns[chosen], rows[chosen]] * corner[2:] + rng.normal(0, 2e-3, 2)
    turn, scale = rng.uniform(0, 2 * np.pi), rng.uniform(0.75, 1.3, 2) * [rng.choice([-1, 1]), 1]
    cosine, sine = np.cos(turn), np.sin(turn)
    half = twin.half_m * scale
    affine = np.array(
        [[cosine * half[0], -sine * half[1], middle_m[0]], [sine * half[0], cosine * half[1], middle_m[1]]]
    )
    size = np.array(twin.size_px)
    out = np.empty(tuple((size + 2 * margin)[::-1]))
    span = (size + 2 * margin) / size
    sample_relief(out, relief.heights_m, corner, affine, span, 0.0, 0.0)
    press_m = rng.uniform(0.7 * min(presses), 1.15 * max(presses))
    return np.asarray(np.maximum(out - (out[margin:-margin, margin:-margin].max() - press_m), 0))


def _primitive(rng: np.random.Generator) -> Relief:
    """Return balls, cones, ridges, blocks and stairs, one to three of them, 7 mm high, on 16 x 16 mm."""
    side, pitch = 320, 5e-5
    y, x = np.mgrid[-1:1:320j, -1:1:320j] * (side * pitch / 2)
    height = np.zeros((side, side))
    for _ in range(int(rng.integers(1, 4))):
        at, turn = rng.uniform(-4e-3, 4e-3, 2), rng.uniform(0, np.pi)
        along = np.cos(turn) * (x - at[0]) + np.sin(turn) * (y - at[1])
        across = np.cos(turn) * (y - at[1]) - np.sin(turn) * (x - at[0])
        top = 7e-3 - rng.uniform(0, 6e-4)
        # How far from a point, a line, an edge, or a square.
        far = (
            np.hypot(along, across),
            np.abs(along),
            along,
            np.maximum(np.abs(along), np.abs(across)),
        )[rng.integers(4)]
        far = np.maximum(far - rng.uniform(0, rng.choice([1e-3, 5e-3])), 0)
        radius, slope = rng.uniform(1.5e-3, 8e-3), rng.uniform(0.15, 1.2)
        rise, tread = 1e-4 * 50 ** rng.random(), rng.uniform(1e-3, 5e-3)
        drop = (
            radius - np.sqrt(np.maximum(radius**2 - far**2, 0)),
            slope * far,
            rise * np.ceil(far / tread),
        )[rng.integers(3)]
        tilt = rng.normal(0, 0.03, 2)
        height = np.maximum(height, top - drop + tilt[0] * along + tilt[1] * across)
    corner = np.array([x[0, 0], y[0, 0], pitch, pitch])
    return Relief(height.astype(np.float32), corner)
