"""Read depth from images of a sensor: slopes from colours, Poisson integration, and depth from the result.

Two networks regress slopes and depth. They are trained on the recordings, and on touches that the twin itself
renders with the noise of the sensor: of the solids of its calibration in random poses, sizes and depths, and
of simple shapes such as stairs. The second network also predicts its error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from tactile_sim.optics.rendering import in_size_of
from tactile_sim.optics.taxim_kernels import blur
from tactile_sim.press.sensors import DepthReading
from tactile_sim.twin import gel
from tactile_sim.twin.fitting import MIN_DRIFT, Fit, Steps, shrunk
from tactile_sim.twin.recordings import Relief, frame_gains
from tactile_sim.twin.twin import Twin, TwinOptics, resized_depth
from tactile_toolkit.value_types import Float32, Float64, Int64, UInt8

_LEAK = np.float32(0.1)
_RATE, _BATCH = 5e-3, 2048
_MAX_ROWS = 100_000  # about as many give the mean and the spread of inputs
_DECAYS = (0.9, 0.999)  # of Adam, as published (Kingma and Ba, 2015)
_BLOCK = 1 << 14  # rows that fit into the processor's cache
_WIDTHS = {"full": 160, "fast": 80}  # of the images that are read, pixels
_TOUCHES = 480  # that are rendered for the training of the networks
_PER_TOUCH = 1500  # pixels of each touch on which the networks are trained
_SLOPE_STEPS, _DEPTH_STEPS = 1000, 3000
_BATCHES_OF_A_STEP = 200  # of progress, about as long as a step of a fit
_SLOPE_HIDDEN = (24, 24)
_DEPTH_HIDDEN = (64, 64)
_BLURS = (0.01, 0.03, 0.09)  # of the width
_NO_CONTACT_MM = 0.02  # a smaller depth counts as no contact
_SMOOTH_MM = 0.01  # the loss is quadratic in smaller errors
_RECORDING_WEIGHT = 3  # pixels of a recording for each pixel of a rendered touch
_SIMPLE_SHARE = 0.2  # of the rendered touches


def network_output(weights: Mapping[str, Float32], name: str, inputs: Float32) -> Float32:
    """Return the outputs (n, k) of a network for inputs (n, m)."""
    layers = sum(key.startswith(f"{name}_w") for key in weights)
    blocks = []
    for start in range(0, len(inputs), _BLOCK):
        values = (inputs[start : start + _BLOCK] - weights[f"{name}_mean"]) * weights[f"{name}_scale"]
        for layer in range(layers):
            values = values @ weights[f"{name}_w{layer}"]
            values += weights[f"{name}_b{layer}"]
            if layer < layers - 1:
                np.maximum(values, values * _LEAK, out=values)
        blocks.append(values)
    return np.concatenate(blocks)


def train_network(
    inputs: Float32,
    targets: Float32,
    widths: tuple[int, ...],
    loss_gradient: Callable[[Float32, Float32], Float32],
    rng: np.random.Generator,
    count: int,
    steps: Steps,
) -> dict[str, Float32]:
    """Train a network by ``count`` batches with Adam; ``widths`` are those of its layers after the inputs.

    ``loss_gradient`` takes outputs and targets to the derivative by outputs.
    """
    # A sample of the rows: differences of all of them would double the memory.
    sample = inputs[:: max(1, len(inputs) // _MAX_ROWS)]
    mean = sample.mean(axis=0)
    scale = 1 / (sample.std(axis=0) + np.float32(1e-6))
    sizes = (inputs.shape[1], *widths)
    weights: dict[str, Float32] = {"mean": mean, "scale": scale}
    layers: list[Float32] = []
    for wide, narrow in pairwise(sizes):
        layers += [
            rng.normal(0, np.sqrt(2 / wide), (wide, narrow)).astype(np.float32),
            np.zeros(narrow, np.float32),
        ]
    layers[-2] *= np.float32(0.1)
    first, second = ([np.zeros_like(layer) for layer in layers] for _ in range(2))
    for step in range(count):
        if step % _BATCHES_OF_A_STEP == 0:
            steps.advance()
        rows = rng.integers(len(inputs), size=_BATCH)
        gradients = _gradients(layers, (inputs[rows] - mean) * scale, targets[rows], loss_gradient)
        # Cosine decay, from the full rate to 0.
        rate = _RATE * 0.5 * (1 + np.cos(np.pi * step / count))
        rate *= np.sqrt(1 - _DECAYS[1] ** (step + 1)) / (1 - _DECAYS[0] ** (step + 1))
        for layer, gradient, mean_gradient, mean_square in zip(layers, gradients, first, second, strict=True):
            mean_gradient += (1 - _DECAYS[0]) * (gradient - mean_gradient)
            mean_square += (1 - _DECAYS[1]) * (gradient * gradient - mean_square)
            layer -= np.float32(rate) * mean_gradient / (np.sqrt(mean_square) + np.float32(1e-8))
    for number in range(len(layers) // 2):
        weights[f"w{number}"], weights[f"b{number}"] = layers[2 * number : 2 * number + 2]
    return {key: np.asarray(array, np.float32) for key, array in weights.items()}


def _gradients(
    layers: list[Float32],
    values: Float32,
    targets: Float32,
    loss_gradient: Callable[[Float32, Float32], Float32],
) -> list[Float32]:
    """Return the derivatives of the mean loss by each array of a network."""
    held = [values]
    for number in range(0, len(layers), 2):
        values = values @ layers[number] + layers[number + 1]
        if number < len(layers) - 2:
            values = np.maximum(values, values * _LEAK)
        held.append(values)
    gradient = loss_gradient(values, targets) / np.float32(len(targets))
    gradients: list[Float32] = []
    for number in range(len(layers) - 2, -1, -2):
        before = held[number // 2]
        gradients = [before.T @ gradient, gradient.sum(axis=0), *gradients]
        if number:
            gradient = (gradient @ layers[number].T) * np.where(before > 0, np.float32(1), _LEAK)
    return gradients


def reader_shapes() -> dict[str, tuple[int, ...]]:
    """Return the shapes of the weights of a reader by name."""
    shapes: dict[str, tuple[int, ...]] = {}
    colours = 11
    for mode in _WIDTHS:
        nets = (
            ("slope", colours, _SLOPE_HIDDEN),
            ("depth", colours + 3 + 6 * len(_BLURS[1:]) + 3, _DEPTH_HIDDEN),
        )
        for kind, inputs, hidden in nets:
            name = f"{mode}_{kind}"
            sizes = (inputs, *hidden, 2)
            shapes |= {f"{name}_mean": (inputs,), f"{name}_scale": (inputs,)}
            for layer, (wide, narrow) in enumerate(pairwise(sizes)):
                shapes |= {f"{name}_w{layer}": (wide, narrow), f"{name}_b{layer}": (narrow,)}
    return shapes


def read_depth(twin: Twin, images: UInt8, *, fast: bool = False) -> DepthReading:
    """Read the depth of images (N, H, W, 3) of the sensor."""
    mode = "fast" if fast else "full"
    shrink = _shrink(twin, mode)
    background = shrunk(twin.background, shrink)
    depths = []
    errors = []
    for image in in_size_of(twin.size_px, images):
        levels = shrunk(image.astype(np.float32), shrink)
        if twin.report.get("light_drift", 0) >= MIN_DRIFT:
            levels /= frame_gains(levels, background, twin.report["noise_levels"]).astype(np.float32)
        change = levels - background
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
    rows, columns, _ = change.shape
    colours = _colours(change)
    slopes = network_output(reader, f"{mode}_slope", colours).reshape(rows, columns, 2)
    outputs = network_output(reader, f"{mode}_depth", _surroundings(colours, slopes))
    depth_mm = outputs[:, 0].reshape(rows, columns)
    error_mm = np.exp(np.clip(outputs[:, 1], -8, 2)).reshape(rows, columns)
    return np.where(depth_mm > _NO_CONTACT_MM, depth_mm, 0), error_mm


def _colours(change: Float32) -> Float32:
    """Return inputs of the network of slopes, (H W, 11): colour changes, sharp and blurred, and place."""
    rows, columns, _ = change.shape
    soft = _blurred(change, _BLURS[0] * columns)
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    position = np.stack([x, y, x * x, x * y, y * y], axis=-1).astype(np.float32)
    return np.concatenate([change, soft, position], axis=-1).reshape(-1, 11)


def _surroundings(colours: Float32, slopes: Float32) -> Float32:
    """Return inputs of the network of depth: colours, slopes and integrated surface, at and around pixels."""
    rows, columns, _ = slopes.shape
    surface = integrated(slopes)
    level = surface - np.float32(np.percentile(surface, 90))
    change = colours[:, 3:6].reshape(rows, columns, 3)
    parts = [slopes, level[..., None]]
    for share in _BLURS[1:]:
        around = np.concatenate([change, slopes, level[..., None]], axis=-1)
        parts.append(_blurred(around, share * columns))
    whole = np.array([level.min(), level.mean(), np.abs(change).max()], np.float32)
    parts.append(np.broadcast_to(whole, (rows, columns, 3)))
    return np.concatenate([colours, np.concatenate(parts, axis=-1).reshape(rows * columns, -1)], axis=1)


def _blurred(image: Float32, sigma_px: float) -> Float32:
    rows, columns, many = image.shape
    plane = image.reshape(rows, columns * many).astype(np.float64)
    across = gel.half_kernel(sigma_px, columns)
    down = gel.half_kernel(sigma_px, rows)
    blur(plane, across, down, many, None, plane)
    return plane.reshape(image.shape).astype(np.float32)


def integrated(slopes: Float32) -> Float32:
    """Return the surface (H, W) that best fits slopes (H, W, 2), per pixel along x and y upwards.

    Poisson's equation with free edges, by the cosine transform (Agrawal, Raskar and Chellappa, ECCV 2006).
    """
    rows, columns, _ = slopes.shape
    along_x = slopes[..., 0]
    along_y = -slopes[..., 1]
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


def training_steps() -> int:
    """Return the steps of progress of :func:`train_reader`."""
    return len(_WIDTHS) * sum(-(-count // _BATCHES_OF_A_STEP) for count in (_SLOPE_STEPS, _DEPTH_STEPS))


def train_reader(twin: Twin, fit: Fit, steps: Steps) -> dict[str, Float32]:
    """Return the weights of the networks of a twin."""
    rng = np.random.default_rng(0)
    samples: dict[str, list[_Sample]] = {mode: [] for mode in _WIDTHS}
    for image, depth_mm, weight in _samples(twin, fit, rng):
        for mode, kept in samples.items():
            shrink = _shrink(twin, mode)
            depth = shrunk(depth_mm, shrink)
            pixels = rng.permutation(depth.size)[: _PER_TOUCH * weight]
            change = shrunk(image, shrink) - shrunk(twin.background, shrink)
            slopes = _true_slopes(depth, twin, shrink).reshape(-1, 2)
            kept.append(_Sample(change, pixels, slopes[pixels], depth.reshape(-1, 1)[pixels]))
    weights: dict[str, Float32] = {}
    for mode, kept in samples.items():
        weights |= _trained(mode, kept, rng, steps)
    return weights


class _Sample(NamedTuple):
    """How an image differs from the background, and slopes and depth at some of its pixels."""

    change: Float32
    pixels: Int64
    slopes: Float32
    depth_mm: Float32


def _trained(mode: str, samples: list[_Sample], rng: np.random.Generator, steps: Steps) -> dict[str, Float32]:
    """Train both networks of a mode: slopes first, then depth from what the first one finds."""
    # Colours of all pixels at once would take four times the memory of the images.
    inputs = np.concatenate([_colours(sample.change)[sample.pixels] for sample in samples])
    targets = np.concatenate([sample.slopes for sample in samples])
    widths = (*_SLOPE_HIDDEN, 2)
    slope = train_network(inputs, targets, widths, _slope_gradient, rng, _SLOPE_STEPS, steps)
    reader = {f"{mode}_slope_{key}": array for key, array in slope.items()}
    first = 0
    targets = np.concatenate([sample.depth_mm for sample in samples])
    for sample in samples:
        colours = _colours(sample.change)
        slopes = network_output(reader, f"{mode}_slope", colours).reshape(*sample.change.shape[:2], 2)
        part = _surroundings(colours, slopes)[sample.pixels]
        if not first:  # in place: parts and the whole would take twice the memory
            inputs = np.empty((len(targets), part.shape[1]), np.float32)
        inputs[first : first + len(part)] = part
        first += len(part)
    widths = (*_DEPTH_HIDDEN, 2)
    depth = train_network(inputs, targets, widths, _depth_gradient, rng, _DEPTH_STEPS, steps)
    return reader | {f"{mode}_depth_{key}": array for key, array in depth.items()}


def _slope_gradient(outputs: Float32, targets: Float32) -> Float32:
    error = outputs - targets
    return np.asarray(error / np.sqrt(error * error + np.float32(1e-4)))


def _depth_gradient(outputs: Float32, targets: Float32) -> Float32:
    """Return derivatives of the absolute error, and of the Laplace likelihood by its logarithmic width."""
    error = outputs[:, :1] - targets
    log_width = np.clip(outputs[:, 1:], -8, 2)
    sharp = error / np.sqrt(error * error + np.float32(_SMOOTH_MM**2))
    return np.concatenate([sharp, np.float32(0.1) * (1 - np.abs(error) * np.exp(-log_width))], axis=1)


def _true_slopes(depth_mm: Float32, twin: Twin, shrink: int) -> Float32:
    """Return the slopes of the gel, mm per pixel along x and y upwards, shape (H, W, 2)."""
    rows, columns = depth_mm.shape
    pitch_m = 2 * twin.half_m / [columns, rows]
    soft = 1e3 * gel.gel_surface(depth_mm.astype(np.float64) / 1e3, pitch_m, gel.unbent(twin.shape))
    down, across = np.gradient(soft)
    return np.stack([across, -down], axis=-1).astype(np.float32)


def _samples(twin: Twin, fit: Fit, rng: np.random.Generator) -> Iterator[tuple[Float32, Float32, int]]:
    """Yield images, depth in mm, and weights, of recordings and of rendered touches."""
    presses = []
    residuals = []
    for touch in np.flatnonzero(fit.used).tolist():
        depth_m = fit.seen_depth_m(touch)
        presses.append(float(depth_m.max()))
        image, _ = fit.image(touch)
        yield image, (1e3 * depth_m).astype(np.float32), _RECORDING_WEIGHT
        residuals.append(image - fit.background - fit.rendered(touch, fit.poses[touch], fit.shape))
    optics = TwinOptics(twin)
    reliefs = list(fit.reliefs.values())
    for number in range(_TOUCHES):
        relief = reliefs[rng.integers(len(reliefs))]
        if rng.random() < _SIMPLE_SHARE:
            relief = simple_shape(rng)
        margin = gel.margin_px(twin.size_px[0])
        reach_m: Float32 | Float64 = _pressed(twin, relief, rng, presses, margin)
        clean = twin.background + optics.response(reach_m, margin=margin)
        reach_m = -gel.seen_through(-reach_m, twin.pitch_m, twin.shape, margin)
        # Residuals of recordings: the noise of the sensor, and effects that the twin does not render.
        noise = residuals[number % len(residuals)]
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
    turn = rng.uniform(0, 2 * np.pi)
    scale = rng.uniform(0.75, 1.3, 2) * [rng.choice([-1, 1]), 1]
    size = np.array(twin.size_px)
    sides = tuple((size + 2 * margin)[::-1])
    out = relief.sampled(np.array([*middle_m, turn]), twin.half_m * scale, sides, (size + 2 * margin) / size)
    press_m = rng.uniform(0.7 * min(presses), 1.15 * max(presses))
    return np.asarray(np.maximum(out - (out[margin:-margin, margin:-margin].max() - press_m), 0))


def simple_shape(rng: np.random.Generator) -> Relief:
    """Return one to three balls, cones, ridges, blocks or stairs, about 7 mm high, on 16 x 16 mm."""
    side, pitch = 320, 5e-5
    y, x = np.mgrid[-1:1:320j, -1:1:320j] * (side * pitch / 2)
    height = np.zeros((side, side))
    for _ in range(int(rng.integers(1, 4))):
        at = rng.uniform(-4e-3, 4e-3, 2)
        turn = rng.uniform(0, np.pi)
        along = np.cos(turn) * (x - at[0]) + np.sin(turn) * (y - at[1])
        across = np.cos(turn) * (y - at[1]) - np.sin(turn) * (x - at[0])
        top = 7e-3 - rng.uniform(0, 6e-4)
        # Distance from a point, a line, an edge, or the centre of a square.
        far = (
            np.hypot(along, across),
            np.abs(along),
            along,
            np.maximum(np.abs(along), np.abs(across)),
        )[rng.integers(4)]
        far = np.maximum(far - rng.uniform(0, rng.choice([1e-3, 5e-3])), 0)
        radius = rng.uniform(1.5e-3, 8e-3)
        slope = rng.uniform(0.15, 1.2)
        rise = 1e-4 * 50 ** rng.random()
        tread = rng.uniform(1e-3, 5e-3)
        drop = (
            radius - np.sqrt(np.maximum(radius**2 - far**2, 0)),
            slope * far,
            rise * np.ceil(far / tread),
        )[rng.integers(3)]
        tilt = rng.normal(0, 0.03, 2)
        body = top - drop + tilt[0] * along + tilt[1] * across
        # The gel is at rest beside a shape, as it is beside a printed solid.
        inside = np.maximum(np.abs(along), np.abs(across)) < rng.uniform(3e-3, 8e-3)
        height = np.maximum(height, np.where(inside, body, 0))
    corner = np.array([x[0, 0], y[0, 0], pitch, pitch])
    return Relief(height.astype(np.float32), corner)
