"""Digit images and where they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tactile_toolkit.array_types import Int64, UInt8
from tactile_toolkit.errors import ItemError

NO_WRITER = -1
"""Writer number of digits whose writer is unknown."""

DIGITS = tuple("0123456789")
"""Names of the classes of digits."""


@dataclass(frozen=True, slots=True, eq=False)
class DigitImage:
    """One handwritten digit.

    Attributes
    ----------
    id : int
        Number of the digit in its source (in HWD+: the row of the image array).
    label : int
        The digit written, 0 to 9, or the number of another class.
    pixels : ndarray of uint8, shape (H, W)
        Grey levels, always dark ink (0) on light paper (255). Row 0 is the top of the digit as it is read.
    writer : int
        Number of the writer in the source, or :data:`NO_WRITER`.
    file : str or None
        Name of the picture, if the source is a folder of files.
    """

    id: int
    label: int
    pixels: UInt8
    writer: int = NO_WRITER
    file: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DigitCatalog:
    """The content of a source without its pixels: three arrays of one length.

    Attributes
    ----------
    ids : ndarray of int64, shape (N,)
        Distinct, in increasing order.
    labels : ndarray of int64, shape (N,)
        Class of each id, a place in ``class_names``: the digit, 0 to 9.
    writers : ndarray of int64, shape (N,)
        Writer of each id, or :data:`NO_WRITER`.
    class_names : tuple of str
        Names of the classes, the ten digits by default.
    has_files : bool
        Whether these are a user's own pictures: each has the name of its file, and no splits are published.
    """

    ids: Int64
    labels: Int64
    writers: Int64
    class_names: tuple[str, ...] = DIGITS
    has_files: bool = False

    def __len__(self) -> int:
        """Return the number of digits."""
        return len(self.ids)


class DigitSource(Protocol):
    """A collection of labelled digit images.

    Sources are small frozen dataclasses of paths, seeds and options. They open their files on first use in
    each process, and never hold all images in memory.
    """

    @property
    def name(self) -> str:
        """Word that selects this source on the command line (``--source``)."""
        ...

    def fingerprint(self) -> dict[str, object]:
        """Return JSON values that identify the content.

        They hold no path of the machine: the same files in another folder are the same source.
        """
        ...

    def catalog(self) -> DigitCatalog:
        """Return ids, labels and writers without reading pixels."""
        ...

    def image(self, digit_id: int) -> DigitImage:
        """Read or draw one digit.

        Raises
        ------
        ItemError
            This image cannot be used (unreadable, wrong shape, NaN pixels). A run lists it and continues.
        """
        ...


def require_known(digit_id: int, count: int, where: str) -> None:
    """Raise ItemError for an id that a source of ``count`` digits does not have."""
    if not 0 <= digit_id < count:
        found = f"{where}: found id {digit_id}, expected 0 to {count - 1}"
        raise ItemError("unknown-id", found, next="choose an id in this range")
