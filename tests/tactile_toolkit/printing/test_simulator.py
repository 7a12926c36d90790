"""Bodies for simulators, read by the readers of the simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

import mnist3d
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, read_mesh
from tactile_toolkit.printing import ExportOptions
from tactile_toolkit.printing.exports import export_files, write_plates
from tactile_toolkit.printing.plate_layouts import arrange
from tactile_toolkit.printing.print_options import Physics, PlateSpec
from tests.tactile_toolkit.printing.solids import box, ell, named, open_box, ring
from tests.tactile_toolkit.toy import folder_bytes

SHAPES = [box(20, 10), ell(30, 8), ring(12, 6)]
needs_simulators = pytest.mark.simulators


def digits() -> list[Mesh]:
    source = SyntheticSource(seed=2)
    return [mnist3d.solidify(source.image(number).pixels) for number in (2000, 5001, 9876)]


@needs_simulators
def test_mujoco_has_the_mass_of_a_body_and_lets_it_rest_on_its_flat_side(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco, of the extra simulators")
    solids = [*SHAPES, *digits()]
    made = export_files(named(solids), str(tmp_path), ExportOptions("mjcf", density_kg_m3=1100, friction=0.7))
    assert made.failed == ()
    for solid, file in zip(solids, made.files, strict=True):
        text = (tmp_path / file.file).read_text()
        floor = '<worldbody><geom type="plane" size="0 0 0.05"/>'
        model = mujoco.MjModel.from_xml_string(text.replace("<worldbody>", floor))
        assert model.body_mass[1] == pytest.approx(1100 * solid.volume_m3, rel=1e-6)
        exact = solid.to_trimesh()
        exact.density = 1100
        moments = np.linalg.eigvalsh(exact.moment_inertia)
        assert sorted(model.body_inertia[1]) == pytest.approx(moments, rel=1e-5)
        assert model.geom_friction[2, 0] == 0.7
        data = mujoco.MjData(model)
        data.qpos[2] = 0.005
        for _ in range(2000):
            mujoco.mj_step(model, data)
        assert np.abs(data.qvel).max() < 0.02, "it does not come to rest"
        assert abs(data.qpos[3]) > 0.99, "it does not lie on the side that it was dropped on"
        assert abs(data.qpos[2]) < 0.001, "it sank, or floats"


@needs_simulators
def test_a_plate_is_a_scene(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco, of the extra simulators")
    from dataclasses import replace

    objects = named(SHAPES)
    layout = arrange(objects, PlateSpec.parse("120x120"))
    made = write_plates(replace(layout, physics=Physics()), str(tmp_path))
    assert [plate.file for plate in made.files] == ["plate-01.xml"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "plate-01.xml"))
    names = [model.body(number).name for number in range(1, model.nbody)]
    assert sorted(names) == sorted(item.name for item in objects)
    data = mujoco.MjData(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 0.01
    before = folder_bytes(tmp_path)
    again = write_plates(replace(layout, physics=Physics()), str(tmp_path))
    assert [plate.state for plate in again.files] == ["kept"]
    assert folder_bytes(tmp_path) == before


@needs_simulators
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # yourdfpy's own
def test_a_reader_of_urdf_finds_masses_and_convex_parts(tmp_path: Path):
    yourdfpy = pytest.importorskip("yourdfpy", reason="needs yourdfpy, of the extra simulators")
    made = export_files(named(SHAPES), str(tmp_path), ExportOptions("urdf"))
    for solid, file in zip(SHAPES, made.files, strict=True):
        robot = yourdfpy.URDF.load(
            str(tmp_path / file.file), build_collision_scene_graph=True, load_collision_meshes=True
        )
        (link,) = robot.robot.links
        assert link.inertial.mass == pytest.approx(1240 * solid.volume_m3, rel=1e-6)
        exact = solid.to_trimesh()
        exact.density = 1240
        assert link.inertial.inertia == pytest.approx(exact.moment_inertia, rel=1e-5, abs=1e-12)
        assert link.inertial.origin[:3, 3] == pytest.approx(np.asarray(exact.center_mass), abs=1e-8)
        shown = robot.scene.to_mesh()
        assert shown.volume == pytest.approx(solid.volume_m3, rel=1e-5)
        felt = robot.collision_scene.to_mesh()
        parts = [trimesh.load_mesh(tmp_path / each.geometry.mesh.filename) for each in link.collisions]
        assert all(part.volume == pytest.approx(part.convex_hull.volume, rel=1e-5) for part in parts)
        assert felt.volume == pytest.approx(sum(part.volume for part in parts), rel=1e-5)
        assert felt.volume <= 1.1 * solid.volume_m3


@needs_simulators
def test_usd_knows_the_body_and_its_parts(tmp_path: Path):
    pytest.importorskip("pxr", reason="needs usd-core, of the extra simulators")
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

    solids = [*SHAPES, *digits()[:1]]
    made = export_files(named(solids), str(tmp_path), ExportOptions("usd", density_kg_m3=1100, friction=0.7))
    for solid, file in zip(solids, made.files, strict=True):
        stage = Usd.Stage.Open(str(tmp_path / file.file))
        assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1, "Z")
        body = stage.GetDefaultPrim()
        assert body.HasAPI(UsdPhysics.RigidBodyAPI)
        exact = solid.to_trimesh()
        exact.density = 1100
        mass = UsdPhysics.MassAPI(body)
        assert mass.GetMassAttr().Get() == pytest.approx(exact.mass, rel=1e-6)
        assert list(mass.GetCenterOfMassAttr().Get()) == pytest.approx(list(exact.center_mass), abs=1e-8)
        turn = np.array(Gf.Matrix3d(Gf.Quatd(mass.GetPrincipalAxesAttr().Get()))).T
        inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
        size = np.abs(exact.moment_inertia).max()
        np.testing.assert_allclose(inertia, exact.moment_inertia, atol=1e-5 * size)
        visual, *parts = (UsdGeom.Mesh(prim) for prim in body.GetChildren() if prim.IsA(UsdGeom.Mesh))
        found = trimesh.Trimesh(visual.GetPointsAttr().Get(), _triangles(visual))
        assert found.volume == pytest.approx(solid.volume_m3, rel=1e-5)
        assert not visual.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
        felt = 0.0
        for part in parts:
            assert part.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
            assert UsdPhysics.MeshCollisionAPI(part.GetPrim()).GetApproximationAttr().Get() == "convexHull"
            material, _ = UsdShade.MaterialBindingAPI(part.GetPrim()).ComputeBoundMaterial("physics")
            friction = UsdPhysics.MaterialAPI(material.GetPrim()).GetDynamicFrictionAttr().Get()
            assert friction == pytest.approx(0.7)
            felt += trimesh.Trimesh(part.GetPointsAttr().Get(), _triangles(part)).convex_hull.volume
        assert solid.volume_m3 * 0.999 <= felt <= 1.1 * solid.volume_m3


def _triangles(mesh: Any) -> np.ndarray:
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    return np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)


def test_meshes_that_cannot_be_bodies_are_named(tmp_path: Path):
    made = export_files(named([box(5, 5), open_box(5, 5)]), str(tmp_path), ExportOptions("urdf"))
    assert [failure.name for failure in made.failed] == ["test-1-00001"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["test-0-00000", "test-0-00000.urdf"]
    for values in ({"density_kg_m3": 0}, {"friction": float("nan")}, {"density_kg_m3": "heavy"}):
        with pytest.raises(InputError, match="expected a number above 0"):
            Physics(**values)


def test_bodies_that_mujoco_refuses_are_named_before(tmp_path: Path):
    """MuJoCo accepts moments of inertia from 1e-14 kg m² on."""
    for kind in ("mjcf", "urdf", "usd"):
        made = export_files(named(SHAPES), str(tmp_path), ExportOptions(kind, scale=0.02))
        assert [each.problem for each in made.failed] == ["too-light"] * len(SHAPES)
        assert "MuJoCo" in made.failed[0].detail


def test_urdf_files_keep_the_paths_of_their_meshes(tmp_path: Path):
    (made,) = export_files(named(SHAPES[:1]), str(tmp_path), ExportOptions("urdf")).files
    root = ElementTree.parse(tmp_path / made.file).getroot()
    assert root.find("mujoco/compiler").attrib == {"strippath": "false"}
    mujoco = pytest.importorskip("mujoco", reason="needs mujoco, of the extra simulators")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / made.file)).nmesh > 0


def test_meshes_of_urdf_are_asked_for_their_unit(tmp_path: Path):
    """URDF is in metres, and OBJ states no unit: parts read in mm are a thousand times too small."""
    solid = ell(40, 12)
    export_files(named([solid]), str(tmp_path), ExportOptions("urdf"))
    (visual,) = tmp_path.rglob("visual.obj")
    with pytest.raises(InputError, match=r"probably in m; next: give --unit m "):
        read_mesh(visual)
    found = read_mesh(visual, unit="m")
    assert np.ptp(found.bounds_m, axis=0) == pytest.approx(np.ptp(solid.bounds_m, axis=0), rel=1e-6)
