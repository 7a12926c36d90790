"""Tags: solids that print and whose digits can be read off a picture of their strokes."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

from tactile_toolkit.mesh.solid_check import judge
from tactile_toolkit.printing.tags import STROKE_MM, TAG_HEIGHT_MM, tag_mesh, tag_size_mm


@pytest.mark.parametrize("text", ["0", "1", "7", "13579", "-42", "0123456789", str(2**63)])
def test_a_tag_is_one_solid_on_the_plate(text: str) -> None:
    mesh = tag_mesh(text)
    verdict = judge(mesh)
    assert (verdict.problem, verdict.bodies) == (None, 1)
    width_mm, depth_mm = tag_size_mm(text)
    assert mesh.bounds_m * 1e3 == pytest.approx(np.array([[0, 0, 0], [width_mm, depth_mm, TAG_HEIGHT_MM]]))


def raised(text: str):
    return tag_mesh(text).to_manifold().slice(TAG_HEIGHT_MM - 0.1)


def test_strokes_are_wide_enough_for_two_threads() -> None:
    for text in "0123456789-":
        strokes = raised(text)
        # A stroke narrower than 0.8 mm would be gone when 0.4 mm are taken off each side.
        left = strokes.offset(-0.4, manifold3d.JoinType.Miter)
        assert left.offset(0.4, manifold3d.JoinType.Miter).area() == pytest.approx(strokes.area(), rel=1e-3)
    assert STROKE_MM >= 0.8


def test_digits_differ_even_upside_down() -> None:
    """The underline tells a 6 from a 9 that lies upside down."""
    seen = []
    for text in ("6", "9", "66", "99", "68", "89", "2", "5", "8", "0"):
        strokes = raised(text)
        width_mm, depth_mm = tag_size_mm(text)
        for turned in (strokes, strokes.rotate(180).translate((width_mm, depth_mm))):
            seen.append((text, turned))
    for place, (_, one) in enumerate(seen):
        for _, other in seen[place + 1 :]:
            same = (one ^ other).area()
            assert same < 0.97 * max(one.area(), other.area())


def test_the_sign_of_each_digit() -> None:
    """Whether each of the seven strokes is there, by looking where it has to be."""
    strokes = {"0": "1110111", "2": "1011101", "3": "1011011", "4": "0111010"}
    strokes |= {"5": "1101011", "6": "1101111", "7": "1010010", "8": "1111111", "9": "1111011"}
    for text, expected in strokes.items():
        picture = raised(text)
        width_mm, depth_mm = tag_size_mm(text)
        left, right, middle = 1.45, width_mm - 1.45, width_mm / 2
        top, bottom = depth_mm - 1.45, 1 + 0.9 + 0.8 + 0.45
        half = (top + bottom) / 2
        points = [(middle, top), (left, (top + half) / 2), (right, (top + half) / 2), (middle, half)]
        points += [(left, (bottom + half) / 2), (right, (bottom + half) / 2), (middle, bottom)]
        found = "".join(str(int(has(picture, point))) for point in points)
        assert found == expected, text
    bar = max(raised("1").decompose(), key=lambda part: part.bounds()[3]).bounds()
    assert (bar[2] - bar[0], bar[3] - bar[1]) == pytest.approx((0.9, 5.4))


def has(section, point) -> bool:
    dot = manifold3d.CrossSection.square((0.02, 0.02), True).translate(point)
    return (dot ^ section).area() > 0
