from __future__ import annotations

import numpy as np
import pytest

import env_assets
from env_assets.mesh_view import MeshView, require_fitting_meshes
from env_assets.provider import KINDS
from starstruck_gen.kind import KIND as SCENES
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh
from tests.env_assets.factories import write_meshes
from tests.env_assets.shapes import box

SMALL = box((0, 0, 0), (0.01, 0.02, 0.005))
WIDE = box((-0.1, 0, 0), (0.1, 0.02, 0.005))
INSIDE_OUT = Mesh(SMALL.vertices_m, SMALL.faces[:, ::-1])
HOLLOW = Mesh(SMALL.vertices_m[:0], SMALL.faces[:0])
STRANGE = Mesh(SMALL.vertices_m, SMALL.faces + 1)
FLAT = Mesh(SMALL.vertices_m[:4], SMALL.faces[:2])


def opened(folder, *solids):
    write_meshes(folder / "solids", [solid.to_trimesh() for solid in solids], ("a", "b", "c"))
    return MeshView.of(env_assets.AssetProvider(folder).meshes("solids"))


def test_measures_are_those_of_the_meshes_in_the_order_of_the_rows(tmp_path):
    meshes = opened(tmp_path, SMALL, WIDE, INSIDE_OUT)
    np.testing.assert_allclose(meshes.volumes_m3, [1e-6, 2e-5, -1e-6], rtol=1e-5)
    np.testing.assert_allclose(meshes[[2, 0]].volumes_m3, [-1e-6, 1e-6], rtol=1e-5)
    expected = [[solid.vertices_m.min(axis=0), solid.vertices_m.max(axis=0)] for solid in (SMALL, WIDE)]
    np.testing.assert_allclose(meshes[:2].bounds_m, expected, rtol=1e-6)


def test_valid_assets_pass_and_others_are_named(tmp_path):
    meshes = opened(tmp_path, SMALL, WIDE, WIDE)
    require_fitting_meshes(meshes, None, "solids", (0.2001, 0.12))
    require_fitting_meshes(meshes[:1], None, "solids", (0.0101, 0.0201))
    words = r"mesh 1 of solids needs 200.0 x 20.0 mm, the cell has 120 x 120 mm \(2 of 3 do not fit\)"
    with pytest.raises(InputError, match=words):
        require_fitting_meshes(meshes, None, "solids", (0.12, 0.12))
    with pytest.raises(InputError, match=r"mesh 0 of solids needs 10.0 x 20.0 mm"):
        require_fitting_meshes(meshes, None, "solids", (1.0, 0.0199))


@pytest.mark.parametrize("wrong", [INSIDE_OUT, FLAT])
def test_meshes_without_volume_are_named(tmp_path, wrong):
    meshes = opened(tmp_path, SMALL, WIDE, wrong)
    require_fitting_meshes(meshes[:2], None, "solids", (1.0, 1.0))
    with pytest.raises(InputError, match=r"mesh 2 of solids has a volume of .*\(1 of 3 do not fit\)"):
        require_fitting_meshes(meshes, None, "solids", (1.0, 1.0))


def test_classes_have_names_and_an_order(tmp_path):
    meshes = opened(tmp_path, SMALL)
    with pytest.raises(InputError, match="solids has classes a, b, c; expected 0, 1, 2"):
        require_fitting_meshes(meshes, KINDS["mnist3d"], "solids", (1.0, 1.0))
    swapped = tuple("1023456789")
    with pytest.raises(InputError, match=r"solids has classes 1, 0, 2, .*; expected 0, 1, 2"):
        require_fitting_meshes(MeshView(meshes.records, swapped), KINDS["mnist3d"], "solids", (1.0, 1.0))
    require_fitting_meshes(
        MeshView(meshes.records, tuple("0123456789")), KINDS["mnist3d"], "solids", (1.0, 1.0)
    )


def test_a_published_wrench_needs_no_columns_of_the_toolkit(tmp_path):
    write_meshes(tmp_path / "wrench", [SMALL.to_trimesh()], ("open-end",))
    assert len(env_assets.AssetProvider(tmp_path).meshes("wrench")) == 1


def test_digits_are_no_wrench(tmp_path):
    write_meshes(tmp_path / "wrench", [SMALL.to_trimesh()], tuple("0123456789"))
    with pytest.raises(InputError, match="expected to hold wrenches, found digits"):
        env_assets.AssetProvider(tmp_path).meshes("wrench")


class Solid:
    """A mesh with arrays that trimesh would not accept."""

    def __init__(self, mesh):
        self.vertices, self.faces = mesh.vertices_m, mesh.faces


@pytest.mark.parametrize(
    ("wrong", "words"), [(HOLLOW, "has no vertices"), (STRANGE, "name vertex 8, but only 8 vertices")]
)
def test_unsound_meshes_are_named(tmp_path, wrong, words):
    write_meshes(tmp_path / "solids", [Solid(SMALL), Solid(wrong)], ("a", "b"))
    meshes = env_assets.AssetProvider(tmp_path).meshes("solids")
    with pytest.raises(InputError, match=f"mesh 1 .*{words}"):
        require_fitting_meshes(MeshView.of(meshes), None, "solids", (1.0, 1.0))


def test_labels_are_classes(tmp_path):
    meshes = opened(tmp_path, SMALL, SMALL, SMALL, SMALL)  # the fourth has label 3, there are three classes
    require_fitting_meshes(meshes[:3], None, "solids", (1.0, 1.0))
    with pytest.raises(InputError, match=r"mesh 3 of solids has label 3, expected 0 to 2 \(1 of 4 do"):
        require_fitting_meshes(meshes, None, "solids", (1.0, 1.0))


def test_scenes_lie_in_their_cell(tmp_path):
    moved = Mesh(SMALL.vertices_m + np.array([1.0, 0, 0]), SMALL.faces)
    meshes = MeshView(opened(tmp_path, SMALL, moved).records, SCENES.class_names)
    require_fitting_meshes(meshes[:1], KINDS["starstruck"], "scenes", (0.12, 0.12))
    with pytest.raises(InputError, match=r"mesh 1 of scenes needs 2018.0 x 38.0 mm"):
        require_fitting_meshes(meshes, KINDS["starstruck"], "scenes", (0.12, 0.12))
