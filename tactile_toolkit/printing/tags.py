"""Tags: thin plates with a raised number that are printed beside objects."""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh

__all__ = ["TAG_HEIGHT_MM", "tag_mesh", "tag_size_mm"]

STROKE_MM = 0.9
"""Two threads of a 0.4 mm nozzle."""
_DIGIT_MM = (3.2, 5.4)
_DASH_MM = 2.0
_SPACE_MM = 1.0
_MARGIN_MM = 1.0
_UNDERLINE_SPACE_MM = 0.8
_BASE_MM = 0.8
_RAISED_MM = 0.6
TAG_HEIGHT_MM = _BASE_MM + _RAISED_MM

_SEGMENTS = {
    "0": "abcdef",
    "1": "bc",
    "2": "abdeg",
    "3": "abcdg",
    "4": "bcfg",
    "5": "acdfg",
    "6": "acdefg",
    "7": "abc",
    "8": "abcdefg",
    "9": "abcdfg",
    "-": "g",
}
"""Strokes of a seven-segment display: a is the top, then clockwise, g the middle."""

Box = tuple[float, float, float, float]


def tag_size_mm(text: str) -> tuple[float, float]:
    """Return width and depth of a tag.

    Parameters
    ----------
    text : str
        Digits, with or without a minus sign.
    """
    widths = [_width_mm(sign) for sign in text]
    width = sum(widths) + _SPACE_MM * (len(text) - 1)
    return width + 2 * _MARGIN_MM, _baseline_mm() + _DIGIT_MM[1] + _MARGIN_MM


def tag_mesh(text: str) -> Mesh:
    """Make a tag.

    Parameters
    ----------
    text : str
        Digits, with or without a minus sign.

    Returns
    -------
    Mesh
        A solid on z = 0, its lower left corner at the origin, metres. The number is underlined: a 6 that
        lies upside down is no 9.
    """
    import manifold3d

    width_mm, depth_mm = tag_size_mm(text)
    strokes = manifold3d.CrossSection.compose([_rectangle(box) for box in _strokes(text)])
    base = manifold3d.Manifold.cube((width_mm, depth_mm, _BASE_MM))
    # The strokes begin inside the base: faces that only touch would not become one solid.
    raised = strokes.extrude(_BASE_MM / 2 + _RAISED_MM).translate((0, 0, _BASE_MM / 2))
    mesh = (base + raised).to_mesh64()
    return Mesh(
        np.array(mesh.vert_properties[:, :3], np.float64) / MM_PER_M, np.array(mesh.tri_verts, np.int32)
    )


def _baseline_mm() -> float:
    return _MARGIN_MM + STROKE_MM + _UNDERLINE_SPACE_MM


def _width_mm(sign: str) -> float:
    return {"1": STROKE_MM, "-": _DASH_MM}.get(sign, _DIGIT_MM[0])


def _strokes(text: str) -> list[Box]:
    width_mm, _ = tag_size_mm(text)
    boxes = [(_MARGIN_MM, _MARGIN_MM, width_mm - _MARGIN_MM, _MARGIN_MM + STROKE_MM)]
    left = _MARGIN_MM
    for sign in text:
        boxes += [_segment(name, left, _width_mm(sign)) for name in _SEGMENTS[sign]]
        left += _width_mm(sign) + _SPACE_MM
    return boxes


def _segment(name: str, left: float, width: float) -> Box:
    bottom, top = _baseline_mm(), _baseline_mm() + _DIGIT_MM[1]
    right, middle, half = left + width, (bottom + top) / 2, STROKE_MM / 2
    return {
        "a": (left, top - STROKE_MM, right, top),
        "b": (right - STROKE_MM, middle - half, right, top),
        "c": (right - STROKE_MM, bottom, right, middle + half),
        "d": (left, bottom, right, bottom + STROKE_MM),
        "e": (left, bottom, left + STROKE_MM, middle + half),
        "f": (left, middle - half, left + STROKE_MM, top),
        "g": (left, middle - half, right, middle + half),
    }[name]


def _rectangle(box: Box) -> Any:
    import manifold3d

    left, bottom, right, top = box
    return manifold3d.CrossSection.square((right - left, top - bottom)).translate((left, bottom))
