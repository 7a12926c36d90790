"""Loading MNIST 3D: typed, lazy, without copies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mnist3d.kind import KIND
from mnist3d.sources.digit_source import NO_WRITER
from tactile_toolkit import mesh, pictures, places
from tactile_toolkit.array_types import Int64
from tactile_toolkit.wording import class_name


class DigitRecord(pictures.DrawnSolid):
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

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the name of the digit."""
        return f"digit {class_name(label_names, self.label)}"

    @property
    def notes(self) -> list[tuple[str, str]]:
        """Size and source."""
        return [*super().notes, ("Source", self.source)] if self.source else super().notes

    @property
    def details(self) -> str:
        """Text below a large picture."""
        return f"{super().details}, writer {self.writer}"


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
