"""Touches of episodes of the published environments equal those of a data set with the same poses."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

import realtouch
from cli.tactile_sim import app
from tests.published_envs import make

pytestmark = [pytest.mark.oracle, pytest.mark.sim, pytest.mark.filterwarnings("ignore")]

SOURCES = {
    "TactileMNIST-Depth-train-v0": ("mnist3d", "train"),
    "Starstruck-Depth-train-v0": ("starstruck", "train"),
    "Toolbox-Depth-v0": ("wrench", "train"),
}


@pytest.mark.parametrize("env_id", SOURCES)
def test_recorded_poses_give_the_same_pictures_as_a_set(env_id, packages, provider, assets, tmp_path):
    """Poses of episodes become a table, a data set and pictures, which equal those of the environment."""
    source, split = SOURCES[env_id]
    env = make(env_id, provider=provider, num_envs=3)
    env.action_space.seed(4)
    env.reset(seed=4)
    seen: dict[tuple[int, int], list[np.ndarray]] = {}
    rows = []
    is_over = np.zeros(3, bool)
    for _ in range(20):
        points, lying = env.unwrapped.current_data_points, env.unwrapped.current_object_poses_platform_frame
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        for number in np.flatnonzero(~is_over):
            key = (points[number].id, int(number))
            gel, lies = info["sensor_pose"].matrix[number], lying.matrix[number]
            if np.abs(gel[:2, 3]).max() > 0.05:
                continue  # sets have a plate of 12 cm, Toolbox one of 30 cm
            assert np.abs(gel[:3, :3] - np.eye(3)).max() < 1e-6
            turn_rad = np.arctan2(lies[1, 0], lies[0, 0])
            rows.append((*gel[:2, 3], *key, *lies[:2, 3], turn_rad))
            seen.setdefault(key, []).append(np.array(observation["sensor_img"][number, ..., 0]))
        is_over = terminated | truncated
    env.close()
    table = tmp_path / "poses.csv"
    names = "x_m,y_m,object_id,round,object_x_m,object_y_m,object_turn_rad"
    table.write_text("\n".join([names, *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n")
    command = ["generate", assets / source, "--split", split, "--out", tmp_path / "set", "--optics", "depth"]
    command += ["--positions", "given", "--touches-from", table, "--image-format", "png", "-w", 1, "--quiet"]
    result = CliRunner().invoke(app, [*map(str, command)])
    assert result.exit_code == 0, result.output
    made = {record.id: record.sensor_image[:][..., 0] for record in realtouch.load(tmp_path / "set", split)}
    assert set(made) == {f"{object_id}-{number}" for object_id, number in seen}
    for (object_id, number), images in seen.items():
        levels = np.rint(255 * np.stack(images))
        off = np.abs(made[f"{object_id}-{number}"] - levels)
        assert off.max() <= 1 or (off > 1).mean() <= 1e-4
        assert (off > 0).mean() < 5e-3  # half a micrometre may change a level
    assert min(image.min() for images in seen.values() for image in images) < 0.5
