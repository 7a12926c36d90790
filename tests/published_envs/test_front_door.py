"""Our data set under its published name on a Hub, loaded by the unmodified published code.

A process pushes a generated set to a Hub on 127.0.0.1 with the client of the Hub, and makes an environment
with ``ap_gym.make``.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.hub_server import hub
from tests.pages import ROOT
from tests.processes import PATIENCE_S
from tests.tactile_toolkit.hub.client import settings, start_python

pytestmark = [pytest.mark.oracle, pytest.mark.filterwarnings("ignore")]

REPOSITORY = "TimSchneider42/tactile-mnist-mnist3d"
SCRIPT = f"""
from huggingface_hub import HfApi

HfApi().create_repo("{REPOSITORY}", repo_type="dataset")
HfApi().upload_folder(repo_id="{REPOSITORY}", folder_path="{{digits}}", repo_type="dataset")

import ap_gym

env = ap_gym.make("tactile_mnist:TactileMNIST-Depth-train-v0")
observation, _ = env.reset(seed=0)
steps, ended = 0, False
while not ended:
    observation, _, terminated, truncated, info = env.step(env.action_space.sample())
    steps, ended = steps + 1, bool(terminated or truncated)
env.close()
print("REPORT", steps, observation["sensor_img"].shape)
"""


def test_the_published_environment_runs_on_our_data_set(assets: Path, tmp_path: Path) -> None:
    pytest.importorskip("tactile_mnist", reason="tactile-mnist (extra `oracle`) is not installed")
    with hub(tmp_path / "repositories") as server:
        token = server.account(REPOSITORY.partition("/")[0])
        paths = {"HOME": str(tmp_path), "PYTHONPATH": str(ROOT), "PYOPENGL_PLATFORM": "egl"}
        environment = settings(server, tmp_path, token, **paths)
        with start_python(SCRIPT.format(digits=assets / "mnist3d"), environment, tmp_path) as process:
            out, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, out + err
        assert "REPORT 16 (64, 64, 1)" in out
        assert "data/train-00000-of-00001.parquet" in server.fetched
