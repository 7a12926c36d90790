"""Mesh files of other programs: read as their formats say, or refused with the reason.

Expected results of the files next to the repository are from the references that `solid.md` lists there.
"""

from __future__ import annotations

import gzip
import math
import os
import struct
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import trimesh

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, MeshFile, PrintReport, read_mesh
from tactile_toolkit.mesh.files import pack_mesh, unpack_mesh
from tactile_toolkit.mesh.plain_formats import cut_polygons
from tests.real_input import SHARED
from tests.tactile_toolkit.mesh.solid_files import cube, outcome_of

CASES = SHARED / "cases" / "solid"

# A volume in mm³, or words of the error or of the problem.
OUTCOMES: dict[str, float | str] = {
    "g01_yup.glb": 3000,
    "g02_draco.glb": "KHR_draco_mesh_compression",
    "m01_negative_prusa.3mf": "negative volume",
    "m01b_modifier_beside_prusa.3mf": 27_000,
    "m02_unprintable.3mf": 27_000,
    "m03_support_type.3mf": 27_000,
    "m05_boolean.3mf": "booleanoperations",
    "m06_degenerate.3mf": 8000,
    "m07_unshared.3mf": "36 edges",
    "o01_concave.obj": 2000,
    **dict.fromkeys(("o02b_bom_mtllib.obj", "o03_comment_gbk.obj", "o05_mixed.obj"), 8000),
    "o04_comma.obj": "'20,5' is not a number",
    "o06_crlf_tabs.obj": 8000,
    "p01_big_endian.ply": 8000,
    "s02_tail.stl": "776 bytes",
    "s05_comma.stl": "is not a number",
    "s06_two_solids.stl": 16_000,
    "s10b_duplicate.stl": "3 edges",
    "s11b_dexp.stl": "is not a number",
    "s12_metres.stl": "--unit m ",
    **{
        f"{name}.stl": 8000
        for name in (
            *("s01_upper", "s01c_solid_capital", "s03_bom", "s04b_end_loop", "s07_name_gbk"),
            *("s07b_name_latin1", "s08_nan_normal", "s08b_nan_normal", "s09_colour", "s10_collapsed"),
            *("s11_cr", "s13_empty_first", "s14_double_solid_line", "s15_ulp"),
        )
    },
}


@pytest.mark.skipif(not CASES.is_dir(), reason="the folder ../shared next to the repository has no cases")
@pytest.mark.parametrize("name", OUTCOMES)
def test_files_of_public_reports(name: str) -> None:
    found, expected = outcome_of(CASES / name), OUTCOMES[name]
    if isinstance(expected, str):
        assert expected in str(found)
    else:
        assert found == pytest.approx(expected, rel=1e-4)


# --- text and binary, made here -----------------------------------------------------------------------


def stl_text(mesh: Mesh, name: str = "part") -> str:
    facets = "".join(
        "  facet normal 0 0 0\n    outer loop\n"
        + "".join(f"      vertex {x:.6g} {y:.6g} {z:.6g}\n" for x, y, z in corners)
        + "    endloop\n  endfacet\n"
        for corners in mesh.vertices_mm[mesh.faces]
    )
    return f"solid {name}\n{facets}endsolid {name}\n"


def obj_text(vertices: Any, polygons: Any) -> str:
    rows = [f"v {x} {y} {z}" for x, y, z in vertices]
    return "\n".join([*rows, *("f " + " ".join(str(c + 1) for c in each) for each in polygons), ""])


CUBE_STL = stl_text(cube())
CUBE_OBJ = obj_text(cube().vertices_mm, cube().faces)
TEXTS = {
    "capitals.stl": CUBE_STL.upper().encode(),
    "mark.stl": b"\xef\xbb\xbf" + CUBE_STL.encode(),
    "utf16.stl": CUBE_STL.encode("utf-16"),
    "words_apart.stl": CUBE_STL.replace("end", "end ").encode(),
    "tabs.stl": CUBE_STL.replace(" ", "\t").encode(),
    "cr.stl": CUBE_STL.replace("\n", "\r").encode(),
    "crlf.stl": CUBE_STL.replace("\n", "\r\n").encode(),
    "one_line.stl": CUBE_STL.replace("endsolid", "\nendsolid").replace("    ", " ").encode(),
    "name.stl": CUBE_STL.replace("part", "\u96f6\u4ef6 facet").encode("gbk"),
    "padded.stl": CUBE_STL.encode() + b"\0" * 40,
    "dos.stl": CUBE_STL.encode() + b"\x1a",
    "normals.stl": CUBE_STL.replace("normal 0 0 0", "normal -nan(ind) nan inf").encode(),
    "mark.obj": b"\xef\xbb\xbf" + CUBE_OBJ.encode(),
    "tabs.obj": CUBE_OBJ.replace(" ", "\t").replace("\n", "\t \r\n").encode(),
    "comments.obj": CUBE_OBJ.replace("\n", " # \u96f6 f 1 2 3\n").encode("gbk"),
    "slashes.obj": CUBE_OBJ.replace("f ", "vt 0 0\nl 1 2\np 3\nf ").encode(),
    "cr.obj": CUBE_OBJ.replace("\n", "\r").encode(),
    "quads.obj": obj_text(
        cube().vertices_mm,
        [[1, 3, 2, 0], [6, 7, 5, 4], [4, 5, 1, 0], [3, 7, 6, 2], [2, 6, 4, 0], [5, 7, 3, 1]],
    ).encode(),
    "from_last.obj": (CUBE_OBJ.partition("f ")[0] + "v 9 9 9\n" * 2).encode()
    + b"".join(b"f %d %d/7 %d//7\n" % tuple(c - 10 for c in each) for each in cube().faces.tolist())
    + b"v 9 9 9\n",
    "continued.obj": CUBE_OBJ.replace("v ", "v \\\n").encode(),
}


@pytest.mark.parametrize("name", TEXTS)
def test_text_of_any_program_is_read(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(TEXTS[name])
    assert outcome_of(tmp_path / name) == pytest.approx(8000)


DAMAGED = {
    "cut.stl": (CUBE_STL[:-20].encode(), "ends with 'endsolid'"),
    "comma.stl": (CUBE_STL.replace("10", "10,0").encode(), "'-10,0' is not a number"),
    "letters.stl": (CUBE_STL.replace("vertex 10", "vertex ten", 1).encode(), "'ten' is not a number"),
    "half.stl": (CUBE_STL.replace("endfacet", "", 1).encode(), "is not a facet"),
    "tail.stl": (pack_mesh(cube(), ".stl") + bytes(92), "776 bytes, a binary STL file of 12 triangles"),
    "underscore.stl": (CUBE_STL.replace("vertex 10", "vertex 1_0").encode(), "'1_0' is not a number"),
    "packed.stl": (gzip.compress(pack_mesh(cube(), ".stl")), "its content is gzip; expected STL"),
    "archive.obj": (pack_mesh(cube(), ".3mf"), "its content is a zip archive; expected OBJ"),
    "model.ply": (pack_mesh(cube(), ".glb"), "its content is binary glTF; expected PLY"),
    "utf16.stl": (CUBE_STL.encode("utf-16-le"), "neither text nor binary STL"),
    "far.stl": (CUBE_STL.replace("vertex 10", "vertex 1e30", 1).encode(), "1e+30 mm long"),
    "page.stl": (b"<html>not found</html>\n" * 9, "begins with '<html>not found</html>'"),
    "short.obj": (b"v 1 2\nf 1 1 1\n", "fewer than three coordinates"),
    "beyond.obj": (CUBE_OBJ.replace("f ", "f 99 ").encode(), "names vertex 98, counted from 0"),
    "bare.obj": ((CUBE_OBJ + "f\n").encode(), "a face has 0 corners"),
    "zero.obj": (CUBE_OBJ.replace("f ", "f 0 ").encode(), "a face names vertex 0 of 8 so far"),
    "underscore.obj": (CUBE_OBJ.replace("f 2 ", "f 0_2 ").encode(), "'0_2' is not a number"),
    "huge.obj": (CUBE_OBJ.replace("f ", f"f {10**30} ").encode(), "faces name vertices 1 to 1000000"),
    "surface.obj": (b"surf 0 1 0 1 1 2\n", "free-form surface"),
    "word.obj": (CUBE_OBJ.replace("f ", "f one ").encode(), "'one' is not a number; expected an integer"),
    "format.ply": (b"ply\nformat text 1.0\nend_header\n", "the format is 'text'"),
    "page.ply": (b"<html>", "no header"),
    "underscore.ply": (
        pack_mesh(cube(), ".ply")[:0] + b"ply\nformat ascii 1.0\nelement vertex 1\n"
        b"property int x\nend_header\n1_0\n",
        "'1_0' is not a number",
    ),
    "type.ply": (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n0\n", "half x"),
    "text.glb": (b"{}", "not binary glTF"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_described_in_a_sentence(name: str, tmp_path: Path) -> None:
    content, words = DAMAGED[name]
    (tmp_path / name).write_bytes(content)
    found = str(outcome_of(tmp_path / name))
    assert words in found
    # Without messages of libraries.
    assert not any(word in found for word in ("unmatched", "reshape", "buffer", "0x", "Error"))


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".glb", ".3mf"])
def test_random_damage_is_refused_without_messages_of_libraries(ending: str) -> None:
    random = np.random.default_rng(0)
    whole, said = pack_mesh(cube(), ending), ""
    for _ in range(150):
        data = bytearray(whole)
        for at in random.integers(0, len(data), random.integers(1, 6)):
            data[at] = random.integers(0, 256)
        try:
            unpack_mesh(bytes(data[: random.integers(1, len(data) + 1)]), ending)
        except InputError as error:
            said += str(error)
    assert not any(word in said for word in ("reshape", "buffer size", "numpy", "broadcast"))


# --- units --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["m", "in", "cm", "mm"])
@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply"])
def test_units_are_requested_and_applied(unit: str, ending: str, tmp_path: Path) -> None:
    size = {"m": 0.02, "in": 20 / 25.4, "cm": 2.0, "mm": 20.0}[unit]
    path = tmp_path / f"part{ending}"
    path.write_bytes(pack_mesh(cube(size), ending))
    assert np.ptp(read_mesh(path, unit=unit).bounds_m, axis=0) == pytest.approx([0.02] * 3)
    if unit in ("m", "in"):
        with pytest.raises(InputError, match=rf"probably in {unit}; next: give --unit {unit} "):
            read_mesh(path)
        assert np.ptp(read_mesh(path, unit="mm").bounds_m, axis=0) == pytest.approx([size / 1000] * 3)
    with pytest.raises(InputError, match="expected one of mm, cm, m, in"):
        read_mesh(path, unit="inch")


def test_objects_that_are_likely_in_inches_have_a_note(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    for size, notes in (
        (50 / 25.4, ("it is 1.97 mm long; if it should be 50 mm, add --unit in",)),
        (20, ()),
    ):
        path.write_bytes(pack_mesh(cube(size), ".stl"))
        assert read_mesh(path).notes == notes
        assert read_mesh(path, unit="mm").notes == ()
    flat = cube(20)
    flat.vertices_m[:, 2] /= 1000
    path.write_bytes(pack_mesh(flat, ".stl"))
    assert read_mesh(path).notes == ("it is 20 mm long; if it should be 508 mm, add --unit in",)
    for ending in (".3mf", ".glb"):
        (tmp_path / f"part{ending}").write_bytes(pack_mesh(cube(2), ending))
        assert read_mesh(tmp_path / f"part{ending}").notes == ()


@pytest.mark.parametrize(("radius_m", "sections"), [(1e-3, 512), (5e-4, 256), (1e-4, 64)])
def test_a_tiny_cone_in_metres_is_a_solid(radius_m: float, sections: int, tmp_path: Path) -> None:
    """Its corners lie a few micrometres apart; trimesh, which drops such triangles, makes it open."""
    turns = np.arange(sections) * (2 * np.pi / sections)
    rim = radius_m * np.stack([np.cos(turns), np.sin(turns), np.zeros(sections)], axis=1)
    beside = np.roll(rim, -1, axis=0)
    tip, middle = np.full((sections, 3), [0, 0, 2 * radius_m]), np.zeros((sections, 3))
    corners = np.concatenate([np.stack([rim, beside, tip], 1), np.stack([beside, rim, middle], 1)])
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["corners"] = corners
    content = bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes()
    (tmp_path / "cone.stl").write_bytes(content)
    base_mm2 = sections / 2 * math.sin(2 * math.pi / sections) * (1e3 * radius_m) ** 2
    assert outcome_of(tmp_path / "cone.stl", "m") == pytest.approx(base_mm2 * 2e3 * radius_m / 3, rel=1e-4)


def test_formats_that_state_their_unit_keep_it(tmp_path: Path) -> None:
    for ending, stated in ((".glb", "m"), (".3mf", "mm")):
        path = tmp_path / f"part{ending}"
        path.write_bytes(pack_mesh(cube(20), ending))
        for unit in (None, "in", "m"):
            assert np.ptp(read_mesh(path, unit=unit).bounds_m, axis=0) == pytest.approx([0.02] * 3)
        path.write_bytes(pack_mesh(cube(20_000), ending))
        for unit in (None, "in"):
            with pytest.raises(InputError, match="expected 1 to 1000 mm"):
                read_mesh(path, unit=unit)
        assert read_mesh(path, unit=stated).volume_m3 == pytest.approx(8000)


# --- polygons -----------------------------------------------------------------------------------------

L_SHAPE = [(20, 0), (20, 10), (10, 10), (10, 30), (0, 30), (0, 0)]


def prism(outline: list[tuple[float, float]]) -> tuple[np.ndarray, list[list[int]]]:
    count = len(outline)
    vertices = np.array([(x, y, z) for z in (0, 5) for x, y in outline], float)
    sides = [[at, (at + 1) % count, count + (at + 1) % count, count + at] for at in range(count)]
    return vertices, [list(range(count))[::-1], list(range(count, 2 * count)), *sides]


def ply_of(vertices: np.ndarray, polygons: list[list[int]], form: str) -> bytes:
    head = (
        f"ply\r\nformat {form} 1.0\r\ncomment end_header is below\r\nelement vertex {len(vertices)}\r\n"
        "property double x\r\nproperty double y\r\nproperty double z\r\nproperty uchar red\r\n"
        f"element face {len(polygons)}\r\nproperty uchar flags\r\nproperty list uchar int vertex_index\r\n"
        "end_header\r\n"
    ).encode()
    if form == "ascii":
        rows = [*(f"{x} {y} {z} 255" for x, y, z in vertices)]
        rows += [f"7 {len(each)} " + " ".join(map(str, each)) for each in polygons]
        return head + "\r\n".join(rows).encode()
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(f"{order}dddB", *row, 255) for row in vertices.tolist())
    return (
        head
        + body
        + b"".join(struct.pack(f"{order}BB{len(each)}i", 7, len(each), *each) for each in polygons)
    )


@pytest.mark.parametrize("turn_deg", [0, 33])
@pytest.mark.parametrize("form", ["obj", "ascii", "binary_little_endian", "binary_big_endian"])
def test_concave_polygons_are_triangulated_correctly(form: str, turn_deg: float, tmp_path: Path) -> None:
    vertices, polygons = prism(L_SHAPE)
    turn = trimesh.transformations.rotation_matrix(math.radians(turn_deg), (1, 2, 3))[:3, :3]
    content = obj_text(vertices @ turn, polygons).encode()
    if form != "obj":
        content = ply_of(vertices @ turn, polygons, form)
    path = tmp_path / ("part.obj" if form == "obj" else "part.ply")
    path.write_bytes(content)
    assert outcome_of(path) == pytest.approx(2000)
    if form != "obj":
        path.write_bytes(content[:-3])
        assert isinstance(outcome_of(path), str)


def test_cut_polygons_cover_their_area_once() -> None:
    random = np.random.default_rng(3)
    for corners in (4, 5, 8, 40):
        way = np.sort(random.uniform(0, 2 * math.pi, corners))
        star = random.uniform(1, 9, corners)[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
        vertices = np.column_stack([star, np.zeros(corners)])
        faces = cut_polygons(vertices, np.array([corners]), np.arange(corners))
        a, b, c = star[faces].swapaxes(0, 1)
        doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        area = manifold3d.CrossSection([star]).area()
        assert len(faces) == corners - 2
        assert np.abs(doubled).sum() / 2 == pytest.approx(area)
        assert doubled.sum() / 2 == pytest.approx(area)
    with pytest.raises(InputError, match="a face has 2 corners"):
        cut_polygons(np.zeros((4, 3)), np.array([4, 2]), np.arange(6) % 4)
    turns = np.arange(10_000) * (2 * np.pi / 10_000)
    radii = 1 + 0.5 * (np.arange(10_000) % 2)
    star = np.stack([radii * np.cos(turns), radii * np.sin(turns), 0 * turns], axis=1)
    with pytest.raises(
        InputError, match=r"too many faces of up to 10,000 corners .*; next: triangulate them"
    ):
        cut_polygons(star, np.full(11, 10_000), np.tile(np.arange(10_000), 11))


# --- corners that rounding has separated -------------------------------------------------------------


@pytest.mark.parametrize("ending", [".stl", ".obj"])
def test_separated_corners_are_welded_and_counted(ending: str, tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2, 0.01)
    apart = ball.vertices[ball.faces].reshape(-1, 3)
    random = np.random.default_rng(0)
    for shift, closes in ((3e-6, True), (3e-4, False)):
        moved = apart + shift * 0.02 * random.uniform(-0.5, 0.5, apart.shape) / math.sqrt(3)
        path = tmp_path / f"ball{ending}"
        path.write_bytes(pack_mesh(Mesh(moved, np.arange(len(apart), dtype=np.int32).reshape(-1, 3)), ending))
        mesh = read_mesh(path)
        report = PrintReport.of(mesh)
        assert report.is_solid == closes
        if closes:
            assert report.notes == (f"{len(np.unique(moved, axis=0)) - len(ball.vertices):,} corners welded",)
            assert report.volume_mm3 == pytest.approx(ball.volume * 1e9, rel=1e-4)
            assert len(mesh.vertices_m) == len(ball.vertices)
        else:
            assert report.notes == ()


def test_a_corner_far_away_does_not_weld_the_others(tmp_path: Path) -> None:
    """Relative to its distance, all others would be close together: half of the cube would be welded."""
    path = tmp_path / "far.stl"
    path.write_text(CUBE_STL.replace("vertex 10", "vertex 1e9", 1))
    mesh = read_mesh(path, unit="mm")
    assert (len(mesh.faces), mesh.notes) == (12, ())
    assert not PrintReport.of(mesh).is_solid


def test_open_surfaces_are_unchanged() -> None:
    open_box = Mesh(cube().vertices_m, cube().faces[1:])
    for ending in (".stl", ".ply", ".glb"):
        found = unpack_mesh(pack_mesh(open_box, ending), ending)
        assert (len(found.vertices_m), len(found.faces), found.notes) == (8, 11, ())


# --- which files are opened ---------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes have names here")
def test_only_regular_files_inside_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    with pytest.raises(InputError, match="not a regular file"):
        read_mesh(tmp_path / "pipe.stl")
    (tmp_path / "inside").mkdir()
    (tmp_path / "part.stl").write_bytes(pack_mesh(cube(), ".stl"))
    (tmp_path / "inside" / "link.stl").symlink_to(tmp_path / "part.stl")
    assert len(read_mesh(tmp_path / "inside" / "link.stl").faces) == 12
    with pytest.raises(InputError, match="a link leads out of the folder"):
        MeshFile(tmp_path / "inside" / "link.stl", root=tmp_path / "inside").read()
