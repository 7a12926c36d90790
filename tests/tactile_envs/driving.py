"""Runs environments as training code does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import tactile_envs

gym.register_envs(tactile_envs)
DEPTH = "tactile_envs/TactileMNIST-Depth-train-v0"
ENVS, STEPS = 3, 20


def make(assets: Path, name: str = DEPTH, **options: Any) -> Any:
    return gym.make_vec(name, num_envs=ENVS, assets=str(assets), **options)


def drive(env: Any, steps: int = STEPS) -> list[Any]:
    """Take more random steps than an episode has; check that observations stay in their spaces."""
    observation, info = env.reset(seed=1)
    env.action_space.seed(1)
    assert observation in env.observation_space
    taken = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert np.isfinite(reward).all()
        taken.append((observation, reward, terminated | truncated, info))
    assert any(np.all(done) for _, _, done, _ in taken)
    return taken
