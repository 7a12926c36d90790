"""Meshes of a user: files, folders of classes, lists of records."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from env_assets.mesh_view import MeshView, flat_turn
from env_assets.provider import meshes_at
from tactile_toolkit.errors import InputError
from tests.env_assets.shapes import box

SOLID = box((0, 0, 0), (0.01, 0.02, 0.03)).to_trimesh()


def write(folder: Path, *names: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        SOLID.copy().apply_scale(1000).export(folder / name)


def test_folders_are_classes_and_loose_files_a_class_each(tmp_path: Path) -> None:
    write(tmp_path / "sorted" / "train" / "10", "b.stl", "a.ply")
    write(tmp_path / "sorted" / "train" / "2", "c.obj", ".half.stl")
    write(tmp_path / "loose", "nut.stl", "bolt.ply")
    by_class, loose = meshes_at(tmp_path / "sorted", "train"), meshes_at(tmp_path / "loose", "test")
    assert by_class.label_names == ("2", "10")
    assert [(each.id, each.label) for each in by_class] == [(0, 0), (1, 1), (2, 1)]
    assert loose.label_names == ("bolt", "nut")
    assert meshes_at(tmp_path / "loose" / "nut.stl", "test").label_names == ("nut",)
    for view in (by_class, loose):
        np.testing.assert_allclose(view.volumes_m3, 6e-6, rtol=1e-5)
        np.testing.assert_allclose(view[1].mesh.extents, (0.01, 0.02, 0.03), rtol=1e-5)


def test_folders_of_another_split_or_of_two_kinds_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "train", "nut.stl")
    with pytest.raises(InputError, match="has no split 'test', only 'train'; next: put meshes into a sub-"):
        meshes_at(tmp_path, "test")
    write(tmp_path / "train" / "screws", "a.stl")
    with pytest.raises(InputError, match=r"holds mesh files \(nut.stl\) next to folders of them \(screws\)"):
        meshes_at(tmp_path, "train")


@pytest.mark.parametrize("sides", [(0.02, 0.03, 0.01), (0.03, 0.02, 0.01)])
def test_objects_are_laid_onto_their_broadest_side_and_stay_as_they_lie(sides: Any) -> None:
    """What is above stays above, what lies along x stays along it."""
    for tilt_deg, about in ((0, "x"), (30, "x"), (-30, "x"), (40, "y"), (-40, "y"), (210, "x"), (150, "y")):
        tilt = Rotation.from_euler(about, tilt_deg, degrees=True).as_matrix()
        tilted = trimesh.creation.box(sides)
        tilted.vertices = tilted.vertices @ tilt.T
        turned = flat_turn(tilted)
        assert np.linalg.det(turned) == pytest.approx(1)
        axes = turned @ tilt  # where the sides of the box lie then
        np.testing.assert_allclose(np.abs(axes), np.eye(3), atol=1e-6)
        assert axes[2, 2] == pytest.approx(np.sign(tilt[2, 2]))
        laid = MeshView([SimpleNamespace(id=0, label=0, mesh=tilted)], ("a",), flat=True)[0].mesh
        np.testing.assert_allclose(laid.extents, sides, atol=1e-6)


def test_meshes_in_metres_need_their_unit(tmp_path: Path) -> None:
    for name in ("a.obj", "b.obj"):
        SOLID.export(tmp_path / name)
    with pytest.raises(InputError, match=r"a\.obj: .* probably in m; next: give --unit m "):
        _ = meshes_at(tmp_path, "train").bounds_m
    found = meshes_at(tmp_path, "train", unit="m")
    np.testing.assert_allclose(np.ptp(found.bounds_m, axis=1), [(0.01, 0.02, 0.03)] * 2, rtol=1e-5)
    with pytest.raises(InputError, match="expected one of mm, cm, m, in"):
        meshes_at(tmp_path, "train", unit="inches")
    (tmp_path / "set").mkdir()
    with pytest.raises(InputError, match="unit is for mesh files"):
        meshes_at(tmp_path / "set", "train", unit="m")


def test_meshes_of_formats_that_are_not_read_are_named(tmp_path, caplog):
    write(tmp_path, "a.STL")
    for name in ("a.step", "b.STEP", "c.dae", "a.mtl", "._d.dae"):
        (tmp_path / name).write_text("x")
    view = meshes_at(tmp_path, "train", unit="m")
    assert [each.id for each in view] == [0]
    named = [
        record.getMessage().partition(": left out; expected one of .stl")[0] for record in caplog.records
    ]
    assert named == [str(tmp_path / "b.STEP"), str(tmp_path / "c.dae")]


def test_a_link_out_of_a_folder_of_meshes_is_not_followed(tmp_path: Path) -> None:
    write(tmp_path, "own.stl")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a.stl").symlink_to(tmp_path / "own.stl")
    with pytest.raises(InputError, match="a link leads out of the folder"):
        _ = meshes_at(tmp_path / "folder", "train").bounds_m


@pytest.mark.oracle
def test_objects_are_laid_flat_as_the_package_does(packages: Any) -> None:
    """The package writes to the vertices; trimesh returns read-only ones now, so they are copied."""
    from tactile_mnist.tactile_perception_vector_env import TactilePerceptionVectorEnv

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
