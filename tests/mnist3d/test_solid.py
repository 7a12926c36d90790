"""The solid: each published step alone, the fast method against the literal one, shapes in closed form."""

from __future__ import annotations

import hashlib
import json
import math
import pickle
import re
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import ndimage

from mnist3d.digit_options import EROSIONS, PROFILES, SolidSpec
from mnist3d.ink.binarisation import binarise, count_bodies_and_holes
from mnist3d.solid.algorithm import literal_solid, solid_steps, solidify
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import PrintReport
from tests.mnist3d.drawings import (
    DIGITS,
    ROWS,
    disc,
    drawn,
    dumbbell,
    neck_mm,
    ring,
    seven,
    six,
    size_mm,
    spiral,
    stroke,
    volume_mm3,
)
from tests.mnist3d.surface_distances import symmetric_distances_mm
from tests.real_input import needs_shared

BOTH_WAYS = pytest.mark.parametrize("method", ["fast", pytest.param("literal", marks=pytest.mark.thorough)])

# --- all steps together --------------------------------------------------------------------------------


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("method", "profile"),
    [*(("fast", profile) for profile in PROFILES), *(("literal", profile) for profile in PROFILES)],
)
def test_every_method_gives_a_solid_on_the_plate(method: Any, profile: str) -> None:
    mesh = solidify(six(), SolidSpec(profile=profile), method=method)
    report = PrintReport.of(mesh)
    assert (report.problem, report.bodies, report.genus) == (None, 1, 1)
    assert mesh.vertices_m.dtype == np.float32
    assert mesh.faces.dtype == np.int32
    assert mesh.vertices_m[:, 2].min() == 0
    assert mesh.to_trimesh().is_watertight


@pytest.mark.parametrize("pixels", [drawn(disc(60)), six(), dumbbell(0.4, 30)], ids=["disc", "six", "neck"])
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


@pytest.mark.parametrize("target", [300, 1500, 5000, 12000])
def test_the_vertex_budget_is_met(target: int) -> None:
    even, rough = (solidify(pixels, SolidSpec(target_vertices=target)) for pixels in (ring(), seven()))
    assert len(even.vertices_m) == pytest.approx(target, rel=0.15)
    # Rough outlines need more, and are decimated where they need too many.
    assert 0.5 * target < len(rough.vertices_m) <= 1.5 * target


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("width_px", [16, 26, 38, 45])
def test_heights_for_all_widths_of_ink(width_px: int) -> None:
    spec = SolidSpec()
    pixels = drawn(stroke([(200, 200), (260, 250)], width_px))
    literal = literal_solid(binarise(pixels, spec), spec, decimated=False)
    for mesh in (solidify(pixels, spec), literal):
        assert 6.0 <= size_mm(mesh)[2] <= 8.2


def test_an_upright_seven_stays_upright_and_unmirrored() -> None:
    vertices = solidify(seven(), SolidSpec()).vertices_m
    top, bottom = vertices[vertices[:, 1] > 0.024], vertices[vertices[:, 1] < -0.02]
    # The bar runs from column 150 to 330 at row 120, the foot stands at row 380 and column 220.
    assert np.ptp(top[:, 0]) > 0.03
    assert bottom[:, 0].mean() == pytest.approx((220 - 249.5) * 0.0002, abs=0.002)


def real(index: int) -> np.ndarray:
    from PIL import Image

    with Image.open(sorted(DIGITS.glob("*.png"))[index]) as image:
        return np.asarray(image)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("draw", "erosion", "mean_mm"),
    [
        *((six, erosion, 0.085) for erosion in EROSIONS),
        # Ink half as wide as that of real digits has a sharp ridge, which a lattice of this pitch smooths.
        *((partial(seven, 18), erosion, 0.085) for erosion in EROSIONS),
        *(
            pytest.param(partial(real, index), EROSIONS[0], 0.05, marks=[needs_shared, pytest.mark.thorough])
            for index in (100, 240)
        ),
    ],
)
def test_the_fast_solid_equals_the_literal_one(draw: Any, erosion: str, mean_mm: float) -> None:
    spec = SolidSpec(erosion=erosion)
    pixels = draw()
    fast = solidify(pixels, spec)
    mask = binarise(pixels, spec)
    literal = literal_solid(mask, spec, decimated=False)
    distances = symmetric_distances_mm(fast, literal, 20_000)
    assert distances.mean() <= mean_mm
    assert np.percentile(distances, 99.9) <= 0.4
    assert fast.volume_m3 == pytest.approx(literal.volume_m3, rel=0.015)
    for report in (PrintReport.of(fast), PrintReport.of(literal)):
        assert (report.bodies, report.genus) == count_bodies_and_holes(mask)


# --- images of other types --------------------------------------------------------------------------


def test_light_ink_floats_and_bool_make_the_same_solid() -> None:
    expected = solidify(six())
    floats = (six() / 255).astype(np.float32)
    for pixels in (255 - six(), floats, 1 - floats, six() > 99, six() < 99):
        found = solidify(pixels)
        assert np.array_equal(found.vertices_m, expected.vertices_m)
        assert np.array_equal(found.faces, expected.faces)


def test_a_small_image_is_resampled_or_refused_with_a_next_step() -> None:
    small = 255 - six().reshape(20, 25, 20, 25).mean(axis=(1, 3)).astype(np.uint8)
    with pytest.raises(
        ItemError, match=r"20 x 20 px, so that the solid would be 4 mm long.*leave pixel_mm out"
    ) as refused:
        solidify(small, pixel_mm=0.2)
    assert refused.value.reason == "too-small"
    report = PrintReport.of(solidify(small))
    assert (report.problem, report.bodies) == (None, 1)
    assert report.size_mm == pytest.approx(size_mm(solidify(six())), rel=0.1)


@pytest.mark.parametrize(
    ("mask", "ink", "reason"),
    [
        (ROWS < 250, "auto", "no-ink"),
        (ROWS < 200, "dark", "cut-off"),
        (~disc(60), "dark", "all-ink"),
        (disc(60), "light", "all-ink"),
    ],
)
def test_no_image_becomes_a_slab(mask: np.ndarray, ink: Any, reason: str) -> None:
    with pytest.raises(ItemError) as refused:
        solidify(drawn(mask), ink=ink)
    assert refused.value.reason == reason


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
    assert PrintReport.of(mesh).genus == 0
    assert np.abs(mesh.center_mass_m - [0, 0, 0.004]).max() < 1e-4


def test_a_linear_bar_is_a_roof() -> None:
    bar = np.zeros((500, 500), bool)
    bar[235:265, 50:450] = True
    mesh = solidify(drawn(bar), SolidSpec(profile="linear", target_vertices=20000))
    # Two roofs of 45 degrees over 6 mm x 80 mm with hipped ends.
    assert volume_mm3(mesh) == pytest.approx(2 * (3**2 * 80 - 2 / 3 * 3**3), rel=0.03)
    assert size_mm(mesh)[2] == pytest.approx(6, abs=0.4)


def test_a_ring_has_one_hole_and_the_wall_of_its_ink() -> None:
    report = PrintReport.of(solidify(ring(), SolidSpec()))
    assert (report.bodies, report.genus) == (1, 1)
    assert report.thinnest_wall_mm == pytest.approx(6.0, abs=0.2)


def test_ink_at_the_border_is_closed() -> None:
    mask = np.zeros((500, 500), bool)
    mask[:, 230:270] = True
    mesh = solidify(drawn(mask), SolidSpec())
    assert PrintReport.of(mesh).is_solid
    assert size_mm(mesh)[1] == pytest.approx(100, abs=0.3)


def test_the_size_of_the_image_moves_only_the_origin() -> None:
    small = six()[50:450, 100:400]
    whole = solidify(six(), SolidSpec())
    part = solidify(small, SolidSpec(), pixel_mm=0.2)
    assert np.array_equal(whole.faces, part.faces)
    shift = whole.vertices_m.mean(axis=0) - part.vertices_m.mean(axis=0)
    assert shift == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)


# --- ink narrower than the lattice -------------------------------------------------------------


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("angle_deg", [0, 30, 71])
@pytest.mark.parametrize("width_mm", [0.4, 0.8])
def test_the_fast_way_keeps_necks_as_wide_as_the_literal_one(width_mm: float, angle_deg: float) -> None:
    spec = SolidSpec()
    pixels = dumbbell(width_mm, angle_deg)
    fast, literal = (
        solidify(pixels, spec, pixel_mm=0.2),
        literal_solid(binarise(pixels, spec), spec, decimated=False),
    )
    assert neck_mm(fast, angle_deg) == pytest.approx(neck_mm(literal, angle_deg), abs=0.1)
    assert PrintReport.of(fast).is_solid


def test_a_whisker_is_as_long_as_it_was_drawn() -> None:
    mask = disc(40)
    mask[249:251, 285:310] = True
    mesh = solidify(drawn(mask), SolidSpec())
    assert mesh.bounds_m[1, 0] * 1000 == pytest.approx((309.5 - 249.5) * 0.2, abs=0.1)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(("gap_px", "turns"), [(2, 3), (12, 3), (3, 4)])
def test_narrow_gaps_do_not_make_the_whole_lattice_finer(gap_px: float, turns: float) -> None:
    spec = SolidSpec()
    pixels = spiral(30, gap_px, turns)
    mesh = solidify(pixels, spec)
    report = PrintReport.of(mesh)
    assert len(mesh.vertices_m) <= 1.5 * spec.target_vertices
    assert (report.problem, report.bodies, report.genus) == (
        None,
        *count_bodies_and_holes(binarise(pixels, spec)),
    )


@needs_shared
def test_nodes_that_touch_at_a_corner_are_joined_by_others() -> None:
    from PIL import Image

    # Ink on two nodes across a slanting gap, paper on the other two: the surface joins the ink.
    with Image.open(DIGITS / "0040_label0_writer6.png") as image:
        lattice, _, surface, mesh = solid_steps(binarise(np.asarray(image), SolidSpec()), SolidSpec())
    report = PrintReport.of(mesh)
    assert (report.problem, report.bodies, report.genus) == (None, 1, 1)
    assert len(lattice.rows_px) < 80
    # Not decimated: the upper half and its mirror image.
    assert len(mesh.faces) == 2 * len(surface.faces)


@BOTH_WAYS
def test_a_digit_that_needs_more_vertices_is_refused_with_their_number(method: Any) -> None:
    mask = np.pad(np.ones((170, 170), bool), 15)
    for row, column in np.ndindex(5, 5):
        mask &= ~disc(6, 40 + 30 * row, 40 + 30 * column)[:200, :200]
    mask = np.pad(mask, 30)
    pattern = (
        r"needs ([\d,]+) vertices to keep its topology .bodies: 1, holes: 25.* "
        r"raise target_vertices .--vertices. to ([\d,]+)"
    )
    with pytest.raises(ItemError, match=pattern) as refused:
        solidify(drawn(mask), SolidSpec(target_vertices=100), method=method)
    assert refused.value.reason == "vertex-budget"
    found = re.search(pattern, refused.value.message)
    assert found is not None
    enough = int(found[2].replace(",", ""))
    mesh = solidify(drawn(mask), SolidSpec(target_vertices=enough), method=method)
    assert len(mesh.vertices_m) <= 1.5 * enough


@pytest.mark.thorough
@BOTH_WAYS
def test_both_ways_keep_the_holes_of_a_sieve_or_refuse(method: Any) -> None:
    mask = np.zeros((300, 360), bool)
    mask[60:240, 60:300] = True
    rows, columns = np.mgrid[:300, :360]
    for row, column in np.ndindex(7, 12):
        mask &= np.hypot(rows - 75 - 25 * row, columns - 72 - 19.5 * column) > 5
    try:
        report = PrintReport.of(solidify(drawn(mask), SolidSpec(), method=method, ink="dark"))
        counts = report.bodies, report.genus
    except ItemError as error:
        counts = (1, 84) if error.reason in ("topology", "vertex-budget") else None
    assert counts == (1, 84)


# --- arbitrary images ------------------------------------------------------------------------------


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


@settings(max_examples=settings.default.max_examples // 2, derandomize=True)
@given(
    st.sampled_from([blobs, strokes, noise, checkerboard]),
    st.integers(0, 10_000),
    st.integers(20, 60),
    st.sampled_from(["round", "linear", "flat"]),
    st.sampled_from([0.0, 2.0]),
)
def test_any_ink_gives_a_solid_or_a_named_refusal(kind, seed, side, profile, speck_mm2):
    pixels = np.pad(drawn(kind(np.random.default_rng(seed), side)), 24, constant_values=250)
    spec = SolidSpec(
        profile=profile, min_speck_mm2=speck_mm2, min_pinhole_mm2=speck_mm2, target_vertices=2000
    )
    reason = None
    try:
        mesh = solidify(pixels, spec, pixel_mm=spec.pixel_pitch_mm)
    except ItemError as refusal:
        reason = refusal.reason
    if reason is not None:
        assert reason in ("no-ink", "vertex-budget")
        return
    report = PrintReport.of(mesh)
    assert report.problem is None, report.detail
    assert (report.bodies, report.genus) == count_bodies_and_holes(binarise(pixels, spec))


# --- specification --------------------------------------------------------------------------------


def test_a_specification_survives_a_manifest_and_pickling() -> None:
    spec = SolidSpec(profile="linear", threshold=90, lattice_pitch_mm=0.7)
    assert SolidSpec(**json.loads(json.dumps(asdict(spec)))) == spec
    assert pickle.loads(pickle.dumps(spec)) == spec


@pytest.mark.parametrize(
    "wrong",
    [
        {"profile": "pointed"},
        {"erosion": "square"},
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
def test_invalid_numbers_are_refused_by_name(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        replace(SolidSpec(), **wrong)


def test_unknown_methods_are_refused() -> None:
    with pytest.raises(InputError, match="quick"):
        solidify(six(), SolidSpec(), method="quick")


@pytest.mark.parametrize(
    ("draw", "expected"),
    [
        (six, "843abcb871fc081d"),
        (partial(dumbbell, 0.4, 30), "815b5fec4c1d80c7"),
        (seven, "1d722d76721773ec"),
    ],
    ids=["even lattice", "added nodes", "decimated"],
)
def test_the_mesh_of_a_digit_never_changes(draw: Callable[[], np.ndarray], expected: str) -> None:
    # If the solid changes, earlier data sets cannot be reproduced.
    mesh = solidify(draw(), SolidSpec(), pixel_mm=0.2)
    digest = hashlib.sha256(mesh.vertices_m.astype("<f4").tobytes() + mesh.faces.astype("<i4").tobytes())
    assert digest.hexdigest()[:16] == expected
