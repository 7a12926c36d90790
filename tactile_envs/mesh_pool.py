"""Meshes packed into a few arrays, as kernels and tasks need them, and mapped from one file.

Only the triangles of a mesh that face upwards are kept, as numbers of corners, sorted into a grid of
:data:`CELL_M`: those under a window that is turned in any way are a few contiguous runs. The training split
of the digits takes 0.8 GB, which the processes of a machine share.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any

import numpy as np
import xxhash

from tactile_toolkit.array_types import AnyArray, Float32, Float64, Int32
from tactile_toolkit.cache import DiskCache
from tactile_toolkit.errors import BusyError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.read import RecordDataset
from tactile_toolkit.store import locked, resource_shortage

CELL_M = 0.0012
"""Side of a cell of the grid, metres; 0.6 to 4 mm are equally fast."""

MEASURES = ("label", "id", "foot_m", "volume_m3", "x_m", "y_m", "z_m")
"""Columns of :attr:`MeshPool.measures`: foot is the lowest height, x, y and z the centre of mass."""

_POOLS = DiskCache(
    "environments",
    8 << 30,
    warning="environments sort their meshes again each time: {problem}",
)
_FORMAT = 2
_CHECKSUM_BYTES = 16
_LOG = logging.getLogger(__name__)

Parts = list[AnyArray]


@dataclass(frozen=True, eq=False)
class MeshPool:
    """Some meshes, metres.

    Attributes
    ----------
    vertices : ndarray of float32, shape (V, 3)
        Corners of triangles that face upwards; the lowest point of each mesh is at height 0.
    faces : ndarray of uint16 or int32, shape (F, 3)
        Triangles, by corners within their mesh: first the large ones, then the others by cell.
    starts : ndarray of int32, shape (S,)
        For each mesh, at which of its small triangles each cell begins, row by row, and where the last ends.
    hulls : ndarray of float32, shape (H, 2)
        Corners of the convex hulls seen from above.
    grids : ndarray of float64, shape (n, 12)
        For each mesh: first vertex, first face, number of large faces, first of its starts; cells across and
        up; left and lower edge of the grid, side of a cell, and how far a small triangle reaches from the
        middle that is in a cell, metres; first corner of the hull and the one after its last.
    measures : ndarray of float64, shape (n, 7)
        For each mesh what :data:`MEASURES` names.
    """

    vertices: Float32
    faces: AnyArray
    starts: Int32
    hulls: Float32
    grids: Float64
    measures: Float64

    @classmethod
    def of(cls, records: Sequence[Any]) -> MeshPool:
        """Pack the meshes of records; those of a data set are kept on disk for the next time."""
        name = _name_of(records)
        if name is None:
            return cls.packed(records)
        path = _POOLS.path(name)
        with contextlib.ExitStack() as stack:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                # Processes that wait find it made.
                stack.enter_context(locked(path.with_suffix(".lock"), is_patient=True))
            except (OSError, BusyError) as error:  # not writable, or locked for too long
                _LOG.warning("meshes are sorted again each time: %s", error)
                return cls.packed(records)
            found = _found(path)
            if found is None:
                _LOG.info("sorting the triangles of %d meshes", len(records))
                parts = _parts_of(records)
                size = sum(part.nbytes for column in parts for part in column)
                is_kept = _POOLS.write(name, size, lambda stream: _write(stream, parts))
                found = (_found(path) if is_kept else None) or _concat(parts)
        _POOLS.mark_used(path)
        return cls(*found)

    @classmethod
    def packed(cls, records: Iterable[Any]) -> MeshPool:
        """Pack the meshes of records in memory."""
        return cls(*_concat(_parts_of(records)))

    def __len__(self) -> int:
        return len(self.grids)

    def measure(self, name: str) -> Float64:
        """Return one measure of each mesh, shape (n,)."""
        return np.ascontiguousarray(self.measures[:, MEASURES.index(name)])

    def hull(self, number: int) -> Float32:
        """Return the hull of a mesh seen from above, shape (h, 2)."""
        first, last = self.grids[number, 10:12]
        return self.hulls[int(first) : int(last)]

    @property
    def arrays(self) -> tuple[Float32, AnyArray, Int32, Float64]:
        """The arrays that :func:`tactile_envs.touch_kernels.touch` takes."""
        return self.vertices, self.faces, self.starts, self.grids


def _name_of(records: Sequence[Any]) -> str | None:
    """Return a name for the content of a data set on disk; None for records that are in memory."""
    if not isinstance(records, RecordDataset):
        return None
    content = [records.identity]  # of the rows as they were when they were loaded
    digest = hashlib.sha256(repr((_FORMAT, CELL_M, content)).encode() + records.row_numbers.tobytes())
    return f"meshes-{digest.hexdigest()[:32]}"


def _parts_of(records: Iterable[Any]) -> list[Parts]:
    """Return the arrays of all meshes, one list for each field of a pool."""
    columns: list[Parts] = [[], [], [], [], [], []]
    ends = np.zeros(4)
    for record in records:
        vertices_m, faces = np.asarray(record.vertices_m, np.float32), np.asarray(record.faces)
        *arrays, grid = _packed(vertices_m, faces)
        grid[[0, 1, 3, 10]] = ends
        ends += [len(array) for array in arrays]
        grid[11] = ends[3]
        solid = Mesh(vertices_m, faces)
        foot_m = vertices_m[:, 2].min()
        measures = [record.label, record.id, foot_m, solid.volume_m3, *solid.center_mass_m]
        for column, array in zip(
            columns, [*arrays, grid[None], np.array([measures], np.float64)], strict=True
        ):
            column.append(array)
    if max(map(len, columns[0])) <= 1 << 16:
        columns[1] = [part.astype(np.uint16) for part in columns[1]]
    return columns


def _packed(vertices_m: Float32, faces: AnyArray) -> Parts:
    """Return vertices, faces, starts, hull and grid of one mesh."""
    from scipy.spatial import ConvexHull

    corners = [vertices_m[faces[:, corner], :2].astype(np.float64) for corner in range(3)]
    one, other = corners[1] - corners[0], corners[2] - corners[0]
    upward = np.flatnonzero(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0)
    low, high = (reduce(corners)[upward] for reduce in (np.minimum.reduce, np.maximum.reduce))
    extent = (high - low).max(axis=1)
    is_large = extent > 2 * CELL_M
    flat = vertices_m[:, :2].astype(np.float64)
    origin = flat.min(axis=0)
    across, up = (np.floor((flat.max(axis=0) - origin) / CELL_M).astype(np.int64) + 1).tolist()
    cells = np.floor(((low + high) / 2 - origin) / CELL_M).astype(np.int64)
    cell = np.where(is_large, -1, cells[:, 1] * across + cells[:, 0])
    order = np.argsort(cell, kind="stable")
    large = int(is_large.sum())
    starts = np.searchsorted(cell[order][large:], np.arange(across * up + 1)).astype(np.int32)
    reach_m = extent[~is_large].max(initial=0.0) / 2
    # In the order in which triangles name them, so that corners of one window lie together in memory.
    named = faces[upward][order].reshape(-1)
    used, first, number = np.unique(named, return_index=True, return_inverse=True)
    by_use = np.argsort(first)
    rank = np.empty(len(used), np.int32)
    rank[by_use] = np.arange(len(used), dtype=np.int32)
    kept = vertices_m[used[by_use]].copy()
    kept[:, 2] -= vertices_m[:, 2].min()
    hull = vertices_m[ConvexHull(flat).vertices, :2]
    # A nanometre more: a quotient is rounded, too.
    grid = np.array([0, 0, large, 0, across, up, *origin, CELL_M, reach_m + 1e-9, 0, 0], np.float64)
    return [kept, rank[number].reshape(-1, 3), starts, hull, grid]


def _concat(parts: list[Parts]) -> Parts:
    arrays = [np.concatenate(column) for column in parts]
    for array in arrays:
        array.flags.writeable = False  # as mapped ones are, for which the kernels are compiled
    return arrays


def _write(stream: IO[bytes], parts: list[Parts]) -> None:
    """Write the arrays one after the other, each as numpy would; none is joined in memory.

    A checksum ends the file, because kernels do not check the places in memory that they read from it.
    """
    digest = xxhash.xxh3_128()

    def write(content: bytes) -> None:
        digest.update(content)
        stream.write(content)

    for column in parts:
        shape = (sum(map(len, column)), *column[0].shape[1:])
        header = io.BytesIO()
        described = {"descr": column[0].dtype.str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(header, described)
        write(header.getvalue())
        for part in column:
            write(np.ascontiguousarray(part).tobytes())
    stream.write(digest.digest())


def _found(path: Path) -> Parts | None:
    """Map a file of the cache; None if it does not exist, or is damaged: then it is removed."""
    arrays: Parts = []
    try:
        with path.open("rb") as stream:
            content = np.memmap(path, np.uint8, "r")  # ValueError for an empty file
            stored, checksum = content[:-_CHECKSUM_BYTES], content[-_CHECKSUM_BYTES:]
            if xxhash.xxh3_128_digest(stored.data) != checksum.tobytes():
                raise ValueError("the meshes do not match their checksum")
            for _ in fields(MeshPool):
                np.lib.format.read_magic(stream)
                shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                # A plain array over the map: numba knows no memmap, and numpy is slower with one.
                arrays.append(np.asarray(np.memmap(path, dtype, "r", stream.tell(), shape)))
                stream.seek(int(np.prod(shape)) * dtype.itemsize, 1)
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        if resource_shortage(error) is None:
            _POOLS.drop(path)
        return None
    return arrays
