"""Height maps kept on disk, by what the mesh is: made once on a machine, whatever data set holds the mesh."""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.mesh import as_mesh
from dataset_store.rowgroups import cache_folder
from env_assets.height_map import HeightMap, Window, top_surface, window_of

__all__ = ["HeightCache", "content_key"]

_VERSION = 1
"""Raised whenever the same mesh and pitch would give other heights than before."""

_CHECKSUM_BYTES = 4
_LIMIT_BYTES = 4 << 30
_SIZED_ANEW_AFTER = 16
"""The folder is sized anew after writing one part in so many of the limit: others write there too."""


@dataclass
class HeightCache:
    """Height maps on disk.

    Parameters
    ----------
    folder : Path, optional
        Where they are kept; ``heights`` in the cache folder (``$TACTILE_TOOLKIT_CACHE``) by default.
    limit_bytes : int
        What they may fill, 4 GiB by default; the ones used longest ago leave first.

    Notes
    -----
    Files appear whole or not at all, and damaged ones are made again. Threads and processes may share a
    folder. A folder that cannot be written costs speed, never a map.
    """

    folder: Path | None = None
    limit_bytes: int = _LIMIT_BYTES
    _unsized_bytes: int | None = field(default=None, repr=False)

    def get(self, mesh: Any, pitch_m: float) -> HeightMap:
        """Return the height map of a mesh, from disk where it is there.

        Raises
        ------
        InputError
            As :func:`env_assets.top_surface`.
        """
        mesh = as_mesh(mesh)
        window = window_of(mesh.vertices_m, pitch_m)
        place = self._folder() / f"{content_key(mesh, pitch_m)}.heights"
        heights_m = _read(place, window)
        if heights_m is not None:
            return HeightMap(heights_m, window)
        made = top_surface(mesh, pitch_m)
        with contextlib.suppress(OSError):
            self._write(place, _pack(made.heights_m))
        return made

    def _folder(self) -> Path:
        return cache_folder() / "heights" if self.folder is None else self.folder

    def _write(self, place: Path, content: bytes) -> None:
        self._make_room(place.parent, len(content))
        place.parent.mkdir(parents=True, exist_ok=True)
        temporary = place.with_name(f".writing-{os.getpid()}-{threading.get_ident()}-{place.name}")
        # Not flushed to the disk, which would take longer than making the map: the checksum tells what a
        # power cut has spoiled.
        try:
            temporary.write_bytes(content)
            temporary.replace(place)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise

    def _make_room(self, folder: Path, needed_bytes: int) -> None:
        """Remove what was used longest ago when the folder may have passed its limit."""
        unsized = self._unsized_bytes
        if unsized is not None and unsized + needed_bytes <= self.limit_bytes // _SIZED_ANEW_AFTER:
            self._unsized_bytes = unsized + needed_bytes
            return
        self._unsized_bytes = needed_bytes
        files = sorted(_files(folder))
        # Room for what is written before the next look, so that the limit holds between looks too.
        ahead = max(needed_bytes, self.limit_bytes // _SIZED_ANEW_AFTER)
        excess = sum(size for _, size, _ in files) + ahead - self.limit_bytes
        for _, size, file in files:
            if excess <= 0:
                return
            with contextlib.suppress(OSError):
                file.unlink()
            excess -= size


def content_key(mesh: Any, pitch_m: float) -> str:
    """Name the height map of a mesh: equal vertices, triangles and pitch give an equal name.

    Parameters
    ----------
    mesh : Mesh or record
        Anything with ``vertices_m`` and ``faces``.
    pitch_m : float
        Side of a pixel, metres.
    """
    vertices_m, faces = np.ascontiguousarray(mesh.vertices_m), np.ascontiguousarray(mesh.faces)
    digest = hashlib.sha256(repr((_VERSION, float(pitch_m), vertices_m.dtype.str, faces.dtype.str)).encode())
    digest.update(vertices_m.data)
    digest.update(faces.data)
    return digest.hexdigest()[:32]


def _pack(heights_m: NDArray[np.float32]) -> bytes:
    """Return the heights row by row as little-endian float32, and their CRC-32."""
    values = heights_m.astype("<f4", copy=False).tobytes()
    return values + zlib.crc32(values).to_bytes(_CHECKSUM_BYTES, "little")


def _read(place: Path, window: Window) -> NDArray[np.float32] | None:
    """Read a map; None where it is not there or is not what it should be."""
    try:
        content = place.read_bytes()
    except OSError:
        return None
    values, checksum = content[:-_CHECKSUM_BYTES], int.from_bytes(content[-_CHECKSUM_BYTES:], "little")
    if len(values) != 4 * window.rows * window.columns or zlib.crc32(values) != checksum:
        return None
    with contextlib.suppress(OSError):
        os.utime(place)  # the time of last use decides what leaves a full cache first
    return np.frombuffer(values, "<f4").reshape(window.rows, window.columns)


def _files(folder: Path) -> Iterator[tuple[int, int, Path]]:
    """Yield time of last use, size and place of files, those of killed writers too.

    Other processes may remove some meanwhile.
    """
    for file in folder.glob("*"):
        with contextlib.suppress(FileNotFoundError):
            facts = file.stat()
            yield facts.st_mtime_ns, facts.st_size, file
