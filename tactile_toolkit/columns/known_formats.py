"""Formats of files that people have, recognised by their first bytes: their names, and what to do with them.

Readers ask here about a file that they do not read, so that no intact file is called damaged or unknown.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from tactile_toolkit.store.files import open_regular

_START_BYTES = 1 << 10

_Test = Callable[[bytes], object]
_PICTURES = "write its pictures as PNG files, and their labels or values as a CSV table"
_BAG = "`realtouch import` reads the pictures of its topics"
_DIGITS = f"digits of 28 x 28 pixels are read by `mnist3d generate --source table`; else {_PICTURES}"
_SHEET = "save each sheet as CSV in UTF-8"
_DRAWING = "draw it as a picture, black on white, and save that as PNG"
_UNPACK = "unpack it, and give the files in it"
_PROGRAM = "which is not read because reading one can run any program"


def _bytes(*signatures: bytes) -> _Test:
    return lambda start: start.startswith(signatures)


def _pattern(pattern: bytes) -> _Test:
    return re.compile(pattern, re.DOTALL).match


def _text(pattern: bytes) -> _Test:
    """Return a test for text that begins with a pattern, after a byte order mark and spaces."""
    return re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:" + pattern + rb")", re.DOTALL | re.IGNORECASE).match


def _zip(member: bytes) -> _Test:
    """Return a test for a ZIP archive whose first member has a name that begins with a pattern."""
    return _pattern(rb"PK\x03\x04.{26}(?:" + member + rb")")


@dataclass(frozen=True, slots=True)
class KnownFormat:
    """A format of files.

    Attributes
    ----------
    key : str
        Short name, such as ``"bag"``, by which a reader finds a step of its own.
    name : str
        Name for messages, with an article.
    step : str
        What to do with such a file.
    fits : callable
        Takes the first bytes of a file, and returns whether it has the format.
    endings : tuple of str
        Endings of file names in lower case, only of formats that no import of recordings reads.
    """

    key: str
    name: str
    step: str
    fits: _Test
    endings: tuple[str, ...] = ()

    @staticmethod
    def of(file: bytes | IO[bytes]) -> KnownFormat | None:
        """Return the format of a file by its beginning, or that of a stream; None if it is unknown.

        The first kilobyte is enough. A stream is left at its start.
        """
        if isinstance(file, bytes):
            start = file
        else:
            file.seek(0)
            start = file.read(_START_BYTES)
            file.seek(0)
        return next((known for known in KNOWN_FORMATS if known.fits(start)), None)

    @classmethod
    def of_file(cls, path: Path) -> KnownFormat | None:
        """Return the format of a local file; None if it is unknown or cannot be read."""
        try:
            with open_regular(path) as stream:
                return cls.of(stream)
        except OSError:
            return None

    @staticmethod
    def by_ending(path: str) -> KnownFormat | None:
        """Return the format of a file by the ending of its name; None if it is unknown or may be read."""
        return next((known for known in KNOWN_FORMATS if path.lower().endswith(known.endings)), None)


# The first format that fits decides.
KNOWN_FORMATS = (
    KnownFormat("empty", "an empty file", "copy or download it again", _pattern(rb"\Z")),
    KnownFormat(
        "lfs", "a pointer of Git LFS", "fetch the file by `git lfs pull`", _text(rb"version https://git-lfs")
    ),
    KnownFormat("html", "a web page", "download the file itself", _text(rb"<!doctype html|<html")),
    KnownFormat("bag", "a ROS bag", _BAG, _bytes(b"#ROSBAG", b"\x89MCAP")),
    KnownFormat("bag", "a ROS bag or another SQLite database", _BAG, _bytes(b"SQLite format 3\0")),
    KnownFormat(
        "matlab",
        "a file of MATLAB",
        f"read it by scipy.io.loadmat, or by h5py if it is of version 7.3, and {_PICTURES}",
        _bytes(b"MATLAB 5.0 MAT", b"MATLAB 7.3 MAT"),
        (".mat",),
    ),
    KnownFormat("hdf5", "an HDF5 file", f"read it by h5py, and {_PICTURES}", _bytes(b"\x89HDF\r\n\x1a\n")),
    KnownFormat("numpy", "a file of NumPy", _DIGITS, _bytes(b"\x93NUMPY"), (".npy", ".npz")),
    KnownFormat("numpy", "a file of NumPy arrays (NPZ)", _DIGITS, _zip(rb"[^\0]*?\.npy")),
    KnownFormat(
        "pickle",
        f"a pickle, {_PROGRAM}",
        f"with a program that you trust, {_PICTURES}",
        _bytes(*(b"\x80%c" % version for version in range(2, 6))),
        (".pkl", ".pickle", ".pt", ".pth"),
    ),
    KnownFormat(
        "pickle",
        f"a file of PyTorch, {_PROGRAM}",
        f"with a program that you trust, {_PICTURES}",
        _zip(rb"[^\0/]+/(?:data\.pkl|byteorder|version)"),
    ),
    KnownFormat(
        "excel",
        "a workbook of Excel",
        _SHEET,
        _zip(rb"\[Content_Types\]|_rels/|docProps/|xl/"),
        (".xlsx", ".xls", ".ods"),
    ),
    KnownFormat("excel", "a workbook of LibreOffice", _SHEET, _zip(rb"mimetypeapplication/vnd\.oasis")),
    KnownFormat("excel", "an old workbook of Excel", _SHEET, _bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")),
    KnownFormat("parquet", "a Parquet file", f"read it by pandas, and {_PICTURES}", _bytes(b"PAR1")),
    KnownFormat("arrow", "an Arrow file", "write it as Parquet, by pyarrow", _bytes(b"ARROW1")),
    KnownFormat("tar", "a tar archive", _UNPACK, _pattern(rb".{257}ustar")),
    KnownFormat("zip", "a ZIP archive", _UNPACK, _bytes(b"PK\3\4")),
    KnownFormat("gzip", "a file compressed by gzip", _UNPACK, _bytes(b"\x1f\x8b")),
    KnownFormat(
        "archive",
        "an archive or a compressed file",
        _UNPACK,
        _bytes(b"BZh", b"7z\xbc\xaf", b"Rar!", b"\xfd7zXZ\0"),
    ),
    KnownFormat(
        "zstd",
        "a file compressed by Zstandard",
        "unpack it by `zstd -d FILE`, and give the file in it",
        _bytes(b"\x28\xb5\x2f\xfd"),
        (".zst", ".zstd"),
    ),
    KnownFormat(
        "svg", "an SVG file, a vector drawing", _DRAWING, _text(rb"(?:(?:<[?!][^>]*|\])>\s*)*<svg\b")
    ),
    KnownFormat("pdf", "a PDF or PostScript file", _DRAWING, _bytes(b"%PDF", b"%!PS")),
    KnownFormat("strokes", "a file of strokes in JSON", _DRAWING, _text(rb'\{.*"drawing"\s*:')),
    KnownFormat("json", "text in JSON", _PICTURES, _text(rb"[\[{]")),
    KnownFormat("pixels", "a table of pixels", _DIGITS, _text(rb'"?label"?[,;\t|]"?(?:pixel|1x1|0)')),
    KnownFormat(
        "video",
        "a video",
        "write its frames as PNG files",
        _pattern(rb"(?:.{4}ftyp(?!hei|hev|mif|msf|avi)|RIFF.{4}AVI|\x1a\x45\xdf\xa3)"),
    ),
)
"""Known formats, in the order in which they are tested."""
