"""The environments whose objects are not made here, on meshes that a user has."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import env_assets
from cli.env_assets import app
from tactile_toolkit.errors import InputError
from tests.env_assets.published.rollouts import roll

pytestmark = [pytest.mark.env, pytest.mark.filterwarnings("ignore")]


@pytest.fixture(autouse=True)
def own_statistics(packages: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the statistics of the package out of the user's home."""
    monkeypatch.setattr(packages.util, "CACHE_BASE_DIR", tmp_path / "statistics")


def solids_mm() -> dict[str, Any]:
    return {
        "nut.stl": trimesh.creation.annulus(5, 12, 8),
        "bolt.ply": trimesh.creation.cylinder(6, 50),
        "plate.obj": trimesh.creation.box((30, 40, 6)),
    }


def write(folder: Path, solids: dict[str, Any]) -> Path:
    folder.mkdir(parents=True)
    for name, solid in solids.items():
        solid.export(folder / name)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three files to train with, two to test."""
    write(tmp_path / "meshes" / "train", solids_mm())
    write(tmp_path / "meshes" / "test", dict(list(solids_mm().items())[:2]))
    (tmp_path / "meshes" / "train" / "notes.txt").write_text("mine")
    (tmp_path / "meshes" / "train" / ".half.stl").write_text("half")
    return tmp_path / "meshes"


FAMILIES = [
    ("ABCVolume-Depth-train-v0", 3),
    ("ABCCenterOfMass-Depth-DR-test-v0", 2),
    ("Minecraft-Depth-v0", 3),
    ("MinecraftPose-Depth-DR-v0", 3),
]


@pytest.mark.parametrize(("env_id", "count"), FAMILIES)
def test_a_family_runs_on_a_folder_of_meshes(folder, env_id, count):
    env = env_assets.make(env_id, assets=folder, num_envs=2)
    try:
        rollout = roll(env, 6, 0)
        data = env.unwrapped.config.dataset
        assert len(data) == count
        names = ("bolt", "nut", "plate") if count == 3 else ("bolt", "nut")
        assert data.label_names == names
        for observation in rollout.observations:
            # Where the sensor turns, the package itself steps out of its space by some per cent.
            assert env.observation_space.contains(observation) or "sensor_rot" in observation
            assert all(np.isfinite(values).all() for values in observation.values())
        volumes_m3 = np.array([abs(solid.volume) for solid in solids_mm().values()])[:count] * 1e-9
        found_m3 = sorted(float(point.mesh.volume) for point in data)
        assert found_m3 == pytest.approx(sorted(volumes_m3), rel=1e-4)
        for step in rollout.steps:
            targets = step.info["prediction"]["target"]
            labels = [point.label for point in env.unwrapped.current_data_points]
            if env_id.startswith("Minecraft-"):
                assert targets.tolist() == labels
            elif "Volume" in env_id:
                mean, std = volumes_m3.mean(), volumes_m3.std()
                allowed = (np.array(found_m3) - mean) / std
                assert all(np.abs(allowed - target).min() < 1e-3 for target in targets.ravel())
            else:
                assert np.isfinite(targets).all()
    finally:
        env.close()


@pytest.mark.parametrize("in_classes", [False, True])
def test_meshes_of_another_split_are_not_taken(tmp_path, in_classes):
    write(tmp_path / "meshes" / "train" / ("tools" if in_classes else "."), solids_mm())
    with pytest.raises(InputError, match="has no split 'test', only 'train'; next: put meshes into"):
        env_assets.make("ABCVolume-Depth-test-v0", assets=tmp_path / "meshes")


def test_objects_are_laid_flat_as_the_package_does(packages):
    """Its own code runs on corners that may be written to, which trimesh no longer gives out."""
    from types import SimpleNamespace

    from tactile_mnist.tactile_perception_vector_env import TactilePerceptionVectorEnv

    from env_assets.mesh_view import flat_turn

    for seed in range(5):
        mesh = trimesh.creation.box(np.array([3, 7, 1 + seed]) * 5e-3)
        mesh.apply_transform(
            trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
        )
        box = mesh.bounding_box_oriented
        theirs = SimpleNamespace(
            bounding_box_oriented=SimpleNamespace(
                transform=np.array(box.transform), vertices=np.array(box.vertices)
            ),
            copy=lambda mesh=mesh: SimpleNamespace(vertices=np.array(mesh.vertices)),
        )
        laid = TactilePerceptionVectorEnv._pre_process_dp(SimpleNamespace(mesh=theirs, id=0, label=0), True)
        assert np.allclose(laid.mesh.vertices, mesh.vertices @ flat_turn(mesh).T, atol=1e-9)
        assert np.linalg.det(flat_turn(mesh)) == pytest.approx(1)


def refused(words: str, given: Any, env_id: str = "Minecraft-Depth-v0", **options: Any) -> str:
    with pytest.raises(InputError, match=words) as caught:
        env_assets.make(env_id, assets=given, num_envs=1, **options)
    return str(caught.value)


def test_what_cannot_be_used_is_named(folder, tmp_path, assets):
    train = folder / "train"
    refused("no assets were given.*Mojang.*next: give `assets`", None)
    message = refused(
        "ABC data set", None, "ABCVolume-v0", provider=env_assets.AssetProvider(tmp_path / "no")
    )
    assert "next: give `assets`" in message
    (tmp_path / "empty").mkdir()
    refused("empty", tmp_path / "empty")
    refused("nowhere", tmp_path / "nowhere")
    refused("a data set of meshes was expected, found int", 7)
    refused("does not exist", "a" * 300)
    solid = trimesh.creation.box((0.01, 0.02, 0.03))
    record = SimpleNamespace(id=0, label="nut", vertices_m=solid.vertices, faces=solid.faces, mesh=solid)
    refused("record 0 has label 'nut'; expected the number of its class", [record])
    refused("has one class; expected at least two", train / "nut.stl")
    refused("has meshes of one volume", train / "nut.stl", "ABCVolume-Depth-train-v0")
    refused("recorded touches", folder, "TactileMNISTRealSnap-train-v0")
    (train / "plate.stl").write_bytes((train / "nut.stl").read_bytes()[:300])
    (train / "plate.obj").unlink()
    refused("plate.stl: the file has 300 bytes, a binary STL file of 256 triangles has 12,884", folder)
    trimesh.creation.box((300, 30, 30)).export(train / "plate.stl")
    refused(r"\('plate.stl'\) of .* needs 300.0 x 30.0 mm, the cell", folder)
    inverted = trimesh.creation.box((30, 30, 30))
    inverted.invert()
    inverted.export(train / "plate.stl")
    refused(r"\('plate.stl'\) of .* volume of -2.7e-05", folder)
    write(train / "screws", {"a.stl": trimesh.creation.cylinder(3, 20)})
    refused("next to folders of them", folder)


def test_the_list_tells_the_state_of_every_id(packages):
    found = CliRunner().invoke(app, ["list", "--json"])
    assert found.exit_code == 0, found.output
    listed = json.loads(found.stdout)
    assert len({each["id"] for each in listed}) == len(listed) == 356
    meshes = [each for each in listed if each["assets"] in ("abc", "minecraft")]
    assert len(meshes) == 76
    assert {each["state"] for each in meshes} <= {"meshes", "sensor"}
    (one,) = [each for each in listed if each["id"] == "TactileMNIST-Depth-test-v0"]
    assert one == {
        "id": "TactileMNIST-Depth-test-v0",
        "task": "classification",
        "split": "test",
        "sensor": "depth",
        "assets": "mnist3d",
        "sparse": False,
        "state": "ready",
        "note": "",
        "native": True,
    }
    some = CliRunner().invoke(app, ["list", "ABCVolume", "DR", "test"])
    assert some.exit_code == 0
    assert "ABCVolume-Depth-DR-test-v0" in some.stdout
    notes = {each["note"] for each in listed if each["id"] == "ABCVolume-Depth-DR-test-v0"}
    assert [note for note in notes if note and note in some.stdout] == [*notes]
    wrong = CliRunner().invoke(app, ["list", "ABCVolum"])
    assert isinstance(wrong.exception, InputError) or wrong.exit_code == 2
