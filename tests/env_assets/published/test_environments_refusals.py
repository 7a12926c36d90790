"""Assets and settings that do not fit are refused before an environment starts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import trimesh

import env_assets
import realtouch
from env_assets.published.environments import noise_folder
from env_assets.published.ids import overview
from env_assets.published.packages import require_sensor
from tactile_toolkit.errors import InputError
from tests.env_assets.factories import write_meshes

pytestmark = [pytest.mark.env, pytest.mark.filterwarnings("ignore")]

ENV = "TactileMNIST-Depth-train-v0"


@pytest.fixture(autouse=True)
def _published(packages: Any) -> None:
    """All of these need the package."""


def box(size_m: tuple[float, float, float]) -> Any:
    return trimesh.creation.box(size_m)


def refused(env_id: str, provider: Any, words: str, config: dict[str, Any] | None = None) -> str:
    with pytest.raises(InputError, match=words) as caught:
        env_assets.make(env_id, provider=provider, num_envs=2, config=config)
    assert "next: " in str(caught.value) or "expected" in str(caught.value)
    return str(caught.value)


def with_place(assets: Path, name: str, folder: Path) -> Any:
    return env_assets.AssetProvider(assets, places={name: folder})


def test_unknown_environment(provider):
    message = refused("TactileMNIST-Depht-train-v0", provider, "no environment 'TactileMNIST-Depht-train-v0'")
    assert "TactileMNIST-Depth-train-v0" in message


@pytest.mark.parametrize("env_id", ["LightDark-v0"])
def test_environment_on_other_assets(provider, env_id):
    refused(env_id, provider, "is not an environment of tactile-mnist")


def test_no_such_split(assets, provider):
    refused("TactileMNISTRealSnap-test-v0", provider, "no split 'test' in .*it has train")


@pytest.mark.parametrize(
    ("env_id", "name", "instead"),
    [
        (ENV, "mnist3d", "starstruck"),
        ("TactileMNISTVolume-Depth-train-v0", "mnist3d", "wrench"),
        ("Starstruck-Depth-train-v0", "starstruck", "mnist3d"),
        ("Toolbox-Depth-v0", "wrench", "mnist3d"),
        (ENV, "mnist3d", "real-single"),
        ("TactileMNISTRealSnap-train-v0", "real-single", "mnist3d"),
    ],
)
def test_another_kind_of_data_set(assets, env_id, name, instead):
    refused(env_id, with_place(assets, name, assets / instead), "next:")


def test_other_label_names(assets, tmp_path):
    folder = write_meshes(tmp_path / "set", [box((0.03, 0.03, 0.01))] * 3, ("a", "b", "c"))
    message = refused(ENV, with_place(assets, "mnist3d", folder), "")
    assert "a, b, c" in message


def test_meshes_larger_than_the_cell(assets, tmp_path):
    """Such as millimetres taken for metres."""
    folder = write_meshes(tmp_path / "set", [box((0.03, 0.03, 0.01)), box((30.0, 0.05, 0.01))])
    message = refused(ENV, with_place(assets, "mnist3d", folder), "mesh 1 of")
    assert "needs 30000.0 x 50.0 mm, the cell has 120 x 120 mm" in message
    refused(ENV, with_place(assets, "mnist3d", folder), "100 x 120 mm", {"cell_size": (0.1, 0.12)})


def test_negative_volume(assets, tmp_path):
    inside_out = box((0.03, 0.03, 0.01))
    inside_out.invert()
    folder = write_meshes(tmp_path / "set", [box((0.03, 0.03, 0.01)), inside_out])
    refused(ENV, with_place(assets, "mnist3d", folder), r"mesh 1 of .* volume of -9e-06")


def test_a_source_of_plain_records_is_checked_too(tmp_path):
    """An environment depends on the shape of a source, not on our provider."""
    import mnist3d

    folder = write_meshes(tmp_path / "set", [box((0.5, 0.03, 0.01))])

    class Source:
        def meshes(self, name: str, split: str = "train") -> Any:
            return mnist3d.load(str(folder), split)

    refused(ENV, Source(), "mesh 0 of")


@pytest.mark.parametrize(
    ("env_id", "name", "what"),
    [(ENV, "mnist3d", "mesh"), ("TactileMNISTRealSnap-train-v0", "real-single", "round")],
)
def test_a_split_without_a_row(assets, tmp_path, env_id, name, what):
    (file,) = (assets / name / "data").glob("train-*")
    (tmp_path / "none" / "data").mkdir(parents=True)
    pq.write_table(pq.read_table(file).slice(0, 0), tmp_path / "none" / "data" / file.name)
    refused(env_id, with_place(assets, name, tmp_path / "none"), f"holds no {what}; next: choose another spl")


def test_touches_without_noise_to_take(assets, seq_folder):
    rounds, clips = realtouch.load(str(assets / "real-single")), realtouch.load(str(seq_folder), "train")
    for given, found in ((rounds[:0], "no round"), (clips, "clips")):
        words = f"these holds {found}; the noise of a -DR environment needs .*next: download"
        with pytest.raises(InputError, match=words):
            noise_folder(given, "these")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["TactileMNST"], "no environment has 'TactileMNST' in its id; did you mean 'TactileMNIST'?; next: "),
        (["Starstruck", "cyclegan"], "has 'cyclegan' in its id; did you mean 'CycleGAN'?; next: "),
        (["Starstruck", "Minecraft"], "has 'Starstruck' and 'Minecraft' in its id; next: choose fewer words"),
    ],
)
def test_words_that_no_environment_has(words, told):
    with pytest.raises(InputError, match=re.escape(told)):
        overview(words)


@pytest.mark.parametrize("num_envs", [0, -1, 1.5, "2"])
def test_numbers_of_environments(provider, num_envs):
    with pytest.raises(InputError, match=r"num_envs is .*expected an integer from 1 on"):
        env_assets.make(ENV, provider=provider, num_envs=num_envs)


def test_a_single_environment_that_cannot_be_reset_is_not_made(provider):
    from importlib.metadata import version

    if version("ap_gym") != "0.7.1":
        pytest.skip("the wrapper of another version of ap-gym")
    with pytest.raises(InputError, match="next: give num_envs=1"):
        env_assets.make("TactileMNIST-Depth-train-sparse-v0", provider=provider)


def test_rounds_shorter_than_an_episode(provider):
    words = "rounds of 24 touches, an episode of 23 steps needs 25"
    refused("TactileMNISTRealSnap-train-v0", provider, words, {"step_limit": 23})


@pytest.mark.parametrize("name", ["step_limits", "dataset"])
def test_unknown_setting(provider, name):
    message = refused(ENV, provider, f"no setting '{name}' in `config`", {name: 3})
    assert "step_limit," in message


@pytest.mark.parametrize(
    "config",
    [
        {"sensor_type": "camera"},
        {"sensor_type": "direct"},
        {"sensor_type": "taxim", "sensor_backend": "numpy"},
    ],
)
def test_unknown_sensor(provider, config):
    refused(ENV, provider, "no sensor .* expected one of|'numpy' cannot run here", config)


@pytest.mark.parametrize(("sensor", "module"), [("taxim", "torch_scatter"), ("cycle_gan", "torchvision")])
def test_sensor_without_its_packages(packages, monkeypatch, sensor, module):
    """What the package puts in its table where an import failed."""
    from tactile_mnist.tactile_renderer import factory

    missing = {"torch": factory.ModuleNotLoaded(module)}
    monkeypatch.setitem(factory.TACTILE_RENDERER_FACTORIES, sensor, missing)
    with pytest.raises(InputError, match=f"'{sensor}' .* cannot run here: .*{module}.*next: install the ex"):
        require_sensor(sensor, "auto")
