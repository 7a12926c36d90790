"""Surfaces that cross themselves: known bodies, and random ones compared with exact arithmetic."""

from __future__ import annotations

import itertools
import math
import tracemalloc
from collections.abc import Callable
from typing import Any

import manifold3d
import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings, strategies as st

from mnist3d.digit_options import SolidSpec
from mnist3d.solid.algorithm import solidify
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.mesh import Mesh, PrintReport, crossings
from tactile_toolkit.mesh.crossings import self_crossing
from tests.tactile_toolkit.mesh.solid_files import surface_of, turned

Surface = tuple[np.ndarray, np.ndarray]


def report_of(surface: Surface) -> Any:
    return PrintReport.of(Mesh(surface[0] / 1000, surface[1].astype(np.int32)))


def tube(curve: Callable[[np.ndarray], np.ndarray], radius: float, along: int, around: int) -> Surface:
    """Sweep a circle along a closed curve in the plane z = 0."""
    middles = curve(2 * np.pi * np.arange(along) / along)
    forward = np.roll(middles, -1, axis=0) - np.roll(middles, 1, axis=0)
    aside = np.stack([forward[:, 1], -forward[:, 0], 0 * forward[:, 0]], axis=1)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    turns = 2 * np.pi * np.arange(around) / around
    rings = np.cos(turns)[:, None] * aside[:, None] + np.sin(turns)[:, None] * np.array([0, 0, 1.0])
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    here, beside = i * around + j, i * around + (j + 1) % around
    ahead, across = (i + 1) % along * around + j, (i + 1) % along * around + (j + 1) % around
    faces = np.concatenate([np.stack([here, ahead, across], -1), np.stack([here, across, beside], -1)])
    return (middles[:, None] + radius * rings).reshape(-1, 3), faces.reshape(-1, 3)


def circle(t: np.ndarray) -> np.ndarray:
    return 3 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)


def eight(t: np.ndarray) -> np.ndarray:
    return np.stack([20 * np.sin(t), 10 * np.sin(2 * t), 0 * t], axis=1)


def pushed_sphere(depth_mm: float = 25.0) -> Surface:
    vertices, faces = surface_of(manifold3d.Manifold.sphere(10, 48))
    vertices[vertices[:, 2].argmax(), 2] -= depth_mm
    return vertices, faces


SIZES = [(64, 8), (61, 9), (100, 12), (200, 16)]


@pytest.mark.parametrize(("along", "around"), SIZES)
@pytest.mark.parametrize("is_turned", [False, True])
def test_tubes_that_run_through_themselves_are_named(along: int, around: int, is_turned: bool) -> None:
    crossing = [tube(eight, 2, along, around), tube(circle, 5, along, around)]
    for vertices, faces in crossing:
        for scale in (1, 1e-4):  # triangles a micrometre wide are none too narrow where all is as small
            place = self_crossing(scale * (turned(vertices, 3) if is_turned else vertices), faces)
            assert place is not None
    report = report_of(crossing[0])
    assert (report.is_solid, report.problem) == (False, "self-crossing")
    assert math.isnan(report.volume_mm3)
    assert "crosses itself, at (" in str(report.detail)
    assert self_crossing(*tube(circle, 2, along, around)) is None


def test_a_sphere_pushed_through_its_far_side_is_named() -> None:
    report = report_of(pushed_sphere())
    assert report.problem == "self-crossing"
    assert report_of(pushed_sphere(15.0)).is_solid


def test_many_needles_that_cross_take_little_memory() -> None:
    """All of 3,006 faces meet in the middle: the boxes of millions of pairs overlap."""
    count = 501
    angles = np.arange(count) * (np.pi + 2 * np.pi / count)
    middle_mm = np.stack([50 * np.cos(angles), 50 * np.sin(angles), np.zeros(count)], axis=1)
    around_mm = np.array([[0, 0, 0.2], [0.1, 0.1, -0.1], [-0.1, -0.1, -0.1]])
    ring = np.arange(3 * count).reshape(count, 3)
    along, beside = np.roll(ring, -1, axis=0), np.roll(ring, -1, axis=1)
    across = np.roll(along, -1, axis=1)
    faces = np.concatenate([np.stack([ring, along, beside], 2), np.stack([beside, along, across], 2)])
    tracemalloc.start()
    crossing_mm = self_crossing((middle_mm[:, None] + around_mm).reshape(-1, 3), faces.reshape(-1, 3))
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert crossing_mm is not None
    assert peak_bytes < 100e6, "144 bytes and more for each pair took 650 MB"


def test_a_ring_that_lies_in_itself_is_named() -> None:
    """Every sheet lies exactly in another one, so that no edge passes through: winding numbers decide."""
    twice = tube(lambda t: circle(2 * t), 1, 64, 8)
    assert report_of(twice).problem == "self-crossing"


# --- compared with exact arithmetic ----------------------------------------------------------------------


def exact_crossing(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Test every edge against every triangle in integers, without degenerate cases."""
    points = [tuple(map(int, vertex)) for vertex in vertices.tolist()]
    edges = {tuple(sorted(pair)) for face in faces.tolist() for pair in itertools.combinations(face, 2)}

    def volume(*names: int) -> int:
        a, b, c, d = (points[name] for name in names)
        (ux, uy, uz), (vx, vy, vz), (wx, wy, wz) = (
            tuple(x - y for x, y in zip(other, a, strict=True)) for other in (b, c, d)
        )
        return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)

    for p, q in edges:
        for a, b, c in faces.tolist():
            if {p, q} & {a, b, c} or volume(a, b, c, p) * volume(a, b, c, q) >= 0:
                continue
            sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)]
            if all(side > 0 for side in sides) or all(side < 0 for side in sides):
                return True
    return False


BALL = trimesh.creation.icosphere(subdivisions=1, radius=1.0)


@settings(max_examples=settings.default.max_examples // 5)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 1.4))
def test_pushed_balls_cross_where_whole_numbers_say_so(seed: int, push: float) -> None:
    rng = np.random.default_rng(seed)
    vertices = turned(np.asarray(BALL.vertices), seed)
    moved = rng.choice(len(vertices), 2, replace=False)
    vertices[moved] -= push * (1 + rng.random((2, 1))) * vertices[moved]
    vertices = np.rint(vertices * 2000 + rng.normal(size=vertices.shape) * 20)
    found = self_crossing(vertices, np.asarray(BALL.faces)) is not None
    assert found == exact_crossing(vertices, np.asarray(BALL.faces))


@settings(max_examples=settings.default.max_examples // 5)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3), st.floats(15.0, 30.0))
def test_turning_and_scaling_change_nothing(seed: int, scale: float, depth_mm: float) -> None:
    assume(abs(depth_mm - 20) > 0.05)
    vertices, faces = pushed_sphere(depth_mm)
    moved = turned(vertices, seed) * scale + scale * np.random.default_rng(seed).normal(size=3)
    assert (self_crossing(moved, faces) is not None) == (depth_mm > 20)


# --- no false alarm -------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [SolidSpec(), SolidSpec(profile="linear", target_vertices=2000)])
def test_digits_cross_nowhere_by_proof_and_by_trial(spec: SolidSpec) -> None:
    source = SyntheticSource(seed=5)
    for number in range(6):
        mesh = solidify(source.image(number * 101).pixels, spec)
        vertices, faces = mesh.vertices_m.astype(float) * 1000, mesh.faces.astype(np.int64)
        if spec.profile == "round":  # the others may be decimated, which leaves no halves to compare
            assert len(crossings.faces_not_proven_free(vertices, faces)) < 500
        assert self_crossing(vertices, faces) is None
        assert crossings._crossing_among(vertices, faces, np.arange(len(faces))) is None


@settings(max_examples=settings.default.max_examples // 5)
@given(st.integers(0, 10**6))
def test_digits_that_are_tampered_with_are_found_through_the_proof(seed: int) -> None:
    """The pruning leaves out only faces that cannot cross: results equal those of a test of all faces."""
    rng = np.random.default_rng(seed)
    mesh = solidify(SyntheticSource(seed=5).image(seed % 1000).pixels, SolidSpec(target_vertices=1000))
    vertices, faces = mesh.vertices_m.astype(float) * 1000, mesh.faces.astype(np.int64)
    chosen = rng.integers(len(vertices), size=3)
    reach = rng.choice([0.5, 2.0, 8.0])
    vertices[chosen, :2] += rng.normal(size=(3, 2)) * reach
    if rng.random() < 0.5:  # else there are still two halves, and the proof is tried
        vertices[chosen, 2] += rng.normal(size=3)
    found = self_crossing(vertices, faces) is not None
    assert found == (crossings._crossing_among(vertices, faces, np.arange(len(faces))) is not None)


@pytest.mark.parametrize(
    "made",
    [
        trimesh.creation.box((1, 2, 3)),
        trimesh.creation.icosphere(subdivisions=3),
        trimesh.creation.uv_sphere(count=[32, 64]),
        trimesh.creation.cylinder(1, 10, sections=64),
        trimesh.creation.capsule(height=5, radius=1),
        trimesh.creation.cone(1, 10),
        trimesh.creation.annulus(2, 3, 1),
        trimesh.creation.torus(5, 2),
    ],
)
def test_shapes_of_trimesh_cross_nowhere(made: Any) -> None:
    for scale in (1e-3, 1.0, 1e3):
        assert self_crossing(np.asarray(made.vertices) * scale, np.asarray(made.faces)) is None


@settings(max_examples=settings.default.max_examples // 5)
@given(st.integers(0, 10**6), st.booleans())
def test_results_of_manifold3d_do_not_cross_themselves(seed: int, single: bool) -> None:
    rng = np.random.default_rng(seed)

    def part() -> Any:
        shapes = (
            manifold3d.Manifold.cube(rng.uniform(3, 9, 3).tolist()),
            manifold3d.Manifold.sphere(rng.uniform(2, 6), int(rng.integers(8, 40))),
            manifold3d.Manifold.cylinder(8, rng.uniform(1, 4), -1, 24),
        )
        shape = shapes[rng.integers(3)].rotate(rng.uniform(0, 360, 3).tolist())
        return shape.translate(rng.uniform(-3, 3, 3).tolist())

    solid = part()
    for _ in range(5):
        solid = solid + part() if rng.random() < 0.6 else solid - part()
    for body in solid.decompose():
        vertices, faces = surface_of(body)
        if single:  # as STL and our own files store them
            vertices = (vertices / 1000).astype(np.float32).astype(float) * 1000
        assert self_crossing(vertices, faces) is None


def test_bodies_that_touch_and_a_body_that_touches_itself_are_solids() -> None:
    """The rule: sheets may touch, at faces too; they cross where space is enclosed twice or inside out."""
    cube = manifold3d.Manifold.cube((10, 10, 10))
    (a, faces), (b, others) = surface_of(cube), surface_of(cube.translate((10, 2, 3)))
    assert report_of((np.concatenate([a, b]), np.concatenate([faces, others + len(a)]))).is_solid
    # A chain of cubes around a hole, two of which meet along one edge only.
    around = [(0, 0), (10, 0), (20, 0), (20, 10), (20, 20), (10, 20), (0, 20), (-10, 10)]
    chain = sum((cube.translate((x, y, 0)) for x, y in around), manifold3d.Manifold())
    assert report_of(surface_of(chain)).is_solid
    assert self_crossing(*surface_of(chain)) is None


@pytest.mark.parametrize("tip_mm", [14.0, 10.01])
def test_the_proof_keeps_faces_above_or_below_an_overhang(tip_mm: float) -> None:
    """Two cones on one rim, of which one leans over it, the second only just: there faces may cross."""
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    here, following = np.arange(24), np.roll(np.arange(24), -1)
    rim = np.stack([10 * np.cos(turn), 10 * np.sin(turn), np.zeros(24)], axis=1)
    vertices = np.concatenate([rim, [[tip_mm, 0, 5], [0, 0, -5]]])
    faces = np.concatenate(
        [
            np.stack([np.full(24, 24), here, following], axis=1),
            np.stack([np.full(24, 25), following, here], axis=1),
        ]
    )
    corners = vertices[faces]
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    odd = up * np.repeat([1, -1], 24) <= 0
    low, high = corners.min(axis=1)[:, None, :2], corners.max(axis=1)[:, None, :2]
    meets = ((low <= high.swapaxes(0, 1)) & (high >= low.swapaxes(0, 1))).all(axis=2)
    kept = crossings.faces_not_proven_free(vertices, faces)
    assert kept.tolist() == np.flatnonzero(meets[:, odd].any(axis=1)).tolist()
    assert 0 < odd.sum() < len(kept) < len(faces)


@pytest.mark.parametrize("bulge", [0.1, 0.3])
def test_two_reliefs_back_to_back_over_a_line_that_winds_twice_are_named(bulge: float) -> None:
    """All faces of each half face the same way, so only the line between the halves shows the crossing."""
    turn = np.linspace(0, 4 * np.pi, 41, endpoint=False)
    far = 10 * (1 + bulge * np.cos(turn / 2))
    rim = np.stack([far * np.cos(turn), far * np.sin(turn), np.zeros(41)], axis=1)
    here, following = np.arange(41), np.roll(np.arange(41), -1)
    faces = np.concatenate(
        [
            np.stack([np.full(41, 41), here, following], axis=1),
            np.stack([np.full(41, 42), following, here], axis=1),
        ]
    )
    surface = np.concatenate([rim, [[0, 0, 5], [0, 0, -5]]]), faces
    assert self_crossing(*surface) is not None
    assert report_of(surface).problem == "self-crossing"
