"""Mesh files: written solids are read back unchanged, and damaged files are refused by name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import manifold3d
import numpy as np
import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, MeshFile, PrintReport, read_mesh, write_mesh
from tactile_toolkit.mesh.mesh import merge_equal_vertices


@pytest.fixture(scope="module")
def ring() -> Mesh:
    arrays = manifold3d.CrossSection.circle(2, 24).translate((8, 0)).revolve(40).to_mesh64()
    vertices_m = np.asarray(arrays.vert_properties)[:, :3] / 1000
    return Mesh(vertices_m.astype(np.float32), np.asarray(arrays.tri_verts).astype(np.int32))


@pytest.mark.parametrize("ending", MeshFile.FORMATS)
def test_a_file_holds_the_solid_that_was_written(ending: str, ring: Mesh, tmp_path: Path) -> None:
    path = tmp_path / f"ring{ending}"
    write_mesh(path, ring)
    back = read_mesh(path)
    assert PrintReport.of(back).problem is None
    assert (PrintReport.of(back).bodies, PrintReport.of(back).genus) == (1, 1)
    assert len(back.vertices_m) == len(ring.vertices_m)
    assert back.faces.shape == ring.faces.shape
    assert np.allclose(back.bounds_m, ring.bounds_m, rtol=0, atol=1e-8)
    assert back.volume_m3 == pytest.approx(ring.volume_m3, rel=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    data = path.read_bytes()
    write_mesh(path, ring)
    assert path.read_bytes() == data


@pytest.mark.parametrize("ending", [".stl", ".glb"])
def test_a_closed_surface_is_read_without_search_trees(ending: str, ring: Mesh, tmp_path: Path) -> None:
    """They take 0.3 s to import, and are for torn surfaces and turned nodes only."""
    path = tmp_path / f"ring{ending}"
    write_mesh(path, ring)
    code = (
        "import sys\nfrom tactile_toolkit.mesh import read_mesh\n"
        "read_mesh(sys.argv[1])\nassert 'scipy.spatial' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)


@pytest.mark.parametrize("ending", MeshFile.FORMATS)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9])
def test_a_file_cut_short_is_refused_or_seen_to_be_open(ending, share, ring, tmp_path):
    path = tmp_path / f"ring{ending}"
    write_mesh(path, ring)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    try:
        mesh = read_mesh(path)
    except InputError:
        return
    # A text file such as OBJ does not state its length.
    assert not PrintReport.of(mesh).is_solid


def test_missing_files_folders_and_unknown_endings_are_refused(ring: Mesh, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent"):
        read_mesh(tmp_path / "absent.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(InputError, match="folder"):
        read_mesh(tmp_path / "folder.stl")
    (tmp_path / "mesh.step").write_text("ISO-10303-21;")
    for name in ("mesh.step", "absent.step"):
        with pytest.raises(InputError, match=r"expected a file ending in \.stl, \.3mf"):
            read_mesh(tmp_path / name)
    with pytest.raises(InputError, match="expected a file ending in"):
        write_mesh(tmp_path / "mesh.step", ring)


def test_ctrl_c_leaves_nothing_behind(ring: Mesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_mesh(tmp_path / "mesh.stl", ring)
    assert list(tmp_path.iterdir()) == []


def test_merging_keeps_the_order_and_the_triangles() -> None:
    corners = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [0, -0.0, 0], [1, 0, 0], [0, 0, 1.0]])
    vertices, faces = merge_equal_vertices(corners, np.array([[0, 1, 2], [3, 4, 5]]))
    assert np.array_equal(vertices, corners[[0, 1, 2, 5]])
    assert faces.tolist() == [[0, 1, 2], [1, 0, 3]]


def test_merging_no_meshes_gives_an_empty_mesh() -> None:
    vertices, faces = merge_equal_vertices(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert (vertices.shape, faces.shape) == ((0, 3), (0, 3))


def test_the_name_of_a_binary_file_may_begin_as_a_text_does(ring: Mesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.stl", ring)
    data = (tmp_path / "a.stl").read_bytes()
    (tmp_path / "a.stl").write_bytes(b"solid facet".ljust(80) + data[80:])
    assert PrintReport.of(read_mesh(tmp_path / "a.stl")).is_solid


def test_meshes_of_trimesh_and_records_are_accepted(ring: Mesh, tmp_path: Path) -> None:
    class Record:
        vertices_m, faces = ring.vertices_m, ring.faces

    for number, thing in enumerate((ring, ring.to_trimesh(), Record())):
        write_mesh(tmp_path / f"{number}.stl", thing)  # type: ignore[arg-type]
        assert PrintReport.of(thing).volume_mm3 == pytest.approx(PrintReport.of(ring).volume_mm3)  # type: ignore[arg-type]
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1
    back = Mesh.from_trimesh(ring.to_trimesh())
    assert (back.faces.dtype, back.vertices_m.dtype) == (np.int32, np.float64)
    for bad in (None, "a.stl", ring.vertices_m):
        with pytest.raises(InputError, match="holds no triangles"):
            PrintReport.of(bad)  # type: ignore[arg-type]
        with pytest.raises(InputError, match="holds no triangles"):
            write_mesh(tmp_path / "bad.stl", bad)  # type: ignore[arg-type]
