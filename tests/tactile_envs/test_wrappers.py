"""Environments in the wrappers of gymnasium, of ap-gym, and of this package."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

ap_gym = pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
import gymnasium as gym  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.wrappers import vector as wrappers  # noqa: E402

import tactile_envs  # noqa: E402, F401
from tactile_envs.wrappers import FlatAction, FlatActionVector  # noqa: E402
from tactile_toolkit.errors import InputError  # noqa: E402
from tests.tactile_envs.driving import DEPTH, ENVS, drive, make  # noqa: E402

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]


def tree_map(function: Callable[[Any], Any], value: Any) -> Any:
    """Apply a function to the arrays in dictionaries."""
    if isinstance(value, dict):
        return {name: tree_map(function, part) for name, part in value.items()}
    return function(value)


def _same(observation: Any) -> Any:
    return observation


APPLY: dict[str, Callable[[Any], Any]] = {
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "TransformObservation": lambda env: wrappers.TransformObservation(env, _same),
    "VectorizeTransformObservation": lambda env: wrappers.VectorizeTransformObservation(
        env, gym.wrappers.TransformObservation, func=_same, observation_space=env.single_observation_space
    ),
    "FilterObservation": lambda env: wrappers.FilterObservation(env, ["sensor_pos", "time_step"]),
    "FlattenObservation": wrappers.FlattenObservation,
    "NormalizeObservation": lambda env: wrappers.NormalizeObservation(wrappers.FlattenObservation(env)),
    "DtypeObservation": lambda env: wrappers.DtypeObservation(wrappers.FlattenObservation(env), np.float64),
    "TransformAction": lambda env: wrappers.TransformAction(env, _same),
    "TransformReward": lambda env: wrappers.TransformReward(env, _same),
    "VectorizeTransformReward": lambda env: wrappers.VectorizeTransformReward(
        env, gym.wrappers.TransformReward, func=_same
    ),
    "ClipReward": lambda env: wrappers.ClipReward(env, -1, 1),
    "NormalizeReward": wrappers.NormalizeReward,
    "DictInfoToList": lambda env: wrappers.DictInfoToList(wrappers.RecordEpisodeStatistics(env)),
    "FlatActionVector": lambda env: wrappers.ClipAction(FlatActionVector(env)),
}
"""Of ``gymnasium.wrappers.vector``."""

APPLY_TO_ONE: dict[str, Callable[[Any], Any]] = {
    "RecordEpisodeStatistics": gym.wrappers.RecordEpisodeStatistics,
    "FlattenObservation": gym.wrappers.FlattenObservation,
    "NormalizeObservation": lambda env: gym.wrappers.NormalizeObservation(
        gym.wrappers.FlattenObservation(env)
    ),
    "FilterObservation": lambda env: gym.wrappers.FilterObservation(env, ["sensor_pos"]),
    "FrameStackObservation": lambda env: gym.wrappers.FrameStackObservation(env, 3),
    "TimeAwareObservation": gym.wrappers.TimeAwareObservation,
    "AddRenderObservation": lambda env: gym.wrappers.AddRenderObservation(env, render_only=False),
    "TimeLimit": lambda env: gym.wrappers.TimeLimit(env, 7),
    "Autoreset": gym.wrappers.Autoreset,
    "NormalizeReward": gym.wrappers.NormalizeReward,
    "FlatAction": lambda env: gym.wrappers.RescaleAction(FlatAction(env), -1.0, 1.0),
}
"""Of ``gymnasium.wrappers``."""


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", APPLY)
def test_wrappers_of_gymnasium(assets, name):
    drive(APPLY[name](make(assets)))


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", APPLY_TO_ONE)
def test_wrappers_of_a_single_one(assets, name):
    env = APPLY_TO_ONE[name](gym.make(DEPTH, assets=str(assets), render_mode="rgb_array"))
    env.action_space.seed(0)
    ends = []
    for seed in (1, 2):
        observation, _ = env.reset(seed=seed)
        assert observation in env.observation_space
        over = False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            assert observation in env.observation_space
            assert isinstance(reward, float)
            over = terminated or truncated
        ends.append(terminated)
    assert ends == [name != "TimeLimit"] * 2


def test_infos_as_lists(assets):
    """Each environment has the info of a single one: statistics if its episode is over, and no masks."""
    env = wrappers.DictInfoToList(make(assets))
    for _, _, done, infos in drive(env):
        for row, info in enumerate(infos):
            assert set(info) == {"sensor_pose", "base_reward", "prediction", *["stats"] * int(done[row])}
            assert info["sensor_pose"].shape == (4, 4)
            assert set(info["prediction"]) >= {"target", "loss"}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_tensors_of_torch(assets, mode):
    """Also infos, and actions that are tensors."""
    torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
    pytest.importorskip("array_api_compat", reason="array-api-compat (extra `test`) is not installed")
    env = wrappers.NumpyToTorch(make(assets, autoreset_mode=mode, config={"step_limit": 3}))
    single = gym.wrappers.NumpyToTorch(gym.make(DEPTH, assets=str(assets)))
    for each in (env, single):
        each.reset(seed=0)
        for _ in range(3):
            action = tree_map(torch.from_numpy, each.action_space.sample())
            observation, *_, info = each.step(action)
        assert all(isinstance(values, torch.Tensor) for values in observation.values())
        assert info["sensor_pose"].shape[-2:] == (4, 4)


@pytest.mark.parametrize(("vector", "size"), [(False, (336, 240)), (True, (672, 480))])
def test_an_episode_is_filmed(assets, tmp_path, vector, size):
    pytest.importorskip("moviepy", reason="moviepy (extra `film`) is not installed")
    options = {"assets": str(assets), "render_mode": "rgb_array", "config": {"step_limit": 4}}
    if vector:
        env = wrappers.RecordVideo(gym.make_vec(DEPTH, num_envs=4, **options), str(tmp_path))
    else:
        env = gym.wrappers.RecordVideo(gym.make(DEPTH, **options), str(tmp_path))
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    with av.open(str(next(tmp_path.glob("*.mp4")))) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert film.streams.video[0].average_rate == 5
    assert len(frames) >= 4
    assert frames[0].shape == (*size[::-1], 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


def sync(assets: Path, mode: AutoresetMode, kind: str, **options: Any) -> Any:
    """Single environments, side by side."""
    return gym.make_vec(
        DEPTH,
        num_envs=2,
        vectorization_mode=kind,
        vector_kwargs={"autoreset_mode": mode, **options},
        assets=str(assets),
        config={"step_limit": 4},
    )


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_single_ones_side_by_side(assets, mode):
    """As one by one, with the seeds of gymnasium, to the end of the episode; then by its mode."""
    env = sync(assets, mode, "sync")
    alone = [gym.make(DEPTH, assets=str(assets), config={"step_limit": 4}) for _ in range(2)]
    wanted = [each.reset(seed=7 + row)[0] for row, each in enumerate(alone)]
    observation, _ = env.reset(seed=7)
    for step in range(5):
        for row, each in enumerate(wanted):
            np.testing.assert_equal({name: values[row] for name, values in observation.items()}, each)
        if step == 4:
            break
        action = env.action_space.sample()
        observation, _, terminated, _, info = env.step(action)
        parts = [{name: part[row] for name, part in action["action"].items()} for row in range(2)]
        pairs = zip(alone, parts, action["prediction"], strict=True)
        results = [each.step({"action": part, "prediction": guess}) for each, part, guess in pairs]
        wanted = [result[0] for result in results]
        assert [result[2] for result in results] == terminated.tolist() == [step == 3] * 2
        poses = [result[-1]["sensor_pose"] for result in results]
        np.testing.assert_array_equal((info.get("final_info") or info)["sensor_pose"], poses)
        if step == 3 and mode is AutoresetMode.SAME_STEP:
            np.testing.assert_equal(list(info["final_obs"]), wanted)
            wanted = [each.reset()[0] for each in alone]


@pytest.mark.thorough
@pytest.mark.own_process
def test_single_ones_in_processes(assets):
    """The results are those of environments side by side in one process."""
    mode = AutoresetMode.SAME_STEP
    pair = [sync(assets, mode, "sync"), sync(assets, mode, "async", context="fork")]
    np.testing.assert_equal(*(env.reset(seed=7) for env in pair))
    for _ in range(6):
        action = pair[0].action_space.sample()
        one, other = (env.step(action) for env in pair)
        for *_, info in (one, other):
            info["final_obs"] = list(info.get("final_obs", ()))
        np.testing.assert_equal(one, other)
    for env in pair:
        env.close()


KINDS: dict[str, dict[str, Any]] = {
    "TactileMNIST-Depth-train-v0": {},
    "TactileMNISTVolume-Depth-train-v0": {"config": {"allow_sensor_rotation": True}},
    "TactileMNISTCenterOfMass-Depth-train-v0": {"config": {"timeout_behavior": "truncate"}},
    "TactileMNISTRealSnap-v0": {},
}


@pytest.mark.parametrize("name", KINDS)
def test_flat_actions_are_those_of_the_environment(assets, name):
    """Numbers are in the order of gymnasium, the prediction last, without scaling; touches are unchanged."""
    options = {"assets": str(assets), **KINDS[name]}
    name = f"tactile_envs/{name}"
    bare, flat = gym.make(name, **options), FlatAction(gym.make(name, **options), limit=3.0)
    bare_ones = gym.make_vec(name, num_envs=ENVS, **options)
    flat_ones = FlatActionVector(gym.make_vec(name, num_envs=ENVS, **options), limit=3.0)
    high = gym.spaces.flatten(
        bare.action_space,
        {
            "action": {key: part.high for key, part in bare.action_space["action"].items()},
            "prediction": bare.action_space["prediction"].high,
        },
    )
    np.testing.assert_array_equal(flat.action_space.high, np.where(np.isinf(high), 3, high))
    assert flat.action_space == flat_ones.single_action_space
    assert flat_ones.action_space.shape == (ENVS, len(high))
    pairs = ((bare, flat, gym.spaces.flatten), (bare_ones, flat_ones, _flattened))
    for one, other, flattened in pairs:
        one.reset(seed=3)
        observation, _ = other.reset(seed=3)
        assert observation in other.observation_space
        assert {key: part.shape[-1:] for key, part in observation.items()}.get("time_step", (1,)) == (1,)
        for _ in range(3):
            action = one.action_space.sample()
            seen, *wanted = one.step(action)
            observation, *found = other.step(flattened(one.action_space, action))
            assert observation in other.observation_space
            np.testing.assert_equal(
                {key: np.ravel(part) for key, part in observation.items()},
                {key: np.ravel(part) for key, part in seen.items()},
            )
            np.testing.assert_equal(found, wanted)
        with pytest.raises(InputError, match=rf"the action has shape \({len(high) - 1},\); expected"):
            other.step(np.zeros(len(high) - 1, np.float32))


def _flattened(_: Any, action: dict[str, Any]) -> Any:
    return np.concatenate([*action["action"].values(), action["prediction"]], axis=1)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_episodes_of_recorded_touches_end_one_by_one(assets, mode):
    """Truncated if no touches are left: each begins again according to its mode."""
    name = "tactile_envs/TactileMNISTRealSnap-v0"
    config = {"approx_truncation_probability": 0.9, "timeout_behavior": "terminate"}
    env = gym.make_vec(name, num_envs=4, assets=str(assets), config=config, autoreset_mode=mode)
    observation, _ = env.reset(seed=0)
    env.action_space.seed(0)
    over, apart = np.zeros(4, bool), 0
    for _ in range(40):
        before = observation
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        begun = over if mode is AutoresetMode.NEXT_STEP else np.zeros(4, bool)
        over = terminated | truncated
        if mode is AutoresetMode.SAME_STEP:
            np.testing.assert_array_equal(info.get("_final_obs", np.zeros(4, bool)), over)
            begun = over
        if mode is AutoresetMode.DISABLED and over.any():
            observation, _ = env.reset(options={"reset_mask": over})
            begun = over
        np.testing.assert_array_equal(observation["time_step"] == -1, begun)
        apart += over.any() and not over.all()
        assert before is not observation
    assert apart


def test_flat_actions_keep_the_mode_and_last_observations(assets):
    env = FlatActionVector(make(assets, autoreset_mode="SAME_STEP", config={"step_limit": 2}))
    assert env.autoreset_mode is AutoresetMode.SAME_STEP
    env.reset(seed=0)
    env.step(env.action_space.sample())
    observation, *_, info = env.step(env.action_space.sample())
    assert observation in env.observation_space
    assert info["final_obs"] in env.observation_space
    for limit in (0, -1.0, np.nan, np.inf, "5"):
        with pytest.raises(InputError, match=r"limit is .*; expected a positive number"):
            FlatActionVector(make(assets), limit=limit)
    with pytest.raises(InputError, match=r"expected a dictionary of boxes; next: give the environment as"):
        FlatAction(FlatAction(gym.make(DEPTH, assets=str(assets))))
    again = gym.make(FlatAction(gym.make(DEPTH, assets=str(assets)), limit=2).spec)
    assert again.action_space.high.max() == 2
    np.testing.assert_equal(copy.deepcopy(again).reset(seed=1), again.reset(seed=1))


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("name", "wrap"),
    [
        (DEPTH, ap_gym.ActivePerceptionVectorWrapper),
        (DEPTH, ap_gym.ActivePerceptionVectorLogWrapper),
        (DEPTH, ap_gym.ActiveClassificationVectorLogWrapper),
        ("tactile_envs/TactileMNISTVolume-Depth-train-v0", ap_gym.ActiveRegressionVectorLogWrapper),
        (DEPTH, lambda env: ap_gym.ActivePerceptionVectorRestoreWrapper(wrappers.ClipReward(env, -9, 9))),
        (DEPTH, ap_gym.ensure_active_perception_vector_env),
    ],
    ids=["plain", "log", "classification", "regression", "restore", "ensure"],
)
def test_wrappers_of_ap_gym(assets, name, wrap):
    env = wrap(make(assets, name))
    assert env.prediction_target_space == env.unwrapped.prediction_target_space
    assert env.loss_fn is env.unwrapped.loss_fn
    for _, _, done, info in drive(env):
        assert info["prediction"]["loss"].shape == (ENVS,)
        assert ("stats" in info) == done.any()


def test_a_vector_seen_as_one(assets):
    env = ap_gym.ActivePerceptionVectorToSingleWrapper(gym.make_vec(DEPTH, num_envs=1, assets=str(assets)))
    env = ap_gym.TimeLimit(ap_gym.ActivePerceptionLogWrapper(env), 5, issue_termination=True)
    observation, _ = env.reset(seed=0)
    for step in range(5):
        observation, _, terminated, _, _ = env.step(env.action_space.sample())
        assert bool(terminated) == (step == 4)
    assert observation["time_step"] == 1


def test_a_single_one_through_the_wrappers_of_ap_gym(assets):
    env = gym.make(DEPTH, assets=str(assets))
    env = ap_gym.ActiveClassificationLogWrapper(ap_gym.ActivePerceptionWrapper(env))
    env = ap_gym.ensure_active_perception_env(gym.wrappers.RecordEpisodeStatistics(env))
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(16):
        *_, terminated, _, info = env.step(env.action_space.sample())
    assert terminated
    assert info["episode"]["l"] == 16
    assert set(info["stats"]) >= {"scalar", "vector"}


@pytest.mark.thorough
@pytest.mark.parametrize("sparse", [False, True])
def test_what_the_training_code_of_the_paper_looks_for(assets, sparse):
    """APPLE (https://github.com/TimSchneider42/apple) looks for image spaces, frames and curves."""
    env = make(assets, DEPTH.replace("train", "train-sparse") if sparse else DEPTH, render_mode="rgb_array")
    assert isinstance(env.single_observation_space["sensor_img"], ap_gym.ImageSpace)
    assert env.metadata["render_fps"] == 5
    env = ap_gym.ensure_active_perception_vector_env(gym.vector.VectorWrapper(env))
    assert env.prediction_target_space.sample() is not None
    for _, _, done, info in drive(env, 40):
        assert "_base_reward" not in info
        target = info["prediction"]["target"]
        assert (set(target) == {"target", "weight"}) if sparse else (target.shape == (ENVS,))
        assert ("stats" in info) == done.any()
        if done.any():
            for values in (info["stats"]["scalar"], info["stats"]["vector"]):
                for key in (key for key in values if key[0] != "_"):
                    valid = values[f"_{key}"]
                    assert np.asarray(values[key])[valid].shape[0] == valid.sum()
            lengths = {len(curve) for curve in info["stats"]["vector"]["accuracy"]}
            assert lengths == {env.spec.max_episode_steps}
    assert all(picture.dtype == np.uint8 for picture in env.render())
