"""Solids as tensors: their values, in this process and in workers of every start method."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import mnist3d
import starstruck_gen
from tactile_toolkit.errors import InputError
from tests.processes import printed_by

torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore")]


def squared(record: Any) -> int:
    """A target of a user, at the top level of the module so that it can be pickled."""
    return int(record.label) ** 2


@pytest.fixture
def digits(digits_set: Path) -> mnist3d.DigitDataset:
    return mnist3d.load(str(digits_set), "test")


SCENES = starstruck_gen.SceneDataset(size=6, seed=1)


def test_points_lie_on_the_surface_evenly(digits: mnist3d.DigitDataset) -> None:
    from tactile_toolkit.mesh import SolidTensors

    data = SolidTensors(digits, points=4000, seed=3)
    points, label = data[4]
    assert (tuple(points.shape), points.dtype, label) == ((4000, 3), torch.float32, digits[4].label)
    mesh = digits[4].mesh
    # In millimetres: trimesh treats very small triangles as points.
    larger = mesh.copy().apply_scale(1e3)
    _, distance_mm, _ = trimesh.proximity.closest_point(larger, 1e3 * points[:200].numpy())
    assert distance_mm.max() < 1e-4
    # The mean of points drawn evenly is the middle of the surface; their spread bounds the difference.
    centres, areas = mesh.triangles_center, mesh.area_faces
    middle = (centres * areas[:, None]).sum(axis=0) / areas.sum()
    error = points.numpy().std(axis=0) / np.sqrt(4000)
    assert (np.abs(points.numpy().mean(axis=0) - middle) < 5 * error).all()
    assert torch.equal(data[4][0], points)
    assert torch.equal(data[-6][0], points)
    assert not torch.equal(data[5][0], points)
    data.set_epoch(1)
    assert not torch.equal(data[4][0], points)
    data.set_epoch(0)
    assert torch.equal(pickle.loads(pickle.dumps(data))[4][0], points)
    assert not torch.equal(SolidTensors(digits, points=4000, seed=4)[4][0], points)


def test_voxels_fill_the_inside(digits: mnist3d.DigitDataset) -> None:
    """Compared with the mesh itself, point by point, and by volume."""
    from tactile_toolkit.mesh import SolidTensors

    random = np.random.default_rng(0)
    for data, record, size_m in (
        (SolidTensors(digits, "voxels", pitch_m=0.0005), digits[8], 0.1),
        (SolidTensors(SCENES, "voxels", pitch_m=0.0005), SCENES[2], 0.12),
    ):
        place = 8 if size_m == 0.1 else 2
        voxels, label = data[place]
        count = round(size_m / 0.0005)
        assert (tuple(voxels.shape), voxels.dtype) == ((1, 20, count, count), torch.uint8)
        assert label == record.label
        assert float(voxels.sum()) * 0.0005**3 == pytest.approx(record.mesh.volume, rel=0.03)
        grid = voxels[0].numpy()
        near = np.argwhere(grid) + random.integers(-2, 3, (int(grid.sum()), 3))
        chosen = near[random.integers(len(near), size=400)]
        chosen = chosen[((chosen >= 0) & (chosen < grid.shape)).all(axis=1)]
        layer, row, column = chosen.T
        centres = np.stack([column - (count - 1) / 2, row - (count - 1) / 2, layer + 0.5], axis=1) * 0.0005
        np.testing.assert_array_equal(record.mesh.contains(centres), grid[layer, row, column] == 1)


def test_height_maps_and_meshes(digits: mnist3d.DigitDataset) -> None:
    from env_assets.mesh_view import top_surface
    from tactile_toolkit.mesh import SolidTensors

    heights, volume_m3 = SolidTensors(digits, "height_map", pitch_m=0.0005, target="volume_m3")[3]
    assert (tuple(heights.shape), heights.dtype) == ((1, 200, 200), torch.float32)
    assert volume_m3 == pytest.approx(digits[3].volume_m3)
    surface = top_surface(digits[3], 0.0005)
    window, (rows, columns) = surface, surface.heights_m.shape
    first_row, first_column = window.first_row + 100, window.first_column + 100
    part = heights[0, first_row : first_row + rows, first_column : first_column + columns]
    np.testing.assert_allclose(part.numpy(), surface.filled(), atol=1e-7)
    assert int((heights > 0).sum()) == int((part > 0).sum())
    cut = SolidTensors(digits, "height_map", extent_m=(0.01, 0.02, 0.01), target=None)[3]
    assert tuple(cut.shape) == (1, 20, 10)
    (vertices, faces), square = SolidTensors(digits, "mesh", target=squared)[3]
    np.testing.assert_array_equal(vertices.numpy(), digits[3].vertices_m)
    np.testing.assert_array_equal(faces.numpy(), digits[3].faces)
    assert (vertices.dtype, faces.dtype, square) == (torch.float32, torch.int64, digits[3].label ** 2)
    doubled = SolidTensors(digits, "height_map", transform=lambda tensor: 2 * tensor, target="id")
    assert doubled[3][1] == digits[3].id


def test_invalid_arguments_are_refused() -> None:
    from tactile_toolkit.mesh import SolidTensors

    for given, words in (
        ({"representation": "soup"}, "no representation 'soup'"),
        ({"target": "taste"}, "no target 'taste'"),
        ({"points": 0}, "points is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"pitch_m": 0.0}, "steps of 0.0 m"),
        ({"pitch_m": 1e-9}, "at most"),
        ({"extent_m": (0.1, float("nan"), 0.1)}, "three positive lengths"),
    ):
        with pytest.raises(InputError, match=words):
            SolidTensors(SCENES, **given)  # type: ignore[arg-type]
    with pytest.raises(IndexError):
        SolidTensors(SCENES)[6]


@pytest.mark.parametrize("dataset", ["mnist3d.digit_records", "starstruck_gen.scene_dataset"])
def test_without_torch_the_extra_is_named(dataset: str, tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("raise ImportError('no torch')")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\nimport {dataset}\n"
        "assert 'torch' not in sys.modules\n"
        "try:\n    from tactile_toolkit.mesh import SolidTensors\n"
        "except Exception as error:\n    print(type(error).__name__, error)"
    )
    said = printed_by(code)
    assert said.startswith("MissingExtraError")
    assert "needs the package 'torch'" in said
    assert "the extra `torch`" in said
