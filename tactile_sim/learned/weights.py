"""Weights of a generator as a file: the published format, an ``.npz`` of float32 arrays by layer.

What the format has no room for (the size that the network was trained at, whether the pictures are of the
whole sensor) stands in the comment of the archive, which readers of the published format do not look at.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError
from tactile_toolkit.store.files import expanded, open_regular
from tactile_toolkit.store.folder import DataFolder

Direction = Literal["touch", "depth"]
"""What a generator makes: touches of depth, or depth of touches."""

PUBLISHED_SIZE_PX = (256, 256)
"""What the published weights were trained at (`tactile-mnist` 0.13.0)."""

FIRST_BLOCK = 10
"""Number of the first residual block among the layers of a generator."""

_PUBLISHED = {
    "touch": "cycle_gan_tactile_mnist_v0.npz",
    "depth": "cycle_gan_inverse_tactile_mnist_v0.npz",
}
# A name in a file must not decide how much is built before it was compared.
_MOST_BLOCKS, _MOST_FILTERS = 64, 1024
_SIDES_PX = range(16, 2049)


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

    arrays: Mapping[str, NDArray[np.float32]]
    size_px: tuple[int, int] = PUBLISHED_SIZE_PX

    @property
    def filters(self) -> int:
        """Filters of the first layer."""
        return int(self.arrays["model.1.weight"].shape[0])

    @property
    def blocks(self) -> int:
        """Residual blocks."""
        return sum(name.endswith("conv_block.1.weight") for name in self.arrays)


def layer_shapes(filters: int, blocks: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a generator's weights by their published names, in the order of the layers."""
    layers: dict[str, tuple[int, int, int]] = {"1": (filters, 3, 7)}
    layers["4"], layers["7"] = (2 * filters, filters, 3), (4 * filters, 2 * filters, 3)
    for number in range(blocks):
        for part in (1, 5):
            layers[f"{FIRST_BLOCK + number}.conv_block.{part}"] = (4 * filters, 4 * filters, 3)
    after = FIRST_BLOCK + blocks
    # Those that enlarge are stored input first.
    layers[f"{after}"], layers[f"{after + 3}"] = (4 * filters, 2 * filters, 3), (2 * filters, filters, 3)
    layers[f"{after + 7}"] = (3, filters, 7)
    enlarging = (f"{after}", f"{after + 3}")
    shapes: dict[str, tuple[int, ...]] = {}
    for name, (first, second, side) in layers.items():
        shapes[f"model.{name}.weight"] = (first, second, side, side)
        shapes[f"model.{name}.bias"] = (second if name in enlarging else first,)
    return shapes


def published_weights(direction: Direction) -> Path:
    """Return the file of published weights, which `tactile-mnist` ships; nothing of it is imported."""
    found = find_spec("tactile_mnist")
    places = list(found.submodule_search_locations or ()) if found is not None else []
    file = Path(places[0]) / "resources" / _PUBLISHED[direction] if places else None
    if file is None or not file.is_file():
        feature = "the optics 'cyclegan' without weights of your own"
        raise MissingExtraError(feature, "tactile-mnist", "env")
    return file


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
        There is no such file, or it holds something else than a generator.
    IntegrityError
        The file is damaged.
    """
    path = expanded(file)
    if not path.is_file():
        raise InputError(
            f"no file of weights {str(path)!r}; expected an .npz such as `tactile-sim train` writes"
        )
    try:
        with open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
            require_unpackable(sum(entry.file_size for entry in archive.infolist()), repr(str(path)))
            arrays = {entry.removesuffix(".npy"): _array(archive, entry) for entry in archive.namelist()}
            noted = archive.comment
    except zipfile.BadZipFile as error:
        raise _no_archive(path, error) from error
    except (
        ValueError,
        EOFError,
        OSError,
        NotImplementedError,
        RuntimeError,
        MemoryError,
        zlib.error,
    ) as error:
        raise InputError(f"{str(path)!r} cannot be read as weights of a generator ({error})") from error
    _require_generator(arrays, str(path))
    return GeneratorWeights(arrays, _noted_size(noted, str(path)))


def _no_archive(path: Path, error: Exception) -> InputError | IntegrityError:
    """Tell a damaged archive from what never was one."""
    with path.open("rb") as stream:
        was_one = stream.read(2) == b"PK"
    if was_one:
        return IntegrityError(f"{str(path)!r} is damaged ({error}); next: fetch or make it again")
    return InputError(f"{str(path)!r} is not an .npz file ({error}); expected weights of a generator")


def _array(archive: zipfile.ZipFile, entry: str) -> NDArray[Any]:
    with archive.open(entry) as stream:
        return np.asarray(npy.read_array(stream, allow_pickle=False))


def _require_generator(arrays: Mapping[str, NDArray[Any]], where: str) -> None:
    """Refuse what is not a generator, naming the first layer that differs."""
    blocks = sum(name.endswith("conv_block.1.weight") for name in arrays)
    first = arrays.get("model.1.weight")
    filters = first.shape[0] if first is not None and first.ndim == 4 else 0
    expected: dict[str, tuple[int, ...]] = {}
    if 1 <= filters <= _MOST_FILTERS and blocks <= _MOST_BLOCKS:
        expected = layer_shapes(filters, blocks)
    found = {name: array.shape for name, array in arrays.items()}
    wrong = next((name for name in [*expected, *found] if found.get(name) != expected.get(name)), None)
    if wrong is not None or not expected:
        named = wrong or "model.1.weight"
        raise InputError(
            f"{where!r} does not hold weights of a generator: {named} has the shape "
            f"{found.get(named, 'none')}, expected {expected.get(named, '(filters, 3, 7, 7)')}",
            next="give a file that `tactile-sim train` wrote, or one of `tactile-mnist`",
        )
    for name, array in arrays.items():
        if array.dtype != np.float32 or not np.isfinite(array).all():
            raise IntegrityError(
                f"{where!r}: {name} holds values that are not finite numbers in single precision"
            )


def _noted_size(comment: bytes, where: str) -> tuple[int, int]:
    if not comment:
        return PUBLISHED_SIZE_PX
    try:
        width, height = json.loads(comment)["size_px"]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise IntegrityError(
            f"{where!r} does not state the size of its pictures as `tactile-sim train` does"
        ) from error
    for side in (width, height):
        if not isinstance(side, int) or isinstance(side, bool) or side not in _SIDES_PX or side % 4:
            raise IntegrityError(
                f"{where!r} is of {width!r} x {height!r} pixels; expected multiples of 4, 16 to 2048"
            )
    return width, height


def weights_bytes(weights: GeneratorWeights) -> bytes:
    """Return the content of a file of weights; equal weights give equal bytes."""
    buffer = io.BytesIO()
    # Stored, not deflated: floats of a network do not compress, and zlib differs between machines.
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in layer_shapes(weights.filters, weights.blocks):
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))  # no time of day in it
            with archive.open(entry, "w") as stream:
                npy.write_array(stream, np.ascontiguousarray(weights.arrays[name]), allow_pickle=False)
        if weights.size_px != PUBLISHED_SIZE_PX:
            archive.comment = json.dumps({"size_px": list(weights.size_px)}).encode()
    return buffer.getvalue()


def write_weights(folder: DataFolder, name: str, weights: GeneratorWeights) -> None:
    """Write a file of weights, whole or not at all; StorageError where it cannot be written."""
    folder.write_bytes(name, weights_bytes(weights))
