"""Wavefront OBJ files.

trimesh is not used, because it triangulates all polygons as if they were convex.
"""

from __future__ import annotations

import re

import numpy as np

from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Surface
from tactile_toolkit.mesh.polygons import cut_polygons
from tactile_toolkit.mesh.text import numbers_of, plain_text

_VERTEX_LINE = re.compile(r"^[ \t]*v(?!\S)([^\n]*)", re.MULTILINE)
_FACE_LINE = re.compile(r"^[ \t]*f(?!\S)([^\n]*)", re.MULTILINE)
_FREE_FORM = re.compile(r"^[ \t]*(curv2?|surf)\b", re.MULTILINE)
_MAX_VERTICES = 2**31 - 1
_COMMENT, _TEXTURE_AND_NORMAL = re.compile(r"#[^\n]*"), re.compile(r"/\S*")


def read_obj(data: bytes) -> Surface:
    """Read the faces of OBJ; lines, points, textures and names are ignored."""
    text = _COMMENT.sub("", plain_text(data).replace("\\\n", " "))
    if free_form := _FREE_FORM.search(text):
        raise InputError(f"{free_form[1]!r} is a free-form surface; expected faces ('f')")
    places = list[str]()
    for line in _VERTEX_LINE.findall(text):
        place = line.split(None, 3)[:3]
        if len(place) < 3:
            raise InputError(f"{f'v {line}'[:40]!r} has fewer than three coordinates")
        places += place
    vertices = np.array(numbers_of(places, float)).reshape(-1, 3)
    faces = [_TEXTURE_AND_NORMAL.sub("", line) if "/" in line else line for line in _FACE_LINE.findall(text)]
    sizes = np.array([len(line.split()) for line in faces], np.int64)
    numbers = numbers_of(" ".join(faces).split(), int)
    if numbers and not -_MAX_VERTICES <= min(numbers) <= max(numbers) <= _MAX_VERTICES:
        raise InputError(f"faces name vertices {min(numbers)} to {max(numbers)} of {len(vertices):,}")
    corners = np.array(numbers, np.int64)
    if (corners < 1).any():
        corners = _from_first(corners, sizes, text)
    return vertices, cut_polygons(vertices, sizes, corners - 1)


def _from_first(corners: Int64, sizes: Int64, text: str) -> Int64:
    """Convert vertex numbers that count back from the last vertex so far to numbers from the first."""
    places, faces = ([line.start() for line in kind.finditer(text)] for kind in (_VERTEX_LINE, _FACE_LINE))
    so_far = np.repeat(np.searchsorted(places, faces), sizes)
    if (wrong := (corners == 0) | (corners < -so_far)).any():
        number, count = corners[wrong][0], so_far[wrong][0]
        raise InputError(f"a face names vertex {number} of {count:,} so far; expected 1, or -1 for the last")
    return np.where(corners < 0, so_far + 1 + corners, corners)
