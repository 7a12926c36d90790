"""The pool of meshes and its height maps, compared with plain loops and with `tactile_sim`."""

from __future__ import annotations

import os
from types import SimpleNamespace

import numpy as np
import pytest

import env_assets
import mnist3d
from tactile_envs.mesh_pool import MeshPool
from tactile_envs.touch_kernels import allocate_workspace, raise_object
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import pose, render_touch
from tactile_sim.press.sensors import center_view
from tests.env_assets.shapes import box


@pytest.mark.parametrize("off_px", [0.0, 4e-7, -4e-7])
def test_pixels_on_the_edge_of_a_triangle_are_raised_whichever_way_its_corners_round(off_px):
    per_m = 1024.0  # a power of two: corners are exactly where they should be
    block = box((2 / per_m, 1 / per_m, 0), (5 / per_m, 4 / per_m, 1 / per_m))
    pool = MeshPool.packed([SimpleNamespace(vertices_m=block.vertices_m, faces=block.faces, label=0, id=0)])
    workspace = allocate_workspace((8, 8))
    raise_object(pool.arrays, 0, (1.0, 0.0, off_px, off_px, per_m), workspace)
    expected = np.zeros((8, 8))
    expected[1:5, 2:6] = 1 / per_m
    assert workspace[0][:, :8].tolist() == expected.tolist()


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", ["mnist3d", "starstruck", "wrench"])
def test_height_maps_agree_with_pressing(name, assets):
    """Within a hundredth of a micrometre at visible pixels, except those on the edge of an upright wall."""
    meshes = env_assets.AssetProvider(assets).meshes(name)
    pool = MeshPool.of(meshes)
    sensor, random = center_view(64, 64), np.random.default_rng(0)
    per_m = 64 / sensor.window_m[0]
    workspace = allocate_workspace((64, 64))
    heights = workspace[0]
    off = pixels = 0
    for trial in range(60):
        number = trial % len(meshes)
        turn = random.uniform(-4, 4)
        lies = pose(0.003, 0.002, turn_rad=turn)
        lies[2, 3] = -pool.measure("foot_m")[number]
        vertices_m = np.asarray(meshes[number].vertices_m, np.float64)
        aimed = (lies[:3, :3] @ vertices_m[random.integers(len(vertices_m))] + lies[:3, 3])[:2]
        gel = np.eye(4)
        gel[:2, 3] = np.clip(aimed, -0.04, 0.04)
        heights[:] = 0
        middle = 31.5 - np.array(sensor.sample_px)
        x_px, y_px = (lies[:2, 3] - gel[:2, 3]) * per_m + middle
        placed = float(np.cos(turn)), float(np.sin(turn)), float(x_px), float(y_px), per_m
        raise_object(pool.arrays, number, placed, workspace)
        found = heights[::-1, :64]
        depth_m = np.minimum(sensor.press_m + found.max() - found, sensor.gel_m)
        truth = render_touch(Pressable.of(meshes[number], check=False), lies, gel, sensor).depth_m
        off += int((np.abs(depth_m - np.minimum(truth, sensor.gel_m)) > 1e-8).sum())
        pixels += depth_m.size
    assert off <= 1e-5 * pixels


def test_a_pool_on_disk_equals_the_one_in_memory(assets):
    meshes = env_assets.AssetProvider(assets).meshes("mnist3d")
    made, again, packed = MeshPool.of(meshes), MeshPool.of(meshes), MeshPool.packed(meshes)
    for name in ("vertices", "faces", "starts", "hulls", "grids", "measures"):
        for pool in (again, packed):
            assert (getattr(made, name) == getattr(pool, name)).all()
            assert getattr(made, name).dtype == getattr(pool, name).dtype
            assert not getattr(pool, name).flags.writeable
    assert isinstance(again.vertices.base, np.memmap)
    assert sum(array.nbytes for array in packed.arrays) < 90_000 * len(meshes)


def test_a_view_of_meshes_has_a_pool_of_its_own(assets):
    meshes = env_assets.AssetProvider(assets).meshes("mnist3d")
    some = MeshPool.of(meshes[[4, 2]])
    assert some.measure("id").tolist() == meshes.ids[[4, 2]].tolist()
    assert len(MeshPool.of(meshes)) == len(meshes)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    "damage", ["empty", "cut", "flipped", "of another program", *["pipe"] * hasattr(os, "mkfifo")]
)
def test_a_damaged_pool_is_made_again(damage, assets, tmp_path, monkeypatch):
    """Kernels trust the indices in the file, so a damaged file must not be used."""
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path))
    meshes = env_assets.AssetProvider(assets).meshes("mnist3d")
    made = MeshPool.of(meshes)
    (path,) = (path for path in (tmp_path / "environments").iterdir() if path.suffix != ".lock")
    intact = path.read_bytes()
    flipped = bytearray(intact)
    flipped[len(intact) // 2] ^= 1
    content = {"empty": b"", "cut": intact[:-1], "flipped": bytes(flipped)}.get(damage, b"text" * 100)
    other = tmp_path / "other"
    other.write_bytes(content)
    if damage == "pipe":  # opening it would wait for a writer
        other.unlink()
        os.mkfifo(other)
    other.replace(path)
    assert (MeshPool.of(meshes).vertices == made.vertices).all()
    assert path.read_bytes() == intact


def test_a_pool_is_of_the_meshes_that_were_loaded(assets, tmp_path, monkeypatch):
    """A data set that replaces another at the same address gets its own pool."""
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path))
    store = fsspec.filesystem("memory")
    found = []
    for kept in ("train", "printed_train"):
        source = next((assets / "mnist3d" / "data").glob(f"{kept}-*.parquet"))
        store.pipe_file("/pools/data/train-00000-of-00001.parquet", source.read_bytes())
        found.append(MeshPool.of(mnist3d.load("memory://pools", "train")).measure("id").tolist())
    assert found[0] != found[1]
