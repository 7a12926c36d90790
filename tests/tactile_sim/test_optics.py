"""Pictures of depth maps, compared with those of the packages they come from."""

from __future__ import annotations

import numpy as np
import pytest

import tactile_sim
from tactile_sim.optics.rendering import make_optics
from tactile_toolkit.errors import InputError, MissingExtraError
from tests.tactile_sim.solids import ball, block

pytestmark = pytest.mark.sim
pytest.importorskip("taxim", reason="needs taxim, of the extra sim")


def _depths(sensor):
    """A ball, a turned block, a slanted edge and a bare plate."""
    targets = np.stack(
        [tactile_sim.pose(*place) for place in ((0, 0), (0.004, 0.001), (-0.003, 0.002), (0.04, 0))]
    )
    poses = np.stack([tactile_sim.pose(turn_rad=turn) for turn in (0.0, 0.4, 1.1, 0.0)])
    return tactile_sim.render_touch([ball(0.006), block(), block(), ball()], poses, targets, sensor).depth_m


@pytest.mark.parametrize("size", [(320, 240), (50, 40)], ids=str)
def test_taxim_equals_the_package_on_slopes_and_is_near_it_on_flat_gel(size):
    jax = pytest.importorskip("taxim.taxim_jax", reason="needs taxim with JAX, of the extra oracle")
    from taxim import CALIB_GELSIGHT_MINI

    package = jax.TaximJax(CALIB_GELSIGHT_MINI, params={"simulator": {"contact_scale": 0.6}})
    sensor = tactile_sim.center_view(*size)
    depths = _depths(sensor)
    ours = make_optics("taxim").shades(depths, sensor, size)
    assert (make_optics("taxim").render(depths, sensor, size) == np.rint(ours * np.float32(255))).all()
    for depth_m, shades in zip(depths, ours, strict=True):
        height_mm = (depth_m * 1000 - 4.25).astype(np.float32)
        # Private functions of the package give the shape of the gel, to find flat pixels.
        gel_mm, _ = package._TaximJax__compute_gel_pad_deformation(height_mm)
        steep, direction = map(np.asarray, package._TaximJax__generate_normals(-gel_mm / 0.0295))
        # At the seam of the directions, rounding decides on which side a pixel is.
        clear = (np.tan(steep) > 1e-4) & (np.abs(direction) < np.pi - 1e-5)
        sloped = clear.copy()
        for radius in range(1, 1 + max(size) // 64):  # the last filters carry colours that far
            inner = np.pad(clear, radius, constant_values=True)
            for row, column in ((0, radius), (2 * radius, radius), (radius, 0), (radius, 2 * radius)):
                sloped &= inner[row : row + size[1], column : column + size[0]]
        off = 255 * np.abs(np.asarray(package.render(height_mm)) - shades).max(axis=2)
        shadowed = size[0] > 64  # a shadow may begin at a flat pixel, in the direction of its noise
        assert np.percentile(off[sloped], 99 if shadowed else 100) < 1 if sloped.any() else True
        assert off.max() <= 26


def test_rounding_does_not_change_the_colour_of_flat_pixels():
    sensor = tactile_sim.center_view(64, 64)
    plate = np.full((1, 64, 64), sensor.press_m)
    optics = make_optics("taxim")
    first = optics.render(plate, sensor, (64, 64))
    noise = np.random.default_rng(0).uniform(-1e-12, 1e-12, plate.shape)
    assert (optics.render(plate + noise, sensor, (64, 64)) == first).all()


def test_depth_pictures_are_grey_levels_of_the_depth_image():
    sensor = tactile_sim.center_view(32, 24)
    depths = _depths(sensor)
    picture = make_optics("depth").render(depths, sensor, (32, 24))
    expected = (np.clip(depths, 0.002125, 0.00425) - 0.002125) / 0.002125 * 255
    assert np.abs(picture - expected[..., None]).max() <= 0.5 + 1e-4
    for wrong in (7.0, tactile_sim.SENSORS["digit"]):
        with pytest.raises(InputError, match="expected a Sensor, such as"):
            make_optics("depth").render(depths, wrong, (32, 24))
    assert make_optics("depth").render(depths[:0], sensor, (16, 12)).shape == (0, 12, 16, 3)


def test_invalid_optics_are_refused(monkeypatch):
    for option in ({"device": "cuda"}, {"bfloat16": True}):
        with pytest.raises(InputError, match="but the optics are 'taxim', which compute on"):
            make_optics("taxim", **option)
    with pytest.raises(InputError, match="too small; expected at least 16 x 16"):
        make_optics("taxim").depth_size(8, 64)
    monkeypatch.setattr("tactile_sim.optics.taxim.find_spec", lambda _: None)
    import tactile_sim.optics.taxim

    tactile_sim.optics.taxim.taxim_package.cache_clear()
    with pytest.raises(MissingExtraError, match=r"the extra `sim`"):
        make_optics("taxim")
