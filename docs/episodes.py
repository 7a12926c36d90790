"""Moving pictures of environments for the site: an episode of each family on small data sets.

::

    python docs/episodes.py [FOLDER]      (extra envs; FOLDER is docs/_generated/episodes by default)

The policy and the predictions are made up: the sensor strays around the object, and predictions start as
noise and end at the answer.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import trimesh
from PIL import Image

import env_assets
from tactile_envs import make_vector

EPISODES = {
    "TactileMNIST": "TactileMNIST-Depth-test-v0",
    "TactileMNISTVolume": "TactileMNISTVolume-Depth-test-v0",
    "TactileMNISTCenterOfMass": "TactileMNISTCenterOfMass-Depth-test-v0",
    "Starstruck": "Starstruck-Depth-test-v0",
    "Toolbox": "Toolbox-Depth-v0",
    "ABCVolume": "ABCVolume-Depth-v0",
    "ABCCenterOfMass": "ABCCenterOfMass-Depth-v0",
    "Minecraft": "Minecraft-Depth-v0",
    "MinecraftPose": "MinecraftPose-Depth-v0",
}
"""What is shown, by the name of the picture."""

OWN_OBJECTS_MM = {"plate": (40, 30, 8), "bar": (60, 12, 10), "block": (25, 25, 20)}
"""In the place of objects that the toolkit does not make."""

FRAME_MS = 400
STRAY, PULL = 0.7, 0.35


def write(folder: Path) -> None:
    """Write the pictures that are not in a folder yet."""
    missing = [name for name in EPISODES if not (folder / f"{name}.webp").exists()]
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        for name, size_mm in OWN_OBJECTS_MM.items():
            (root / "own").mkdir(exist_ok=True)
            trimesh.creation.box(size_mm).export(root / "own" / f"{name}.stl")
        provider = env_assets.AssetProvider(root, generate=True, per_class=1)
        for name in missing:
            frames = [Image.fromarray(frame) for frame in episode(EPISODES[name], provider)]
            shown = {"save_all": True, "append_images": frames[1:], "duration": FRAME_MS, "loop": 0}
            frames[0].save(folder / f"{name}.webp", quality=60, method=6, **shown)


def episode(env_id: str, provider: env_assets.AssetProvider) -> list[np.ndarray]:
    """Return the pictures of an episode, from the first touch to the last."""
    assets = provider.root / "own"
    if not env_id.startswith(("ABC", "Minecraft")):
        assets = provider.root
        for kind in ("mnist3d", "starstruck"):
            provider.meshes(kind, "test")
        provider.meshes("wrench", "train")
    env = make_vector(env_id, assets=assets, render_mode="rgb_array")
    rng = np.random.default_rng(2)
    observation, info = env.reset(seed=2)
    frames, is_over, answer = list(env.render() or ()), False, None
    while not is_over:
        way = PULL * _to_object(env, info) + STRAY * rng.normal(size=3)
        action = env.action_space.sample()
        action["action"]["sensor_target_pos_rel"][:] = way
        action["prediction"][:] = _guess(env, answer, (observation["time_step"][0] + 1) / 2, rng)
        observation, _, terminated, truncated, info = env.step(action)
        answer = info["prediction"]["target"]
        is_over = bool((terminated | truncated)[0])
        frames += env.render() or ()
    env.close()
    return frames


def _to_object(env: Any, info: dict[str, Any]) -> np.ndarray:
    """Return the way to the object in steps of the sensor."""
    place_m = env.current_object_poses_platform_frame.translation[0, :2]
    off_m = place_m - info["sensor_pose"][0, :2, 3]
    step_m = env.config.max_distance(env.config.linear_velocity, env.config.linear_acceleration)
    return np.append(off_m / step_m, 0.0)


def _guess(env: Any, answer: Any, certainty: float, rng: np.random.Generator) -> np.ndarray:
    """Return noise, and the more of the answer the higher the certainty; noise before the first answer."""
    guess = 0.5 * rng.normal(size=env.prediction_space.shape)
    if answer is None:
        return guess
    right = np.asarray(answer)
    if right.ndim == 1:  # the number of a class
        right = 6.0 * np.eye(guess.shape[1])[right]
    return certainty * right + (1 - certainty) * guess


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "_generated" / "episodes")
