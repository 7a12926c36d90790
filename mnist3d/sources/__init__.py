"""Where digit images come from: one file each, one Protocol."""

from __future__ import annotations

from typing import Protocol

from mnist3d.digit import DigitCatalog, DigitImage

__all__ = ["DigitSource"]


class DigitSource(Protocol):
    """A collection of labelled digit images.

    Sources are small frozen dataclasses: they pickle in a few hundred bytes (paths, seeds, options), open
    their files on first use in whatever process they land in, and never hold all images in memory.
    """

    @property
    def name(self) -> str:
        """Word that selects this source on the command line (``--source``)."""
        ...

    def fingerprint(self) -> dict[str, object]:
        """Return what identifies the content, as JSON values; equal content gives an equal value.

        It holds no machine path: the same files in another folder are the same source.
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
            When this one image cannot be used (unreadable, wrong shape, NaN pixels); a run lists it and
            goes on.
        """
        ...
