"""Printability: solids and broken meshes, and measures of shapes with known values."""

from __future__ import annotations

import math
from typing import Any

import manifold3d
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, PrintProfile, PrintReport
from tactile_toolkit.mesh.printability import WARNINGS, section_area_mm2, thinnest_width_mm
from tactile_toolkit.mesh.solid_check import PROBLEMS

ANGLES = st.floats(0, 2 * math.pi)


def mesh_of(solid: Any) -> Mesh:
    arrays = solid.to_mesh64()
    return Mesh(
        np.asarray(arrays.vert_properties)[:, :3] / 1000, np.asarray(arrays.tri_verts).astype(np.int32)
    )


def cube(side_mm: float = 10, at: tuple[float, float, float] = (0, 0, 0)) -> Any:
    return manifold3d.Manifold.cube((side_mm, side_mm, side_mm)).translate(at)


def pile(*meshes: Mesh) -> Mesh:
    counts = np.cumsum([0] + [len(m.vertices_m) for m in meshes])
    faces = [m.faces + n for m, n in zip(meshes, counts, strict=False)]
    return Mesh(np.concatenate([m.vertices_m for m in meshes]), np.concatenate(faces).astype(np.int32))


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices_m, np.ascontiguousarray(mesh.faces[:, ::-1]))


# --- measures -------------------------------------------------------------------------------------


def test_a_cube_in_numbers() -> None:
    report = PrintReport.of(mesh_of(cube()))
    assert (report.is_solid, report.status, report.problem) == (True, "NoError", None)
    assert (report.vertices, report.faces, report.bodies, report.genus) == (8, 12, 1, 0)
    assert report.volume_mm3 == pytest.approx(1000)
    assert report.mass_g == pytest.approx(1.24)
    assert report.size_mm == pytest.approx((10, 10, 10))
    assert report.thinnest_wall_mm == pytest.approx(10, abs=0.05)
    assert report.contact_mm2 == pytest.approx(100)
    assert report.overhang_mm2 == 0
    assert report.warnings == ()


@given(st.floats(5, 85))
def test_overhang_begins_at_the_angle_of_the_profile(lean_deg: float) -> None:
    if abs(lean_deg - 45) < 0.01:
        return
    top = 10 + 10 * math.tan(math.radians(lean_deg))
    section = manifold3d.CrossSection([[(0, 0), (10, 0), (top, 10), (0, 10)]])
    wedge = section.extrude(20).rotate((90, 0, 0))
    slope_mm2 = 20 * 10 / math.cos(math.radians(lean_deg))
    expected = slope_mm2 if lean_deg > 45 else 0
    assert PrintReport.of(mesh_of(wedge)).overhang_mm2 == pytest.approx(expected)


def test_bodies_and_holes_are_counted_over_all_bodies() -> None:
    torus = manifold3d.CrossSection.circle(2, 32).translate((8, 0)).revolve(48)
    solid = manifold3d.Manifold.compose([torus, torus.translate((30, 0, 0)), cube(5, (50, 0, 0))])
    report = PrintReport.of(mesh_of(solid))
    assert (report.is_solid, report.bodies, report.genus) == (True, 3, 2)
    for apart in (solid, manifold3d.Manifold.compose([cube(5), cube(5, (9, 0, 0))])):
        assert "separate-bodies" in PrintReport.of(mesh_of(apart)).warnings
    assert "separate-bodies" not in PrintReport.of(mesh_of(cube(5))).warnings


def test_a_body_loose_in_a_cavity_is_one_of_two() -> None:
    """Winding numbers 1, 0, 1: a rattle; and one whose inner body has a cavity with another body."""
    ball = cube(4, (8, 8, 8)) - cube(2, (9, 9, 9))
    rattle = pile(shell(), mesh_of(cube(6, (7, 7, 7))))
    nested = pile(shell(), mesh_of(ball), mesh_of(cube(1, (9.5, 9.5, 9.5))))
    for mesh, bodies, volume_mm3 in ((rattle, 2, 7216), (nested, 3, 7000 + 64 - 8 + 1)):
        report = PrintReport.of(mesh)
        assert (report.is_solid, report.bodies, report.status) == (True, bodies, "NoError")
        assert report.volume_mm3 == pytest.approx(volume_mm3)


@pytest.mark.parametrize(
    ("size_mm", "warning"),
    [
        ((300, 20, 5), "larger-than-plate"),
        ((20, 300, 5), "larger-than-plate"),
        ((20, 20, 300), "too-tall"),
        ((20, 0.5, 10), "thin-wall"),
        ((20, 20, 0.5), "thin-wall"),
        ((3, 3, 5), "small-contact"),
    ],
)
def test_each_limit_has_its_warning(size_mm: tuple[float, float, float], warning: str) -> None:
    assert warning in PrintReport.of(mesh_of(manifold3d.Manifold.cube(size_mm))).warnings


# --- thinnest wall --------------------------------------------------------------------------------


def turned_outline(points: np.ndarray, angle: float) -> np.ndarray:
    cosine, sine = math.cos(angle), math.sin(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def circle(radius: float, count: int = 200) -> np.ndarray:
    way = np.arange(count) * 2 * math.pi / count
    return radius * np.stack([np.cos(way), np.sin(way)], axis=1)


@given(st.floats(0.4, 10), ANGLES, st.booleans())
def test_wall_of_a_bar_with_square_or_round_ends(width: float, angle: float, is_round: bool) -> None:
    half = width / 2
    if is_round:
        way = np.linspace(-math.pi / 2, math.pi / 2, 40)
        cap = half * np.stack([np.cos(way), np.sin(way)], axis=1)
        end = np.array([15.0, 0.0])
        outline = np.concatenate([cap + end, -cap - end])
    else:
        outline = np.array([[-15, -half], [15, -half], [15, half], [-15, half]])
    assert thinnest_width_mm([turned_outline(outline, angle)]) == pytest.approx(width, abs=0.2)


@given(st.floats(4, 20), st.floats(0.4, 3), ANGLES)
def test_wall_of_a_ring_is_narrowest_where_its_hole_is_nearest(outer, wall, angle):
    inner = outer - 1.5 * wall - 0.5
    if inner < 1:
        return
    shift = (outer - inner - wall) * np.array([math.cos(angle), math.sin(angle)])
    hole = circle(inner)[::-1] + shift
    assert thinnest_width_mm([circle(outer), hole]) == pytest.approx(wall, abs=0.2)


@given(st.integers(0, 1000), ANGLES)
def test_rough_edges_are_no_thin_walls(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    x = np.arange(-15, 15, 0.4)
    rough = [np.convolve(rng.normal(size=len(x) + 4), np.ones(5) / 5, "valid") * 0.15 for _ in range(2)]
    lower = np.stack([x, -3 + rough[0]], axis=1)
    upper = np.stack([x, 3 + rough[1]], axis=1)[::-1]
    found = thinnest_width_mm([turned_outline(np.concatenate([lower, upper]), angle)])
    assert found == pytest.approx((rough[1] - rough[0]).min() + 6, abs=0.5)


@given(st.integers(0, 1000), st.integers(1, 300))
def test_the_thinnest_wall_does_not_depend_on_where_outlines_begin(seed: int, begun: int) -> None:
    way = np.arange(160) * 2 * math.pi / 160
    radius = 9 + np.random.default_rng(seed).normal(size=(4, 4)) @ np.cos(np.outer(np.arange(2, 6), way))
    outer = np.clip(radius[0], 6, 14)[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
    hole = circle(3, 60)[::-1] + np.array([1.0, 0.5])
    found = thinnest_width_mm([np.roll(hole, begun, axis=0), np.roll(outer, -begun, axis=0)])
    assert found == thinnest_width_mm([outer, hole])


def test_the_area_of_a_section() -> None:
    assert section_area_mm2([circle(5, 2000), circle(2, 2000)[::-1]]) == pytest.approx(math.pi * 21, rel=1e-4)
    assert thinnest_width_mm([]) == 0


# --- broken meshes --------------------------------------------------------------------------------


def box() -> Mesh:
    return mesh_of(cube())


def with_vertex(value: float) -> Mesh:
    vertices = box().vertices_m.copy()
    vertices[3, 1] = value
    return Mesh(vertices, box().faces)


def with_index(index: int) -> Mesh:
    faces = box().faces.copy()
    faces[0, 0] = index
    return Mesh(box().vertices_m, faces)


def pushed_through() -> Mesh:
    ball = mesh_of(manifold3d.Manifold.sphere(10, 32))
    vertices = ball.vertices_m.copy()
    vertices[vertices[:, 2].argmax(), 2] -= 0.025
    return Mesh(vertices, ball.faces)


def one_face_turned() -> Mesh:
    faces = box().faces.copy()
    faces[0] = faces[0, ::-1]
    return Mesh(box().vertices_m, faces)


def shell() -> Mesh:
    return mesh_of(cube(20) - cube(10, (5, 5, 5)))


BROKEN = {
    "cavities that overlap": (pile(shell(), turned(mesh_of(cube(10, (8, 8, 8))))), "overlap"),
    "a body that sticks in the wall of a cavity": (pile(shell(), mesh_of(cube(6, (11, 7, 7)))), "overlap"),
    "inside out": (turned(box()), "inside-out"),
    "hole": (Mesh(box().vertices_m, box().faces[1:]), "not-manifold"),
    "one face turned": (one_face_turned(), "not-manifold"),
    "a face twice": (Mesh(box().vertices_m, np.concatenate([box().faces, box().faces[:1]])), "not-manifold"),
    "overlapping bodies": (pile(box(), mesh_of(cube(10, (5, 5, 5)))), "overlap"),
    "the same body twice": (pile(box(), box()), "overlap"),
    "a body in a body": (pile(mesh_of(cube(20)), mesh_of(cube(5, (5, 5, 5)))), "overlap"),
    "a body that crosses itself": (pushed_through(), "self-crossing"),
    "one body inside out": (pile(mesh_of(cube(20)), turned(mesh_of(cube(5, (40, 0, 0))))), "inside-out"),
    "flat": (Mesh(box().vertices_m * [1, 1, 0], box().faces), "no-volume"),
    "two faces back to back": (Mesh(np.eye(3), np.array([[0, 1, 2], [0, 2, 1]], np.int32)), "not-manifold"),
    "NaN": (with_vertex(math.nan), "not-finite"),
    "infinite": (with_vertex(math.inf), "not-finite"),
    "index too large": (with_index(8), "index-out-of-range"),
    "index negative": (with_index(-1), "index-out-of-range"),
    "no vertices": (Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), "empty"),
    "no faces": (Mesh(box().vertices_m, np.zeros((0, 3), np.int32)), "empty"),
    "flat array": (Mesh(np.zeros(9), np.zeros(3, np.int32)), "bad-shape"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_meshes_are_reported_by_name(name: str) -> None:
    mesh, problem = BROKEN[name]
    report = PrintReport.of(mesh)
    assert (report.is_solid, report.problem) == (False, problem)
    assert problem in PROBLEMS
    assert report.detail
    assert report.warnings == ()
    if problem in ("overlap", "self-crossing"):  # the signed sum is not the enclosed volume of such bodies
        assert math.isnan(report.volume_mm3)


def test_the_message_about_a_hole_counts_its_edges() -> None:
    assert "3 edges" in str(PrintReport.of(BROKEN["hole"][0]).detail)


# --- rows -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", [box(), BROKEN["hole"][0]], ids=["solid", "broken"])
def test_a_row_has_the_columns_and_types_it_promises(mesh: Mesh) -> None:
    row = PrintReport.of(mesh).to_row()
    declared = PrintReport.columns()
    assert list(row) == list(declared)
    for name, column in declared.items():
        assert pa.array([row[name]], column.data_type).to_pylist() == [pytest.approx(row[name], nan_ok=True)]


def test_warnings_of_a_row_are_words() -> None:
    row = PrintReport.of(mesh_of(manifold3d.Manifold.cube((300, 0.5, 300)))).to_row()
    assert set(row["warnings"]) <= set(WARNINGS)
    assert len(row["warnings"]) >= 2


@pytest.mark.parametrize(
    "wrong",
    [{"nozzle_mm": 0.0}, {"plate_mm": (256.0, -1.0)}, {"overhang_deg": 90.0}, {"min_wall_mm": math.nan}],
)
def test_impossible_profiles_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        PrintProfile(**wrong)
