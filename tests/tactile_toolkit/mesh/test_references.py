"""Mesh files compared with other programs: meshio, lib3mf, and the command line of PrusaSlicer."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import PrintReport, read_mesh
from tests.processes import PATIENCE_S
from tests.real_input import SHARED
from tests.tactile_toolkit.mesh.solid_files import cube
from tests.tactile_toolkit.mesh.test_foreign_files import TEXTS
from tests.tactile_toolkit.mesh.test_threemf import ITEM, TWO, mesh_xml, package, volume_type

OPC = {
    "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>",
    "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="r" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>',
}
CASES = SHARED / "cases" / "solid"
SLICER = shutil.which("prusa-slicer") or ""


# --- meshio -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("ending", ["stl", "ply", "obj"])
def test_what_meshio_writes_is_read(ending: str, binary: bool, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio", reason="meshio (extra `test`) is not installed")
    ball = trimesh.creation.icosphere(2, 9.0)
    cells = [("triangle", ball.faces.astype(np.int32))]
    path = tmp_path / f"ball.{ending}"
    options = {} if ending == "obj" else {"binary": binary}
    meshio.write(path, meshio.Mesh(ball.vertices, cells), **options)
    found = read_mesh(path)
    # Text of STL and OBJ has six to eight digits.
    assert found.vertices_mm[found.faces] == pytest.approx(ball.triangles, abs=1e-5)


READ_BY_MESHIO = ("mark.stl", "crlf.stl", "tabs.obj", "cr.obj", "from_last.obj")
CASES_READ_BY_MESHIO = (
    *("s01c_solid_capital.stl", "s03_bom.stl", "s06_two_solids.stl", "s08b_nan_normal.stl", "s09_colour.stl"),
    *("s13_empty_first.stl", "s14_double_solid_line.stl", "o02b_bom_mtllib.obj", "o06_crlf_tabs.obj"),
)


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning:meshio")  # of a text, taken as binary
@pytest.mark.parametrize("name", [*READ_BY_MESHIO, *CASES_READ_BY_MESHIO])
def test_what_meshio_reads_is_the_same(name: str, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio", reason="meshio (extra `test`) is not installed")
    path = path_of(name, tmp_path)
    wanted, found = meshio.read(path), read_mesh(path)
    triangles = wanted.points[wanted.cells_dict["triangle"]]
    assert found.vertices_mm[found.faces] == pytest.approx(triangles)


# --- PrusaSlicer --------------------------------------------------------------------------------------

SLICED = (
    *("crlf.stl", "tabs.stl", "one_line.stl", "name.stl", "padded.stl", "dos.stl", "normals.stl"),
    *("tabs.obj", "slashes.obj", "cr.obj", "quads.obj", "from_last.obj"),
    *("modifier.3mf", "blocker.3mf", "two.3mf", "moved.3mf"),
)
CASES_SLICED = (
    *("s06_two_solids.stl", "s07_name_gbk.stl", "s07b_name_latin1.stl", "s08_nan_normal.stl"),
    *("s09_colour.stl", "s10_collapsed.stl", "s15_ulp.stl", "o03_comment_gbk.obj", "o05_mixed.obj"),
    *("o06_crlf_tabs.obj", "m01b_modifier_beside_prusa.3mf"),
)


@pytest.mark.slicer
@pytest.mark.skipif(not SLICER, reason="PrusaSlicer's command line is not installed")
def test_volumes_and_sizes_are_those_of_prusaslicer(tmp_path: Path) -> None:
    package(tmp_path / "modifier.3mf", TWO, ITEM, **volume_type("ParameterModifier"))
    package(tmp_path / "blocker.3mf", TWO, ITEM, **volume_type("SupportBlocker"))
    package(tmp_path / "two.3mf", TWO, ITEM)
    one = f'<object id="1" type="model">{mesh_xml(cube())}</object>'
    one += '<object id="2" type="model"><components><component objectid="1"/></components></object>'
    package(tmp_path / "moved.3mf", one, '<item objectid="2" transform="0 2 0 -1 0 0 0 0 1 9 9 9"/>')
    cases = CASES_SLICED if CASES.is_dir() else ()
    paths = [path_of(name, tmp_path) for name in (*SLICED, *cases)]
    command = [SLICER, "--info", *map(str, paths)]
    told = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, check=False).stdout
    parts = re.split(r"^\[(\w+\.\w+)\]$", told.decode("latin-1"), flags=re.MULTILINE)[1:]
    assert parts[::2] == [path.name for path in paths]
    for path, block in zip(paths, parts[1::2], strict=True):
        said = dict(re.findall(r"^(\w+) = +(\S+)", block, re.MULTILINE))
        report = PrintReport.of(read_mesh(path))
        assert (path.name, said["manifold"], report.is_solid) == (path.name, "yes", True)
        assert report.volume_mm3 == pytest.approx(float(said["volume"]), rel=1e-6), path.name
        assert report.size_mm == pytest.approx([float(said[f"size_{axis}"]) for axis in "xyz"], abs=1e-5)


# --- lib3mf -------------------------------------------------------------------------------------------


def volume_by_lib3mf(path: Path) -> float | None:
    """Return the volume of all built meshes of type "model"; None if lib3mf reads none."""
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf is not installed")
    model = lib3mf.get_wrapper().CreateModel()
    try:
        model.QueryReader("3mf").ReadFromFile(str(path))
    except lib3mf.Lib3MF.ELib3MFException:
        return None
    volume, items = 0.0, model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        mesh = model.GetMeshObjectByID(item.GetObjectResource().GetResourceID())
        if mesh.GetType() == lib3mf.ObjectType.Model:
            matrix = np.array([list(row) for row in item.GetObjectTransform().Fields])[:3]
            places = np.array([list(each.Coordinates) for each in mesh.GetVertices()])
            faces = np.array([list(each.Indices) for each in mesh.GetTriangleIndices()])
            volume += trimesh.Trimesh(places @ matrix, faces, process=False).volume
    return volume


@pytest.mark.parametrize(
    ("resources", "build"),
    [
        (TWO, ITEM),
        (TWO, '<item objectid="1" transform="-2 0 0 0 1 0 0 0 1 5 5 5"/>'),
        (TWO + TWO.replace('id="1" type="model"', 'id="2" type="support"'), ITEM + '<item objectid="2"/>'),
        (TWO + TWO, ITEM),
        (TWO, '<item objectid="9"/>'),
        (TWO.replace('x="10', 'x="10,', 1), ITEM),
    ],
)
def test_3mf_is_read_or_refused_as_by_lib3mf(resources: str, build: str, tmp_path: Path) -> None:
    path = package(tmp_path / "a.3mf", resources, build, **OPC)
    volume = volume_by_lib3mf(path)
    if volume is None:
        with pytest.raises(InputError):
            read_mesh(path)
    else:
        assert read_mesh(path).volume_m3 * 1e9 == pytest.approx(abs(volume))


def path_of(name: str, folder: Path) -> Path:
    """Return the path of a file that was made in a folder, or of one next to the repository."""
    if name in TEXTS:
        (folder / name).write_bytes(TEXTS[name])
    path = folder / name if (folder / name).exists() else CASES / name
    if not path.is_file():
        pytest.skip("the folder ../shared next to the repository has no cases")
    return path
