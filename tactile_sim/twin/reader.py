"""Read depth from images of a sensor: slopes from colours, Poisson integration, and depth from the result.

A network regresses slopes. The twin renders the gel that has them, and a second network corrects them by what
the image has beyond that; a third one regresses depth and its own error. They are trained on the recordings,
and on touches that the twin itself renders with the noise of the sensor: of the solids of its calibration in
random poses, sizes and depths, and of simple shapes such as stairs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from tactile_sim.optics.rendering import in_size_of
from tactile_sim.press.sensors import DepthReading
from tactile_sim.twin import gel, surface_kernels
from tactile_sim.twin.fitting import MIN_DRIFT, Fit, Steps
from tactile_sim.twin.recordings import Relief, frame_gains, shrunk
from tactile_sim.twin.twin import Twin, resized_depth
from tactile_toolkit.value_types import Float32, Float64, Int64, UInt8

_LEAK = np.float32(0.1)
_RATE, _BATCH = 5e-3, 2048
_MAX_ROWS = 100_000  # about as many give the mean and the spread of inputs
_DECAYS = (0.9, 0.999)  # of Adam, as published (Kingma and Ba, 2015)
_BLOCK = 1 << 14  # rows that fit into the processor's cache
_WIDTHS = {"full": 160, "fast": 80}  # of the images that are read, pixels
_TOUCHES = 320  # that are rendered for the training of the networks
_PER_TOUCH = {"full": 1500, "fast": 750}  # pixels of each touch on which the networks are trained
_SLOPE_PASSES = 2
_SLOPE_STEPS, _DEPTH_STEPS = 1000, 2500
_BATCHES_OF_A_STEP = 200  # of progress, about as long as a step of a fit
_SLOPE_HIDDEN = (32, 32)
_DEPTH_HIDDEN = (64, 64)
_POSITIONS = 5  # inputs: x, y, and their products
_COLOURS = 3  # maps that the first network sees: how an image differs from the background
_MAPS = 9  # maps that the others see: these, what the twin does not render, two slopes, and the surface
_BLURS = (0.01, 0.03, 0.09)  # of the width
_NO_CONTACT_MM = 0.02  # a smaller depth counts as no contact
_SMOOTH_MM, _SMOOTH_SLOPE = 0.01, 0.1  # the loss is quadratic in smaller errors
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
    for number in range(_SLOPE_PASSES + 1):
        name, hidden = _network(number)
        maps = _MAPS if number else _COLOURS
        sizes = (_POSITIONS + maps * (1 + len(_BLURS)), *hidden, 2)
        shapes |= {f"{name}_mean": sizes[:1], f"{name}_scale": sizes[:1]}
        for layer, (wide, narrow) in enumerate(pairwise(sizes)):
            shapes |= {f"{name}_w{layer}": (wide, narrow), f"{name}_b{layer}": (narrow,)}
    return shapes


def _network(number: int) -> tuple[str, tuple[int, ...]]:
    """Return the name of a network and the widths of its hidden layers: those of slopes come first."""
    return (f"slope{number}", _SLOPE_HIDDEN) if number < _SLOPE_PASSES else ("depth", _DEPTH_HIDDEN)


class _View:
    """How a twin shows the gel in images of a width that is read."""

    def __init__(self, twin: Twin, mode: str) -> None:
        self.shrink = max(1, round(twin.size_px[0] / _WIDTHS[mode]))
        self.background = shrunk(twin.background, self.shrink)
        self._wanders = twin.report.get("light_drift", 0) >= MIN_DRIFT
        self._noise = twin.report["noise_levels"]
        self.sides = self.background.shape[:2]
        self.pitch_m = 2 * twin.half_m / self.sides[::-1]
        self._shape = twin.shape
        self._table = gel.response_table(twin.coefficients)
        self._terms = gel.position_terms(self.background)
        y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in self.sides), indexing="ij")
        self._positions = np.stack([x, y, x * x, x * y, y * y])
        self._blurs = [gel.gel_blur(np.full(2, share * self.sides[1]), self.sides) for share in _BLURS]

    def _change(self, levels: Float32, shown: Float32 | float = 0.0) -> Float32:
        """Return how levels differ from the background, (h, w, 3), corrected for a light that wanders.

        ``shown`` is how they are expected to differ from it, apart from their gains.
        """
        if self._wanders:
            gains = frame_gains(levels, self.background + shown, self._noise)
            levels = (levels / gains).astype(np.float32)
        return levels - self.background

    def slopes_of(self, surface_m: Float32) -> Float32:
        """Return the slopes along x and y upwards, (h, w, 2), of a surface of the gel in full size."""
        down, across = np.gradient(shrunk(surface_m, self.shrink))
        return np.asarray(np.stack([across, -down], axis=-1) / self.pitch_m, np.float32)

    def inputs(self, levels: Float32, known: Float32 | None) -> Float32:
        """Return the inputs of a network, (m, h w), from an image and the slopes known so far, (h, w, 2)."""
        if known is None:
            maps = self._change(levels)
        else:
            surface_m = integrated(known * self.pitch_m.astype(np.float32))
            surface_m -= np.float32(np.percentile(surface_m, 90))
            shown = gel.response(surface_m, self.pitch_m, self._shape, self._table, self._terms)
            change = self._change(levels, shown)
            level_mm = np.float32(1e3) * surface_m[..., None]
            maps = np.concatenate([change, change - shown, known, level_mm], axis=-1)
        count = maps.shape[2]
        out = np.empty((_POSITIONS + count * (1 + len(_BLURS)), *self.sides), np.float32)
        out[:_POSITIONS] = self._positions
        out[_POSITIONS : _POSITIONS + count] = np.moveaxis(maps, 2, 0)
        for number, blur in enumerate(self._blurs, 1):
            for plane in range(_POSITIONS, _POSITIONS + count):
                surface_kernels.soften(out[plane + number * count], out[plane], blur, 0)
        return out.reshape(len(out), -1)

    def outputs(
        self, reader: Mapping[str, Float32], number: int, levels: Float32, known: Float32 | None
    ) -> Float32:
        """Return what a network finds, (h, w, 2): a correction of slopes, or depth and its error."""
        inputs = np.ascontiguousarray(self.inputs(levels, known).T)
        return network_output(reader, _network(number)[0], inputs).reshape(*self.sides, 2)

    def corrected(
        self, reader: Mapping[str, Float32], number: int, levels: Float32, known: Float32 | None
    ) -> Float32:
        """Return slopes (h, w, 2) after a network has corrected those that are known so far."""
        correction = self.outputs(reader, number, levels, known)
        return correction if known is None else known + correction


def read_depth(twin: Twin, images: UInt8, *, fast: bool = False) -> DepthReading:
    """Read the depth of images (N, H, W, 3) of the sensor."""
    view = _View(twin, "fast" if fast else "full")
    readings = []
    for image in in_size_of(twin.size_px, images):
        levels = shrunk(image.astype(np.float32), view.shrink)
        known = None
        for number in range(_SLOPE_PASSES):
            known = view.corrected(twin.reader, number, levels, known)
        readings.append(view.outputs(twin.reader, _SLOPE_PASSES, levels, known))
    depth_mm, log_error = np.moveaxis(np.stack(readings), 3, 0)
    size_px = (images.shape[2], images.shape[1])
    depth_m = np.float32(1e-3) * np.where(depth_mm > _NO_CONTACT_MM, depth_mm, 0)
    error_m = np.float32(1e-3) * np.exp(np.clip(log_error, -8, 2))
    return DepthReading(resized_depth(depth_m, size_px), resized_depth(error_m, size_px))


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
    counts = [_SLOPE_STEPS] * _SLOPE_PASSES + [_DEPTH_STEPS]
    return sum(-(-count // _BATCHES_OF_A_STEP) for count in counts)


def train_reader(twin: Twin, fit: Fit, steps: Steps) -> dict[str, Float32]:
    """Return the weights of the networks of a twin."""
    rng = np.random.default_rng(0)
    views = [(_View(twin, mode), count) for mode, count in _PER_TOUCH.items()]
    samples: list[_Sample] = []
    for image, surface_m, depth_mm, weight in _samples(twin, fit, rng):
        for view, count in views:
            depth = shrunk(depth_mm, view.shrink)
            pixels = rng.permutation(depth.size)[: count * weight]
            slopes = view.slopes_of(surface_m).reshape(-1, 2)[pixels]
            samples.append(
                _Sample(view, shrunk(image, view.shrink), pixels, slopes, depth.reshape(-1, 1)[pixels])
            )
    reader: dict[str, Float32] = {}
    known: list[Float32 | None] = [None] * len(samples)
    missing = np.concatenate([sample.slopes for sample in samples])
    for number in range(_SLOPE_PASSES):
        inputs = _inputs_of(samples, known)
        reader |= _trained(number, inputs, missing, _slope_gradient, rng, _SLOPE_STEPS, steps)
        missing -= network_output(reader, _network(number)[0], inputs)
        for at, sample in enumerate(samples):
            known[at] = sample.view.corrected(reader, number, sample.levels, known[at])
    inputs = _inputs_of(samples, known)
    depths = np.concatenate([sample.depth_mm for sample in samples])
    return reader | _trained(_SLOPE_PASSES, inputs, depths, _depth_gradient, rng, _DEPTH_STEPS, steps)


class _Sample(NamedTuple):
    """An image, and slopes and depth at some of its pixels."""

    view: _View
    levels: Float32
    pixels: Int64
    slopes: Float32
    depth_mm: Float32


def _inputs_of(samples: list[_Sample], known: list[Float32 | None]) -> Float32:
    """Return the inputs of a network at the pixels of all samples, (n, m)."""
    ends = np.cumsum([len(sample.pixels) for sample in samples])
    out = np.empty((0, 0), np.float32)
    for sample, slopes, end in zip(samples, known, ends.tolist(), strict=True):
        part = sample.view.inputs(sample.levels, slopes)[:, sample.pixels].T
        if not out.size:  # in place: parts and the whole would take twice the memory
            out = np.empty((ends[-1], part.shape[1]), np.float32)
        out[end - len(part) : end] = part
    return out


def _trained(
    number: int,
    inputs: Float32,
    targets: Float32,
    loss_gradient: Callable[[Float32, Float32], Float32],
    rng: np.random.Generator,
    count: int,
    steps: Steps,
) -> dict[str, Float32]:
    """Return the weights of one of the networks by name."""
    name, hidden = _network(number)
    weights = train_network(inputs, targets, (*hidden, 2), loss_gradient, rng, count, steps)
    return {f"{name}_{key}": array for key, array in weights.items()}


def _slope_gradient(outputs: Float32, targets: Float32) -> Float32:
    """Return derivatives of the absolute error of both slopes."""
    error = outputs - targets
    return np.asarray(error / np.sqrt(error * error + np.float32(_SMOOTH_SLOPE**2)))


def _depth_gradient(outputs: Float32, targets: Float32) -> Float32:
    """Return derivatives of the absolute error, and of the Laplace likelihood by its logarithmic width."""
    error = outputs[:, :1] - targets
    log_width = np.clip(outputs[:, 1:], -8, 2)
    sharp = error / np.sqrt(error * error + np.float32(_SMOOTH_MM**2))
    return np.concatenate([sharp, np.float32(0.1) * (1 - np.abs(error) * np.exp(-log_width))], axis=1)


def _samples(
    twin: Twin, fit: Fit, rng: np.random.Generator
) -> Iterator[tuple[Float32, Float32, Float32, int]]:
    """Yield images, surfaces of the gel, m, depth, mm, and weights, of recordings and rendered touches."""
    presses = []
    residuals = []
    for touch in np.flatnonzero(fit.used).tolist():
        depth_m = fit.seen_depth_m(touch)
        presses.append(float(depth_m.max()))
        image, _ = fit.image(touch)
        surface_m = fit.seen(fit.pressed(touch, fit.poses[touch], fit.shape), fit.shape)
        yield image, surface_m, (1e3 * depth_m).astype(np.float32), _RECORDING_WEIGHT
        residuals.append(image - fit.background - fit.shown(surface_m, fit.shape))
    table = gel.response_table(twin.coefficients)
    terms = gel.position_terms(twin.background)
    reliefs = list(fit.reliefs.values())
    margin = gel.margin_px(twin.size_px[0])
    for number in range(_TOUCHES):
        relief = reliefs[rng.integers(len(reliefs))]
        if rng.random() < _SIMPLE_SHARE:
            relief = simple_shape(rng)
        reach_m = _pressed(twin, relief, rng, presses, margin)
        surface_m = gel.gel_surface(reach_m, twin.pitch_m, twin.shape, margin)
        clean = twin.background + gel.response(surface_m, twin.pitch_m, twin.shape, table, terms)
        depth_mm = -1e3 * gel.seen_through(-reach_m, twin.pitch_m, twin.shape, margin)
        # Residuals of recordings: the noise of the sensor, and effects that the twin does not render.
        noise = residuals[number % len(residuals)]
        image = np.clip(np.rint(clean + noise[:: rng.choice([1, -1]), :: rng.choice([1, -1])]), 0, 255)
        yield image.astype(np.float32), surface_m, depth_mm.astype(np.float32), 1


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
