"""Small files in the formats of MNIST."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PREFIXES = {"train": "train", "test": "t10k"}


def bars(count: int, seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """White bars on black, of different heights, and labels in a random order."""
    images = np.zeros((count, 28, 28), np.uint8)
    for row in range(count):
        images[row, 4 : 10 + row, 12:16] = 255
    return images, np.random.default_rng(seed).integers(0, 10, count).astype(np.uint8)


def idx(array: NDArray[np.uint8]) -> bytes:
    return struct.pack(f">{1 + array.ndim}I", 0x800 + array.ndim, *array.shape) + array.tobytes()


def name_of(part: str, kind: str, mark: str = "-", end: str = "") -> str:
    return f"{PREFIXES[part]}-{kind}{mark}idx{3 if kind == 'images' else 1}-ubyte{end}"


def write(
    folder: Path,
    part: str = "test",
    images: NDArray[np.uint8] | None = None,
    labels: NDArray[np.uint8] | None = None,
    mark: str = "-",
    end: str = "",
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    made = bars(4, len(part))
    contents = {
        "images": made[0] if images is None else images,
        "labels": made[1] if labels is None else labels,
    }
    for kind, array in contents.items():
        data = gzip.compress(idx(array)) if end else idx(array)
        (folder / name_of(part, kind, mark, end)).write_bytes(data)
