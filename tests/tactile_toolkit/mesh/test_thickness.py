"""Walls of solids with a known thinnest place: necks, floors, fins, shells, grooves, at any angle."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import manifold3d
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from PIL import Image, ImageDraw

from mnist3d.solid.algorithm import solidify
from tactile_toolkit.mesh import Mesh, PrintReport
from tactile_toolkit.mesh.walls import thinnest_wall_mm

Solid = manifold3d.Manifold
ANGLES = st.floats(0, 360)


def report_of(solid: Any) -> PrintReport:
    arrays = solid.to_mesh64()
    vertices_m = np.array(arrays.vert_properties)[:, :3] / 1000
    return PrintReport.of(Mesh(vertices_m.astype(np.float32), np.array(arrays.tri_verts).astype(np.int32)))


def require_wall(solid: Any, wall_mm: float) -> None:
    report = report_of(solid)
    assert report.thinnest_wall_mm == pytest.approx(wall_mm, rel=0.1)
    if not 0.79 < wall_mm < 0.81:
        assert ("thin-wall" in report.warnings) == (wall_mm < 0.8)


def hourglass(neck_mm: float, taper_deg: float, half_mm: float, high_mm: float) -> Any:
    end = neck_mm / 2 + half_mm * math.tan(math.radians(taper_deg))
    outline = [(-half_mm, -end), (0, -neck_mm / 2), (half_mm, -end)]
    return manifold3d.CrossSection([outline + [(-x, -y) for x, y in outline]]).extrude(high_mm)


# Steeper, the outer edges are sharper than 36 degrees.
@given(st.floats(0.3, 1.2), st.floats(5, 53), st.floats(5, 15), st.floats(3, 12), ANGLES)
def test_necks(neck: float, taper: float, half: float, high: float, angle: float) -> None:
    require_wall(hourglass(neck, taper, half, high).rotate((0, 0, angle)).translate((20, -30, 0)), neck)


@settings(max_examples=settings.default.max_examples // 5)
@given(st.floats(0.3, 2), ANGLES, st.booleans())
def test_floors_of_cups(floor: float, angle: float, is_round: bool) -> None:
    if is_round:
        cup = Solid.cylinder(20, 12, 12, 64) - Solid.cylinder(40, 9, 9, 64).translate((0, 0, floor))
    else:
        cup = Solid.cube((30, 25, 20)) - Solid.cube((24, 19, 40)).translate((3, 3, floor))
    require_wall(cup.rotate((0, 0, angle)), floor)


@settings(max_examples=settings.default.max_examples // 5)
@given(st.floats(0.3, 2), st.integers(0, 10**6))
def test_shells_in_any_position(wall: float, seed: int) -> None:
    turn = np.random.default_rng(seed).uniform(0, 360, 3).tolist()
    box = Solid.cube((14, 12, 10), True) - Solid.cube((14 - 2 * wall, 8, 6), True)
    require_wall(box.rotate(turn), wall)
    assert report_of(Solid.sphere(8, 32) - Solid.sphere(8 - wall, 32)).thinnest_wall_mm == pytest.approx(
        wall, rel=0.1
    )


def sharp(angle_deg: float) -> Any:
    side = 20 * math.tan(math.radians(angle_deg / 2))
    return manifold3d.CrossSection([[(0, 0), (20, -side), (20, side)]]).extrude(10)


def blunt() -> Any:
    return manifold3d.CrossSection([[(0, -0.2), (9, -2.6), (9, 2.6), (0, 0.2)]]).extrude(8)


def ring() -> Any:
    return manifold3d.CrossSection.circle(0.6, 32).translate((8, 0)).revolve(48)


def rod(wide_mm: float, sides: int = 64) -> Any:
    return Solid.cylinder(20, wide_mm / 2, wide_mm / 2, sides)


DIVIDED = {
    **{f"rod {wide}": (partial(rod, wide), wide) for wide in (0.84, 1.0, 2.0)},
    "rod of 18 sides": (partial(rod, 1.0, 18), 1.0),
    **{f"wedge of {angle} degrees": (partial(sharp, angle), 0.0) for angle in (5, 10, 19, 30, 36)},
    "cone": (partial(Solid.cylinder, 20, 3, 0, 32), 0.0),
    "wedge of 37 degrees": (partial(sharp, 37), math.inf),
    "plate": (partial(Solid.cube, (12, 9, 0.7)), 0.7),
    "ring": (ring, 1.2),
    "neck": (partial(hourglass, 0.9, 40, 8, 6), 0.9),
    "blunt wedge": (blunt, 0.4),
}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", DIVIDED)
def test_a_wall_does_not_change_when_faces_are_divided(name: str) -> None:
    make, wall_mm = DIVIDED[name]
    solid = make()
    surfaces = [solid.to_mesh64(), solid.refine(2).to_mesh64(), solid.refine(3).to_mesh64()]
    arrays = [
        (np.array(each.vert_properties)[:, :3], np.array(each.tri_verts).astype(np.int64))
        for each in surfaces
    ]
    arrays.append(trimesh.remesh.subdivide(*arrays[0]))
    found = [thinnest_wall_mm(np.asarray(v), np.asarray(f), 2.5) for v, f in arrays]
    assert found[0] == pytest.approx(wall_mm, rel=0.08)
    assert found == pytest.approx([found[0]] * len(found), rel=0.02)


def test_corners_are_no_walls() -> None:
    """Neither the edges of a box nor the tips of a cone or a wedge of 40 degrees."""
    wedge = manifold3d.CrossSection([[(0, 0), (20, -7.28), (20, 7.28)]]).extrude(10)
    for solid in (Solid.cube((10, 10, 10)), Solid.cylinder(14, 6, 0, 64), wedge, wedge.refine_to_length(1.5)):
        assert report_of(solid).thinnest_wall_mm >= 2.5


def test_thick_walls_are_those_of_the_middle_section() -> None:
    assert report_of(Solid.cube((40, 6, 20))).thinnest_wall_mm == pytest.approx(6, rel=0.02)
    assert report_of(Solid.cube((40, 30, 4))).thinnest_wall_mm == pytest.approx(4, rel=0.02)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(("ink_px", "angle"), [(6, 0), (8, 17), (10, 45)])
def test_a_thin_stroke_of_a_digit_is_found(ink_px: int, angle: float) -> None:
    picture = Image.new("L", (350, 350), 255)
    draw = ImageDraw.Draw(picture)
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    for side in (-1, 1):
        x, y = 175 + side * 70 * cosine, 175 + side * 70 * sine
        draw.ellipse((x - 45, y - 45, x + 45, y + 45), fill=0)
    ends = [(175 + side * 60 * cosine, 175 + side * 60 * sine) for side in (-1, 1)]
    draw.line(ends, fill=0, width=ink_px)
    mesh = solidify(np.asarray(picture), pixel_mm=0.2)
    vertices_mm = mesh.vertices_m.astype(float) * 1000
    whole = thinnest_wall_mm(vertices_mm, mesh.faces.astype(np.int64), 2.5)
    assert PrintReport.of(mesh).thinnest_wall_mm == whole < 2.5


@pytest.mark.parametrize("wall", [0.495, 1.5])
def test_fins_far_from_the_outline_of_a_relief_are_found(wall: float) -> None:
    """Two reliefs back to back, with walls that neither the outline nor the middle section shows."""
    half = manifold3d.CrossSection.circle(15, 64).extrude(10, scale_top=(0.7, 0.7))
    fin = manifold3d.CrossSection.square((8, 1.2 * wall), True).extrude(16, scale_top=(0.6, 0.6))
    upper = half + fin.translate((0, 0, 0.01))
    solid = (upper + upper.mirror((0, 0, 1))).refine_to_length(1.0)
    assert report_of(solid).thinnest_wall_mm == pytest.approx(0.72 * wall, rel=0.05)


def shuffled(mesh: Mesh, seed: int) -> Mesh:
    """Return the same triangles, elsewhere on the plate, with triangles and corners in another order."""
    rng = np.random.default_rng(seed)
    moved, turned = rng.permutation(len(mesh.vertices_m)), rng.integers(0, 3, len(mesh.faces))
    faces = np.argsort(moved)[np.take_along_axis(mesh.faces, (np.arange(3) + turned[:, None]) % 3, axis=1)]
    return Mesh(
        mesh.vertices_m[moved] + rng.uniform(-0.1, 0.1, 3) * [1, 1, 0],
        rng.permutation(faces).astype(np.int32),
    )


@settings(max_examples=settings.default.max_examples // 5)
@given(st.integers(0, 10**6), st.sampled_from([8, 40]))
def test_walls_depend_neither_on_place_nor_on_order(seed: int, ink_px: int) -> None:
    """Neither a thin wall, found in the solid, nor a thick one, found in the middle section."""
    picture = Image.new("L", (350, 350), 255)
    draw = ImageDraw.Draw(picture)
    draw.line([(80, 90), (250, 130), (150, 280)], fill=0, width=ink_px)
    draw.ellipse((200, 80, 290, 190), fill=0)
    mesh = solidify(np.asarray(picture))
    report, other = PrintReport.of(mesh), PrintReport.of(shuffled(mesh, seed))
    assert (report.thinnest_wall_mm < 2.5) == (ink_px == 8)
    assert other.thinnest_wall_mm == pytest.approx(report.thinnest_wall_mm, rel=1e-4)
