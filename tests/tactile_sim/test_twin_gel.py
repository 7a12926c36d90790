"""The gel of a twin and its response: kernels against plain numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import tactile_sim
from tactile_sim.twin import gel, gel_kernels, surface_kernels, view_kernels
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.recordings import shrunk
from tests.tactile_sim.made_up_twin import (
    HALF_M,
    SHAPE,
    hills,
    made_up_twin,
    response_of,
    terms_of,
    without,
)


def test_a_relief_is_sampled_under_a_turned_sensor():
    """A slanting plane, turned, off the middle."""
    slope, level, turn = np.array([0.3, -0.2]), 0.001, 0.4
    corner, half_m = np.array([-0.02, -0.03, 5e-4, 4e-4]), 0.6 * HALF_M
    plane = np.array([[slope @ (corner[:2] + corner[2:] * (x, y)) for x in range(100)] for y in range(150)])
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) * half_m
    affine, span = np.column_stack([turned, [0.002, -0.001]]), np.array([0.9, 0.8])
    out = np.empty((12, 16))
    surface_kernels.sample_relief(out, plane.astype(np.float32), corner, affine, span, level)
    y, x = np.mgrid[11:-12:-2, -15:16:2] / [[[12]], [[16]]] * span[::-1, None, None]
    heights = np.einsum("k,kj,jrc->rc", slope, turned, np.stack([x, y])) + slope @ affine[:, 2]
    assert out == pytest.approx(np.maximum(heights - level, 0), abs=1e-8)
    assert 0 < (out > 0).mean() < 1


def test_kernels_of_the_gel_are_gaussian():
    """Half kernels sum to one over both sides, and blur as scipy does where they reach far enough."""
    half = gel.half_kernel(3.0, 100, reach=4.0)
    assert half[0] + 2 * half[1:].sum() == pytest.approx(1, abs=1e-12)
    impulse = np.zeros((41, 41))
    impulse[20, 20] = 1
    expected = ndimage.gaussian_filter1d(impulse[20], 3.0, truncate=4)
    assert half == pytest.approx(expected[20 : 20 + len(half)], abs=1e-5)
    assert len(gel.half_kernel(50.0, 12)) == 12  # never beyond the image


def test_the_optics_render_what_features_and_coefficients_give():
    """The kernel sums over all entries of a pixel, and blurs as scipy does, lens included."""
    pitch_m = 2 * HALF_M / [64, 48]
    soft = gel.gel_surface(hills(), pitch_m, SHAPE)
    twin = made_up_twin()
    terms = gel.position_terms(twin.background)
    assert terms.reshape(-1, 9) == pytest.approx(terms_of(twin.background, 64), abs=2e-3)
    seen = gel.surface_features(soft, pitch_m, SHAPE)
    plain = response_of(seen, twin.coefficients, terms.reshape(-1, 9)).reshape(48, 64, 3)
    assert np.abs(plain).max() > 10
    table = gel.response_table(twin.coefficients)
    sharp = gel.response(soft, pitch_m, without(SHAPE, Fitted.BLUR), table, terms)
    assert sharp == pytest.approx(plain, abs=1e-3)
    shape = without(SHAPE, Fitted.BLUR) + 4e-4 * (np.arange(len(SHAPE)) == Fitted.BLUR)
    sigmas = [*(4e-4 / pitch_m[::-1]), 0]
    blurred = ndimage.gaussian_filter(plain, sigmas, mode="mirror", truncate=3)
    assert gel.response(soft, pitch_m, shape, table, terms) == pytest.approx(
        blurred, abs=5e-3 * np.abs(blurred).max()
    )


def test_slopes_exactly_along_an_axis_have_an_entry():
    """The direction of a slope along x is the first one, not the one after the last."""
    pitch_m, (rows, columns) = np.array([3e-4, 3e-4]), (20, 30)
    coefficients = made_up_twin().coefficients
    terms = gel.position_terms(np.full((rows, columns, 3), 90, np.float32))
    along = np.arange(columns) * 1e-4 - 0.004
    for soft in (np.tile(along, (rows, 1)), np.tile(along[:rows, None], (1, columns))):
        soft = soft.astype(np.float32)
        for turned in (soft, np.ascontiguousarray(soft[::-1, ::-1])):
            seen = gel.surface_features(turned, pitch_m, SHAPE)
            plain = response_of(seen, coefficients, terms.reshape(-1, 9)).reshape(rows, columns, 3)
            sharp = without(SHAPE, Fitted.BLUR)
            table = gel.response_table(coefficients)
            assert gel.response(turned, pitch_m, sharp, table, terms) == pytest.approx(plain, abs=0.02)


def lamps_of(soft: np.ndarray, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """From each pixel to each lamp, (H, W, lamps, 3), and the shares of the lamps, (H, W, lamps)."""
    rows, columns = soft.shape
    _, shares = gel.surface_features(soft, np.array([pitch, pitch]), without(SHAPE, Fitted.LENS))
    ring = SHAPE[Fitted.LAMP_DISTANCE] * np.hypot(columns, rows) * pitch / 2
    turns = 2 * np.pi * np.arange(gel_kernels.AZIMUTHS) / gel_kernels.AZIMUTHS
    turn = np.repeat(turns, len(gel_kernels.HEIGHTS))
    height = np.tile(SHAPE[Fitted.LAMP_HEIGHT] * gel_kernels.HEIGHTS, gel_kernels.AZIMUTHS)
    lamps = ring * np.stack([np.cos(turn), np.sin(turn), height], axis=1)
    y, x = np.mgrid[(rows - 1) / 2 : -rows / 2 : -1, -(columns - 1) / 2 : columns / 2] * pitch
    pixels = np.stack([x, y, -soft.astype(float)], axis=2)
    return (lamps - pixels[:, :, None]) / ring, shares[:, gel_kernels.SLOPED :].reshape(rows, columns, -1)


def sent(to: np.ndarray) -> np.ndarray:
    """The light that lamps, which face the middle, send to pixels, over that ahead, (H, W, lamps)."""
    turn = np.repeat(np.arange(gel_kernels.AZIMUTHS), len(gel_kernels.HEIGHTS)) * 2 * np.pi
    turn = turn / gel_kernels.AZIMUTHS
    ahead = to[..., 0] * np.cos(turn) + to[..., 1] * np.sin(turn)
    sine = np.sqrt(1 - ahead**2 / (to**2).sum(axis=-1))
    return 1 - SHAPE[Fitted.LOBE] * sine**2


def at_rest(to: np.ndarray, soft: np.ndarray, pitch: float) -> np.ndarray:
    """The light of lamps on gel at rest, (H, W, lamps), from the vectors of :func:`lamps_of`."""
    ring = SHAPE[Fitted.LAMP_DISTANCE] * np.hypot(*soft.shape) * pitch / 2
    level = to + np.array([0.0, 0.0, 1.0]) * (-soft.astype(float) / ring)[:, :, None, None]
    return sent(level) * level[..., 2] / np.linalg.norm(level, axis=-1) ** 3


def test_lamps_shine_as_lamberts_law_says():
    """On slopes without shadows, light is the cosine over the square of the distance, less that at rest.

    Lamps send less of it to the side.
    """
    pitch = 3e-4
    y, x = np.mgrid[-1:1:48j, -1:1:64j]
    soft = np.float32(-4e-4 * np.exp(-2 * (x - 0.2) ** 2 - 3 * (y + 0.1) ** 2))
    to, shares = lamps_of(soft, pitch)
    down, right = np.gradient(-soft.astype(float), pitch)
    normal = np.stack([-right, down, np.ones_like(down)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    light = np.einsum("hwi,hwli->hwl", normal, to) / np.linalg.norm(to, axis=-1) ** 3 * sent(to)
    expected = light - at_rest(to, soft, pitch)
    inside = (slice(2, -2), slice(2, -2))
    assert np.abs(expected[inside]).max() > 0.1
    assert shares[inside] == pytest.approx(expected[inside], abs=3e-3)


def test_light_is_lost_behind_what_rises_above_the_ray_of_a_lamp():
    """Beside a wall, all light of a lamp behind it is lost, and none beyond its shadow."""
    rows, columns, pitch = 41, 96, 1e-4
    wall_m, foot = 1.2e-3, 30
    soft = np.zeros((rows, columns), np.float32)
    soft[:, :foot] = -wall_m
    to, shares = lamps_of(soft, pitch)
    rest = at_rest(to, soft, pitch)
    away_m = (np.arange(columns) - foot + 0.5) * pitch
    behind = gel_kernels.AZIMUTHS // 2  # the wall is on the left, and this lamp straight behind it
    row = rows // 2
    for height in range(len(gel_kernels.HEIGHTS)):
        lamp = behind * len(gel_kernels.HEIGHTS) + height
        tangent = to[row, :, lamp, 2] / np.abs(to[row, :, lamp, 0])
        inside = (away_m > 3 * pitch) & (away_m < 0.7 * wall_m / (tangent + 0.1))
        assert inside.sum() > 5
        assert shares[row, inside, lamp] == pytest.approx(-rest[row, inside, lamp], abs=1e-3)
        assert shares[row, away_m > 1.3 * wall_m / tangent, lamp] == pytest.approx(0.0, abs=1e-3)
        assert shares[row, foot + 2 :, height] == pytest.approx(0.0, abs=1e-3)  # of the lamp on the right


@pytest.mark.parametrize("fade_m", [-8e-4, 0.0, 8e-4])
def test_half_of_a_lamp_is_hidden_by_what_reaches_its_fade_above_its_middle(fade_m: float):
    """Shadows of a wall begin farther away, or nearer, than on the ray from its edge to the lamp."""
    rows, columns, pitch, foot, wall_m = 21, 96, 1e-4, 30, 1.2e-3
    soft = np.zeros((rows, columns), np.float32)
    soft[:, :foot] = -wall_m
    view = gel.view_of(soft.shape, np.full(2, pitch), without(SHAPE, Fitted.LENS))
    view = view._replace(ring=0.012, lamp_height=4e-3, fade=fade_m)
    reaches_m = pitch * np.arange(1, 80)
    height = 3
    lamp = np.array([gel_kernels.AZIMUTHS // 2 * len(gel_kernels.HEIGHTS) + height])  # behind the wall
    walled, bare = (
        gel_kernels.lamp_light(surface, surface, view, reaches_m, lamp)[rows // 2, foot + 1 : -1, 0, 2]
        for surface in (soft, np.zeros_like(soft))
    )
    column = np.arange(foot + 1, columns - 1)
    from_lamp_m = 0.012 + (column - (columns - 1) / 2) * pitch
    over_m = (
        wall_m * from_lamp_m / ((column - foot + 1) * pitch)
    )  # where the ray over the edge meets the lamp
    half_m = np.interp(0.5, walled / bare, over_m)
    assert half_m == pytest.approx(gel_kernels.HEIGHTS[height] * 4e-3 + fade_m, abs=1.5e-4)


def test_light_is_lost_in_small_windows_as_if_their_edge_went_on():
    """A window that is smaller than the reach of a shadow needs no map of that size."""
    rng = np.random.default_rng(0)
    soft = ndimage.gaussian_filter(rng.normal(0, 4e-4, (24, 36)), 3).astype(np.float32)
    light = []
    for surface in (soft, np.pad(soft, 80, mode="edge")):
        view = gel.view_of(surface.shape, np.array([2e-5, 3e-5]), without(SHAPE, Fitted.LENS))
        near = view._replace(ring=1e-3, lamp_height=4e-4, fade=4e-5)
        light.append(
            gel_kernels.lamp_light(surface, surface, near, np.geomspace(1e-4, 6e-3, 5), np.arange(9))
        )
    small, inner = light[0][1:-1, 1:-1], light[1][81:-81, 81:-81]  # slopes at an edge are those of one side
    assert np.ptp(small[..., 3]) > 0.5
    assert small == pytest.approx(inner, abs=1e-3)


@pytest.mark.parametrize(("value", "size"), [(Fitted.LENS, 0.06), (Fitted.CAMERA, 28.0)])
def test_slopes_that_a_camera_sees_are_those_of_the_gel(value: Fitted, size: float):
    """A plane keeps its slope wherever a lens or a pinhole near it shows it."""
    pitch_m, margin = np.array([1.2e-4, 1.2e-4]), 12
    y, x = np.mgrid[36 + margin : -36 - margin : -1, -48 - margin : 48 + margin].astype(float) * 1.2e-4
    flat, bent = without(SHAPE, Fitted.LENS), without(SHAPE, Fitted.LENS)
    bent[value] = size
    seen = gel.seen_through((0.3 * x - 0.2 * y).astype(np.float32), pitch_m, bent, margin)
    steepness = slice(0, 4, 2)  # first entries of both directions
    plane = np.ascontiguousarray((0.3 * x - 0.2 * y)[12:-12, 12:-12])
    entries, straight = gel.surface_features(plane.astype(np.float32), pitch_m, flat)
    found, shares = gel.surface_features(seen, pitch_m, bent)
    inside = np.zeros(seen.shape, bool)
    inside[2:-2, 2:-2] = True
    inside = inside.ravel()
    assert (found[inside][:, steepness] == entries[inside][0, steepness]).all()
    assert np.abs(shares[inside][:, steepness] - straight[inside][:, steepness]).max() < 0.02
    _, shares = gel.surface_features(seen, pitch_m, flat)  # without the correction
    assert np.abs(shares[inside][:, steepness] - straight[inside][:, steepness]).max() > 0.05


@pytest.mark.parametrize(("value", "size"), [(Fitted.LENS, 0.06), (Fitted.CAMERA, 28.0)])
def test_shadows_fall_as_on_the_gel_however_a_camera_sees_it(value: Fitted, size: float):
    """Light goes straight: pixels have the light of the points that they see, though walls look moved."""
    pitch_m, margin = np.full(2, 1.2e-4), 12
    row, column = np.mgrid[-47.5:48, -59.5:60]
    away_m = 1.2e-4 * np.hypot(column, 1.3 * row)
    hill = (-1.2e-3 * np.exp(-0.5 * ((away_m - 3.6e-3) / 7e-4) ** 2)).astype(np.float32)
    straight, bent = without(SHAPE, Fitted.LENS), without(SHAPE, Fitted.LENS)
    bent[value] = size
    lamps = gel_kernels.ALL_LAMPS[::7]
    seen = gel.seen_through(hill, pitch_m, bent, margin)
    on_gel, _ = gel._lamp_light(hill[12:-12, 12:-12].copy(), pitch_m, straight, lamps)
    light, _ = gel._lamp_light(seen, pitch_m, bent, lamps)
    row, column = np.mgrid[-35.5:36, -47.5:48]
    bend = 1 + bent[Fitted.LENS] * (row * row + column * column) / 60**2
    bend = bend * (1 + bent[Fitted.CAMERA] * seen)
    at = [row * bend + 35.5, column * bend + 47.5]
    expected = [ndimage.map_coordinates(on_gel[..., k, 2], at, order=1) for k in range(len(lamps))]
    inside = (slice(8, -8), slice(8, -8))
    off, seen_off = (
        np.abs(values[..., 2] - np.stack(expected, axis=2))[inside].mean()
        for values in (light, gel._lamp_light(seen, pitch_m, straight, lamps)[0])
    )
    assert off < 0.5 * seen_off


def test_entries_of_a_slope_follow_its_direction_and_steepness():
    """Shares of planes in all directions add up, and their entries are where arc tangents say."""
    pitch_m = np.array([3e-4, 3e-4])
    y, x = np.mgrid[9:-9:-1, -9:10].astype(float) * 3e-4
    for angle in np.linspace(0.05, 2 * np.pi, 17):
        steep = 0.1 + 0.05 * angle
        soft = np.float32(steep * (np.cos(angle) * x + np.sin(angle) * y) - 0.01)
        entries, shares = gel.surface_features(soft, pitch_m, without(SHAPE, Fitted.LENS))
        entry, share = entries[9 * 19 + 9], shares[9 * 19 + 9].astype(float)
        assert share[:4].sum() == pytest.approx(1, abs=1e-5)
        first, step = divmod(entry[0] // gel_kernels.TERMS, view_kernels.STEPS)
        found = (first + share[2:4].sum()) * 2 * np.pi / view_kernels.TURNS
        assert np.cos(found - angle) > np.cos(0.006)
        half = np.tan(np.arctan(steep) / 2) / view_kernels.STEEPEST
        assert step + share[[1, 3]].sum() == pytest.approx((view_kernels.STEPS - 1) * np.sqrt(half), abs=1e-3)


@pytest.mark.parametrize("sides", [(12, 20), (13, 23), (12, 20, 3)])
@pytest.mark.parametrize("factor", [1, 2, 4])
def test_shrunk_images_are_means_over_blocks(sides: tuple[int, ...], factor: int):
    """Bright pixels of uint8 do not overflow, and what fills no block is left out."""
    image = np.random.default_rng(0).integers(200, 256, sides).astype(np.uint8)
    small = shrunk(image, factor)
    assert small.shape == (sides[0] // factor, sides[1] // factor, *sides[2:])
    for row, column in np.ndindex(small.shape[:2]):
        block = image[row * factor : (row + 1) * factor, column * factor : (column + 1) * factor]
        assert small[row, column] == pytest.approx(block.mean(axis=(0, 1)), abs=1e-3)


def test_a_gel_at_rest_does_not_respond():
    """Where the gel is level, there are no shares, and the kernel of the optics writes zeros."""
    entries, shares = gel.surface_features(np.zeros((20, 30), np.float32), np.array([1e-4, 1e-4]), SHAPE)
    assert entries.shape == (600, gel_kernels.SLOPED + gel_kernels.LAMPS)
    assert not shares.any()


@pytest.mark.parametrize("sigma_px", [3.0, 5.0, 9.0, 20.0])
def test_wide_blurs_on_smaller_maps_are_gaussian(sigma_px: float):
    """A blur of the gel is scipy's to a thousandth, on a smaller map too."""
    gel_map = np.zeros((150, 211), np.float32)
    gel_map[60:100, 80:120] = -1.0
    expected = ndimage.gaussian_filter(gel_map, sigma_px, truncate=4, mode="mirror")
    surface_kernels.soften(gel_map, gel_map, gel.gel_blur(np.full(2, sigma_px), gel_map.shape), 0)
    assert np.abs(gel_map - expected).max() < 1e-3


def test_normal_equations_are_those_of_the_dense_matrix():
    """Sums of the kernels equal products of the matrix whose columns are images of single coefficients."""
    rng = np.random.default_rng(1)
    pitch_m = 2 * HALF_M / [64, 48]
    seen = gel.surface_features(gel.gel_surface(hills(), pitch_m, SHAPE), pitch_m, SHAPE)
    met = np.unique(seen[0][seen[1] != 0])
    # Directions that are neighbours across the whole turn, and lamps.
    sloped = met[met < gel_kernels.SLOPES * gel_kernels.TERMS]
    slopes = np.add.outer([*sloped[:6], *sloped[-6:]], np.arange(gel_kernels.TERMS))
    at = np.unique([*slopes.ravel(), *met[-8:]])
    terms = gel.position_terms(made_up_twin().background)
    dense = []
    for coefficient in at:
        single = np.zeros((gel_kernels.COEFFICIENTS, 3))
        single[coefficient, 0] = 1
        dense.append(response_of(seen, single, terms.reshape(-1, 9))[:, 0])
    matrix = np.array(dense).T
    weights = rng.uniform(0, 1, (48, 64)).astype(np.float32)
    columns = rng.normal(size=(48, 64, 2)).astype(np.float32)
    normal = np.zeros((gel_kernels.COEFFICIENTS, gel_kernels.COEFFICIENTS))
    products = np.zeros((gel_kernels.COEFFICIENTS, 2))
    gel_kernels.add_normal(normal, *seen, terms, weights)
    gel_kernels.add_products(products, *seen, terms, (weights[..., None] * columns).astype(float))
    weighed = matrix * weights.reshape(-1, 1)
    half = 2 * weighed[::2].T @ matrix[::2]  # every second pixel counts twice
    assert normal[np.ix_(at, at)] == pytest.approx(np.tril(half), abs=1e-5)
    assert np.abs(half[54:, :54]).max() > 1e-3
    assert products[at] == pytest.approx(weighed.T @ columns.reshape(-1, 2), abs=1e-5)


def test_an_elastic_gel_is_a_solved_layer():
    """It is a finer solution to a twentieth, with sides that blocks do not fill, and rises beside it."""
    pitch, gel_m, press_m = 1e-4, 4e-3, 1.4e-3
    y, x = np.mgrid[-6.4e-3:6.4e-3:127j, -8e-3:8e-3:159j]
    far = np.hypot(np.maximum(np.abs(x - 0.3 * y) - 2e-3, 0), np.maximum(np.abs(y) - 1e-3, 0))
    reach = np.clip(press_m - far**2 / 2.4e-3, -3e-3, None)
    load = tactile_sim.GelLoad(depth_m=press_m, gel=tactile_sim.Gel(poisson_ratio=0.48, friction=0.0))
    solved = tactile_sim.solve_contact(reach, pitch, load, thickness_m=gel_m).displacement_m[..., 2]
    elastic, pulled = without(SHAPE, Fitted.LENS), without(SHAPE, Fitted.LENS)
    elastic[[Fitted.GEL, Fitted.LAST, Fitted.POISSON]] = gel_m, 2e-5, 0.48
    pulled[[Fitted.GEL, Fitted.LAST]] = gel_m, 2e-5
    true = np.stack(np.gradient(solved, pitch))
    errors = []
    for shape in (elastic, pulled):
        soft = -gel.gel_surface(np.maximum(reach, 0), np.array([pitch, pitch]), shape).astype(float)
        errors.append(np.sqrt(np.mean((np.stack(np.gradient(soft, pitch)) - true) ** 2) / np.mean(true**2)))
    assert errors[0] < 0.05
    assert errors[1] > 0.2
    assert solved.min() < -2e-5
    level = gel.gel_surface(np.zeros((127, 159)), np.array([pitch, pitch]), elastic)
    assert (level == 0).all()


@pytest.mark.parametrize("half_m", [2e-4, 9.4e-3, 0.09])
@pytest.mark.parametrize("gel_m", [1e-4, 1e-3, 0.05])
@pytest.mark.parametrize("poisson_ratio", [0.05, 0.499])
def test_every_elastic_gel_within_bounds_is_solved(half_m: float, gel_m: float, poisson_ratio: float):
    """Noise, a plate, a single pixel, and a picometre; no gel is pressed in more than it is thick."""
    shape = without(SHAPE, Fitted.LENS)
    shape[[Fitted.GEL, Fitted.POISSON]] = gel_m, poisson_ratio
    shape = gel.bounded(shape, half_m * np.array([1.0, 0.75]), 64)
    noise = np.random.default_rng(0).uniform(0, 0.9 * gel_m, (48, 64))
    single = np.zeros((48, 64))
    single[20, 30] = 0.5 * gel_m
    for reach in (noise, np.full((48, 64), 0.5 * gel_m), single, np.full((48, 64), 1e-12)):
        soft = gel.gel_surface(reach, np.full(2, 2 * half_m / 64), shape, 8)
        assert np.isfinite(soft).all()
        assert soft.min() >= -1.001 * shape[Fitted.GEL]


@pytest.mark.parametrize("lens", [-0.2, 0.0, 0.15])
@pytest.mark.parametrize("width_m", [2e-4, 9e-4, 4e-3])
def test_what_blurs_leave_out_is_not_seen(lens: float, width_m: float, monkeypatch):
    """The surface is the same to the bit when every blur covers all of the margin."""
    shape = SHAPE.copy()
    shape[Fitted.LENS], shape[Fitted.WIDTH] = lens, width_m
    pitch_m, margin = np.array([1.2e-4, 1.2e-4]), 19
    y, x = np.mgrid[-1:1:158j, -1:1:198j]
    solid = np.clip(0.001 - 0.002 * np.abs(x - 0.3 * y) + 2e-4 * np.sin(40 * x), 0, None)
    part = gel.gel_surface(solid, pitch_m, shape, margin)
    press_gel = surface_kernels.press_gel
    monkeypatch.setattr(
        surface_kernels, "press_gel", lambda *given: press_gel(*given[:3], (0,) * len(given[3]), *given[4:])
    )
    assert (part == gel.gel_surface(solid, pitch_m, shape, margin)).all()


def test_a_solid_goes_on_beyond_the_image():
    """A ridge that leaves the image pulls at the gel nearly as if the map were larger."""
    pitch_m, margin = np.array([3e-4, 3e-4]), 10
    y, x = np.mgrid[24 + margin : -24 - margin : -1, -32 - margin : 32 + margin] * 3e-4
    whole = np.clip(0.001 - np.abs(0.2 * x - 0.1 * y), 0, None)
    part = np.ascontiguousarray(whole[margin:-margin, margin:-margin])
    out = surface_kernels.extend(-part, 0.0, margin)
    assert (out[margin:-margin, margin:-margin] == part.astype(np.float32)).all()
    shape = without(SHAPE, Fitted.LENS)
    true = gel.gel_surface(whole, pitch_m, shape, margin)
    extended, mirrored = gel.gel_surface(out, pitch_m, shape, margin), gel.gel_surface(part, pitch_m, shape)
    assert np.abs(extended - true).mean() < 0.3 * np.abs(mirrored - true).mean()
