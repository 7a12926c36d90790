"""Objects that environments make themselves, during and after the run, and objects of a user."""

from __future__ import annotations

import copy
import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
import gymnasium as gym
import trimesh

from env_assets import AssetProvider
from tactile_envs import mesh_pool, object_sets
from tactile_envs.entry_points import make_vector
from tactile_envs.mesh_pool import GrowingPool, MeshPool
from tactile_toolkit.errors import InputError
from tests.env_assets.factories import write_meshes
from tests.env_assets.shapes import box

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

DEPTH, VOLUME = "TactileMNIST-Depth-train-v0", "TactileMNISTVolume-Depth-train-v0"


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """A working folder without assets, and small sets; yields the work that would start in the background."""
    started: list[Any] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(object_sets, "AssetProvider", partial(AssetProvider, per_class=1))
    monkeypatch.setattr(object_sets.mesh_pool, "free_workers", lambda: 1)
    monkeypatch.setattr(object_sets, "start_background", lambda *work: started.append(work))
    return started


def steps(env: Any, count: int) -> list[Any]:
    """Take steps; return all observations and rewards."""
    found = []
    for _ in range(count):
        observation, reward, *_ = env.step(env.action_space.sample())
        found.append((*observation.values(), reward))
    return found


def test_episodes_begin_before_the_set_is_made_and_go_on_with_it(begun, capsys):
    """A seed gives the same objects: with single digits, in copies, when the set replaces them, and later."""
    env = make_vector(DEPTH, num_envs=3)
    told = capsys.readouterr().err
    for words in ("10 digits (split train)", "tactile-assets/mnist3d'", " s on 1 core", "`assets=` takes"):
        assert words in told
    pool = env._scene.pool
    assert isinstance(pool, GrowingPool)
    assert not Path("tactile-assets/mnist3d").exists()
    env.reset(seed=4)
    env.action_space.seed(4)
    assert 0 < len(pool.hulls) < 10 * 200
    other = make_vector(DEPTH, num_envs=3)
    assert capsys.readouterr().err == ""  # announced once
    (work,) = begun
    course = steps(env, 40)
    for copied in (copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))):
        again = copied(env)
        assert again._scene.pool._is_packed.sum() <= 3  # of the objects in the cells
        action = env.action_space.sample()
        np.testing.assert_equal(again.step(action)[:2], copy.deepcopy(env).step(action)[:2])
        assert again._scene.pool._is_packed.sum() <= 6
    work[0](*work[1:])
    observation, _ = other.reset(seed=4)
    other.action_space.seed(4)
    assert isinstance(other._scene.pool.vertices.base, np.memmap)  # of the set that is being made
    later = make_vector(DEPTH, num_envs=3)
    assert type(later._scene.pool) is MeshPool
    np.testing.assert_equal(later.reset(seed=4)[0], observation)
    later.action_space.seed(4)
    for found in (steps(other, 40), steps(later, 40)):
        np.testing.assert_equal(found, course)
    assert [record.id for record in other.current_data_points] == [
        record.id for record in later.current_data_points
    ]
    assert capsys.readouterr().err == ""


def test_a_task_that_needs_all_objects_waits_for_them(begun, capsys):
    env = make_vector(VOLUME, num_envs=2)
    assert type(env._scene.pool) is MeshPool
    assert "This environment needs all of them first." in capsys.readouterr().err
    assert not begun


def test_a_large_data_set_is_packed_in_the_background(begun, assets, monkeypatch, capsys):
    """Episodes are the same meanwhile, and the objects are records of the data set."""
    monkeypatch.setattr(object_sets, "_MANY", 1)
    env, other = (make_vector(DEPTH, num_envs=3, assets=assets) for _ in range(2))
    assert capsys.readouterr().err.count("episodes begin meanwhile") == 1
    (work,) = begun
    work[0](*work[1:])
    later = make_vector(DEPTH, num_envs=3, assets=assets)
    assert [type(each._scene.pool) for each in (env, other, later)] == [GrowingPool, GrowingPool, MeshPool]
    for each in (env, later):
        each.reset(seed=2)
        each.action_space.seed(2)
    np.testing.assert_equal(steps(env, 20), steps(later, 20))
    assert [each.writer for each in env.current_data_points] == [
        each.writer for each in later.current_data_points
    ]
    assert type(make_vector(VOLUME, assets=assets)._scene.pool) is MeshPool


def test_another_set_in_the_folder_is_refused(begun):
    AssetProvider("tactile-assets", generate=True, per_class=2, seed=1).meshes("mnist3d", "test")
    with pytest.raises(InputError, match="seed"):
        make_vector(DEPTH)
    assert not begun


def test_an_interrupt_is_one_error_and_keeps_finished_shards(tmp_path, monkeypatch):
    provider = AssetProvider(tmp_path, generate=True, per_class=1)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    default_set = provider._default_set("mnist3d")
    make = partial(default_set.make, on_progress=lambda progress: progress.done and interrupted())
    with monkeypatch.context() as patched:
        patched.setattr(type(default_set), "make", lambda _, out, split, **__: make(out, split))
        with pytest.raises(KeyboardInterrupt, match=r"what is finished stays in .*mnist3d'") as caught:
            provider.meshes("mnist3d")
    assert caught.value.__suppress_context__
    (shard,) = (tmp_path / "mnist3d" / "data").iterdir()
    content = shard.read_bytes()
    assert len(provider.meshes("mnist3d")) == 10
    assert shard.read_bytes() == content


def test_a_process_in_the_background_makes_a_set(tmp_path, monkeypatch):
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    provider = AssetProvider(tmp_path, generate=True, per_class=1)
    object_sets._make_set(provider, "mnist3d", "train")
    meshes = provider.finished("mnist3d")
    assert MeshPool.kept(meshes).measure("id").tolist() == meshes.ids.tolist()
    assert not provider.is_being_made("mnist3d")
    assert not AssetProvider(tmp_path / "other").is_being_made("mnist3d")
    assert not (tmp_path / "other").exists()


def test_a_large_set_is_packed_by_several_processes_as_by_one(tmp_path, monkeypatch):
    """A mesh with more corners than 16 bits can count makes the type of all faces wider."""
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    solids = [box((0, 0, 0), (0.01, 0.01, 0.001 * n)).to_trimesh() for n in range(1, 12)]
    write_meshes(tmp_path / "set", solids, ("a", "b"))
    meshes = AssetProvider(tmp_path).meshes("set")
    for name, value in {"_CHUNK": 2, "_FEW_CHUNKS": 1}.items():
        monkeypatch.setattr(f"tactile_envs.mesh_pool.{name}", value)
    # In this process, in any order: workers would import the module again.
    monkeypatch.setattr("tactile_toolkit.run.runner_for", lambda _: _Backwards())
    found, expected = MeshPool.of(meshes), MeshPool.packed(meshes)
    for name in ("vertices", "faces", "starts", "hulls", "grids", "measures"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


class _Backwards:
    def run(self, function: Any, tasks: Any) -> Any:
        return map(function, reversed(list(tasks)))


def test_faces_of_a_growing_pool_are_as_wide_as_they_must_be(begun):
    provider = object_sets.AssetProvider(generate=True)
    pool = GrowingPool(provider.plan_meshes("mnist3d"))
    pool.require(np.array([3]))
    narrow = pool.faces.copy()
    fine = trimesh.creation.icosphere(subdivisions=7, radius=0.01)  # its upper half has 80,000 corners
    pool._planned.records[5] = type(pool._planned.records[5])(5, 0, lambda: fine)
    pool.require(np.array([5, 3]))
    assert (narrow.dtype, pool.faces.dtype) == (np.uint16, np.int32)
    np.testing.assert_array_equal(pool.faces[: len(narrow)], narrow)
    assert pool.faces.max() >= 1 << 16
    assert not pool.faces.flags.writeable


@pytest.mark.parametrize(("unit", "per_mm"), [(None, 1.0), ("m", 1e-3), ("cm", 0.1)])
def test_two_folders_of_ones_own_are_two_classes(tmp_path, unit, per_mm):
    for name, side_mm in (("nut", 20), ("bolt", 30), ("bolt", 40)):
        (tmp_path / name).mkdir(exist_ok=True)
        solid = trimesh.creation.box([side_mm * per_mm, 30 * per_mm, 6 * per_mm])
        solid.export(tmp_path / name / f"{side_mm}.stl")
    env = gym.make(f"tactile_envs/{DEPTH}", assets=str(tmp_path), unit=unit)
    assert env.action_space["prediction"].shape == (2,)
    env.reset(seed=0)
    vector = make_vector(DEPTH, assets=tmp_path, unit=unit, num_envs=3)
    vector.reset(seed=0, options={"datapoint_idx": [0, 1, 2]})
    seen = {
        (record.name, record.label, round(float(np.ptp(record.vertices_m[:, 0])) * 1e3))
        for record in vector.current_data_points
    }
    assert seen == {("20.stl", 1, 20), ("30.stl", 0, 30), ("40.stl", 0, 40)}


def test_workers_of_other_programs_start_no_processes(monkeypatch):
    assert mesh_pool.free_workers() >= 1
    monkeypatch.setattr("multiprocessing.process._current_process", type("P", (), {"daemon": True})())
    assert mesh_pool.free_workers() == 1
