"""MNIST from its IDX files, enlarged for printing."""

from __future__ import annotations

import gzip
import hashlib
import struct
import sys
import zlib
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import lru_cache
from http.client import HTTPException
from itertools import product
from math import prod
from pathlib import Path
from typing import ClassVar

import numpy as np

import mnist3d.ink
from mnist3d.sources.digit_source import NO_WRITER, DigitCatalog, DigitImage, require_known
from tactile_toolkit import cache, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import HubError, InputError, needs_extra
from tactile_toolkit.wording import with_count

IMAGES_MAGIC = 0x803
"""Magic number of a file of images: unsigned bytes (8) in three dimensions (3)."""

LABELS_MAGIC = 0x801
"""Magic number of a file of labels: unsigned bytes (8) in one dimension (1)."""

_GZIP = b"\x1f\x8b"
"""First bytes of a gzipped file."""

_PREFIXES = {"train": "train", "test": "t10k"}
_KINDS = {"images": "idx3-ubyte", "labels": "idx1-ubyte"}

Part = tuple[UInt8, UInt8]
"""Images of shape (N, 28, 28), white on black, and labels of shape (N,)."""


@dataclass(frozen=True, slots=True)
class MnistSource:
    """The IDX files of MNIST, plain or gzipped, as LeCun names them.

    The files may be in the folder itself, in ``MNIST/raw`` (where torchvision puts them) or in ``raw``, with
    a dot or a hyphen before ``idx``. The 28 x 28 images are inverted to dark ink on white paper and enlarged
    to 500 x 500 px with smooth outlines. The median width of ink is 44 px, digits are about 355 px tall.

    Parameters
    ----------
    root : str
        The folder.

    Notes
    -----
    Ids count from 0 in the order of the files: 0 to 59,999 are the training digits, 60,000 to 69,999 the
    test digits. If there is one part only, its ids begin at 0. Writers are unknown. Each process holds the
    small images: 47 MB for training, 8 MB for test.
    """

    name: ClassVar[str] = "mnist"
    """Word that selects this source on the command line."""

    root: str

    def catalog(self) -> DigitCatalog:
        """Read and check the files and return ids and labels.

        Raises InputError when files are missing, damaged, not MNIST, or do not belong together.
        """
        labels = np.concatenate([labels for _, labels in self._parts()]).astype(np.int64)
        return DigitCatalog(np.arange(len(labels)), labels, np.full_like(labels, NO_WRITER))

    def image(self, digit_id: int) -> DigitImage:
        """Draw one digit, 500 x 500 px.

        Raises ItemError ``"unknown-id"`` when no digit has the id.
        """
        parts, index = self._parts(), digit_id
        require_known(digit_id, sum(len(images) for images, _ in parts), self.root)
        while index >= len(parts[0][0]):
            index -= len(parts.pop(0)[0])
        images, labels = parts[0]
        pixels = mnist3d.ink.fit(255 - images[index])
        return DigitImage(digit_id, int(labels[index]), pixels)

    def fingerprint(self) -> dict[str, object]:
        """Return count and SHA-256 of the unpacked images and labels of each part.

        Raises InputError as :meth:`catalog` does.
        """
        parts = [
            {
                "images": len(images),
                "images_sha256": hashlib.sha256(images.tobytes()).hexdigest(),
                "labels_sha256": hashlib.sha256(labels.tobytes()).hexdigest(),
            }
            for images, labels in self._parts()
        ]
        return {"name": self.name, "parts": parts}

    def _parts(self) -> list[Part]:
        parts = []
        # One file of a pair selects the part, so that an error names the missing one.
        known = list(_PREFIXES.values())
        there = [each for each in known if any(_find(self.root, each, kind) for kind in _KINDS)]
        for prefix in there or known:
            images, labels = (self._file(prefix, kind) for kind in _KINDS)
            parts.append(_read_pair(images, labels, images.stat().st_mtime_ns, labels.stat().st_mtime_ns))
        return parts

    def _file(self, prefix: str, kind: str) -> Path:
        path, folder = _find(self.root, prefix, kind), Path(self.root)
        if path is not None:
            return path
        found = "no folder"
        if folder.is_dir():
            found = str(sorted(each.name for each in folder.iterdir() if not store.is_hidden(each.name))[:8])
        raise InputError(
            f"{self.root}: found {found}, expected {prefix}-{kind}-{_KINDS[kind]} or the same with .gz, "
            "there or in MNIST/raw",
            next="check the folder, or fetch the files with --download",
        )


def download_mnist(root: str) -> None:
    """Download the four files of MNIST into ``root/MNIST/raw`` with torchvision, unless they are in `root`.

    Raises MissingExtraError without torchvision, and HubError when the servers cannot be reached or send
    damaged files, or the folder cannot be written.
    """
    if all(_find(root, prefix, kind) for prefix, kind in product(_PREFIXES.values(), _KINDS)):
        return
    with needs_extra("Downloading MNIST", "torchvision", "torch"):
        from torchvision.datasets import MNIST  # an extra, which takes seconds to import
    try:
        # torchvision writes to stdout, which belongs to the results of a command.
        with redirect_stdout(sys.stderr):
            MNIST(root, download=True)
    except (RuntimeError, HTTPException, EOFError, OSError) as error:
        raise HubError(
            f"MNIST could not be downloaded to {root} ({' '.join(str(error).split())}), expected its four "
            f"files from {list(MNIST.mirrors)}, and a folder with 70 MB of room",
            next="check network and folder and try again, or copy the files into the folder",
        ) from error


def _find(root: str, prefix: str, kind: str) -> Path | None:
    names = [f"{prefix}-{kind}{mark}{_KINDS[kind]}{end}" for mark, end in product("-.", ("", ".gz"))]
    # Some archives unpack each file into a folder of the same name.
    paths = [Path(root, folder, name) for name in names for folder in (".", "MNIST/raw", "raw", name)]
    return next((path for path in paths if path.is_file()), None)


@lru_cache(maxsize=4)
def _read_pair(images_path: Path, labels_path: Path, _images_ns: int, _labels_ns: int) -> Part:
    images, labels = read_idx(images_path, IMAGES_MAGIC), read_idx(labels_path, LABELS_MAGIC)
    if images.shape[1:] != (28, 28):
        raise _unusable(images_path, f"images of {images.shape[1:]} pixels", "(28, 28)")
    if not len(images) == len(labels) > 0:
        counted = with_count(len(labels), "labels"), with_count(len(images), "images")
        found = f"{' for '.join(counted)} of {images_path.name}"
        raise _unusable(labels_path, found, "one for each and at least one")
    if labels.max() > 9:
        row = int(labels.argmax())
        raise _unusable(labels_path, f"label {labels[row]} in row {row}", "digits from 0 to 9")
    return images, labels


def read_idx(path: Path, magic: int) -> UInt8:
    """Return the read-only array of an IDX file of unsigned bytes, which may be gzipped.

    The first number of the file must be ``magic``, whose last byte is the number of dimensions. Raises
    InputError when the file cannot be read, is damaged, cut off or too long, or is of another kind. The size
    in the header is bounded (:mod:`tactile_toolkit.cache`), and nothing beyond it is unpacked.
    """
    start = 4 + 4 * (magic & 0xFF)
    try:
        with store.open_regular(path) as file:
            is_packed = file.read(len(_GZIP)) == _GZIP
            file.seek(0)
            stream = gzip.GzipFile(fileobj=file) if is_packed else file
            header = stream.read(start)
            if len(header) < start:
                raise EOFError
            found, *shape = struct.unpack(f">{start // 4}I", header)
            if found != magic:
                raise _unusable(path, f"magic number {found}", magic)
            cache.require_unpackable(prod(shape), str(path))
            data = stream.read(prod(shape) + 1)
    except (EOFError, OSError, zlib.error) as error:
        problem = getattr(error, "strerror", None) or "damaged or cut off"
        raise _unusable(path, f"a file that cannot be read ({problem})", "an intact IDX file") from error
    if len(data) != prod(shape):
        raise _unusable(
            path, f"{len(data)} bytes or more of numbers", f"{prod(shape)} for an array of shape {shape}"
        )
    return np.frombuffer(data, np.uint8).reshape(shape)


def _unusable(path: Path, found: str, expected: object) -> InputError:
    return InputError(
        f"{path}: found {found}, expected {expected}",
        next="replace it by an intact copy, or check the folder",
    )
