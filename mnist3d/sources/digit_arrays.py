"""Digits in files of arrays: HWD+ as published by its authors, and MNIST."""

from __future__ import annotations

import gzip
import hashlib
import struct
import sys
import warnings
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import lru_cache
from http.client import HTTPException
from itertools import product
from math import prod
from pathlib import Path
from typing import ClassVar

import numpy as np

from mnist3d.ink.grey_levels import as_grey, fit
from mnist3d.sources.digit_source import NO_WRITER, DigitCatalog, DigitImage, require_known
from tactile_toolkit import cache, store
from tactile_toolkit.columns import known_formats
from tactile_toolkit.errors import InputError, RemoteError, needs_extra
from tactile_toolkit.value_types import AnyArray, Int64, UInt8
from tactile_toolkit.wording import with_count

SIDE_PX = 28
"""Side of the images of MNIST."""

_SCALE_SAMPLE = 16
_FINGERPRINT_SAMPLE = 64

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
class HwdPlusSource:
    """The two ``.npy`` files of HWD+ (Beaulac and Rosenthal 2022), or other files of the same layout.

    The image array is mapped for one image at a time, so memory does not grow with the file. Integers of any
    width are grey levels from 0 to 255. Floats run from 0 to 1 if the brightest pixels of 16 evenly spaced
    images have a median of at most 1, otherwise from 0 to 255. The scale is decided once per file. Images of
    another size are fitted into 500 x 500 px.

    Parameters
    ----------
    images : str
        ``Images(500x500).npy``: shape (N, 500, 500), dark ink on light paper, any integer or float dtype.
    writer_info : str
        ``WriterInfo.npy``: one row per image, column 0 is the digit; numbers or strings of digits.
    writer_column : int, optional
        Column of `writer_info` that numbers the writer; by default the writer is unknown.

    Notes
    -----
    The id of an image is its row. An array in Fortran order is slow to read, as the pixels of an image are
    spread over the file.
    """

    name: ClassVar[str] = "hwdplus"
    """Word that selects this source on the command line."""

    images: str
    writer_info: str
    writer_column: int | None = None

    def catalog(self) -> DigitCatalog:
        """Check both files and return ids, labels and writers.

        Raises InputError when a file is missing, damaged or of another shape or type, when the numbers of
        rows differ, or when a label is not an integer from 0 to 9.
        """
        count, (labels, writers) = len(self._stack()), self._annotations()
        if len(labels) != count:
            raise InputError(
                f"{self.writer_info}: found {len(labels)} rows, expected {count}, one for each image of "
                f"{self.images}",
                next="take both files from the same download",
            )
        return DigitCatalog(np.arange(count), labels, writers)

    def image(self, digit_id: int) -> DigitImage:
        """Read the image of row `digit_id` only.

        Raises ItemError ``"unknown-id"``, ``"not-finite"`` (NaN or infinite pixels) or ``"bad-pixels"``
        (values outside the grey scale of the file).
        """
        stack, (labels, writers) = self._stack(), self._annotations()
        row_name = f"{self.images}, row {digit_id}"
        require_known(digit_id, min(len(stack), len(labels)), self.images)
        full_scale = _full_scale(self.images, _stamp(self.images))
        pixels = fit(as_grey(np.array(stack[digit_id]), full_scale, row_name))
        return DigitImage(digit_id, int(labels[digit_id]), pixels, int(writers[digit_id]))

    def fingerprint(self) -> dict[str, object]:
        """Return dtype and shape, and SHA-256 of labels, writers and 64 evenly spaced images.

        Only a sample is hashed, because hashing gigabytes would take longer than making the first shard.
        Raises InputError as :meth:`catalog` does.
        """
        stack, (labels, writers) = self._stack(), self._annotations()
        sample = hashlib.sha256()
        for row in _evenly_spaced(len(stack), _FINGERPRINT_SAMPLE):
            sample.update(self._stack()[row].tobytes())
        return {
            "name": self.name,
            "dtype": stack.dtype.str,
            "shape": list(stack.shape),
            "labels_sha256": hashlib.sha256(labels.tobytes()).hexdigest(),
            "writers_sha256": hashlib.sha256(writers.tobytes()).hexdigest(),
            "images_sample_sha256": sample.hexdigest(),
        }

    def _stack(self) -> AnyArray:
        # Mapped again for each image: pages of a lasting mapping count as memory of the process.
        stack = open_npy(self.images)
        shape = stack.shape
        squarish = len(shape) == 3 and min(shape) > 0 and max(shape[1:]) <= 1.5 * min(shape[1:])
        if squarish and stack.dtype.kind in "biuf":
            return stack
        raise InputError(
            f"{self.images}: found shape {shape} of {stack.dtype}, expected (N, 500, 500) of integers or "
            "floats",
            next="give the file 'Images(500x500).npy' of HWD+",
        )

    def _annotations(self) -> tuple[Int64, Int64]:
        return _labels_and_writers(self.writer_info, _stamp(self.writer_info), self.writer_column)


@lru_cache(maxsize=4)
def _full_scale(path: str, stamp: tuple[int, int]) -> float:
    stack = open_npy(path)
    return scale_of(stack[row] for row in _evenly_spaced(len(stack), _SCALE_SAMPLE))


def scale_of(images: Iterable[AnyArray]) -> float:
    """Return the level of white of images of one type: 1 or 255.

    It is 1 for bool, and for floats if the brightest pixels of the images have a median of at most 1.
    """
    sample = [np.asarray(image) for image in images]
    if sample[0].dtype.kind == "b":
        return 1.0
    if sample[0].dtype.kind in "iu":
        return 255.0
    # The median, as a single image may be damaged or hold no paper.
    brightest = [float(np.max(image, where=np.isfinite(image), initial=-np.inf)) for image in sample]
    finite = [level for level in brightest if level > -np.inf]
    # Half a grey level of slack: rounding may have left white a little above 1.
    if finite and float(np.median(finite)) <= 1 + 0.5 / 255:
        return 1.0
    return 255.0


def _evenly_spaced(count: int, number: int) -> list[int]:
    return [int(row) for row in np.rint(np.linspace(0, count - 1, min(count, number)))]


@lru_cache(maxsize=4)
def _labels_and_writers(path: str, stamp: tuple[int, int], writer_column: int | None) -> tuple[Int64, Int64]:
    cells = open_npy(path)
    if cells.ndim not in (1, 2) or min(cells.shape) <= 0 or cells.dtype.kind not in "biufUS":
        raise InputError(
            f"{path}: found shape {cells.shape} of {cells.dtype}, expected one row per image with the "
            "digit in column 0, as numbers or strings of digits",
            next="give the file 'WriterInfo.npy' of HWD+",
        )
    table = np.array(cells).reshape(len(cells), -1)
    labels = int_column(table, 0, path, 9)
    writers = np.full(len(table), NO_WRITER, np.int64)
    if writer_column is not None:
        if not 1 <= writer_column < table.shape[1]:
            raise InputError(
                f"{path}: there is no writer column {writer_column}; the file has "
                f"{with_count(table.shape[1], 'columns')}; expected one after column 0, which is the digit",
                next="change --writer-column, or leave it out",
            )
        writers = int_column(table, writer_column, path)
    for shared in (labels, writers):
        shared.flags.writeable = False
    return labels, writers


def int_column(table: AnyArray, column: int, path: str, most: float = np.inf) -> Int64:
    """Return a column of numbers, or of strings of digits, as integers.

    ``most`` is 9 for a column of digits, which are not negative.
    """
    expected = "a digit from 0 to 9" if most == 9 else "an integer"
    next_step = "check that this file belongs to the images and is not damaged"
    try:
        numbers = table[:, column].astype(np.float64)
    except ValueError as error:
        content = f"column {column} holds text that is not a number"
        raise InputError(f"{path}: {content}, expected {expected}", next=next_step) from error
    # From 2**53 on, floats cannot represent all integers.
    fits = (np.rint(numbers) == numbers) & (np.abs(numbers) < 2.0**53)
    fits &= (most > 9) | ((numbers >= 0) & (numbers <= most))
    if not fits.all():
        content = table[int(np.argmin(fits)), column].item()
        raise InputError(
            f"{path}: row {np.argmin(fits)}, column {column}: found {content!r}, expected {expected}",
            next=next_step,
        )
    return numbers.astype(np.int64)


def open_npy(path: str) -> AnyArray:
    """Map a ``.npy`` file without reading its numbers.

    Raises InputError when the file is missing, is not a ``.npy`` file, is shorter than its header states, or
    holds pickled Python objects (which are never loaded, as they can run code).
    """
    try:
        with warnings.catch_warnings():
            # Files of Python 2, or with old names of types, can be read: no warning is needed.
            warnings.simplefilter("ignore")
            return np.lib.format.open_memmap(path, mode="r")
    except Exception as error:  # a damaged header, which numpy parses as Python, raises many types
        raise InputError(
            f"{path}: cannot be read ({error}), expected an intact .npy file of numbers or strings, as "
            "numpy.save writes them",
            next="check the path, or download or copy it again",
        ) from error


def _stamp(path: str) -> tuple[int, int]:
    """Return size and modification time, by which caches recognise a replaced file; 0 if it is missing."""
    try:
        status = Path(path).stat()
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns


@dataclass(frozen=True, slots=True)
class SmallImages(ABC):
    """A source of images of 28 x 28 pixels, light on black, in parts of images and labels.

    They are inverted to dark ink on white paper and enlarged to 500 x 500 px with smooth outlines. Ids count
    from 0 through the parts.
    """

    name: ClassVar[str]

    root: str

    def catalog(self) -> DigitCatalog:
        """Read and check the files and return ids and labels.

        Raises InputError when files are missing, damaged, or do not belong together.
        """
        labels = np.concatenate([labels for _, labels in self._parts()]).astype(np.int64)
        return DigitCatalog(np.arange(len(labels)), labels, np.full_like(labels, NO_WRITER))

    def image(self, digit_id: int) -> DigitImage:
        """Draw one digit, 500 x 500 px.

        Raises ItemError ``"unknown-id"`` when no digit has the id.
        """
        parts = self._parts()
        index = digit_id
        require_known(digit_id, sum(len(images) for images, _ in parts), self.root)
        while index >= len(parts[0][0]):
            index -= len(parts.pop(0)[0])
        images, labels = parts[0]
        pixels = fit(255 - images[index])
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

    @abstractmethod
    def _parts(self) -> list[Part]:
        """Return images and labels; InputError if they cannot be read."""


@dataclass(frozen=True, slots=True)
class MnistSource(SmallImages):
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

    def _parts(self) -> list[Part]:
        parts = []
        # One file of a pair selects the part, so that an error names the missing one.
        known = list(_PREFIXES.values())
        there = [prefix for prefix in known if any(_find(self.root, prefix, kind) for kind in _KINDS)]
        for prefix in there or known:
            images, labels = (self._file(prefix, kind) for kind in _KINDS)
            parts.append(_read_pair(images, labels, images.stat().st_mtime_ns, labels.stat().st_mtime_ns))
        return parts

    def _file(self, prefix: str, kind: str) -> Path:
        path = _find(self.root, prefix, kind)
        folder = Path(self.root)
        if path is not None:
            return path
        content = "no folder"
        if folder.is_dir():
            content = str(
                sorted(inner.name for inner in folder.iterdir() if not store.is_hidden(inner.name))[:8]
            )
        raise InputError(
            f"{self.root}: found {content}, expected {prefix}-{kind}-{_KINDS[kind]} or the same with .gz, "
            "there or in MNIST/raw",
            next="check the folder, fetch the files with --download, or give CSV, NPY or NPZ to "
            "--source table",
        )


def download_mnist(root: str) -> None:
    """Download the four files of MNIST into ``root/MNIST/raw`` with torchvision, unless they are in `root`.

    Raises MissingExtraError without torchvision, and RemoteError when the servers cannot be reached or send
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
        raise RemoteError(
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
    if images.shape[1:] != (SIDE_PX, SIDE_PX):
        raise _unusable(images_path, f"images of {images.shape[1:]} pixels", (SIDE_PX, SIDE_PX))
    if not len(images) == len(labels) > 0:
        counted = with_count(len(labels), "labels"), with_count(len(images), "images")
        content = f"{' for '.join(counted)} of {images_path.name}"
        raise _unusable(labels_path, content, "one for each and at least one")
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
            first_number, *shape = struct.unpack(f">{start // 4}I", header)
            if first_number != magic:
                raise _unusable(path, f"magic number {first_number}", magic)
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


def _unusable(path: Path, content: str, expected: object) -> InputError:
    known = known_formats.KnownFormat.of_file(path)
    if known is not None and known.key != "gzip":  # IDX files are read compressed, too
        return InputError(f"{path}: found {known.name}, expected {expected}", next=known.step)
    return InputError(
        f"{path}: found {content}, expected {expected}",
        next="replace it by an intact copy, or check the folder",
    )
