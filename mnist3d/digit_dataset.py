"""Loading MNIST 3D: typed, lazy, without copies."""

from __future__ import annotations

import numpy as np

from mnist3d.kind import KIND
from mnist3d.sources.digit_source import NO_WRITER
from tactile_toolkit import mesh, pictures, places
from tactile_toolkit.array_types import Int64


class DigitRecord(mesh.SolidRecord):
    """One 3D digit: ``id``, ``label``, ``vertices_m``, ``faces``, ``mesh``, ``writer`` and ``source``.

    Frame of the mesh: origin at the image centre, x right and y up as the digit is read, z out of the plate,
    lowest point at z = 0; metres.
    """

    __slots__ = ()

    @property
    def writer(self) -> int:
        """Number of the writer in the source, -1 if it is unknown."""
        return self.row.integer("writer") if self.row.has("writer") else NO_WRITER

    @property
    def source(self) -> str:
        """Name of the source of the digit; empty if it is unknown."""
        return str(self.row.required("source")) if self.row.has("source") else ""

    @property
    def file(self) -> str | None:
        """Name of the picture in its folder; None unless the source was a folder of pictures."""
        return str(self.row.required("file")) if self.row.has("file") else None

    def __repr__(self) -> str:
        return (
            f"DigitRecord(id={self.id}, label={self.label}, writer={self.writer}, {len(self.faces):,} faces)"
        )

    def _repr_html_(self) -> str:
        """Show the digit from above in a notebook."""
        size_mm = np.ptp(self.vertices_m, axis=0) * mesh.MM_PER_M
        caption = (
            f"digit {self.label}, id {self.id}, writer {self.writer}: "
            f"{size_mm[0]:.1f} x {size_mm[1]:.1f} x {size_mm[2]:.1f} mm, "
            f"{self.volume_m3 * mesh.MM_PER_M**3:.0f} mm³, {len(self.faces):,} triangles"
        )
        return pictures.figure_html(pictures.relief(self.vertices_m, self.faces), caption)

    def tile_html(self) -> str:
        """Return HTML of a small picture with a caption, for notebooks."""
        return pictures.relief_tile_html(self.vertices_m, self.faces, f"{self.label}, id {self.id}")


class DigitDataset(mesh.SolidDataset[DigitRecord]):
    """A lazy sequence of :class:`DigitRecord`; see :class:`tactile_toolkit.read.RecordDataset`."""

    record_class = DigitRecord
    things = "digits"

    @property
    def writers(self) -> Int64:
        """Writer of each row, shape (len,), int64, -1 if unknown; loads no mesh."""
        return self._integers(
            "writer", lambda: np.full(len(self), NO_WRITER, np.int64), lambda digit: digit.writer
        )


class DigitStream(mesh.RecordStream[DigitRecord]):
    """Digits one after another, read on demand.

    See :class:`~tactile_toolkit.mesh.RecordStream`.
    """


load = places.loader(KIND, DigitDataset, DigitStream)
