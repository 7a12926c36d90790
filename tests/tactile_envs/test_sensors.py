"""Environments that see through another sensor, calibrated or not."""

from __future__ import annotations

import sys

import numpy as np
import pytest

ap_gym = pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")

import tactile_sim  # noqa: E402
from tactile_envs.entry_points import make_vector  # noqa: E402
from tactile_sim.optics.taxim import taxim_package  # noqa: E402
from tactile_toolkit.errors import InputError, MissingExtraError  # noqa: E402
from tests.tactile_sim.made_up_twin import made_up_sensor  # noqa: E402

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

SIZE = (64, 48)
TAXIM, DEPTH = "TactileMNIST-train-v0", "TactileMNIST-Depth-train-v0"


def test_an_environment_sees_through_a_twin(assets, tmp_path) -> None:
    """Its images are those of the optics of the twin, for the depth that it states, also from a folder."""
    model = made_up_sensor()
    model.save(tmp_path / "mine")
    pictures = []
    for given in (model, str(tmp_path / "mine")):
        config = {"sensor_model": given, "sensor_output_size": SIZE, "depth_in_info": True}
        env = make_vector(TAXIM, num_envs=2, assets=assets, config=config)
        options = {"initial_sensor_target_pose": [np.zeros(2)] * 2}
        observation, info = env.reset(seed=3, options=options)
        pictures.append(observation["sensor_img"])
        env.close()
    np.testing.assert_array_equal(*pictures)
    view = tactile_sim.press.sensors.sensor_of_model(model, "center", SIZE)
    expected = model.optics.render(info["depth"].astype(np.float64), view, SIZE)
    assert np.abs(255 * pictures[0] - expected).max() <= 1.0
    assert np.abs(expected - model.background).mean() > 3  # something is pressed in


def test_presets_have_their_depth_and_no_images_of_others(assets) -> None:
    """The geometry is that of the preset, whose gel is taken where none is given."""
    digit = tactile_sim.SENSORS["digit"]
    config = {"sensor_model": "digit", "sensor_output_size": SIZE, "depth_in_info": True}
    env = make_vector(DEPTH, num_envs=1, assets=assets, config=config)
    _, info = env.reset(seed=1, options={"initial_sensor_target_pose": [np.zeros(2)]})
    assert info["depth"].min() == pytest.approx(digit.gel_mm / 1e3 - digit.press_m, abs=1e-5)
    env.close()
    with pytest.raises(InputError, match="'taxim' are calibrated for the GelSight Mini"):
        make_vector(TAXIM, num_envs=1, assets=assets, config=config)
    with pytest.raises(InputError, match="sensor is 'absent'; expected one of"):
        make_vector(DEPTH, num_envs=1, assets=assets, config={**config, "sensor_model": "absent"})


def test_environments_of_depth_need_no_package_of_other_optics(assets, monkeypatch) -> None:
    """`ap-gym` suffices for them; the default sensor also has optics that need the package `taxim`."""
    monkeypatch.setitem(sys.modules, "taxim", None)
    taxim_package.cache_clear()  # another test of the process may have read the package
    env = make_vector(DEPTH, num_envs=1, assets=assets)
    env.close()
    with pytest.raises(MissingExtraError, match="'taxim'"):
        make_vector(TAXIM, num_envs=1, assets=assets)
