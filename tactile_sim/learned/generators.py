"""Inference with trained generators: on a CPU by Winograd's algorithm, or on a GPU.

On one core of a Zen 5 processor, the published generator (64 filters, 9 blocks, 256 x 256 pixels) takes
0.23 s for an image, and 0.19 s in bfloat16; as layers of PyTorch 0.49 s, in bfloat16 0.27 s, compiled 0.41 s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim.learned.networks import GeneratorNetwork
from tactile_sim.learned.processes import chosen_device
from tactile_sim.learned.weights import GeneratorWeights, generator_of
from tactile_sim.learned.winograd_kernels import (
    POINTS,
    add_image_sums,
    add_scaled,
    join_tiles,
    rectify,
    split_tiles,
    tiles_across,
    transformed_weights,
)
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.errors import InputError

Generator: TypeAlias = Callable[[Tensor], Tensor]
"""Computes images (n, 3, H, W) from images (n, 3, H, W), -1 to 1, both on the CPU."""

# Half a million pixels take about half a gigabyte in a generator of 64 filters on a GPU.
_PIXELS_TOGETHER = 1 << 19
# Values of the image inside a residual block; for fewer, layers of PyTorch are faster.
_MIN_VALUES = 1 << 15
_EPSILON = 1e-5  # of nn.InstanceNorm2d
_BORDER = 3  # of the last convolution
_ZERO, _NO_FLOOR = np.float32(0), np.float32(-np.inf)

_InParts: TypeAlias = Callable[[Callable[[int, int], object], int], None]
"""Calls a function for parts ``first`` to ``last`` of a number of rows."""

_Multiply: TypeAlias = Callable[[Tensor], Tensor]
"""Multiplies rows (n, in) by a matrix, which gives (n, out)."""


def make_generator(weights: GeneratorWeights, device: str = "cpu", *, bfloat16: bool = False) -> Generator:
    """Return a generator with these weights.

    Parameters
    ----------
    weights : GeneratorWeights
        Weights.
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one. On the CPU, an image does not depend
        on its batch.
    bfloat16 : bool
        Multiply numbers of 8 bits of precision, for speed.

    Returns
    -------
    callable
        Computes images (n, 3, H, W) from images, both on the CPU.

    Raises
    ------
    InputError
        There is no such device, or the processor has no bfloat16.
    """
    chosen = chosen_device(device)
    if chosen != "cpu":
        width, height = weights.size_px
        together = max(1, _PIXELS_TOGETHER // (width * height))
        return partial(_by_layers, generator_of(weights).eval().to(chosen), together, bfloat16)
    if bfloat16 and not torch.cpu._is_avx512_bf16_supported():
        raise InputError(
            "bfloat16 was asked for, but this processor does not compute with it (AVX-512 BF16)",
            next="leave it out",
        )
    values = weights.filters * weights.size_px[0] * weights.size_px[1] // 4
    if values > _MIN_VALUES:
        return FastGenerator(weights, bfloat16)
    return partial(_by_layers, generator_of(weights).eval(), 1, bfloat16)


def _by_layers(network: GeneratorNetwork, together: int, bfloat16: bool, images: Tensor) -> Tensor:
    """Run a network on its device, on some images at a time."""
    device = next(network.parameters()).device
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=bfloat16):
        return torch.cat([network(part.to(device)).float().cpu() for part in images.split(together)])


class FastGenerator:
    """A generator on the CPU, in about two fifths of the time of its layers in PyTorch.

    The convolutions of the residual blocks, nine tenths of all multiplications, are computed by Winograd's
    algorithm. Their matrices take four times the memory of the weights. Instance norm, ReLU and borders are
    part of its transforms; biases before a norm have no effect and are left out. In single precision, images
    are within 0.001 levels of 255 of those of the layers.

    Each image is computed by itself, with as many threads as PyTorch has. Each layer of PyTorch is
    computed on one thread, so that values do not depend on the number of threads.
    """

    def __init__(self, weights: GeneratorWeights, bfloat16: bool = False) -> None:
        self._arguments = weights, bfloat16
        self._bfloat16 = bfloat16
        found = {name: torch.from_numpy(array) for name, array in weights.arrays.items()}
        blocks, (width, height) = weights.blocks, weights.size_px
        self._tiles = tiles_across(width // 4) * tiles_across(height // 4)
        convolutions = ("model.1", "model.4", "model.7", f"model.{10 + blocks}", f"model.{13 + blocks}")
        self._first, *self._halving, up, up_again = (
            _channels_last(found[f"{name}.weight"]) for name in convolutions
        )
        self._doubling = up, up_again
        self._blocks = [
            [self._matrices(found[f"model.{10 + block}.conv_block.{layer}.weight"]) for layer in (1, 5)]
            for block in range(blocks)
        ]
        last = found[f"model.{17 + blocks}.weight"]
        colours, channels, side, _ = last.shape
        # With three outputs, most lanes of a processor would be idle. So a convolution gives an output for
        # each column of the kernels, and another one adds them up.
        columns = last.permute(0, 3, 1, 2).reshape(colours * side, channels, side, 1)
        adding = torch.eye(colours * side).reshape(colours, side, colours * side).transpose(1, 2)
        self._columns, self._adding = _channels_last(columns), _channels_last(adding[:, :, None])
        self._bias = found[f"model.{17 + blocks}.bias"]

    def __reduce__(self) -> tuple[type[FastGenerator], tuple[GeneratorWeights, bool]]:
        return FastGenerator, self._arguments  # prepared matrices cannot be copied

    def __call__(self, images: Tensor) -> Tensor:
        """Return images (n, 3, H, W) of images (n, 3, H, W), -1 to 1; H and W are multiples of 4."""
        threads = torch.get_num_threads()
        with _single_threads(threads) as pool:
            in_parts = _at_once
            if len(images) < threads:
                # At least one thread is left to compute parts, so no image waits forever.
                in_parts = partial(_in_parts, pool, threads)
            made = list(pool.map(partial(self._image, in_parts=in_parts), images.split(1)))
        return torch.cat(made).contiguous()

    def _image(self, image: Tensor, in_parts: _InParts) -> Tensor:
        with torch.inference_mode():  # of a thread
            return self._layers(image, in_parts)

    def _layers(self, image: Tensor, in_parts: _InParts) -> Tensor:
        conv = nn.functional.conv2d
        framed = nn.functional.pad(image, (_BORDER,) * 4, mode="reflect")
        made = conv(_channels_last(framed), self._first)
        for weight in self._halving:
            made = conv(_rectified(made, in_parts), weight, stride=2, padding=1)
        made = self._run_blocks(_rectified(made, in_parts), in_parts)
        for margin, weight in zip((0, _BORDER), self._doubling, strict=True):
            made = nn.functional.conv_transpose2d(made, weight, stride=2, padding=1, output_padding=1)
            made = _rectified(made, in_parts, margin)
        return torch.tanh(conv(conv(made, self._columns), self._adding, self._bias))

    def _run_blocks(self, image: Tensor, in_parts: _InParts) -> Tensor:
        """Add what the residual blocks compute to an image (1, channels, h, w), in place."""
        pixels = _pixels(image)
        height, width, channels = pixels.shape
        one, zero = np.ones(channels, np.float32), np.zeros(channels, np.float32)
        count = tiles_across(height) * tiles_across(width)
        tiles = np.empty((POINTS, count, channels), np.float32)
        inner, outer = np.empty_like(pixels), np.empty_like(pixels)
        for first, second in self._blocks:
            norm = _convolve(
                partial(split_tiles, pixels, one, zero, _NO_FLOOR), first, tiles, inner, in_parts
            )
            norm = _convolve(partial(split_tiles, inner, *norm, _ZERO), second, tiles, outer, in_parts)
            in_parts(partial(add_scaled, outer, *norm, pixels), height)
        return image

    def _matrices(self, weight: Tensor) -> list[_Multiply]:
        """Prepare a convolution (out, in, 3, 3)."""
        matrices = torch.from_numpy(transformed_weights(weight.numpy()))
        if self._bfloat16:
            matrices = matrices.bfloat16()
        return [_multiplication(each, self._tiles) for each in matrices]


def _convolve(
    split: Callable[[Float32, int, int], None],
    matrices: list[_Multiply],
    tiles: Float32,
    out: Float32,
    in_parts: _InParts,
) -> tuple[Float32, Float32]:
    """Convolve what ``split`` writes to ``tiles``; return scale and shift of the norm that follows."""
    height, width, channels = out.shape
    down = tiles_across(height)
    sums = np.empty((down, 2, channels))

    def multiply(first: int, last: int) -> None:
        with torch.inference_mode():
            # In place: less memory stays in the cache of the processor.
            for rows, matrix in zip(tiles[first:last], matrices[first:last], strict=True):
                together = torch.from_numpy(rows)
                together.copy_(matrix(together))

    in_parts(partial(split, tiles), down)
    in_parts(multiply, POINTS)
    in_parts(partial(join_tiles, tiles, out, sums), down)
    return _norm(sums, height * width)


def _multiplication(matrix: Tensor, rows: int) -> _Multiply:
    """Return a function that multiplies rows, usually this many, by a matrix (out, in), in its precision."""
    operations, dtype = torch.ops.mkldnn, matrix.dtype
    if torch.backends.mkldnn.is_available() and hasattr(operations, "_linear_pointwise"):
        # PyTorch's compiler uses these. On AMD processors they are twice as fast as torch.mm.
        packed = operations._reorder_linear_weight(matrix, rows)
        return lambda taken: operations._linear_pointwise(taken.to(dtype), packed, None, "none", [], "")
    transposed = matrix.t().contiguous()
    return lambda taken: torch.mm(taken.to(dtype), transposed)


def _norm(sums: Float64, count: int) -> tuple[Float32, Float32]:
    """Return scale and shift by which instance norm changes channels, from sums of parts (n, 2, channels)."""
    mean, square = sums.sum(axis=0) / count
    scale = 1 / np.sqrt(square - mean * mean + _EPSILON)
    return scale.astype(np.float32), (-mean * scale).astype(np.float32)


def _rectified(image: Tensor, in_parts: _InParts, margin: int = 0) -> Tensor:
    """Apply instance norm and ReLU to an image (1, channels, h, w), and mirror it into a margin."""
    pixels = _pixels(image)
    height, width, channels = pixels.shape
    sums = np.empty((height, 2, channels))
    in_parts(partial(add_image_sums, pixels, sums), height)
    out = pixels
    if margin:
        out = np.empty((height + 2 * margin, width + 2 * margin, channels), np.float32)
    in_parts(partial(rectify, pixels, *_norm(sums, height * width), margin, out), len(out))
    return torch.from_numpy(out).permute(2, 0, 1)[None]


def _pixels(image: Tensor) -> Float32:
    """Return an image (1, channels, h, w) as an array (h, w, channels), each pixel in one place."""
    pixels: Float32 = image[0].permute(1, 2, 0).contiguous().numpy()
    return pixels


def _channels_last(values: Tensor) -> Tensor:
    return values.contiguous(memory_format=torch.channels_last)


def _at_once(function: Callable[[int, int], object], count: int) -> None:
    function(0, count)


def _in_parts(
    pool: ThreadPoolExecutor, threads: int, function: Callable[[int, int], object], count: int
) -> None:
    bounds = [count * part // threads for part in range(threads + 1)]
    list(pool.map(function, bounds[:-1], bounds[1:]))


@contextmanager
def _single_threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads, each of which computes on one thread of PyTorch."""
    try:
        with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield pool
    finally:
        torch.set_num_threads(count)  # those of the pool also set the default of all threads to come
