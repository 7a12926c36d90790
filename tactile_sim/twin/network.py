"""Small fully connected networks on pixels, trained and evaluated in NumPy, single precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np

from tactile_toolkit.array_types import Float32

_LEAK = np.float32(0.1)
_RATE, _BATCH = 5e-3, 4096
_MAX_ROWS = 100_000  # about as many give the mean and the spread of inputs
_DECAYS = (0.9, 0.999)  # of Adam, as published (Kingma and Ba, 2015)
_BLOCK = 1 << 14  # rows that fit into the processor's cache


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


def trained(
    name: str,
    inputs: Float32,
    targets: Float32,
    hidden: tuple[int, ...],
    outputs: int,
    loss_gradient: Callable[[Float32, Float32], Float32],
    rng: np.random.Generator,
    steps: int,
) -> dict[str, Float32]:
    """Train a network by Adam; ``loss_gradient`` takes outputs and targets to the derivative by outputs."""
    # A sample of the rows: differences of all of them would double the memory.
    sample = inputs[:: max(1, len(inputs) // _MAX_ROWS)]
    mean = sample.mean(axis=0)
    scale = 1 / (sample.std(axis=0) + np.float32(1e-6))
    sizes = (inputs.shape[1], *hidden, outputs)
    found: dict[str, Float32] = {f"{name}_mean": mean, f"{name}_scale": scale}
    layers: list[Float32] = []
    for wide, narrow in pairwise(sizes):
        layers += [
            rng.normal(0, np.sqrt(2 / wide), (wide, narrow)).astype(np.float32),
            np.zeros(narrow, np.float32),
        ]
    layers[-2] *= np.float32(0.1)
    first, second = ([np.zeros_like(each) for each in layers] for _ in range(2))
    for step in range(steps):
        rows = rng.integers(len(inputs), size=_BATCH)
        gradients = _gradients(layers, (inputs[rows] - mean) * scale, targets[rows], loss_gradient)
        # Cosine decay, from the full rate to 0.
        rate = _RATE * 0.5 * (1 + np.cos(np.pi * step / steps))
        rate *= np.sqrt(1 - _DECAYS[1] ** (step + 1)) / (1 - _DECAYS[0] ** (step + 1))
        for each, gradient, mean_gradient, mean_square in zip(layers, gradients, first, second, strict=True):
            mean_gradient += (1 - _DECAYS[0]) * (gradient - mean_gradient)
            mean_square += (1 - _DECAYS[1]) * (gradient * gradient - mean_square)
            each -= np.float32(rate) * mean_gradient / (np.sqrt(mean_square) + np.float32(1e-8))
    for number in range(len(layers) // 2):
        found[f"{name}_w{number}"], found[f"{name}_b{number}"] = layers[2 * number : 2 * number + 2]
    return {key: np.asarray(each, np.float32) for key, each in found.items()}


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
