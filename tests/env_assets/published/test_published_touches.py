"""Touches of the published environments: the same as those of a set; and OpenGL that is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import env_assets
import realtouch
from cli.tactile_sim import app
from tests.env_assets.published.rollouts import roll
from tests.processes import printed_by

pytestmark = [pytest.mark.env, pytest.mark.sim, pytest.mark.filterwarnings("ignore")]

SOURCES = {
    "TactileMNIST-Depth-train-v0": ("mnist3d", "train"),
    "Starstruck-Depth-train-v0": ("starstruck", "train"),
    "Toolbox-Depth-v0": ("wrench", "train"),
}
CASES = [*SOURCES]


@pytest.fixture(scope="module")
def provider(assets: Path, packages: Any) -> Any:
    return env_assets.AssetProvider(assets)


@pytest.fixture(scope="module", params=CASES)
def recorded(request, provider):
    """Episodes of the published environment as it is, with the name of the environment."""
    env = env_assets.make(request.param, provider=provider, num_envs=3)
    truth = roll(env, 20, seed=4)
    env.close()
    return request.param, truth


def _off(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Which values are more than half a micrometre apart, of 2.125 mm."""
    return np.abs(one - other) > 0.5e-3 / 2.125


def test_recorded_poses_give_the_same_pictures_as_a_set(recorded, assets, tmp_path):
    """From the poses of episodes to a table, to a data set, to pictures: those that the environment gave."""
    env_id, truth = recorded
    source, split = SOURCES[env_id]
    seen: dict[tuple[int, int], list[np.ndarray]] = {}
    rows = []
    for step in truth.steps:
        for number in np.flatnonzero(~step.was_done):
            key = (step.points[number].id, int(number))
            gel, lies = step.info["sensor_pose"].matrix[number], step.object_poses.matrix[number]
            if np.abs(gel[:2, 3]).max() > 0.05:
                continue  # sets have a plate of 12 cm, Toolbox one of 30 cm
            assert np.abs(gel[:3, :3] - np.eye(3)).max() < 1e-6
            turn_rad = np.arctan2(lies[1, 0], lies[0, 0])
            rows.append((*gel[:2, 3], *key, *lies[:2, 3], turn_rad))
            seen.setdefault(key, []).append(step.observation["sensor_img"][number, ..., 0])
    table = tmp_path / "poses.csv"
    names = "x_m,y_m,object_id,round,object_x_m,object_y_m,object_turn_rad"
    table.write_text("\n".join([names, *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n")
    command = ["generate", assets / source, "--split", split, "--out", tmp_path / "set", "--optics", "depth"]
    command += ["--positions", "given", "--touches-from", table, "--format", "png", "-w", 1, "--quiet"]
    result = CliRunner().invoke(app, [*map(str, command)])
    assert result.exit_code == 0, result.output
    made = {record.id: record.sensor_image[:][..., 0] for record in realtouch.load(tmp_path / "set", split)}
    assert set(made) == {f"{object_id}-{number}" for object_id, number in seen}
    for (object_id, number), images in seen.items():
        levels = np.rint(255 * np.stack(images))
        off = np.abs(made[f"{object_id}-{number}"] - levels)
        assert off.max() <= 1 or (off > 1).mean() <= 1e-4
        assert (off > 0).mean() < 5e-3  # where half a micrometre crosses the border of two levels
    assert min(image.min() for images in seen.values() for image in images) < 0.5


WITHOUT_OPENGL = """
import ctypes, ctypes.util, sys

load, find = ctypes.CDLL.__init__, ctypes.util.find_library
GRAPHICS = ("EGL", "GL", "GLX", "OpenGL", "GLESv2", "GLU", "OSMesa")

def hidden(self, name, *more, **options):
    if name and any(f"lib{each}.so" in str(name) or name == each for each in GRAPHICS):
        raise OSError(f"{name}: cannot open shared object file")
    load(self, name, *more, **options)

ctypes.CDLL.__init__ = hidden
ctypes.util.find_library = lambda name: None if name in GRAPHICS else find(name)

import env_assets
from tactile_toolkit.errors import InputError

try:
    env_assets.make("TactileMNIST-Depth-train-v0", provider=env_assets.AssetProvider(sys.argv[1]))
except InputError as error:
    print(error)
"""


def test_a_missing_library_of_opengl_is_named(provider, assets):
    """The packages import OpenGL in any case; where none is installed, the loader of libraries fails."""
    (line,) = printed_by(
        WITHOUT_OPENGL, assets, PYTHONWARNINGS="ignore", PYOPENGL_PLATFORM="egl"
    ).splitlines()
    assert "need a library of OpenGL, and none can be loaded here" in line
    assert "'tactile_envs:TactileMNIST-Depth-train-v0'" in line
