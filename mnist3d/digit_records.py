"""MNIST 3D as rows and as records: columns (published ones first), printability report, and loading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import cache

import numpy as np
import pyarrow as pa

from mnist3d.kind import KIND
from mnist3d.sources.digit_source import NO_WRITER
from mnist3d.sources.picture_folder import FolderSource
from tactile_toolkit import mesh, pictures, places, store
from tactile_toolkit.rows import column
from tactile_toolkit.value_types import Int64, JsonDict

PARQUET_STYLE = store.ParquetStyle(
    rows_per_group=32,
    compression="zstd",
    compression_level=3,
    encodings=mesh.MeshRow.encodings("BYTE_STREAM_SPLIT"),
    chunks_by_content=True,
)
"""32 meshes are about 6 MB unpacked: small enough to unpack for one row, large enough to compress well.

Level 3 of zstd takes 1.0 ms and 52.6 kB per mesh, level 9 takes 1.7 ms and 51.1 kB. Without the encodings,
level 3 takes 65.8 kB. Pages cut by content add 1.6 %; a set with other meshes in 1 % of its rows then shares
89 % of its bytes with the former set, instead of 81 %.
"""

REPORT_FILE = "reports/printability.parquet"
"""Printability report, one row per digit."""


class DigitRow(mesh.MeshRow):
    """One digit."""

    id: int = column(pa.int64(), "", "number of the digit in its source, unique over all splits")
    label: int = column(pa.int64(), "", "the digit", role="facet", title="Class")
    writer: int = column(
        pa.int64(), "", "number of the writer in the source, -1 where unknown", role="facet", title="Writer"
    )
    volume_m3: float = column(pa.float64(), "m³", "enclosed volume")
    source: str = column(pa.string(), "", "digit source")
    report: mesh.PrintReport = field()  # stored in the report, not in the shard
    file: str | None = column(
        pa.string(), "", "name of the picture in its folder, with the page of several", default=None
    )


SUMMED_UP = (DigitRow.columns()["label"], *mesh.PrintReport.with_role("facet", "measure"))
"""Columns of the report that are summarised for each split."""


def digit_schema(manifest: store.Manifest | None = None) -> pa.Schema:
    """Return the Arrow schema of the shards that a manifest lists; by default that of MNIST 3D."""
    source = _source_of(manifest)
    return stored_schema(classes_of(manifest), has_files=source.get("name") == FolderSource.name)


def classes_of(manifest: store.Manifest | None) -> tuple[str, ...]:
    """Return the names of the classes of a data set, which are the digits unless its source names others."""
    return tuple(_source_of(manifest).get("classes") or KIND.class_names)


def _source_of(manifest: store.Manifest | None) -> JsonDict:
    source = None if manifest is None else manifest.spec.get("source")
    return source if isinstance(source, dict) else {}


@cache
def stored_schema(class_names: tuple[str, ...], *, has_files: bool = False) -> pa.Schema:
    """Return the Arrow schema of a shard; only the rows of pictures in a folder name their files."""
    return DigitRow.schema(class_names, without=() if has_files else ("file",))


def report_table(shard: store.ShardName, rows: Sequence[DigitRow]) -> pa.Table:
    """Pack the reports about the digits of one shard into an Arrow table."""
    origins = pa.table(
        {
            "id": pa.array([row.id for row in rows], pa.int64()),
            "label": pa.array([row.label for row in rows], pa.int64()),
            "split": pa.array([shard.split] * len(rows), pa.string()),
            "shard": pa.array([str(shard)] * len(rows), pa.string()),
        }
    )
    # The columns of the report are those of `PrintReport`: a further measure needs no edit here.
    reports = mesh.PrintReport.table([row.report for row in rows])
    return pa.table([*origins.columns, *reports.columns], [*origins.column_names, *reports.column_names])


class DigitRecord(pictures.DrawnSolid):
    """One 3D digit: ``id``, ``label``, ``vertices_m``, ``faces``, ``mesh``, ``writer`` and ``source``.

    Frame of the mesh: origin at the image centre, x right and y up as the digit is read, z out of the plate,
    lowest point at z = 0; metres.
    """

    __slots__ = ()
    class_noun = "digit"

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
    extent_m = (0.1, 0.1, 0.01)

    @property
    def writers(self) -> Int64:
        """Writer of each row, shape (len,), int64, -1 if unknown; loads no mesh."""
        return self._integers(
            "writer", lambda: np.full(len(self), NO_WRITER, np.int64), lambda digit: digit.writer
        )


load = places.loader(KIND, DigitDataset, DigitRecord)
