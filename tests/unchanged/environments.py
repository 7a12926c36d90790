"""Behaviour of environments, as numbers of five digits that do not depend on the processor."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tactile_envs.config import EpisodeConfig
from tactile_envs.env_specs import env_specs

COURSES = {
    "TactileMNIST-Depth-train-v0": {},
    "TactileMNISTVolumeSnap-Depth-test-sparse-v0": {"snap_touch_positions": 7},
    "TactileMNISTCenterOfMass-Depth-train-v0": {"step_limit": 9, "timeout_behavior": "truncate"},
    "Starstruck-Depth-train-v0": {"perturb_object_pose": True, "sensor_output_size": (48, 32)},
    "Toolbox-Depth-v0": {
        "step_limit": 9,
        "randomize_initial_sensor_pose": False,
        "randomize_initial_object_pose": False,
        "cell_size": (0.24, 0.18),
        "action_regularization": 0.1,
    },
}
"""Ids with settings that differ from their defaults, so that each setting has an effect somewhere."""

_STEPS = 14
_BLOCK_PX = 16


def ids() -> dict[str, str]:
    """Return the settings of each id that differ from the defaults."""
    return {
        name: f"{each.task} {each.assets} {each.split} {each.frame} {_changed(each.config)}"
        for name, each in env_specs().items()
    }


def _changed(config: EpisodeConfig) -> str:
    kept = type(config)()
    changed = [
        field.name for field in fields(config) if getattr(config, field.name) != getattr(kept, field.name)
    ]
    return ", ".join(f"{name}={getattr(config, name)!r}" for name in changed)


def course(name: str, assets: Path) -> dict[str, list[float]]:
    """Drive three environments of one id at random.

    Returns sums over observations, rewards and infos of each step, and the brightness of the pictures of
    two steps in blocks of 16 pixels.
    """
    from tactile_envs.entry_points import make_vector

    env = make_vector(name, num_envs=3, assets=assets, render_mode="rgb_array", config=COURSES[name])
    rng = np.random.default_rng(3)
    observation, info = env.reset(seed=5)
    found = {f"reset {key}": [value] for key, value in _numbers({**observation, **info})}
    for step in range(_STEPS):
        # Short movements, so that most touches meet something, and sometimes a longer one.
        way = rng.uniform(-1, 1, (3, 3)) * rng.choice([0.2, 1.0], p=[0.8, 0.2])
        shape = env.action_space["prediction"].shape
        action = {
            "action": {"sensor_target_pos_rel": way.astype(np.float32)},
            "prediction": rng.normal(size=shape).astype(np.float32),
        }
        observation, reward, terminated, truncated, info = env.step(action)
        seen = {"reward": reward, "terminated": terminated, "truncated": truncated, **observation, **info}
        for key, value in _numbers(seen):
            found.setdefault(key, []).append(value)
        if step in (1, _STEPS - 2):
            rows, columns = env.render()[1].shape[:2]
            blocks = env.render()[1].reshape(rows // _BLOCK_PX, _BLOCK_PX, columns // _BLOCK_PX, -1)
            found[f"picture {step}"] = [round(float(each), 1) for each in blocks.mean(axis=(1, 3)).ravel()]
    env.close()
    return found


def _numbers(seen: Any, path: str = "") -> Any:
    """Yield the weighted sum of every array, by the keys that lead to it."""
    if isinstance(seen, dict):
        for key, value in seen.items():
            yield from _numbers(value, f"{path}{key}.")
    elif hasattr(seen, "translation"):
        yield from _numbers({"translation": seen.translation, "quaternion": seen.rotation.as_quat()}, path)
    else:
        values = np.asarray(seen)
        if values.dtype.kind in "biuf":
            flat = np.nan_to_num(values.astype(float)).ravel()
            # Weighted, so that exchanged values are noticed.
            yield path[:-1], float(f"{flat @ np.linspace(0.5, 1.5, flat.size):.6g}")
