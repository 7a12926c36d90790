"""Environments with an elastic gel: the forces that they observe are those of `render_touch`."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

ap_gym = pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
import gymnasium as gym  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

import tactile_sim  # noqa: E402
from tactile_envs.entry_points import make_vector  # noqa: E402
from tactile_toolkit.errors import InputError  # noqa: E402

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

DEPTH = "TactileMNIST-Depth-train-v0"
ELASTIC = {"elastic_gel": "elastic", "press_force": 3.0, "sensor_output_size": (32, 32)}


def _touched(env, seed=3):
    """Press at the objects; return observation and info."""
    where = [np.zeros(2)] * env.num_envs
    lies = [np.array([0.0, 0.0, 0.3 * row]) for row in range(env.num_envs)]
    options = {"initial_sensor_target_pose": where, "initial_object_pose": lies}
    return env.reset(seed=seed, options=options)


@pytest.mark.parametrize(("force", "depth_m"), [(3.0, None), (None, 0.002125)])
def test_forces_and_images_are_those_of_render_touch(force, depth_m, assets):
    config = {**ELASTIC, "press_force": force, "depth_in_info": True}
    env = make_vector(DEPTH, num_envs=3, assets=assets, config=config, threads=2)
    observation, info = _touched(env)
    assert observation in env.observation_space
    assert observation["force"].dtype == np.float32
    for row, record in enumerate(env.current_data_points):
        solid = tactile_sim.Pressable.of(record, check=False)
        lies = tactile_sim.pose(z_m=-solid.foot_m, turn_rad=0.3 * row)
        pressed = tactile_sim.render_touch(
            solid,
            lies,
            tactile_sim.pose(),
            tactile_sim.center_view(32, 32),
            load=tactile_sim.GelLoad(force_n=force, depth_m=depth_m),
        )
        assert observation["force"][row] == pytest.approx(pressed.contact.force_n, abs=0.02)
        assert np.median(np.abs(info["depth"][row] - pressed.depth_m)) < 2e-6
        assert np.median(np.abs(observation["sensor_img"][row, ..., 0] - pressed.image)) < 1e-3
        assert info["sensor_pose"][row, 2, 3] == pytest.approx(pressed.sensor_z_m, abs=5e-6)
    low_m, high_m = env.sensor_pos_limits
    share = (info["sensor_pose"][:, :3, 3] - low_m) / (high_m - low_m) * 2 - 1
    np.testing.assert_allclose(observation["sensor_pos"], np.clip(share, -1, 1), atol=1e-6)


def test_the_plate_alone_and_copies(assets):
    env = make_vector(DEPTH, num_envs=2, assets=assets, config={**ELASTIC, "perturb_object_pose": False})
    away = [np.array([0.035, 0.035, 0.0])] * 2
    places = [np.array([-0.03, -0.03])] * 2
    observation, _ = env.reset(
        seed=1, options={"initial_object_pose": away, "initial_sensor_target_pose": places}
    )
    np.testing.assert_allclose(observation["force"], [[0, 0, 3], [0, 0, 3]], atol=1e-3)
    again = pickle.loads(pickle.dumps(env))
    action = env.action_space.sample()
    for one, other in zip(env.step(action)[0].values(), again.step(action)[0].values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.one_at_a_desk
def test_checkers_pass_and_other_environments_have_no_force(assets):
    single = gym.make(f"tactile_envs/{DEPTH}", assets=str(assets), config=ELASTIC)
    check_env(single.unwrapped, skip_render_check=True)
    assert "force" not in make_vector(DEPTH, assets=assets).single_observation_space.spaces


def test_sensors_that_tilt_feel_where_the_object_leans(assets):
    config = {**ELASTIC, "allow_sensor_rotation": True}
    env = make_vector(DEPTH, num_envs=2, assets=assets, config=config)
    observation, info = _touched(env)
    assert observation["force"][:, 2] == pytest.approx([3.0, 3.0], rel=0.01)
    up = info["sensor_pose"][:, :3, 2]
    assert (info["sensor_pose"][:, 2, 3] > 0).all()
    assert (up[:, 2] > 0.7).all()


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ({"press_force": 5.0}, "its gel is not elastic"),
        ({"elastic_gel": "elastic", "press_force": -1.0}, "press_force of the environment"),
        ({"elastic_gel": "soft"}, "expected none, elastic, or a JSON file"),
        ({"elastic_gel": {"hardness": 3}}, "expected a Gel, 'elastic', a JSON file"),
        ({"elastic_gel": {"poisson_ratio": 0.7}}, "poisson_ratio of the gel"),
        ({"elastic_gel": {}, "max_platform_penetration": 0.0}, "for a gel that is not elastic"),
    ],
    ids=str,
)
def test_invalid_settings_are_refused(config, told):
    with pytest.raises(InputError, match=told):
        make_vector(DEPTH, config=config)
