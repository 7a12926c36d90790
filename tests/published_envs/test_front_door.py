"""Our data sets under the published names on a Hub, loaded by the unmodified published code.

A process pushes generated sets to a Hub on 127.0.0.1 with the client of the Hub, makes environments with
``ap_gym.make``, and next to them those of other tests (``make``). With the same seed, both must give the same
values.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.hub_server import hub
from tests.pages import ROOT
from tests.processes import PATIENCE_S
from tests.tactile_toolkit.hub.client import settings, start_python

pytestmark = [pytest.mark.oracle, pytest.mark.filterwarnings("ignore")]

OWNER = "TimSchneider42"
PUBLISHED = {
    "mnist3d": "tactile-mnist-mnist3d",
    "wrench": "tactile-mnist-wrench",
    "real-single": "tactile-mnist-touch-real-single-t256-320x240",
}

IDS = [
    "TactileMNIST-Depth-train-v0",
    "TactileMNISTVolume-Depth-test-v0",
    "TactileMNISTCenterOfMass-Depth-train-v0",
    "Toolbox-Depth-v0",
    "TactileMNISTRealSnap-train-v0",
]

SCRIPT = """
import json
from huggingface_hub import HfApi

assets, published, ids = {arguments}
for name, repository in published.items():
    HfApi().create_repo(repository, repo_type="dataset")
    HfApi().upload_folder(repo_id=repository, folder_path=f"{{assets}}/{{name}}", repo_type="dataset")

import ap_gym

env = ap_gym.make("tactile_mnist:TactileMNIST-Depth-train-v0")
observation, _ = env.reset(seed=0)
steps, ended = 0, False
while not ended:
    observation, _, terminated, truncated, info = env.step(env.action_space.sample())
    steps, ended = steps + 1, bool(terminated or truncated)
env.close()

import numpy as np
from env_assets import AssetProvider
from tests.published_envs import make

provider = AssetProvider(assets)

def seen(env):
    observation, _ = env.reset(seed=3)
    env.action_space.seed(3)
    observations, answers = [observation], []
    for _ in range(12):
        observation, reward, _, _, info = env.step(env.action_space.sample())
        observations.append(observation)
        answers += [reward, info["prediction"]["target"]]
    env.close()
    return [np.array(one[name]) for one in observations for name in sorted(one)], answers

def same(env_id):
    theirs, their_answers = seen(ap_gym.make_vec(f"tactile_mnist:{{env_id}}", num_envs=2))
    ours, our_answers = seen(make(env_id, provider=provider, num_envs=2))
    alike = all(np.array_equal(one, other) for one, other in zip(ours, theirs, strict=True))
    # The package adds up its statistics in the order in which processes finish, so last digits may differ.
    pairs = zip(our_answers, their_answers, strict=True)
    return alike and all(np.allclose(one, other, rtol=1e-6, atol=1e-9) for one, other in pairs)

report = {{"steps": steps, "image": observation["sensor_img"].shape, "same": {{i: same(i) for i in ids}}}}
print("REPORT" + json.dumps(report))
"""


@pytest.fixture(scope="module")
def report(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    pytest.importorskip("tactile_mnist", reason="tactile-mnist (extra `oracle`) is not installed")
    home = tmp_path_factory.mktemp("home")
    names = {name: f"{OWNER}/{repository}" for name, repository in PUBLISHED.items()}
    with hub(home / "repositories") as server:
        token = server.account(OWNER)
        environment = settings(
            server, home, token, HOME=str(home), PYOPENGL_PLATFORM="egl", PYTHONPATH=str(ROOT)
        )
        script = SCRIPT.format(arguments=repr((str(assets), names, IDS)))
        with start_python(script, environment, home) as process:
            out, err = process.communicate(timeout=PATIENCE_S)
        fetched = set(server.fetched)
    assert process.returncode == 0, out + err
    line = next(line for line in out.splitlines() if line.startswith("REPORT"))
    return {**json.loads(line.removeprefix("REPORT")), "fetched": fetched}


def test_the_published_environment_runs_on_our_data_set(report):
    assert report["steps"] == 16
    assert report["image"] == [64, 64, 1]
    assert "data/train-00000-of-00001.parquet" in report["fetched"]


@pytest.mark.parametrize("env_id", IDS)
def test_environments_of_other_tests_are_the_same(report, env_id):
    assert report["same"][env_id]
