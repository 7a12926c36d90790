"""The solid: each published step on its own, the fast way against the literal one, shapes in closed form."""

from __future__ import annotations

import hashlib
import math
import pickle
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from dataset_store.errors import InputError, ItemError
from dataset_store.mesh import Mesh
from mnist3d.comparison import symmetric_distances_mm
from mnist3d.distance import distance_px, signed_distance_px
from mnist3d.ink import count_bodies_and_holes
from mnist3d.printability import inspect
from mnist3d.solid import (
    SolidSpec,
    decimate,
    erode,
    erosion_radii_px,
    ink_mask,
    literal_solid,
    marching_cubes,
    mirror,
    scale,
    smooth,
    solidify,
    stack,
)

DIGITS = Path(__file__).resolve().parents[2].parent / "shared" / "digits" / "png"
ROWS, COLUMNS = np.mgrid[:500, :500]


def drawn(mask: np.ndarray) -> np.ndarray:
    return np.where(mask, 20, 250).astype(np.uint8)


def disc(radius: float, row: float = 249.5, column: float = 249.5) -> np.ndarray:
    return np.hypot(ROWS - row, COLUMNS - column) <= radius


def stroke(points: list[tuple[float, float]], width: float) -> np.ndarray:
    """A line of round pen through (row, column) points."""
    path = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(points)])
    mask = np.zeros((500, 500), bool)
    mask[tuple(np.round(path).astype(int).T)] = True
    return ndimage.distance_transform_edt(~mask) <= width / 2


def seven(width: float = 30) -> np.ndarray:
    rough = ndimage.gaussian_filter(np.random.default_rng(7).normal(size=(500, 500)), 2)
    mask = stroke([(120, 150), (120, 330), (380, 220)], width)
    edge = signed_distance_px(mask, 3, 3) + 8 * rough
    return drawn((edge > 0) & (ndimage.distance_transform_edt(~mask) < 3))


def six(width: float = 34) -> np.ndarray:
    way = np.linspace(0, 2 * np.pi, 30)
    loop = [(320 + 60 * math.sin(t), 240 + 60 * math.cos(t)) for t in way]
    return drawn(stroke(loop, width) | stroke([(110, 280), (220, 190), (320, 180)], width))


def volume_mm3(mesh: Mesh) -> float:
    return mesh.volume_m3 * 1e9


def size_mm(mesh: Mesh) -> np.ndarray:
    return np.ptp(mesh.bounds_m, axis=0) * 1000


# --- steps ----------------------------------------------------------------------------------------


@given(hnp.arrays(bool, st.tuples(st.integers(1, 25), st.integers(1, 25))), st.floats(1, 12))
def test_distance_is_exact_up_to_its_reach(mask: np.ndarray, reach: float) -> None:
    padded = np.pad(mask, 1)
    expected = np.minimum(ndimage.distance_transform_edt(padded), reach)
    assert np.allclose(distance_px(padded, reach), expected, atol=1e-5)


@given(hnp.arrays(bool, st.tuples(st.integers(3, 25), st.integers(3, 25))), st.floats(0, 8))
def test_erosion_is_binary_erosion_with_a_disc(mask: np.ndarray, radius: float) -> None:
    reach = math.ceil(radius) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    squared = y * y + x * x
    if np.isclose(np.sqrt(squared), radius + 0.5, atol=1e-5).any():
        return
    expected = ndimage.binary_erosion(mask, squared < (radius + 0.5) ** 2)
    assert np.array_equal(erode(mask, radius), expected)


def test_erosion_radii_follow_a_quarter_circle() -> None:
    radii = erosion_radii_px(SolidSpec())
    heights = np.arange(20) + 0.5
    assert np.allclose((20 - radii) ** 2 + heights**2, 20**2)
    assert (np.diff(radii) > 0).all()


def test_erosion_radii_of_the_other_profiles() -> None:
    assert np.array_equal(erosion_radii_px(SolidSpec(profile="linear")), np.arange(20) + 0.5)
    assert np.array_equal(erosion_radii_px(SolidSpec(profile="flat")), np.zeros(20))


def test_stack_and_mirror_order_the_layers() -> None:
    layers = [np.full((2, 3), k) for k in range(3)]
    assert stack(layers).shape == (2, 3, 3)
    assert mirror(stack(layers))[0, 0].tolist() == [2, 1, 0, 0, 1, 2]


def test_marching_cubes_faces_outwards() -> None:
    volume = np.zeros((6, 7, 8))
    volume[2:4, 2:5, 2:6] = 1
    vertices, faces = marching_cubes(volume, 0.5)
    assert vertices.dtype == np.float32
    assert faces.dtype == np.int32
    # A box of 2 x 3 x 4 nodes is cut at its twelve edges and eight corners.
    assert 20 < Mesh(vertices, faces).volume_m3 < 24


def test_smoothing_evens_out_and_keeps_the_volume() -> None:
    grid = np.mgrid[-12:13, -12:13, -12:13]
    vertices, faces = marching_cubes((np.sqrt((grid**2).sum(axis=0)) < 9.3).astype(float), 0.5)
    smoothed = smooth(vertices, faces, 20, 0.5)
    radii = [np.linalg.norm(v - 12, axis=1) for v in (vertices, smoothed)]
    assert radii[1].std() < 0.5 * radii[0].std()
    assert Mesh(smoothed, faces).volume_m3 == pytest.approx(Mesh(vertices, faces).volume_m3, rel=0.01)


def test_no_rounds_of_smoothing_move_nothing() -> None:
    vertices, faces = marching_cubes(np.pad(np.ones((3, 3, 3)), 1), 0.5)
    assert np.array_equal(smooth(vertices, faces, 0, 0.5), vertices)


def test_scale_puts_the_image_centre_at_the_origin_and_the_lowest_point_on_the_plate() -> None:
    corners = np.array([[0, 0, -3], [9, 0, 0], [0, 19, 2]], dtype=np.float32)
    mesh = scale(corners, np.array([[0, 1, 2]], np.int32), (10, 20), SolidSpec(vertex_quantum_mm=0))
    expected_mm = [[-1.9, 0.9, 0], [-1.9, -0.9, 0.6], [1.9, 0.9, 1.0]]
    assert np.allclose(mesh.vertices_m * 1000, expected_mm, atol=1e-6)
    assert mesh.vertices_m.dtype == np.float32


def test_decimation_keeps_to_the_budget_and_to_the_solid() -> None:
    spec = SolidSpec()
    fine = literal_solid(ink_mask(six(), spec), spec, decimated=False)
    coarse = decimate(fine, 3000)
    report = inspect(coarse)
    assert 1500 < len(coarse.vertices_m) <= 3000
    assert (report.is_solid, report.bodies, report.genus) == (True, 1, 1)
    assert coarse.volume_m3 == pytest.approx(fine.volume_m3, rel=0.03)
    assert decimate(coarse, 5000) is coarse


# --- the whole way --------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["fast", "literal"])
@pytest.mark.parametrize("profile", ["round", "linear", "flat"])
def test_every_way_gives_a_solid_on_the_plate(method: Any, profile: str) -> None:
    mesh = solidify(six(), SolidSpec(profile=profile), method=method)
    report = inspect(mesh)
    assert (report.problem, report.bodies, report.genus) == (None, 1, 1)
    assert mesh.vertices_m.dtype == np.float32
    assert mesh.faces.dtype == np.int32
    assert mesh.vertices_m[:, 2].min() == 0
    assert mesh.to_trimesh().is_watertight


@pytest.mark.parametrize("pixels", [seven(), six()], ids=["seven", "six"])
def test_the_fast_solid_is_symmetric_to_the_last_bit(pixels: np.ndarray) -> None:
    vertices = solidify(pixels, SolidSpec()).vertices_m.astype(np.float64)
    turned = vertices.copy()
    turned[:, 2] = vertices[:, 2].max() - vertices[:, 2]
    assert {tuple(v) for v in vertices} == {tuple(v) for v in turned}


def test_vertices_lie_on_the_storage_grid_and_apart() -> None:
    spec = SolidSpec()
    vertices = solidify(seven(), spec).vertices_m.astype(np.float64)
    steps = vertices * 1000 / spec.vertex_quantum_mm
    assert np.array_equal(steps, np.round(steps))
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    assert len(solidify(seven(), spec).to_trimesh().process().vertices) == len(vertices)


@pytest.mark.parametrize("target", [1500, 5000, 12000])
def test_the_vertex_budget_is_met(target: int) -> None:
    assert len(solidify(seven(), SolidSpec(target_vertices=target)).vertices_m) == pytest.approx(
        target, rel=0.1
    )


def test_a_lattice_pitch_can_be_asked_for() -> None:
    coarse, fine = (len(solidify(seven(), SolidSpec(lattice_pitch_mm=p)).vertices_m) for p in (1.0, 0.5))
    assert fine == pytest.approx(4 * coarse, rel=0.1)


@pytest.mark.parametrize("width_px", [16, 20, 26, 32, 38, 45])
def test_heights_for_all_widths_of_ink(width_px: int) -> None:
    spec = SolidSpec()
    pixels = drawn(stroke([(200, 200), (260, 250)], width_px))
    literal = literal_solid(ink_mask(pixels, spec), spec, decimated=False)
    for mesh in (solidify(pixels, spec), literal):
        assert 6.0 <= size_mm(mesh)[2] <= 8.2


def test_an_upright_seven_stays_upright_and_unmirrored() -> None:
    vertices = solidify(seven(), SolidSpec()).vertices_m
    top, bottom = vertices[vertices[:, 1] > 0.024], vertices[vertices[:, 1] < -0.02]
    # The bar runs from column 150 to 330 at row 120, the foot stands at row 380 and column 220.
    assert np.ptp(top[:, 0]) > 0.03
    assert bottom[:, 0].mean() == pytest.approx((220 - 249.5) * 0.0002, abs=0.002)


@pytest.mark.parametrize("pixels", [six(), seven(18)], ids=["6", "thin 7"])
def test_the_fast_solid_is_the_literal_one(pixels: np.ndarray) -> None:
    spec = SolidSpec()
    fast = solidify(pixels, spec)
    literal = literal_solid(ink_mask(pixels, spec), spec, decimated=False)
    distances = symmetric_distances_mm(fast, literal, 20_000)
    # Ink half as wide as that of the real digits has a sharp ridge, which a lattice of this pitch wears down.
    assert distances.mean() <= 0.085
    assert np.percentile(distances, 99.9) <= 0.4
    assert fast.volume_m3 == pytest.approx(literal.volume_m3, rel=0.015)


@pytest.mark.skipif(not DIGITS.is_dir(), reason="the real digits of ../shared/digits are not there")
@pytest.mark.parametrize("place", [100, 240])
def test_the_fast_solid_is_the_literal_one_on_real_digits(place: int) -> None:
    from PIL import Image

    with Image.open(sorted(DIGITS.glob("*.png"))[place]) as image:
        pixels = np.asarray(image)
    spec = SolidSpec()
    fast = solidify(pixels, spec)
    mask = ink_mask(pixels, spec)
    literal = literal_solid(mask, spec, decimated=False)
    distances = symmetric_distances_mm(fast, literal, 20_000)
    assert distances.mean() <= 0.05
    assert np.percentile(distances, 99.9) <= 0.4
    assert fast.volume_m3 == pytest.approx(literal.volume_m3, rel=0.015)
    for report in (inspect(fast), inspect(literal)):
        assert (report.bodies, report.genus) == count_bodies_and_holes(mask)


# --- shapes in closed form ------------------------------------------------------------------------


def test_a_disc_of_ink_becomes_a_lens_of_known_volume() -> None:
    # Turning the quarter circle of radius R about the axis of a disc of radius A >= R (Pappus): the flat
    # core, and a quarter disc whose centre of area lies 4 R / 3 pi outside of it.
    A, R = 12.0, 4.0
    core = 2 * R * math.pi * (A - R) ** 2
    rim = 2 * (math.pi * R**2 / 4) * 2 * math.pi * ((A - R) + 4 * R / (3 * math.pi))
    mesh = solidify(drawn(disc(60)), SolidSpec())
    assert volume_mm3(mesh) == pytest.approx(core + rim, rel=0.015)
    assert size_mm(mesh) == pytest.approx([24, 24, 8], abs=0.25)
    assert inspect(mesh).genus == 0
    assert np.abs(mesh.center_mass_m - [0, 0, 0.004]).max() < 1e-4


def test_a_flat_bar_is_a_box() -> None:
    bar = np.zeros((500, 500), bool)
    bar[200:300, 100:400] = True
    mesh = solidify(drawn(bar), SolidSpec(profile="flat", target_vertices=20000))
    assert volume_mm3(mesh) == pytest.approx(20 * 60 * 8, rel=0.02)
    assert size_mm(mesh) == pytest.approx([60, 20, 8], abs=0.25)


def test_a_linear_bar_is_a_roof() -> None:
    bar = np.zeros((500, 500), bool)
    bar[235:265, 50:450] = True
    mesh = solidify(drawn(bar), SolidSpec(profile="linear", target_vertices=20000))
    # Two roofs of 45 degrees over 6 mm x 80 mm with hipped ends.
    assert volume_mm3(mesh) == pytest.approx(2 * (3**2 * 80 - 2 / 3 * 3**3), rel=0.03)
    assert size_mm(mesh)[2] == pytest.approx(6, abs=0.4)


def test_a_ring_has_one_hole_and_the_wall_of_its_ink() -> None:
    report = inspect(solidify(drawn(disc(90) & ~disc(60)), SolidSpec()))
    assert (report.bodies, report.genus) == (1, 1)
    assert report.thinnest_wall_mm == pytest.approx(6.0, abs=0.2)


def test_separate_pieces_stay_apart_unless_joined() -> None:
    pixels = drawn(disc(30, 150, 250) | disc(30, 300, 250) | disc(20, 400, 100))
    assert inspect(solidify(pixels, SolidSpec())).bodies == 3
    assert inspect(solidify(pixels, SolidSpec(join_bodies=True))).bodies == 1


def test_a_gap_narrower_than_the_lattice_is_kept() -> None:
    mask = np.zeros((500, 500), bool)
    mask[100:400, 200:300] = True
    mask[:, 250:252] = False
    report = inspect(solidify(drawn(mask), SolidSpec()))
    assert (report.is_solid, report.bodies) == (True, 2)


def test_ink_at_the_border_is_closed() -> None:
    mask = np.zeros((500, 500), bool)
    mask[:, 230:270] = True
    mesh = solidify(drawn(mask), SolidSpec())
    assert inspect(mesh).is_solid
    assert size_mm(mesh)[1] == pytest.approx(100, abs=0.3)


def test_the_size_of_the_image_moves_only_the_origin() -> None:
    small = six()[50:450, 100:400]
    whole = solidify(six(), SolidSpec())
    part = solidify(small, SolidSpec())
    assert np.array_equal(whole.faces, part.faces)
    shift = whole.vertices_m.mean(axis=0) - part.vertices_m.mean(axis=0)
    assert shift == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)


# --- anything at all ------------------------------------------------------------------------------


def blobs(rng: np.random.Generator, side: int) -> np.ndarray:
    return ndimage.gaussian_filter(rng.normal(size=(side, side)), rng.uniform(1, 8)) > 0.02


def strokes(rng: np.random.Generator, side: int) -> np.ndarray:
    mask = np.zeros((side, side), bool)
    for a, b in zip(rng.uniform(0, side - 1, (5, 2)), rng.uniform(0, side - 1, (5, 2)), strict=True):
        mask[tuple(np.round(np.linspace(a, b, 2 * side)).astype(int).T)] = True
    return ndimage.distance_transform_edt(~mask) <= rng.choice([0, 1, 3, 8])


def noise(rng: np.random.Generator, side: int) -> np.ndarray:
    return rng.random((side, side)) < rng.uniform(0.05, 0.95)


def checkerboard(rng: np.random.Generator, side: int) -> np.ndarray:
    step = int(rng.integers(1, 12))
    return (np.add.outer(np.arange(side) // step, np.arange(side) // step) % 2).astype(bool)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    st.sampled_from([blobs, strokes, noise, checkerboard]),
    st.integers(0, 10_000),
    st.integers(20, 60),
    st.sampled_from(["round", "linear", "flat"]),
    st.sampled_from([0.0, 2.0]),
)
def test_any_ink_gives_a_solid_or_a_named_refusal(
    kind: Any, seed: int, side: int, profile: str, speck_mm2: float
) -> None:
    pixels = drawn(kind(np.random.default_rng(seed), side))
    spec = SolidSpec(
        profile=profile, min_speck_mm2=speck_mm2, min_pinhole_mm2=speck_mm2, target_vertices=2000
    )
    reason = None
    try:
        mesh = solidify(pixels, spec)
    except ItemError as refusal:
        reason = refusal.reason
    if reason is not None:
        assert reason in ("no-ink", "all-ink")
        return
    report = inspect(mesh)
    assert report.problem is None, report.detail
    assert (report.bodies, report.genus) == count_bodies_and_holes(ink_mask(pixels, spec))


# --- specification --------------------------------------------------------------------------------


def test_a_specification_survives_a_manifest_and_a_process_border() -> None:
    spec = SolidSpec(profile="linear", threshold=90, lattice_pitch_mm=0.7)
    assert SolidSpec.from_dict(spec.to_dict()) == spec
    assert pickle.loads(pickle.dumps(spec)) == spec


@pytest.mark.parametrize(
    "wrong",
    [
        {"profile": "pointed"},
        {"pixel_pitch_mm": 0.0},
        {"half_thickness_mm": math.nan},
        {"half_thickness_mm": 0.1},
        {"half_thickness_mm": 30.0},
        {"lattice_pitch_mm": -1.0},
        {"threshold": 300},
        {"target_vertices": 5},
        {"smoothing_factor": 1.5},
        {"smoothing_iterations": -1},
        {"vertex_quantum_mm": 0.1},
        {"min_speck_mm2": -1.0},
    ],
)
def test_numbers_that_describe_no_solid_are_refused_by_name(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        replace(SolidSpec(), **wrong)


def test_unknown_fields_and_methods_are_refused() -> None:
    with pytest.raises(InputError, match="colour"):
        SolidSpec.from_dict({"colour": "red"})
    with pytest.raises(InputError, match="quick"):
        solidify(six(), SolidSpec(), method="quick")


def test_the_mesh_of_one_digit_never_changes() -> None:
    # Sampled distances and vertices are rounded to grids far coarser than the rounding of a processor, so the
    # hash does not depend on it. It changes when the solid does: then data sets made before are others.
    mesh = solidify(six(), SolidSpec())
    digest = hashlib.sha256(mesh.vertices_m.astype("<f4").tobytes() + mesh.faces.astype("<i4").tobytes())
    assert digest.hexdigest()[:16] == "2c301d5ae49d6dce"
