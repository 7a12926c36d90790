"""The ids of environments: their descriptions without any extra, and their registration in gymnasium."""

from __future__ import annotations

import json
import re
from itertools import pairwise

import pytest
from PIL import Image
from typer.testing import CliRunner

import tactile_envs
from cli.tactile_envs import app
from tactile_envs.env_specs import GRASP_ID
from tactile_toolkit.errors import InputError
from tests.pages import ROOT
from tests.processes import printed_by

SENSORS = {"Depth": "depth", "CycleGAN": "cycle_gan", "Taxim": "taxim"}

ALONE = """
import sys

class Without:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in ("gymnasium", "ap_gym", "tactile_mnist", "taxim", "torch", "jax"):
            return self.finder.find_spec(name, path, target)

sys.meta_path = [Without(finder) for finder in sys.meta_path]
from tests.command_line import call
sys.exit(call("tactile-envs", "list", "--json"))
"""

TOGETHER = """
import sys
import warnings

warnings.simplefilter("ignore")  # what the other package warns of is not ours
with warnings.catch_warnings(record=True) as caught:
    warnings.filterwarnings("always", ".*registry.*")
    for name in sys.argv[1:]:
        __import__(name)
import gymnasium

for name in ("TactileMNIST-Depth-train-v0", "tactile_envs/Toolbox-v0"):
    print(name, "default_config" in gymnasium.spec(name).kwargs)
print([str(each.message) for each in caught])
"""


def listed(*words: str) -> list[dict[str, object]]:
    found = CliRunner().invoke(app, ["list", *words, "--json"])
    assert found.exit_code == 0, found.output
    rows: list[dict[str, object]] = json.loads(found.stdout)
    return rows


def test_ids_are_listed_without_any_extra() -> None:
    """Each id occurs once, with the parts of its name; the command prints the same as Python."""
    rows = json.loads(printed_by(ALONE))
    assert rows == listed()
    assert [row["id"] for row in rows] == [each.id for each in tactile_envs.ids()]
    assert len({row["id"] for row in rows}) == len(rows) == 357
    for row in rows:
        if row["id"] == GRASP_ID:
            assert (row["task"], row["action"], row["episode_length"]) == ("mass", {"grip": [1]}, 32)
            continue
        words = row["id"].split("-")
        default = "direct" if "RealSnap" in row["id"] else "taxim"
        assert row["sensor"] == next((SENSORS[word] for word in words if word in SENSORS), default)
        assert row["split"] == ("test" if "test" in words else "train")
        assert row["sparse"] == ("sparse" in words)
        assert row["episode_length"] == (16 if row["assets"] == "mnist3d" else 32)
        assert row["observation"]["sensor_img"] == [64, 64, 1 if row["sensor"] == "depth" else 3]
        assert ("sensor_rot" in row["observation"]) == row["id"].startswith("ABC")
        assert ("sensor_target_rot_rel" in row["action"]) == row["id"].startswith("ABC")


def test_words_choose_ids_and_objects_that_are_not_made_are_named() -> None:
    (one,) = listed("TactileMNIST", "Depth", "test", "sparse", "DR")
    assert one["id"] == "TactileMNIST-Depth-DR-test-sparse-v0"
    shown = CliRunner().invoke(app, ["list", "ABCVolume", "DR", "test"])
    assert "ABCVolume-Depth-DR-test-v0" in shown.stdout
    assert "abc: give `assets`, a folder of meshes; CAD models of the ABC data set" in shown.stdout
    assert "6 environments" in shown.stdout


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["TactileMNST"], "no environment has 'TactileMNST' in its id; did you mean 'TactileMNIST'?; next: "),
        (["Starstruck", "cyclegan"], "has 'cyclegan' in its id; did you mean 'CycleGAN'?; next: "),
        (["Starstruck", "Minecraft"], "has 'Starstruck' and 'Minecraft' in its id; next: choose fewer words"),
    ],
)
def test_words_that_no_environment_has(words: list[str], told: str) -> None:
    with pytest.raises(InputError, match=re.escape(told)):
        tactile_envs.ids(*words)


def test_the_page_describes_every_family() -> None:
    """With the steps of its episodes, and every picture that CI makes."""
    text = (ROOT / "docs/howto/environments.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`TactileMNIST.*|`\w+`) \|.*\| (\d+) \|$", text, re.MULTILINE)
    steps = {family: int(number) for names, number in rows for family in re.findall(r"`(\w+)`", names)}
    assert steps == {each.id.partition("-")[0]: each.episode_length for each in tactile_envs.ids()}
    assert f"the {len(tactile_envs.ids())} ids" in text
    episodes = pytest.importorskip("docs.episodes", exc_type=InputError)
    assert set(re.findall(r"episodes/(\w+)\.webp", text)) == set(episodes.EPISODES)


@pytest.mark.thorough
def test_a_moving_picture_shows_an_episode(provider, tmp_path, monkeypatch):
    """From the first touch to the last; existing files are not made again."""
    pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
    from docs import episodes

    frames = episodes.episode("TactileMNIST-Depth-test-v0", provider)
    assert [frame.shape for frame in frames] == [(240, 336, 3)] * 17
    assert all((one != other).any() for one, other in pairwise(frames))
    monkeypatch.setattr(episodes, "EPISODES", {"one": "MinecraftPose-Depth-v0"})
    for _ in range(2):
        episodes.write(tmp_path)
        with Image.open(tmp_path / "one.webp") as picture:
            assert (picture.n_frames, picture.size) == (33, (336, 240))
        monkeypatch.setattr(episodes, "episode", None)


@pytest.mark.oracle
@pytest.mark.parametrize("names", [("tactile_envs", "tactile_mnist"), ("tactile_mnist", "tactile_envs")])
def test_the_published_package_may_be_imported_before_and_after(names: tuple[str, str]) -> None:
    """Each package keeps its ids, without a warning."""
    pytest.importorskip("tactile_mnist", reason="tactile-mnist (extra `oracle`) is not installed")
    assert printed_by(TOGETHER, *names, PYOPENGL_PLATFORM="egl").splitlines() == [
        "TactileMNIST-Depth-train-v0 True",
        "tactile_envs/Toolbox-v0 False",
        "[]",
    ]
