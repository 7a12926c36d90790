"""STL, the file that every printer reads: loose triangles that share no corners."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["read_stl", "write_stl"]

_HEADER_BYTES = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(data: bytes) -> NDArray[np.float64]:
    """Read a binary or ASCII file.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    ndarray of float64, shape (F, 3, 3)
        Corners of each triangle in the unit of the file.

    Raises
    ------
    ValueError
        The file is cut short or is no STL.
    """
    if len(data) >= _HEADER_BYTES:
        count = int.from_bytes(data[80:_HEADER_BYTES], "little")
        if len(data) == _HEADER_BYTES + count * _TRIANGLE.itemsize:
            triangles = np.frombuffer(data, _TRIANGLE, count, _HEADER_BYTES)
            return np.asarray(triangles["corners"], dtype=np.float64)
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        return _read_ascii(data)
    if len(data) < _HEADER_BYTES:
        message = f"{len(data)} bytes; an STL file has at least {_HEADER_BYTES}"
        raise ValueError(message)
    expected = _HEADER_BYTES + count * _TRIANGLE.itemsize
    message = f"{len(data)} bytes; a binary STL file of {count} triangles has {expected}"
    raise ValueError(message)


def write_stl(corners_mm: NDArray[np.float64]) -> bytes:
    """Pack triangles into a binary file.

    Parameters
    ----------
    corners_mm : ndarray of float64, shape (F, 3, 3)
        Corners of each triangle, counter-clockwise seen from outside.

    Returns
    -------
    bytes
    """
    normals = np.cross(corners_mm[:, 1] - corners_mm[:, 0], corners_mm[:, 2] - corners_mm[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.zeros(len(corners_mm), _TRIANGLE)
    triangles["normal"] = normals / np.where(lengths > 0, lengths, 1)
    triangles["corners"] = corners_mm
    return b"millimetres".ljust(80) + len(corners_mm).to_bytes(4, "little") + triangles.tobytes()


def _read_ascii(data: bytes) -> NDArray[np.float64]:
    words = data.split()
    if not words[-1:] or b"endsolid" not in words[-64:]:
        message = "the text ends without 'endsolid'"
        raise ValueError(message)
    numbers = [words[i + 1 : i + 4] for i, word in enumerate(words) if word == b"vertex"]
    corners = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    if len(corners) % 3:
        message = f"{len(corners)} corners do not make whole triangles"
        raise ValueError(message)
    return corners.reshape(-1, 3, 3)
