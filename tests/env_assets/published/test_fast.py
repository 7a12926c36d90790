"""``renderer="fast"``: the same episodes as with OpenGL, and a plain word where it does not apply."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import env_assets
from tactile_toolkit.errors import InputError
from tests.env_assets.published.rollouts import roll

pytestmark = [pytest.mark.env, pytest.mark.sim, pytest.mark.filterwarnings("ignore")]

CASES = ["TactileMNIST-Depth-train-v0", "Starstruck-Depth-train-v0", "Toolbox-Depth-v0"]


@pytest.fixture(scope="module")
def provider(assets: Path, packages: Any) -> Any:
    pytest.importorskip("numba", reason="needs numba, of the extra sim")
    return env_assets.AssetProvider(assets)


@pytest.mark.parametrize("env_id", CASES)
def test_episodes_are_those_of_opengl(env_id, provider):
    found = []
    for renderer in ("opengl", "fast"):
        env = env_assets.make(env_id, provider=provider, num_envs=3, renderer=renderer)
        found.append(roll(env, 20, seed=4))
        env.close()
    truth, fast = found
    off = pixels = 0
    for one, other in zip(truth.observations, fast.observations, strict=True):
        assert set(one) == set(other)
        for name in set(one) - {"sensor_img"}:
            assert np.abs(one[name] - other[name]).max() < 2e-5, name
        assert one["sensor_img"].dtype == other["sensor_img"].dtype
        # Half a micrometre of 2.125 mm.
        off += int((np.abs(one["sensor_img"] - other["sensor_img"]) > 0.5e-3 / 2.125).sum())
        pixels += one["sensor_img"].size
    assert off <= max(1e-4 * pixels, 1)
    for one, other in zip(truth.steps, fast.steps, strict=True):
        assert (one.terminated == other.terminated).all()
        assert np.abs(one.object_poses.matrix - other.object_poses.matrix).max() < 1e-12


def test_a_single_environment_and_a_picture_of_its_scene(provider):
    env = env_assets.make(CASES[0], provider=provider, renderer="fast")
    observation, _ = env.reset(seed=1)
    truth = env_assets.make(CASES[0], provider=provider)
    expected, _ = truth.reset(seed=1)
    assert np.abs(observation["sensor_img"] - expected["sensor_img"]).max() < 1e-3
    assert (env.render() == truth.render()).mean() > 0.999
    env.close()
    truth.close()


def test_where_it_does_not_apply(provider):
    for env_id, words in (("TactileMNIST-train-v0", "its sensor is 'taxim'"), (CASES[0], "renderer is 'gl'")):
        with pytest.raises(InputError, match=words):
            env_assets.make(env_id, provider=provider, renderer="gl" if env_id == CASES[0] else "fast")
