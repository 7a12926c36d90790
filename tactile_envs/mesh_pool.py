"""Meshes packed into a few arrays, as kernels and tasks need them, and mapped from one file.

Only the triangles of a mesh that sensors can see are kept, as numbers of corners, sorted into a grid of
:data:`CELL_M`: those under a window that is turned in any way are a few contiguous runs. The training split
of the digits takes 0.8 GB for upright sensors, which the processes of a machine share.
"""

from __future__ import annotations

import hashlib
import io
import logging
import multiprocessing
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np
import xxhash

from env_assets import mesh_view
from tactile_toolkit import cache, mesh, read, run, store
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Int32, Int64

CELL_M = 0.0012
"""Side of a cell of the grid, metres; 0.6 to 4 mm are equally fast."""

MEASURES = ("label", "id", "foot_m", "volume_m3", "x_m", "y_m", "z_m")
"""Columns of :attr:`MeshPool.measures`: foot is the lowest height, x, y and z the centre of mass."""

_POOLS = cache.DiskCache(
    "environments",
    8 << 30,
    warning="environments sort their meshes again each time: {problem}",
)
_FORMAT = 3
_CHUNK = 128
# Fewer chunks are packed before workers would have started.
_FEW_CHUNKS = 8
_MAX_WORKERS = 16  # each takes about 300 MB of memory
# In seconds; shorter work shows no progress.
_QUIET_S = 2.0
_LOOK_AGAIN_S = 5.0
# Columns of `grids` with the first vertex, face, start and corner of the hull.
_FIRSTS = [0, 1, 3, 10]
_CHECKSUM_BYTES = 16
_LOG = logging.getLogger(__name__)

Parts = list[AnyArray]


@dataclass(eq=False)
class MeshPool:
    """Some meshes, metres.

    Attributes
    ----------
    vertices : ndarray of float32, shape (V, 3)
        Corners of triangles that sensors can see; the lowest point of each mesh is at height 0.
    faces : ndarray of uint16 or int32, shape (F, 3)
        Triangles, by corners within their mesh: first the large ones, then the others by cell.
    starts : ndarray of int32, shape (S,)
        For each mesh, the first small triangle of each cell, row by row, and the end of the last.
    hulls : ndarray of float32, shape (H, 2)
        Corners of the convex hulls seen from above.
    grids : ndarray of float64, shape (n, 13)
        For each mesh, by column: 0 first vertex, 1 first face, 2 number of large faces, 3 first start;
        4, 5 number of cells along x and y; 6, 7 least x and y of the grid, metres; 8 side of a cell, metres;
        9 greatest half side of the box around a small triangle, whose middle decides its cell, metres;
        10 first corner of the hull, 11 the one after its last; 12 height, metres.
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
    def of(cls, records: Sequence[mesh_view.MeshRecord], tilt_rad: float = 0.0) -> MeshPool:
        """Pack the meshes of records; those of a data set are kept on disk for the next time.

        Triangles are kept that sensors can see that are tilted by ``tilt_rad`` at most. Meshes that are not
        made yet are packed when :meth:`require` names them, for upright sensors.
        """
        if isinstance(records, mesh_view.PlannedView):
            return GrowingPool(records)
        name = _name_of(records, tilt_rad)
        if name is None:
            return cls.packed(records, tilt_rad)
        path = _POOLS.path(name)
        with cache.held(name) as problem:
            if problem is not None:  # not writable, or locked for too long
                _LOG.warning("meshes are sorted again each time: %s", problem)
                return cls.packed(records, tilt_rad)
            # Another process may have packed them meanwhile.
            arrays = _mapped(path)
            if arrays is None:
                columns = _joined(_chunks_of(records, tilt_rad))
                size = sum(part.nbytes for column in columns for part in column)
                is_kept = _POOLS.write(name, size, lambda stream: _write(stream, columns))
                arrays = (_mapped(path) if is_kept else None) or _concat(columns)
        _POOLS.mark_used(path)
        return cls(*arrays)

    @classmethod
    def kept(cls, records: Sequence[mesh_view.MeshRecord]) -> MeshPool | None:
        """Map the meshes of a data set if they were packed before."""
        name = _name_of(records)
        arrays = None
        if name is not None:
            arrays = _mapped(_POOLS.path(name))
        return None if arrays is None else cls(*arrays)

    @staticmethod
    def is_kept(records: Sequence[mesh_view.MeshRecord]) -> bool:
        """Return whether the meshes of a data set were packed before."""
        name = _name_of(records)
        return name is not None and _POOLS.path(name).is_file()

    @classmethod
    def packed(cls, records: Iterable[mesh_view.MeshRecord], tilt_rad: float = 0.0) -> MeshPool:
        """Pack the meshes of records in memory."""
        return cls(*_concat(_joined([_packed_records(records, tilt_rad)])))

    def require(self, numbers: Int64) -> None:
        """Make sure that the arrays hold the meshes of these numbers; a complete pool holds all."""

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


class GrowingPool(MeshPool):
    """Meshes of a data set that is not made yet: each is packed when an episode first needs it.

    When any process has finished the data set and packed it on disk, its arrays replace these. Both have the
    same meshes under the same numbers.
    """

    def __init__(self, view: mesh_view.PlannedView) -> None:
        self._planned, self._next_look_s = view, 0.0
        self._is_packed = np.zeros(len(view), np.bool_)
        # With spare room, so that adding a mesh seldom copies the others.
        self._buffers: Parts = [
            np.empty((0, 3), np.float32),
            np.empty((0, 3), np.uint16),
            np.empty(0, np.int32),
            np.empty((0, 2), np.float32),
        ]
        self._used = np.zeros(4, np.int64)
        self._grids, self._measures = np.zeros((len(view), 13)), np.zeros((len(view), len(MEASURES)))
        self._measures[:, 0], self._measures[:, 1] = view.column("label"), view.column("id")
        super().__init__(*map(_read_only, [*self._buffers, self._grids, self._measures]))

    def require(self, numbers: Int64) -> None:
        """Pack the meshes of these numbers, unless they are packed."""
        missing = np.unique(numbers[~self._is_packed[numbers]])
        if not len(missing) or self._is_replaced():
            return
        *arrays, grids, measures = _packed_records(self._planned[number] for number in missing.tolist())
        self._grids[missing], self._measures[missing] = _moved(grids, self._used), measures
        for column, array in enumerate(arrays):
            self._extend(column, array)
        self.vertices, self.faces, self.starts, self.hulls = (
            _read_only(buffer[:end]) for buffer, end in zip(self._buffers, self._used, strict=True)
        )
        self._is_packed[missing] = True

    def _extend(self, column: int, array: AnyArray) -> None:
        buffer = self._buffers[column]
        begin = int(self._used[column])
        end = begin + len(array)
        dtype = buffer.dtype
        if dtype == np.uint16 and not _is_small(array):
            dtype = array.dtype
        if end > len(buffer) or dtype != buffer.dtype:
            larger = np.empty((max(2 * end, len(buffer)), *buffer.shape[1:]), dtype)
            larger[:begin] = buffer[:begin]
            self._buffers[column] = buffer = larger
        buffer[begin:end] = array
        self._used[column] = end

    def _is_replaced(self) -> bool:
        """Take the arrays of the finished data set, if it is there."""
        if time.monotonic() < self._next_look_s:
            return False
        records = self._planned.finished()
        pool = None
        if records is not None:
            pool = MeshPool.kept(records)
        self._next_look_s = time.monotonic() + _LOOK_AGAIN_S
        if pool is None or not np.array_equal(pool.measures[:, :2], self.measures[:, :2]):
            return False
        for field in fields(MeshPool):
            setattr(self, field.name, getattr(pool, field.name))
        self._buffers.clear()
        self._is_packed[:] = True
        return True


def free_workers() -> int:
    """Return the default number of worker processes: one for each core.

    In a worker of another program, which may start none, the number is 1: this process.
    """
    if multiprocessing.current_process().daemon:
        return 1
    return min(run.usable_cores(), _MAX_WORKERS)


def _name_of(records: Sequence[mesh_view.MeshRecord], tilt_rad: float = 0.0) -> str | None:
    """Return a name for the content of a data set on disk; None for records that are in memory."""
    is_flat = isinstance(records, mesh_view.MeshView) and records.flat
    if isinstance(records, mesh_view.MeshView):
        records = records.records
    if not isinstance(records, read.RecordDataset):
        return None
    # The identity is that of the rows when they were loaded.
    content = (_FORMAT, CELL_M, tilt_rad, is_flat, records.identity)
    digest = hashlib.sha256(repr(content).encode() + records.row_numbers.tobytes())
    return f"meshes-{digest.hexdigest()[:32]}"


def _chunks_of(records: Sequence[mesh_view.MeshRecord], tilt_rad: float) -> list[Parts]:
    """Pack the meshes of a data set in chunks, on all cores if they are many."""
    firsts = range(0, len(records), _CHUNK)
    workers = 1
    if len(firsts) > _FEW_CHUNKS:
        workers = free_workers()
    chunks: dict[int, Parts] = {}
    with run.shown_progress("sorting the triangles of meshes, once", "meshes", _QUIET_S) as update:
        for first, parts in run.runner_for(workers).run(partial(_packed_chunk, records, tilt_rad), firsts):
            chunks[first] = parts
            update(min(len(chunks) * _CHUNK, len(records)), len(records))
    return [chunks[first] for first in firsts]


def _packed_chunk(records: Sequence[mesh_view.MeshRecord], tilt_rad: float, first: int) -> tuple[int, Parts]:
    return first, _packed_records(records[first : first + _CHUNK], tilt_rad)


def _packed_records(records: Iterable[mesh_view.MeshRecord], tilt_rad: float = 0.0) -> Parts:
    """Return the arrays of some meshes, one for each field of a pool of them; faces are int32."""
    columns: list[Parts] = [[], [], [], [], [], []]
    ends = np.zeros(4)
    for record in records:
        vertices_m = np.asarray(record.vertices_m, np.float32)
        faces = np.asarray(record.faces)
        *arrays, grid = _packed(vertices_m, faces, tilt_rad)
        grid[_FIRSTS] = ends
        ends += [len(array) for array in arrays]
        grid[11] = ends[3]
        solid = mesh.Mesh(vertices_m, faces)
        foot_m = vertices_m[:, 2].min()
        measures = [record.label, record.id, foot_m, solid.volume_m3, *solid.center_mass_m]
        for column, array in zip(
            columns, [*arrays, grid[None], np.array([measures], np.float64)], strict=True
        ):
            column.append(array)
    return [np.concatenate(column) for column in columns]


def _moved(grids: Float64, ends: AnyArray) -> Float64:
    """Return the grids of meshes whose arrays follow others that end at ``ends``, shape (4,)."""
    moved = grids.copy()
    moved[:, _FIRSTS] += ends
    moved[:, 11] += ends[3]
    return moved


def _joined(chunks: Iterable[Parts]) -> list[Parts]:
    """Return the arrays of all chunks, one list for each field of a pool."""
    columns: list[Parts] = [[], [], [], [], [], []]
    ends = np.zeros(4)
    for vertices, faces, starts, hulls, grids, measures in chunks:
        for column, array in zip(
            columns, (vertices, faces, starts, hulls, _moved(grids, ends), measures), strict=True
        ):
            column.append(array)
        ends += [len(vertices), len(faces), len(starts), len(hulls)]
    if all(_is_small(faces) for faces in columns[1]):
        columns[1] = [faces.astype(np.uint16) for faces in columns[1]]
    return columns


def _is_small(faces: AnyArray) -> bool:
    """Return whether the number of each corner fits into 16 bits."""
    return int(faces.max(initial=0)) < 1 << 16


def _packed(vertices_m: Float32, faces: AnyArray, tilt_rad: float) -> Parts:
    """Return vertices, faces, starts, hull and grid of one mesh."""
    from scipy.spatial import ConvexHull

    corners = [vertices_m[faces[:, corner]].astype(np.float64) for corner in range(3)]
    normals = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    steepest = -np.sin(tilt_rad) * np.linalg.norm(normals, axis=1)
    visible = np.flatnonzero(normals[:, 2] > steepest)
    low, high = (reduce(corners)[visible, :2] for reduce in (np.minimum.reduce, np.maximum.reduce))
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
    # A nanometre more, for the rounding of quotients.
    reach_m = extent[~is_large].max(initial=0.0) / 2 + 1e-9
    # Vertices in the order in which triangles use them: those of one window are close together in memory.
    named = faces[visible][order].reshape(-1)
    used, first, number = np.unique(named, return_index=True, return_inverse=True)
    by_use = np.argsort(first)
    rank = np.empty(len(used), np.int32)
    rank[by_use] = np.arange(len(used), dtype=np.int32)
    kept = vertices_m[used[by_use]].copy()
    kept[:, 2] -= vertices_m[:, 2].min()
    height_m = vertices_m[:, 2].max() - vertices_m[:, 2].min()
    hull = vertices_m[ConvexHull(flat).vertices, :2]
    grid = np.array([0, 0, large, 0, across, up, *origin, CELL_M, reach_m, 0, 0, height_m], np.float64)
    return [kept, rank[number].reshape(-1, 3), starts, hull, grid]


def _concat(parts: list[Parts]) -> Parts:
    return [_read_only(np.concatenate(column)) for column in parts]


def _read_only(array: AnyArray) -> AnyArray:
    """Return a view as mapped arrays are, for which the kernels are compiled."""
    view = array.view()
    view.flags.writeable = False
    return view


def _write(stream: IO[bytes], parts: list[Parts]) -> None:
    """Write the arrays one after the other, each as numpy would; none is joined in memory.

    The file ends with a checksum, because kernels do not check indices that they read from it.
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


def _mapped(path: Path) -> Parts | None:
    """Map a file of the cache; None if it does not exist or is damaged; a damaged one is removed."""
    arrays: Parts = []
    try:
        with store.open_regular(path) as stream:
            content = np.memmap(stream, np.uint8, "r")  # ValueError for an empty file
            stored, checksum = content[:-_CHECKSUM_BYTES], content[-_CHECKSUM_BYTES:]
            if xxhash.xxh3_128_digest(stored.data) != checksum.tobytes():
                raise ValueError("the meshes do not match their checksum")
            stream.seek(0)
            for _ in fields(MeshPool):
                np.lib.format.read_magic(stream)
                shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                # A plain array over the map: numba does not support memmap, and numpy is slower with it.
                offset = stream.tell()
                arrays.append(np.asarray(np.memmap(stream, dtype, "r", offset, shape)))
                stream.seek(offset + int(np.prod(shape)) * dtype.itemsize)
    except FileNotFoundError:
        return None
    except (ValueError, OSError, IntegrityError) as error:  # the last for a pipe
        _POOLS.drop_unreadable(path, error)
        return None
    return arrays
