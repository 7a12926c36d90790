"""Weights of generators as files.

A file has the published format: an ``.npz`` of float32 arrays by layer. The size that the network was trained
at, for which that format has no room, is stored in the comment of the archive, which readers of the published
format ignore.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from tactile_sim import array_files
from tactile_sim.learned.networks import GeneratorNetwork
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Float32
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

Direction = Literal["touch", "depth"]
"""Output of a generator: touches from depth, or depth from touches."""

PUBLISHED_SIZE_PX = (256, 256)
"""Size that the published weights were trained at (`tactile-mnist` 0.13.0)."""

_PUBLISHED = {
    "touch": "cycle_gan_tactile_mnist_v0.npz",
    "depth": "cycle_gan_inverse_tactile_mnist_v0.npz",
}
# A file must not decide how large a network is built before its shapes are compared.
_MAX_BLOCKS, _MAX_FILTERS = 64, 1024
_SIDES_PX = range(16, 2049, 4)
_MISSING: AnyArray = np.empty(0)


@dataclass(frozen=True, eq=False)
class GeneratorWeights:
    """Weights of one generator.

    Attributes
    ----------
    arrays : mapping of str to ndarray of float32
        By the names of the published files, such as ``model.10.conv_block.1.weight``.
    size_px : tuple of int
        Width and height of the pictures that it was trained with, pixels; multiples of 4.
    """

    arrays: Mapping[str, Float32]
    size_px: tuple[int, int] = PUBLISHED_SIZE_PX

    @property
    def filters(self) -> int:
        """Filters of the first layer."""
        return int(self.arrays["model.1.weight"].shape[0])

    @property
    def blocks(self) -> int:
        """Number of residual blocks."""
        return sum(name.endswith("conv_block.1.weight") for name in self.arrays)


def generator_of(weights: GeneratorWeights) -> GeneratorNetwork:
    """Return the generator with these weights."""
    network = GeneratorNetwork(weights.filters, weights.blocks)
    network.load_state_dict({name: torch.from_numpy(array) for name, array in weights.arrays.items()})
    return network


def weights_of(network: GeneratorNetwork, size_px: tuple[int, int]) -> GeneratorWeights:
    """Return the weights of a generator."""
    state = network.state_dict()
    arrays = {name: np.asarray(value.detach().float().cpu().numpy()) for name, value in state.items()}
    return GeneratorWeights(arrays, size_px)


def published_weights(direction: Direction) -> Path:
    """Return the file of the published weights, which `tactile-mnist` ships, without importing the package.

    Raises InputError if the package is not installed.
    """
    found = find_spec("tactile_mnist")
    if found is not None and found.origin is not None:
        file = Path(found.origin).parent / "resources" / _PUBLISHED[direction]
        if file.is_file():
            return file
    user = {"touch": "the optics 'cyclegan'", "depth": "DepthEstimator"}[direction]
    raise InputError(
        f"{user} without weights of your own needs a file of the package 'tactile-mnist', which is not "
        "installed",
        next="give `weights`, or run `pip install --no-deps tactile-mnist==0.13.0`",
    )


def read_weights(file: str | Path) -> GeneratorWeights:
    """Read and check a file of weights.

    Parameters
    ----------
    file : str or path
        An ``.npz`` as `tactile-mnist` ships it or ``tactile-sim train`` writes it; any number of filters
        and residual blocks.

    Returns
    -------
    GeneratorWeights

    Raises
    ------
    InputError
        The file does not exist, is damaged, or holds no generator.
    """
    path = store.expanded(file)
    try:
        arrays, comment = array_files.read_npz(path)
        _require_generator(arrays)
        width, height = PUBLISHED_SIZE_PX
        if comment:
            width, height = json.loads(comment)["size_px"]
        if not (width in _SIDES_PX and height in _SIDES_PX):
            problem = f"of {width!r} x {height!r} pixels; expected multiples of 4, 16 to 2048"
            raise ValueError(problem)
    except Exception as error:  # zipfile, zlib, json and numpy raise many kinds on damaged files
        raise InputError(
            f"{str(path)!r} cannot be read as weights of a generator ({error}); expected an .npz such as "
            "`tactile-sim train` writes",
            next="download or make it again",
        ) from error
    return GeneratorWeights(arrays, (width, height))


def _require_generator(arrays: Mapping[str, AnyArray]) -> None:
    """Raise ValueError, which names the first layer that differs, for arrays that no generator has."""
    blocks, expected = GeneratorWeights(arrays).blocks, {}
    first = arrays.get("model.1.weight")
    if first is not None and first.ndim and 0 < len(first) <= _MAX_FILTERS and blocks <= _MAX_BLOCKS:
        with torch.device("meta"):  # only shapes, no memory
            state = GeneratorNetwork(len(first), blocks).state_dict()
        expected = {name: tuple(each.shape) for name, each in state.items()}
    for name in [*expected, *arrays] or ["model.1.weight"]:
        array = arrays.get(name, _MISSING)
        if array is _MISSING or array.shape != expected.get(name):
            problem = f"{name} has the shape {array.shape}, expected {expected.get(name)}"
            raise ValueError(problem)
        if not (array.dtype == np.float32 and np.isfinite(array).all()):
            problem = f"{name} holds values that are not finite numbers in single precision"
            raise ValueError(problem)


def weights_bytes(weights: GeneratorWeights) -> bytes:
    """Return the bytes of a file of weights; equal weights give equal bytes."""
    comment = b""
    if weights.size_px != PUBLISHED_SIZE_PX:
        comment = json.dumps({"size_px": list(weights.size_px)}).encode()
    return array_files.npz_bytes(weights.arrays, comment)


def write_weights(folder: store.DataFolder, name: str, weights: GeneratorWeights) -> None:
    """Write a file of weights, complete or not at all; StorageError if it cannot be written."""
    folder.write_bytes(name, weights_bytes(weights))


def weights_facts(weights: str | None) -> JsonDict:
    """Return JSON values that identify a file of weights by its content; the published one by default."""
    file = published_weights("touch") if weights is None else store.expanded(weights)
    return {
        "weights_size_px": list(read_weights(file).size_px),
        "weights_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
    }
