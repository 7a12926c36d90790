"""Properties of environments that need no published package."""

from __future__ import annotations

import copy
import pickle
import threading
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ap_gym = pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
import gymnasium as gym  # noqa: E402
import trimesh  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from hypothesis import given, strategies as st  # noqa: E402
from scipy import stats  # noqa: E402

import tactile_sim  # noqa: E402
from tactile_envs import tasks  # noqa: E402
from tactile_envs.config import Config  # noqa: E402
from tactile_envs.entry_points import make_vector  # noqa: E402
from tactile_envs.env_specs import env_specs  # noqa: E402
from tactile_toolkit.errors import InputError  # noqa: E402

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

DEPTH = "TactileMNIST-Depth-train-v0"
TASKS = (
    *(DEPTH, "TactileMNISTVolume-Depth-train-v0", "TactileMNISTCenterOfMass-Depth-train-v0"),
    *("Starstruck-Depth-train-v0", "Toolbox-Depth-v0"),
)
OTHER_FORMS = (
    *("TactileMNISTSnap-Depth-train-sparse-v0", "TactileMNISTRealSnap-train-v0"),
    "TactileMNISTVolumeRealSnap-train-v0",
)
WAY = st.floats(-1e3, 1e3, width=32)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("env_id", [*TASKS, *OTHER_FORMS])
def test_checkers_pass(env_id, assets):
    single = gym.make(f"tactile_envs/{env_id}", assets=str(assets))
    check_env(single.unwrapped, skip_render_check=True)
    assert single.unwrapped.render() is None
    assert single.spec.max_episode_steps == single.unwrapped.vector_env.config.step_limit
    for make in (gym.make_vec, ap_gym.make_vec):
        env = make(f"tactile_envs/{env_id}", num_envs=3, assets=str(assets), render_mode="rgb_array")
        assert isinstance(env, ap_gym.BaseActivePerceptionVectorEnv)
        assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        assert env.metadata["render_fps"] * env.unwrapped.config.transfer_timedelta_s == pytest.approx(1)
        assert env.spec.max_episode_steps
        observation, _ = env.reset(seed=0)
        assert observation in env.observation_space
        pictures = env.render()
        assert len(pictures) == 3
        assert all(each.shape == (240, 336, 3) and each.dtype == np.uint8 for each in pictures)
        env.close()


def test_meshes_do_not_travel_in_the_specification(assets):
    env = gym.make_vec(f"tactile_envs/{DEPTH}", num_envs=2, assets=str(assets))
    assert len(repr(env.spec.kwargs)) < 1000


def test_volumes_are_standardised_over_all_objects_and_fill_their_space():
    volumes_m3 = np.array([9.0, 1.0, 2.0, 4.0]) * 1e-6
    for which, touched in ((None, volumes_m3), (np.array([3, 3, 1]), volumes_m3[[3, 3, 1]])):
        task = tasks.Volume(volumes_m3, which)
        targets = task.targets(np.arange(len(touched)), np.empty((0, 3)))[:, 0]
        expected = stats.zmap(touched, volumes_m3)
        np.testing.assert_allclose(targets, expected, rtol=1e-5)
    ends = [task.target_space.low[0], task.target_space.high[0]]
    np.testing.assert_allclose(ends, np.sort(stats.zscore(volumes_m3))[[0, -1]], rtol=1e-5)


@pytest.fixture(scope="module")
def walked(assets: Path) -> Any:
    return {task: make_vector(task, num_envs=2, assets=assets) for task in TASKS}


@given(
    st.sampled_from(TASKS),
    st.integers(0, 2**31),
    st.lists(st.lists(WAY, min_size=6, max_size=6), max_size=40),
)
def test_observations_stay_in_their_spaces(walked, task, seed, ways):
    env = walked[task]
    env.action_space.seed(seed)
    observation, _ = env.reset(seed=seed)
    assert observation in env.observation_space
    for way in ways:
        action = env.action_space.sample()
        action["action"]["sensor_target_pos_rel"] = np.array(way, np.float32).reshape(2, 3)
        observation, reward, *_ = env.step(action)
        assert observation in env.observation_space
        assert np.isfinite(reward).all()


def test_episodes_depend_on_the_seed_but_not_on_threads(assets):
    courses = []
    for threads in (1, 3):
        before = set(threading.enumerate())
        env = make_vector(DEPTH, num_envs=5, assets=assets, threads=threads)
        observation, _ = env.reset(seed=1)
        env.action_space.seed(1)
        course = [observation]
        course += [env.step(env.action_space.sample())[0] for _ in range(20)]
        started = set(threading.enumerate()) - before
        helpers = [thread for thread in started if thread.name.startswith("ThreadPoolExecutor")]
        assert bool(helpers) == (threads > 1)
        env.close()
        assert env.closed
        assert not any(thread.is_alive() for thread in helpers)
        courses.append(course)
    for one, other in zip(*courses, strict=True):
        assert all((one[name] == other[name]).all() for name in one)


def _cloudpickled(env: Any) -> Any:
    cloudpickle = pytest.importorskip("cloudpickle", reason="cloudpickle is not installed")
    return pickle.loads(cloudpickle.dumps(env))


MADE = {
    "single": lambda **options: gym.make(f"tactile_envs/{TASKS[1]}", **options),
    "vector": lambda **options: gym.make_vec(f"tactile_envs/{TASKS[2]}", num_envs=9, **options),
    "threads": lambda **options: gym.make_vec(f"tactile_envs/{DEPTH}", num_envs=9, threads=2, **options),
}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("made", MADE)
@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env)), _cloudpickled]
)
def test_a_copy_continues_where_the_first_is(assets, copied, made):
    """In the middle of an episode, with its wrappers and with threads of its own; meshes stay on disk."""
    env = MADE[made](assets=str(assets))
    env.reset(seed=1)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(40)]
    for action in actions[:5]:
        env.step(action)
    other = copied(env)
    assert type(other) is type(env)
    assert len(pickle.dumps(env)) < 1 << 20
    for action in actions[5:]:
        (one, *outcome, _), (found, *again, _) = env.step(action), other.step(action)
        np.testing.assert_equal(found, one)
        np.testing.assert_equal(again, outcome)
    assert env.unwrapped.np_random.random() == other.unwrapped.np_random.random()
    env.close()
    assert other.reset(seed=2)
    other.close()


def test_a_single_environment_is_not_a_vector(assets):
    """TorchRL and others look for `num_envs`; attributes of the vector are available under their names."""
    single, vector = gym.make(f"tactile_envs/{DEPTH}", assets=str(assets)), make_vector(DEPTH, assets=assets)
    env = single.unwrapped
    for name in ("num_envs", "single_action_space", "autoreset_mode", "closed"):
        assert hasattr(vector, name)
        assert not hasattr(env, name)
    assert "autoreset_mode" not in env.metadata
    options = {"datapoint_idx": 3, "initial_object_pose": (0.01, -0.02, 0.5)}
    single.reset(seed=4, options=options)
    assert env.np_random_seed == 4
    assert env.vector_env.current_data_point_indices.tolist() == [3]
    (one, _), (other, _) = single.reset(seed=4), vector.reset(seed=4)
    for _ in range(18):
        np.testing.assert_equal(one, {name: values[0] for name, values in other.items()})
        action = vector.action_space.sample()
        other, *outcome, info = vector.step(action)
        nested = {"sensor_target_pos_rel": action["action"]["sensor_target_pos_rel"][0]}
        one, *result, found = single.step({"action": nested, "prediction": action["prediction"][0]})
        assert [type(each) for each in result] == [float, bool, bool]
        assert result == [values[0] for values in outcome]
        assert found.keys() == info.keys()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_step_after_the_end_is_refused_in_words(assets, threads):
    for env in (
        make_vector(DEPTH, num_envs=2, assets=assets, threads=threads),
        gym.make(f"tactile_envs/{DEPTH}", assets=str(assets), threads=threads),
    ):
        env.reset(seed=0)
        env.close()
        for call in (env.reset, lambda env=env: env.step(env.action_space.sample())):
            with pytest.raises(gym.error.ClosedEnvironmentError, match="was closed; next: make another one"):
                call()


def test_the_next_episode_may_begin_in_the_same_step(assets):
    """The touches are those of the default mode, whose resets take a separate step."""
    same, later = (
        make_vector(DEPTH, num_envs=3, assets=assets, config={"step_limit": 4}, autoreset_mode=mode)
        for mode in ("SAME_STEP", AutoresetMode.NEXT_STEP)
    )
    assert same.metadata["autoreset_mode"] is same.autoreset_mode is AutoresetMode.SAME_STEP
    np.testing.assert_equal(same.reset(seed=1), later.reset(seed=1))
    ends = 0
    for _ in range(10):
        action = same.action_space.sample()
        observation, *outcome, info = same.step(action)
        wanted, *result, other = later.step(action)
        np.testing.assert_equal(outcome, result)
        if outcome[1].any():
            ends += 1
            np.testing.assert_equal(info.pop("final_obs"), wanted)
            np.testing.assert_equal(info.pop("final_info"), other)
            for name in ("_final_obs", "_final_info"):
                np.testing.assert_array_equal(info.pop(name), True)
            first, *_, begun = later.step(action)
            np.testing.assert_equal(observation, first)
            np.testing.assert_equal(info, {**other, "sensor_pose": begun["sensor_pose"]})
        else:
            np.testing.assert_equal((observation, info), (wanted, other))
    assert ends == 2


def test_episodes_that_end_apart_begin_apart_in_the_same_step(assets):
    env = make_vector(DEPTH, num_envs=3, assets=assets, config={"step_limit": 4}, autoreset_mode="SAME_STEP")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([False, True, False])})
    for _ in range(3):
        observation, _, terminated, _, info = env.step(env.action_space.sample())
    np.testing.assert_array_equal(terminated, [True, False, True])
    np.testing.assert_array_equal(info["_final_obs"], terminated)
    np.testing.assert_array_equal(info["final_obs"]["time_step"], [1.0, 0.5, 1.0])
    np.testing.assert_array_equal(observation["time_step"], [-1.0, 0.5, -1.0])
    last, first = info["final_info"]["sensor_pose"], info["sensor_pose"]
    np.testing.assert_array_equal((last == first).all(axis=(1, 2)), ~terminated)
    for name, values in observation.items():
        np.testing.assert_array_equal(values[1], info["final_obs"][name][1])
    _, _, terminated, _, info = env.step(env.action_space.sample())
    np.testing.assert_array_equal(terminated, [False, True, False])
    assert np.isfinite(info["stats"]["scalar"]["avg_accuracy"][1])


def test_without_automatic_resets_a_step_after_the_end_is_refused(assets):
    env = make_vector(DEPTH, num_envs=2, assets=assets, config={"step_limit": 2}, autoreset_mode="Disabled")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    _, _, terminated, _, info = env.step(env.action_space.sample())
    assert terminated.all()
    assert not set(info) & {"final_obs", "final_info"}
    with pytest.raises(gym.error.ResetNeeded, match="some episodes are over; next: call reset"):
        env.step(env.action_space.sample())
    observation, _ = env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(observation["time_step"], [-1, 1])
    with pytest.raises(gym.error.ResetNeeded):
        env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([False, True])})
    assert not env.step(env.action_space.sample())[2].any()


def test_options_of_an_environment_are_known(assets):
    """Unknown options raise a TypeError as Python does: TorchRL tries `frameskip`, and then leaves it out."""
    place = {"assets": str(assets)}
    for make in (gym.make, gym.make_vec):
        with pytest.raises(TypeError, match=r"argument 'thread'; did you mean 'threads'\?; next: choose one"):
            make(f"tactile_envs/{DEPTH}", thread=2, **place)
    for name in ("num_envs", "autoreset_mode"):
        with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
            gym.make(f"tactile_envs/{DEPTH}", **{name: 1}, **place)
    with pytest.raises(InputError, match="autoreset_mode is 'never'; expected one of NEXT_STEP, "):
        gym.make_vec(f"tactile_envs/{DEPTH}", autoreset_mode="never", **place)
    own = Config(sensor_type="depth", sensor_output_size=(32, 32), step_limit=5)
    env = gym.make_vec(f"tactile_envs/{DEPTH}", num_envs=2, config=own, **place)
    assert env.unwrapped.config == own
    again = gym.make_vec(env.spec)
    assert (again.num_envs, again.unwrapped.config) == (2, own)
    assert gym.make_vec(f"tactile_envs/{DEPTH}", max_episode_steps=3, **place).spec.max_episode_steps == 3
    assert gym.make(gym.make(f"tactile_envs/{DEPTH}", **place).spec).spec.max_episode_steps == 16


def test_infos_hold_arrays_and_numbers_alone(assets):
    """Training code converts values to tensors, so there must be no objects or arrays of objects."""

    def plain(value: Any) -> None:
        for each in value.values() if isinstance(value, dict) else ():
            plain(each)
        if not isinstance(value, dict):
            assert np.asarray(value).dtype.kind in "bif"
            assert isinstance(value, (np.ndarray, int, float))

    env = make_vector(DEPTH, num_envs=3, assets=assets)
    _, info = env.reset(seed=0)
    for _ in range(env.config.step_limit):
        plain(info)
        *_, info = env.step(env.action_space.sample())
    plain(info)
    assert info["stats"]["vector"]["accuracy"].shape == (3, env.config.step_limit)
    assert info["sensor_pose"].shape == (3, 4, 4)


@pytest.mark.parametrize("env_id", [*TASKS, "Toolbox-small-Depth-sparse-v0"])
def test_same_reward_by_the_loss_function(env_id, assets):
    """`loss_fn`, which training code differentiates, returns the loss of the steps times its weight."""
    env = make_vector(env_id, num_envs=4, assets=assets, config={"step_limit": 2})
    env.reset(seed=0)
    for _ in range(2):
        action = env.action_space.sample()
        *_, info = env.step(action)
        target = info["prediction"]["target"]
        weight = target["weight"] if isinstance(target, dict) else 1.0
        given = env.loss_fn(action["prediction"], target, (4,))
        np.testing.assert_allclose(weight * info["prediction"]["loss"], given, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("task", TASKS)
def test_predictions_without_a_loss_are_refused(assets, task):
    """The published class gives a reward of NaN; here, the state is unchanged, and the episode continues."""
    env, unharmed = (make_vector(task, num_envs=2, assets=assets) for _ in range(2))
    env.action_space.seed(1)
    for each in (env, unharmed):
        each.reset(seed=1)
    action = env.action_space.sample()
    wrong = copy.deepcopy(action)
    wrong["prediction"][1, 0] = np.nan
    with pytest.raises(InputError, match="predictions hold NaN"):
        env.step(wrong)
    for wrong in (action["action"], np.zeros((2, 3)), None):
        with pytest.raises(InputError, match="does not hold 'action' and 'prediction'"):
            env.step(wrong)
    for one, other in zip(env.step(action)[:2], unharmed.step(action)[:2], strict=True):
        np.testing.assert_equal(one, other)


@pytest.mark.thorough
def test_observations_stay_unchanged_in_later_steps(assets):
    """A step does not change arrays of earlier ones; depth is that of the picture, from the camera."""
    env = make_vector(DEPTH, num_envs=2, assets=assets, config={"depth_in_info": True})
    press_m = tactile_sim.center_view().press_m
    env.action_space.seed(0)
    observation, info = env.reset(seed=0)
    kept = {**observation, "depth": info["depth"], "place": info["sensor_pose"][:, :3, 3]}
    copies, touched = {name: value.copy() for name, value in kept.items()}, 0
    for _ in range(20):
        observation, *_, info = env.step(env.action_space.sample())
        pressed = observation["sensor_img"][..., 0]
        reached = pressed < 1
        assert info["depth"][reached] == pytest.approx(press_m * (1 + pressed[reached]), rel=1e-5)
        assert (info["depth"][~reached] >= 2 * press_m * (1 - 1e-5)).all()
        touched += ((pressed > 0) & reached).sum()
    assert touched
    assert all((kept[name] == copies[name]).all() for name in kept)


def test_objects_and_places_may_be_given(assets):
    env = make_vector(DEPTH, num_envs=2, assets=assets, config={"perturb_object_pose": False})
    options = {
        "datapoint_idx": [3, None],
        "initial_object_pose": [(0.01, -0.02, 0.5), None],
        "initial_sensor_target_pose": [(0.01, -0.02, 0.0), None],
    }
    _, info = env.reset(seed=0, options=options)
    assert env.current_data_point_indices[0] == 3
    np.testing.assert_allclose(env.current_object_poses_platform_frame.translation[0, :2], (0.01, -0.02))
    np.testing.assert_allclose(info["sensor_pose"][0, :2, 3], (0.01, -0.02))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"config": {"step_limitt": 3}}, "did you mean 'step_limit'"),
        ({"config": {"step_limit": 0}}, "step_limit of the environment is 0; expected an integer from 1 to"),
        ({"config": {"snap_touch_positions": 0}}, "snap_touch_positions of the environment is 0"),
        ({"config": {"linear_acceleration": 0}}, "linear_acceleration of the environment is 0"),
        ({"config": {"sensor_output_size": (64,)}}, "expected width and height in whole pixels"),
        ({"config": {"cell_padding": (0.06, 0.0)}}, "less than half of cell_size"),
        ({"config": {"sensor_type": "eye"}}, "sensor_type of the environment is 'eye'"),
        ({"render_mode": "human"}, "expected None or 'rgb_array'"),
        *(({"num_envs": wrong}, "num_envs is ") for wrong in (0, True, 2.0, float("nan"), None, 10**18)),
        *(({"threads": wrong}, "threads is ") for wrong in (0, True, 10**7)),
        ({"num_envs": 10**5, "config": {"sensor_output_size": (640, 480)}}, "458 GiB; expected at most 32"),
        ({"config": {"transfer_timedelta_s": 0}}, "transfer_timedelta_s of the environment is 0"),
        ({"config": {"snap_touch_positions": 10**9}}, "snap_touch_positions of the environment is"),
        ({"config": {"cell_size": (1e9, 1e9)}}, "cell_size of the environment is"),
        ({"config": {"perturb_object_pose": "no"}}, "perturb_object_pose .* 'no'; expected True or False"),
        ({"config": ["step_limit"]}, "expected a mapping of settings, or a Config"),
        ({"config": Config(step_limit=3)}, "sensor_type of `config` is 'taxim'; the id has 'depth'"),
    ],
)
def test_invalid_settings_are_named(assets, options, words):
    with pytest.raises(InputError, match=words):
        make_vector(DEPTH, assets=assets, **options)


def test_invalid_actions_and_options_of_a_reset_are_named(assets):
    env = make_vector(DEPTH, num_envs=2, assets=assets)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(env.action_space.sample())
    env.reset(seed=0)
    action = env.action_space.sample()
    for number in (np.nan, np.inf):
        action["action"]["sensor_target_pos_rel"][0, 0] = number
        with pytest.raises(ValueError, match="NaN"):
            env.step(action)
    for name, places in {
        "initial_object_pose": [(0.0, 0.0), (0.0, 0.0, np.nan)],
        "initial_sensor_target_pose": [(0.0,), (np.inf, 0.0)],
    }.items():
        for place in places:
            with pytest.raises(InputError, match=f"option '{name}'.*expected [23] numbers"):
                env.reset(options={name: [place, None]})
    with pytest.raises(InputError, match="expected metres, up to 10; next: positions are metres"):
        env.reset(options={"initial_object_pose": [[1e6, 0.0, 0.0], None]})
    for options, entries in ((count(), "more than 2"), ([1], "1")):
        with pytest.raises(InputError, match=f"'datapoint_idx' has {entries} entr.*; expected 2"):
            env.reset(options={"datapoint_idx": options})
    with pytest.raises(InputError, match="option 'datapoint' is unknown; expected datapoint_idx, "):
        env.reset(options={"datapoint": [0, 1]})
    for mask in ([True], [False, False], [1, 0], "10"):
        with pytest.raises(InputError, match="'reset_mask' is"):
            env.reset(options={"reset_mask": mask})
    action["action"]["sensor_target_pos_rel"] = np.zeros((3, 3), np.float32)
    with pytest.raises(InputError, match="shape"):
        env.step(action)


def test_a_mask_resets_some_environments_alone(assets):
    """The others observe their last touch again, continue their episode, and end later."""
    env = make_vector(DEPTH, num_envs=3, assets=assets, config={"step_limit": 4})
    before, _ = env.reset(seed=0)
    for _ in range(2):
        before, *_ = env.step(env.action_space.sample())
    mask = np.array([False, True, False])
    poses = env.current_object_poses_platform_frame.matrix
    after, info = env.reset(options={"reset_mask": mask})
    for name in ("sensor_pos", "sensor_img"):
        np.testing.assert_array_equal(after[name][~mask], before[name][~mask], name)
    np.testing.assert_array_equal(after["time_step"], [0.0, -1.0, 0.0])
    np.testing.assert_array_equal(env.current_object_poses_platform_frame.matrix[~mask], poses[~mask])
    np.testing.assert_array_equal(info["_sensor_pose"], mask)
    assert not info["sensor_pose"][~mask].any()
    ends, lengths = [], []
    for _ in range(5):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        assert not truncated.any()
        ends.append(terminated.tolist())
        if terminated.any():
            stats = info["stats"]
            np.testing.assert_array_equal(stats["_scalar"], terminated)
            np.testing.assert_array_equal(np.isnan(stats["scalar"]["avg_accuracy"]), ~terminated)
            lengths.append(stats["vector"]["accuracy"].shape)
    assert ends == [[False] * 3, (~mask).tolist(), [False] * 3, mask.tolist(), [False] * 3]
    assert lengths == [(3, 4), (3, 4)]


def test_an_action_without_a_finite_cost_is_named(assets):
    """Its square is infinite: the published class gives a reward of -inf, and does not move."""
    env = make_vector(DEPTH, num_envs=2, assets=assets)
    env.reset(seed=0)
    action = env.action_space.sample()
    action["action"]["sensor_target_pos_rel"][1, 2] = -3e38
    with pytest.raises(InputError, match=r"sensor_target_pos_rel of environment 1 is \[.*-3.*e\+38\]"):
        env.step(action)
    action["action"]["sensor_target_pos_rel"][1, 2] = -1e12
    assert np.isfinite(env.step(action)[1]).all()


@pytest.mark.parametrize("size", [[64, 48], np.array([64, 48]), (np.int64(64), 48)])
def test_a_size_of_pictures_has_one_spelling(size):
    """So equal settings compare equal, whether they come from a command line, NumPy or JSON."""
    config = Config(sensor_output_size=size)
    assert config == Config(sensor_output_size=(64, 48))
    assert [type(side) for side in config.sensor_output_size] == [int, int]


def test_meshes_of_ones_own(assets, tmp_path):
    """A folder of mesh files, or one data set of several; missing ones are named."""
    for number, side_mm in enumerate((20, 30)):
        trimesh.creation.box([side_mm, 30, 6]).export(tmp_path / f"{number}.stl")
    env = make_vector("MinecraftPose-Depth-v0", num_envs=3, assets=tmp_path)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert {record.label for record in env.current_data_points} <= {0, 1}
    # Also under an id with other classes: those of the meshes count.
    assert make_vector(DEPTH, num_envs=1, assets=tmp_path).reset(seed=0)
    one, other = (make_vector(DEPTH, assets=place) for place in (assets, assets / "mnist3d"))
    assert (one.reset(seed=0)[0]["sensor_img"] == other.reset(seed=0)[0]["sensor_img"]).all()
    with pytest.raises(InputError, match="give `assets`, a folder of meshes"):
        make_vector("Minecraft-Depth-v0")
    with pytest.raises(InputError, match="no meshes of 'minecraft' are published"):
        make_vector("Minecraft-Depth-v0", assets="published")
    with pytest.raises(InputError, match="one class"):
        make_vector("Minecraft-Depth-v0", assets=tmp_path / "0.stl")


def test_an_unwritable_cache_costs_time_alone(assets, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "file"))
    assert make_vector(DEPTH, assets=assets).reset(seed=0)


def test_ids_are_registered():
    assert all(gym.spec(f"tactile_envs/{name}").vector_entry_point for name in env_specs())
