"""The environment in which digits are lifted: its spaces, what slips, the rule, and recordings."""

from __future__ import annotations

import numpy as np
import pytest

import realtouch
import tactile_envs
from tactile_envs.env_specs import GRASP_ID
from tactile_toolkit.errors import InputError

for module, extra in (("mujoco", "mujoco"), ("ap_gym", "envs"), ("taxim", "sim")):
    pytest.importorskip(module, reason=f"needs {module}, of the extra {extra}")

from gymnasium.utils.env_checker import check_env  # noqa: E402

pytestmark = [
    pytest.mark.mujoco,
    pytest.mark.filterwarnings("ignore:.*WARN.*:UserWarning"),
]


@pytest.fixture(scope="module")
def options(digits_set):
    return {"assets": str(digits_set.parent / "grasped")}


@pytest.fixture(scope="module", autouse=True)
def digits(options):
    """Two digits."""
    import mnist3d
    from mnist3d.sources.synthetic import SyntheticSource

    spec = mnist3d.DigitSetSpec(
        SyntheticSource(), mnist3d.SolidSpec(target_vertices=2_000), per_class=1, limit=2
    )
    mnist3d.generate(spec, f"{options['assets']}/mnist3d", ("train",))


def test_it_is_an_environment_of_gymnasium(options):
    single = tactile_envs.make_one(GRASP_ID, render_mode="rgb_array", config={"step_limit": 2}, **options)
    check_env(single, skip_render_check=True)
    observation, _ = single.reset(seed=1)
    assert observation["sensor_img"].shape == (64, 128, 3)
    assert single.render().shape == (240, 336, 3)
    (row,) = tactile_envs.ids("GraspDigit")
    assert row.observation == {name: part.shape for name, part in single.observation_space.items()}
    assert row.action == {name: part.shape for name, part in single.action_space["action"].items()}


@pytest.mark.parametrize(("grip", "is_held"), [(0.0, False), (1.0, True)])
def test_a_heavy_digit_slips_unless_the_grip_grows(options, grip, is_held):
    env = tactile_envs.make_vector(GRASP_ID, num_envs=1, config={"mass_kg": (0.08, 0.081)}, **options)
    env.reset(seed=0)
    for _ in range(31):
        observation, reward, *_ = env.step(
            {"action": {"grip": np.full((1, 1), grip)}, "prediction": np.zeros((1, 1))}
        )
    assert (reward[0] < -1) != is_held
    if is_held:
        assert observation["force"][0, 2] == pytest.approx(4.0, rel=0.01)
        assert np.hypot(*observation["force"][0, :2]) == pytest.approx(0.5 * 0.0805 * 9.81, rel=0.03)


def test_the_rule_holds_what_a_constant_grip_loses(options):
    spec = tactile_envs.EpisodeSpec(GRASP_ID, episodes=2, num_envs=2, **options)
    reports = {name: tactile_envs.evaluate(spec, name, seeds=1) for name in ("constant", "rule")}
    held = {name: report.metrics["held"].final.mean for name, report in reports.items()}
    assert held["rule"] > held["constant"]
    assert reports["rule"].metrics["grip_n"].final.mean < 2.0


def test_episodes_are_recorded_and_played_again(options, tmp_path):
    settings = {"step_limit": 3}
    spec = tactile_envs.EpisodeSpec(GRASP_ID, episodes=2, num_envs=2, settings=settings, **options)
    tactile_envs.record(spec, "random", tmp_path / "episodes")
    (episode, _) = realtouch.load(tmp_path / "episodes", split="train")
    assert episode.touch_count == 4
    assert episode.extra["in_contact"].all()
    assert episode.extra["force_n"][0, 2] == pytest.approx(0.5, rel=0.05)
    assert tactile_envs.replay(tmp_path / "episodes", **options).difference is None


def test_settings_without_effect_are_refused(options):
    with pytest.raises(InputError, match="sensor_noise of the environment has no effect on a grasp"):
        tactile_envs.make_one(GRASP_ID, config={"sensor_noise": "calibrated"}, **options)
    with pytest.raises(InputError, match="expected two numbers in ascending order"):
        tactile_envs.make_one(GRASP_ID, config={"mass_kg": (0.1, 0.01)}, **options)
    env = tactile_envs.make_one(GRASP_ID, **options)
    with pytest.raises(InputError, match="poses of digits and sensors are drawn"):
        env.reset(options={"initial_object_pose": [0.0, 0.0, 0.0]})
