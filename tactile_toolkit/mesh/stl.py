"""STL files, text and binary.

trimesh is not used, because it ignores unexpected content and may return another surface without a
warning. Memory is bounded by the size of the file, not by numbers in it.
"""

from __future__ import annotations

import re

import numpy as np

from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Surface
from tactile_toolkit.mesh.text import numbers_of, plain_text

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER_BYTES = 84
_VERTEX = r"vertex\s+(\S+)\s+(\S+)\s+(\S+)\s+"
_FACET_TEXT = re.compile(
    r"facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop\s+" + _VERTEX * 3 + r"end\s*loop\s+end\s*facet\b",
    re.IGNORECASE,
)
_SOLID, _SOLID_END = re.compile(r"(end\s*)?solid\b", re.IGNORECASE), re.compile(r"end\s*solid\b", re.I)


def read_stl(data: bytes) -> Surface:
    """Read STL: binary where the size of the file matches its stated number of triangles, otherwise text."""
    stated = int.from_bytes(data[_HEADER_BYTES - 4 : _HEADER_BYTES], "little")
    size = _HEADER_BYTES + stated * _FACET.itemsize
    # Decided by the size, because many programs begin binary files with "solid" too.
    if len(data) == size:
        corners = np.frombuffer(data, _FACET, stated, _HEADER_BYTES)["corners"]
        return _apart(corners.reshape(-1, 3).astype(np.float64))
    text = plain_text(data)
    if "\0" not in text[:_HEADER_BYTES]:
        return _read_stl_text(text)
    if stated > len(data):
        raise InputError(f"neither text nor binary STL: its {len(data):,} bytes do not begin as one of them")
    raise InputError(
        f"the file has {len(data):,} bytes, a binary STL file of {stated:,} triangles has {size:,}",
        next="export or copy it again",
    )


def _read_stl_text(text: str) -> Surface:
    words, others, end = list[str](), [], 0
    for facet in _FACET_TEXT.finditer(text):
        others.append(text[end : facet.start()])
        words.extend(facet.groups())
        end = facet.end()
    lines = [line.strip() for part in (*others, text[end:]) if part.strip() for line in part.split("\n")]
    lines = [line for line in lines if line]
    if not lines or not _SOLID.match(lines[0]):
        found = repr(lines[0][:40]) if lines else "nothing"
        raise InputError(f"the file begins with {found}; expected 'solid' or a binary STL file")
    if not _SOLID_END.match(lines[-1]):
        raise InputError("the text is cut short; expected one that ends with 'endsolid'")
    if unknown := [line for line in lines if not _SOLID.match(line)]:
        raise InputError(f"{unknown[0][:40]!r} is not a facet; expected 'facet normal ... endfacet'")
    return _apart(np.array(numbers_of(words, float)).reshape(-1, 3))


def _apart(vertices: Float64) -> Surface:
    """Return a surface whose triangles share no vertices."""
    return vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
