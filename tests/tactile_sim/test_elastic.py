"""The elastic gel compared with textbooks: closed formulas, and laws that each contact obeys."""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import tactile_sim
from tactile_sim import GelLoad
from tactile_sim.elastic import layer
from tactile_toolkit.errors import InputError
from tests.tactile_sim import elastic_formulas as formulas
from tests.tactile_sim.elastic_bodies import (
    E_PA,
    FREE,
    LAYER_M,
    PIXEL_M,
    REDUCED_PA,
    area_radius_m,
    bumps,
    grid,
    grid_of,
    punch,
    punch_on_layer,
    shear_pa,
    sphere,
)
from tests.tactile_sim.elastic_reference import PlainSolver

thorough = pytest.mark.thorough


def solved(heights, pixel_m, thickness_m=LAYER_M, block_px=1, **load):
    """Press heights into a layer, which is infinitely thick for a half-space."""
    return tactile_sim.solve_contact(
        heights, pixel_m, GelLoad(**load), thickness_m=thickness_m, block_px=block_px
    )


@pytest.mark.parametrize("count", [128, pytest.param(256, marks=thorough)])
def test_sphere_on_a_half_space(count):
    radius_m, depth_m = 0.02, 1e-3
    pixel_m = 0.016 / count
    x, y = grid(count, pixel_m)
    far_m = np.hypot(x, y)
    heights = sphere(count, pixel_m, radius_m)
    contact = solved(heights, pixel_m, math.inf, depth_m=depth_m, gel=FREE)
    force_n, contact_m, peak_pa = formulas.hertz(contact.depth_m - heights.max(), radius_m, REDUCED_PA)
    assert contact.force_n[2] == pytest.approx(force_n, rel=1e-3)
    assert area_radius_m(contact.is_contact, pixel_m) == pytest.approx(contact_m, rel=0.01)
    inside, outside = far_m < 0.9 * contact_m, far_m > 1.02 * contact_m
    profile = peak_pa * np.sqrt(1 - (far_m[inside] / contact_m) ** 2)
    np.testing.assert_allclose(contact.pressure_pa[inside], profile, rtol=0.01)
    sunk_m = formulas.hertz_outside(far_m[outside], depth_m, contact_m)
    assert np.abs(contact.displacement_m[..., 2][outside] - sunk_m).max() < 1e-6


@pytest.mark.parametrize("count", [128, pytest.param(256, marks=thorough)])
def test_cone_and_punch_on_a_half_space(count):
    pixel_m, depth_m, slope = 0.01 / count, 2e-4, 0.1
    x, y = grid(count, pixel_m)
    heights = -slope * np.hypot(x, y)
    contact = solved(heights, pixel_m, math.inf, depth_m=depth_m + heights.max(), gel=FREE)
    assert contact.force_n[2] == pytest.approx(formulas.cone_force(depth_m, slope, REDUCED_PA), rel=0.005)
    flat = solved(punch(count, pixel_m, 0.004), pixel_m, math.inf, depth_m=depth_m, gel=FREE)
    assert flat.force_n[2] == pytest.approx(formulas.punch_force(depth_m, 0.004, REDUCED_PA), rel=0.01)


STIFFNESS = {
    0.3: (1.2066, 1.4726, 2.4835, 4.3532),
    0.45: (1.2523, 1.5993, 3.0914, 6.4206),
    0.49: (1.2741, 1.6638, 3.4840, 8.3370),
    0.4999: (1.2806, 1.6835, 3.6173, 9.1402),
}
"""Stiffness of a flat punch on a bonded layer, for a / h of 0.2, 0.4, 1 and 2, by Poisson's ratio: values of
another solution of Fredholm's equation."""


@pytest.mark.parametrize(
    ("poisson_ratio", "number"),
    [
        pytest.param(poisson_ratio, number, marks=[thorough] * (number != row))
        for row, poisson_ratio in enumerate(STIFFNESS)
        for number in range(4)
    ],
)
def test_punch_on_the_bonded_layer(poisson_ratio, number):
    ratio = (0.2, 0.4, 1.0, 2.0)[number]
    expected = formulas.stiffness(ratio, poisson_ratio, nodes=80)
    assert expected == pytest.approx(STIFFNESS[poisson_ratio][number], abs=6e-5)
    unit_n = 4 * shear_pa(poisson_ratio) * ratio * LAYER_M * 1e-5 / (1 - poisson_ratio)
    stiffness = punch_on_layer(ratio, poisson_ratio, 160) / unit_n
    assert stiffness == pytest.approx(expected, rel=0.01)


@given(st.floats(0.05, 8), st.sampled_from([0.0, 0.3, 0.45, 0.49, 0.4999]))
def test_response_of_the_layer_solves_its_equations_over_depth(wave, poisson_ratio):
    z, a, n, b = (
        wave * float(response[0]) for response in layer.layer_response(np.array([wave]), poisson_ratio)
    )
    assert np.abs(formulas.layer_waves(wave, poisson_ratio) - [z, a, n, n, b]).max() < 1e-9


def test_thick_layer_is_a_half_space():
    for poisson_ratio in (0.0, 0.3, 0.5):
        thick = layer.layer_response(np.array([40.0]), poisson_ratio)
        limits = (1 - poisson_ratio, 1 - poisson_ratio, (1 - 2 * poisson_ratio) / 2, 1.0)
        np.testing.assert_allclose(40 * np.ravel(thick), limits, atol=1e-15)
    shape, pixel_m = (20, 30), (2e-4, 1e-4)
    near = layer.pixel_kernels(shape, pixel_m, 1.0, 0.49, math.inf)
    far = layer.pixel_kernels(shape, pixel_m, 1.0, 0.49, 10.0)
    for name in layer.NAMES:
        assert np.abs(near[name] - far[name]).max() < 1e-3 * np.abs(near["zz"]).max()


def response_to_smooth_load(poisson_ratio, count=64, width_m=2e-3):
    """Return displacements by a bell of pressure and of traction along x: by kernels, and by waves."""
    pixel_m = 0.02 / count
    solver = PlainSolver((count, count), (pixel_m, pixel_m), tactile_sim.Gel(E_PA, poisson_ratio), LAYER_M)
    x, y = grid(count, pixel_m)
    load = np.exp(-(x**2 + y**2) / (2 * width_m**2))[::-1]
    moved = solver.tangential(load.astype(complex))
    ours = (solver.normal(load), solver.sideways(load).real, moved.real, moved.imag)
    # A periodic window, so large that its neighbours are far away.
    wide = 8 * count
    padded = np.zeros((wide, wide))
    padded[:count, :count] = load
    k_x, k_y = np.meshgrid(*[2 * np.pi * np.fft.fftfreq(wide, pixel_m)] * 2)
    k = np.hypot(k_x, k_y)
    k[0, 0] = 1e-6 / LAYER_M
    z, a, n, b = (LAYER_M / shear_pa(poisson_ratio) * term for term in waves_of(k * LAYER_M, poisson_ratio))
    # Each pixel bears the same load all over.
    spectrum = (
        np.fft.fft2(padded) * np.sinc(k_x * pixel_m / (2 * np.pi)) * np.sinc(k_y * pixel_m / (2 * np.pi))
    )
    along, across = (k_x / k) ** 2, (k_y / k) ** 2
    answers = (z, 1j * n * k_x / k, a * along + b * across, (a - b) * k_x * k_y / k**2)
    return zip(ours, [np.fft.ifft2(spectrum * term).real[:count, :count] for term in answers], strict=True)


def waves_of(waves, poisson_ratio):
    return layer.layer_response(np.maximum(waves, 1e-3), poisson_ratio)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
def test_pixel_kernels_add_up_to_the_response_to_a_smooth_load(poisson_ratio):
    for ours, waves in response_to_smooth_load(poisson_ratio):
        assert np.abs(ours - waves).max() < 6e-3 * np.abs(waves).max()


@pytest.mark.parametrize("share", [0.5, pytest.param(0.2, marks=thorough), pytest.param(0.8, marks=thorough)])
def test_slide_of_a_sphere(share):
    """Partial slip; Mindlin neglects the traction across the slide, so the tolerance holds for nu = 0.5."""
    count, radius_m, force_n = 192, 0.02, 0.5
    gel = tactile_sim.Gel(E_PA, 0.5, 0.4)
    contact_m = (3 * force_n * radius_m * (1 - 0.25) / (4 * E_PA)) ** (1 / 3)
    pixel_m = 2.4 * contact_m / count
    slide_m, inner = formulas.mindlin_slide(share, 0.4, force_n, contact_m, gel.shear_modulus_pa, 0.5)
    contact = solved(
        sphere(count, pixel_m, radius_m), pixel_m, math.inf, force_n=force_n, slide_m=(slide_m, 0), gel=gel
    )
    assert contact.force_n[0] == pytest.approx(share * 0.4 * force_n, rel=0.01)
    assert contact.force_n[1] == pytest.approx(0.0, abs=1e-4)
    assert area_radius_m(contact.is_stick, pixel_m) == pytest.approx(inner * contact_m, rel=0.02)


@pytest.mark.parametrize(
    "inner", [0.6, 0.02, pytest.param(0.5, marks=thorough), pytest.param(0.8, marks=thorough)]
)
def test_twist_of_a_sphere(inner):
    count, radius_m, force_n = 128, 0.02, 0.5
    gel = tactile_sim.Gel(E_PA, 0.5, 0.4)
    contact_m = (3 * force_n * radius_m * (1 - 0.25) / (4 * E_PA)) ** (1 / 3)
    pixel_m = 2.4 * contact_m / count
    twist, torque_n_m = formulas.lubkin(inner, 0.4, force_n, contact_m, gel.shear_modulus_pa)
    contact = solved(
        sphere(count, pixel_m, radius_m), pixel_m, math.inf, force_n=force_n, twist_rad=twist, gel=gel
    )
    assert contact.torque_n_m[2] == pytest.approx(torque_n_m, rel=0.01)
    if inner >= 0.5:
        assert area_radius_m(contact.is_stick, pixel_m) == pytest.approx(inner * contact_m, rel=0.02)
    if inner < 0.1:
        assert torque_n_m == pytest.approx(3 * math.pi * 0.4 * force_n * contact_m / 16, rel=0.01)


STICKY = tactile_sim.Gel(poisson_ratio=0.0, friction=1000.0)
MOTIONS = st.tuples(st.floats(-5e-4, 5e-4), st.floats(-5e-4, 5e-4), st.floats(-0.1, 0.1))


@settings(max_examples=12)
@given(st.integers(0, 999), st.floats(0.2, 8), st.sampled_from([0.0, 0.3, 0.8]), MOTIONS)
def test_each_contact_obeys_the_laws(seed, force_n, friction, motion):
    heights, gel = bumps(seed), tactile_sim.Gel(friction=friction)
    contact = solved(heights, PIXEL_M, force_n=force_n, slide_m=motion[:2], twist_rad=motion[2], gel=gel)
    pressure, traction, moved = contact.pressure_pa, contact.traction_pa, contact.displacement_m
    gap_m = moved[..., 2] - (contact.depth_m - (heights.max() - heights))
    assert pressure.min() >= 0
    assert gap_m.min() >= 0
    np.testing.assert_array_equal(gap_m[contact.is_contact], 0)
    assert (pressure[~contact.is_contact] == 0).all()
    size = np.hypot(*np.moveaxis(traction, 2, 0))
    assert (size <= friction * pressure * (1 + 1e-5)).all()
    assert (contact.is_stick <= contact.is_contact).all()
    if friction == 0:
        assert not contact.is_stick.any()
    # Where it sticks, the gel follows the body.
    x, y = grid_of(heights.shape)
    motion_m = np.stack([motion[0] - motion[2] * y, motion[1] + motion[2] * x], 2)
    largest = max(np.abs(motion_m).max(), np.abs(moved[..., :2]).max())
    if contact.is_stick.any():
        assert np.abs(moved[..., :2] - motion_m)[contact.is_stick].max() < 0.03 * largest
    # Where it slips, it is dragged along.
    behind_m = motion_m - moved[..., :2]
    slips = contact.is_contact & ~contact.is_stick & (np.hypot(*np.moveaxis(behind_m, 2, 0)) > 0.03 * largest)
    assert ((traction * behind_m).sum(2)[slips] >= 0).all()
    # Force and torque are the sums of what acts on the pixels.
    area = PIXEL_M[0] * PIXEL_M[1]
    loads = np.dstack([traction, pressure]) * area
    assert contact.force_n[2] == pytest.approx(force_n, rel=1e-5)
    np.testing.assert_allclose(contact.force_n, loads.sum((0, 1)), atol=1e-9 + 1e-6 * force_n)
    arms = np.dstack([x, y, np.zeros_like(x)])
    turned = np.cross(arms, loads).sum((0, 1))
    np.testing.assert_allclose(contact.torque_n_m, turned, atol=1e-9)
    # The work of the loads is positive.
    assert (loads * moved).sum() > 0


@settings(max_examples=8)
@given(st.integers(0, 999), MOTIONS)
def test_mirror_images_have_mirrored_results(seed, motion):
    heights, gel = bumps(seed), tactile_sim.Gel()
    (slide_x, slide_y, twist) = motion
    original = solved(heights, PIXEL_M, force_n=3.0, slide_m=(slide_x, slide_y), twist_rad=twist, gel=gel)
    mirrored = solved(
        heights[:, ::-1], PIXEL_M, force_n=3.0, slide_m=(-slide_x, slide_y), twist_rad=-twist, gel=gel
    )
    assert mirrored.depth_m == pytest.approx(original.depth_m, rel=1e-4)
    np.testing.assert_allclose(
        mirrored.displacement_m[:, ::-1] * [-1, 1, 1], original.displacement_m, atol=2e-3 * original.depth_m
    )
    np.testing.assert_allclose(np.multiply(mirrored.torque_n_m, [1, -1, -1]), original.torque_n_m, atol=3e-4)
    # Rows and columns change places, and so do x and y; turns change their sense.
    turned = solved(
        heights[::-1, ::-1].T,
        PIXEL_M[::-1],
        force_n=3.0,
        slide_m=(slide_y, slide_x),
        twist_rad=-twist,
        gel=gel,
    )
    np.testing.assert_allclose(
        turned.displacement_m[..., [1, 0, 2]].transpose(1, 0, 2)[::-1, ::-1],
        original.displacement_m,
        atol=2e-3 * original.depth_m,
    )


def test_depth_and_force_lead_to_the_same_contact():
    for friction in (0.0, 0.5):
        gel = tactile_sim.Gel(friction=friction)
        pressed = solved(bumps(3), PIXEL_M, force_n=4.0, gel=gel)
        again = solved(bumps(3), PIXEL_M, depth_m=pressed.depth_m, gel=gel)
        assert again.depth_m == pytest.approx(pressed.depth_m, rel=1e-12)
        assert again.force_n[2] == pytest.approx(4.0, rel=2e-3)
        deeper = solved(bumps(3) + 1.0, PIXEL_M, force_n=8.0, gel=gel)
        assert deeper.depth_m > pressed.depth_m
        assert deeper.is_contact.sum() > pressed.is_contact.sum()


def test_results_depend_on_the_arguments_alone():
    def result(seed):
        contact = solved(bumps(seed), PIXEL_M, force_n=5.0, slide_m=(2e-4, 0))
        arrays = (contact.pressure_pa, contact.traction_pa, contact.displacement_m, contact.is_stick)
        return tuple(array.tobytes() for array in arrays) + contact.force_n + contact.torque_n_m

    seeds = list(range(6))
    first = [result(seed) for seed in seeds]
    assert [result(seed) for seed in reversed(seeds)] == first[::-1]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(result, seeds)) == first


@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.0), (3e-4, 0.0, 0.03)])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_displacements_are_the_response_to_the_loads(friction, motion):
    """In double precision, also where the contact states what they are."""
    heights, gel = bumps(5, (64, 86)), tactile_sim.Gel(friction=friction)
    pixel_m = (0.01888 / 86, 0.01416 / 64)
    load = GelLoad(force_n=5.0, slide_m=motion[:2], twist_rad=motion[2], gel=gel)
    contact = tactile_sim.solve_contact(heights, pixel_m, load, thickness_m=LAYER_M)
    traction = contact.traction_pa[::-1] @ [1, 1j]
    plain = PlainSolver(heights.shape, pixel_m, gel, LAYER_M)
    off_m = contact.displacement_m - plain.displacement_m(contact.pressure_pa[::-1], traction)[::-1]
    assert np.abs(off_m).mean() < 1e-7
    assert np.abs(off_m).max() < 5e-6


@pytest.mark.thorough
def test_blocks_of_pixels_are_near_the_whole():
    pixel_m = (0.01888 / 160, 0.01416 / 120)
    y, x = np.mgrid[:120, :160]
    heights = np.maximum(-(((x - 70) / 160) ** 2 + ((y - 50) / 160) ** 2) * 0.01, -2e-3)
    heights += 2e-5 * np.sin(x / 3.0) * np.cos(y / 5.0)
    whole, blocks = (solved(heights, pixel_m, force_n=5.0, block_px=size) for size in (1, 2))
    assert blocks.pressure_pa.shape == whole.pressure_pa.shape
    assert abs(blocks.depth_m - whole.depth_m) < 1e-5
    assert np.abs(blocks.displacement_m - whole.displacement_m).mean() < 3e-6
    assert blocks.force_n[2] == pytest.approx(5.0, rel=1e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"force_n": None}, "exactly one of force_n and depth_m"),
        ({"depth_m": 1e-3}, "exactly one of force_n and depth_m"),
        ({"force_n": 0.0}, "force_n is 0.0; expected a number from 1e-09 to 1e+06"),
        ({"height_m": np.zeros(5)}, "height_m has shape (5,)"),
        ({"height_m": np.full((4, 4), np.nan)}, "height_m goes from nan to nan"),
        ({"height_m": np.eye(4) * 1e9}, "height_m goes from 0 to 1e+09"),
        ({"height_m": np.eye(4) * 1j}, "is an array of complex128"),
        ({"force_n": None, "depth_m": 1e-15}, "depth_m is 1e-15"),
        ({"force_n": 1e30}, "force_n is 1e+30"),
        ({"gel": "elastic"}, "gel is 'elastic'; expected a Gel"),
        ({"thickness_m": 1e-9}, "thickness_m is 1e-09; expected a number from"),
        ({"height_m": np.zeros((4, 4)), "pixel_m": 0.005}, "are 5 mm wide; expected no more than"),
        ({"pixel_m": (1e-3, 1e-6)}, "one at most 100 times the other"),
        ({"twist_rad": math.nan}, "twist_rad is nan"),
        ({"block_px": 2.0}, "block_px is 2.0"),
        ({"pixel_m": (1e-4, 0.0)}, "pixel_m is (0.0001, 0.0)"),
        ({"pixel_m": (1e-4, 1e-4, 1e-4)}, "metres, or width and height"),
        ({"slide_m": (math.inf, 0.0)}, "slide_m is inf"),
        ({"slide_m": (0.0,)}, "expected two numbers, metres"),
        ({"block_px": 3}, "block_px is 3"),
    ],
)
def test_invalid_arguments_are_refused(change, words):
    arguments = {"height_m": bumps(1), "pixel_m": 1e-4, "thickness_m": LAYER_M, "block_px": 1}
    load = {"force_n": 1.0} | {name: value for name, value in change.items() if name not in arguments}
    arguments |= {name: value for name, value in change.items() if name in arguments}
    with pytest.raises(InputError) as caught:
        tactile_sim.solve_contact(load=GelLoad(**load), **arguments)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("height_m", "load", "thickness_m", "words"),
    [
        (1.0, GelLoad(1.2), LAYER_M, "pressed in by 0.*expected at most 0.00425 m"),
        (0.0, GelLoad(1e6), math.inf, "pressed in by .* m; expected at most 1 m"),
        (1e-5, GelLoad(depth_m=1e-5, twist_rad=-2.8, gel=STICKY), LAYER_M, "was not solved: after .* steps"),
        (1e-5, GelLoad(depth_m=2 * LAYER_M), LAYER_M, "pressed in by 0.0085 m; expected at most 0.00425 m"),
    ],
)
def test_what_is_no_solution_is_refused(height_m, load, thickness_m, words):
    heights = np.zeros((24, 32))
    heights[12, 16] = height_m
    with pytest.raises(InputError, match=words):
        tactile_sim.solve_contact(heights, 1e-4, load, thickness_m=thickness_m)


def test_a_gel_states_its_limits():
    with pytest.raises(InputError, match="poisson_ratio"):
        tactile_sim.Gel(poisson_ratio=0.51)
    with pytest.raises(InputError, match="youngs_modulus_pa"):
        dataclasses.replace(tactile_sim.Gel(), youngs_modulus_pa=0)


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (13, 14), (5, 40)], ids=str)
def test_results_of_small_windows_turn_with_them(shape):
    """A stencil reaches over three pixels, more than some windows have."""
    height_m = 1e-3 * np.random.default_rng(3).random(shape)
    original, turned = (
        solved(heights, 1e-3, force_n=1.0, slide_m=slide_m, twist_rad=0.02)
        for heights, slide_m in ((height_m, (1e-4, 2e-4)), (height_m.T[::-1], (-2e-4, 1e-4)))
    )
    assert original.depth_m == pytest.approx(turned.depth_m, abs=1e-8)
    np.testing.assert_allclose(
        original.pressure_pa.T[::-1], turned.pressure_pa, atol=1e-3 * original.pressure_pa.max()
    )
    assert original.force_n == pytest.approx((turned.force_n[1], -turned.force_n[0], 1.0), abs=1e-3)
    assert original.torque_n_m[2] == pytest.approx(turned.torque_n_m[2], abs=1e-6)


@pytest.mark.parametrize("depth_m", [2e-5, 4e-4])
def test_a_press_to_a_depth_has_that_depth_even_on_blocks(depth_m):
    """A steep cone: the highest mean of a block lies 0.06 mm below the tip."""
    side = (np.arange(64) - 31.5) * 1e-4
    cone_m = -np.hypot(*np.meshgrid(side, side)) / 2
    contact = solved(cone_m, 1e-4, depth_m=depth_m, block_px=4)
    assert contact.depth_m == depth_m
    assert contact.displacement_m[..., 2].max() == pytest.approx(depth_m, abs=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.24])
def test_a_sphere_on_an_incompressible_layer(share):
    """Garcia and Garcia, Biophysical Journal 114, 2018: force over that of Hertz, by sqrt(R d) / h."""
    radius_m = 0.01
    depth_m = (share * LAYER_M) ** 2 / radius_m
    pixel_m = 4 * share * LAYER_M / 120
    side = (np.arange(120) - 59.5) * pixel_m
    ball_m = -(side[:, None] ** 2 + side**2) / (2 * radius_m)
    gel = tactile_sim.Gel(poisson_ratio=0.5, friction=0.0)
    on_layer, on_half_space = (
        solved(ball_m, pixel_m, thickness_m, depth_m=depth_m, gel=gel).force_n[2]
        for thickness_m in (LAYER_M, math.inf)
    )
    series = 1 + 1.133 * share + 1.497 * share**2 + 1.469 * share**3 + 0.755 * share**4
    assert on_layer / on_half_space == pytest.approx(series, rel=3e-3)
