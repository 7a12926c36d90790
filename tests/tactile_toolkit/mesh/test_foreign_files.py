"""Mesh files of other programs: read as their formats say, or refused with the reason.

Outcomes of the files next to the repository are those of the references that `solid.md` names there.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import os
import struct
import zipfile
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import trimesh

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, inspect, pack_mesh, read_mesh, unpack_mesh
from tactile_toolkit.mesh.gltf import read_glb
from tactile_toolkit.mesh.polygons import cut_polygons
from tests.real_input import SHARED

CASES = SHARED / "cases" / "solid"

# A volume in mm³, or words of a refusal or of what is wrong.
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


def outcome_of(path: Path, unit: str | None = None) -> float | str:
    """Return the volume of a solid, mm³, or why there is none."""
    try:
        report = inspect(read_mesh(path, unit=unit))
    except InputError as error:
        return str(error)
    return report.volume_mm3 if report.is_solid else f"{report.problem}: {report.detail}"


@pytest.mark.skipif(not CASES.is_dir(), reason="the folder ../shared next to the repository has no cases")
@pytest.mark.parametrize("name", OUTCOMES)
def test_files_of_public_reports(name: str) -> None:
    found, expected = outcome_of(CASES / name), OUTCOMES[name]
    if isinstance(expected, str):
        assert expected in str(found)
    else:
        assert found == pytest.approx(expected, rel=1e-4)


# --- text and binary, made here -----------------------------------------------------------------------


def cube(side: float = 20.0) -> Mesh:
    return Mesh.from_trimesh(trimesh.creation.box((side / 1000,) * 3))


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
def test_damage_is_told_in_a_sentence(name: str, tmp_path: Path) -> None:
    content, words = DAMAGED[name]
    (tmp_path / name).write_bytes(content)
    found = str(outcome_of(tmp_path / name))
    assert words in found
    # No words of libraries.
    assert not any(word in found for word in ("unmatched", "reshape", "buffer", "0x", "Error"))


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".glb", ".3mf"])
def test_random_damage_is_refused_or_read_without_words_of_libraries(ending: str) -> None:
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
def test_units_are_asked_for_and_obeyed(unit: str, ending: str, tmp_path: Path) -> None:
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
def test_concave_polygons_are_cut_as_polygons(form: str, turn_deg: float, tmp_path: Path) -> None:
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


# --- corners that rounding has torn apart -------------------------------------------------------------


@pytest.mark.parametrize("ending", [".stl", ".obj"])
def test_torn_corners_are_welded_and_counted(ending: str, tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2, 0.01)
    apart = ball.vertices[ball.faces].reshape(-1, 3)
    random = np.random.default_rng(0)
    for shift, closes in ((3e-6, True), (3e-4, False)):
        moved = apart + shift * 0.02 * random.uniform(-0.5, 0.5, apart.shape) / math.sqrt(3)
        path = tmp_path / f"ball{ending}"
        path.write_bytes(pack_mesh(Mesh(moved, np.arange(len(apart), dtype=np.int32).reshape(-1, 3)), ending))
        mesh = read_mesh(path)
        report = inspect(mesh)
        assert report.is_solid == closes
        if closes:
            assert report.notes == (f"{len(np.unique(moved, axis=0)) - len(ball.vertices):,} corners welded",)
            assert report.volume_mm3 == pytest.approx(ball.volume * 1e9, rel=1e-4)
            assert len(mesh.vertices_m) == len(ball.vertices)
        else:
            assert report.notes == ()


def test_a_corner_far_away_does_not_weld_the_others(tmp_path: Path) -> None:
    """Measured by it, all others would be near: two facets fewer, and half of the cube were a solid."""
    path = tmp_path / "far.stl"
    path.write_text(CUBE_STL.replace("vertex 10", "vertex 1e9", 1))
    mesh = read_mesh(path, unit="mm")
    assert (len(mesh.faces), mesh.notes) == (12, ())
    assert not inspect(mesh).is_solid


def test_what_is_open_stays_as_it_is() -> None:
    open_box = Mesh(cube().vertices_m, cube().faces[1:])
    for ending in (".stl", ".ply", ".glb"):
        found = unpack_mesh(pack_mesh(open_box, ending), ending)
        assert (len(found.vertices_m), len(found.faces), found.notes) == (8, 11, ())


# --- glTF ---------------------------------------------------------------------------------------------

BOX = Mesh.from_trimesh(trimesh.creation.box((0.03, 0.02, 0.005)))


def glb_of(tree: dict[str, Any], content: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(content), b"BIN\0") + content
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def tree_of(mesh: Mesh = BOX, **changes: Any) -> tuple[dict[str, Any], bytes]:
    """A mesh as it is, y up, and what a test changes in its tree."""
    vertices, corners = mesh.vertices_m.astype("<f4"), mesh.faces.astype("<u2")
    content = vertices.tobytes() + corners.tobytes()
    tree: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": corners.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": vertices.nbytes},
            {"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": corners.nbytes},
        ],
        "buffers": [{"byteLength": len(content)}],
    }
    return {**tree, **changes}, content


def sizes_mm(data: bytes) -> np.ndarray:
    vertices, _ = read_glb(data)
    return np.asarray(np.ptp(vertices, axis=0) * 1000)


def test_y_is_up_in_glb_files() -> None:
    """A part that lies flat is low along y in the file, and comes back along z, as it was."""
    shape = Mesh(BOX.vertices_m + np.array([0.1, 0.2, 0.3]), BOX.faces)
    data = pack_mesh(shape, ".glb")
    there = trimesh.load_scene(io.BytesIO(data), file_type="glb").to_mesh()
    assert there.bounds == pytest.approx(np.array([[0.085, 0.2975, -0.21], [0.115, 0.3025, -0.19]]), abs=1e-7)
    assert unpack_mesh(data, ".glb").bounds_m == pytest.approx(shape.bounds_m, abs=1e-7)
    assert sizes_mm(glb_of(*tree_of())) == pytest.approx([30, 5, 20], abs=1e-4)


def test_nodes_place_what_they_hold() -> None:
    half = math.sqrt(0.5)
    nodes = [
        {"children": [1, 2], "translation": [1, 0, 0]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [1, 1, 2]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1]},
    ]
    vertices, faces = read_glb(glb_of(*tree_of(nodes=nodes)))
    reference = trimesh.load_scene(io.BytesIO(glb_of(*tree_of(nodes=nodes))), file_type="glb").to_mesh()
    assert np.sort(vertices, axis=0) == pytest.approx(
        np.sort(reference.vertices[:, [0, 2, 1]] * [1, -1, 1], axis=0), abs=1e-6
    )
    assert Mesh(vertices, faces).volume_m3 == pytest.approx(3 * BOX.volume_m3, rel=1e-5)


def test_the_default_scene_is_read() -> None:
    scenes = [{"nodes": [0]}, {"nodes": [1]}]
    nodes = [{"mesh": 0}, {"mesh": 0, "scale": [2, 2, 2]}]
    tree, content = tree_of(scenes=scenes, nodes=nodes, scene=1)
    assert sizes_mm(glb_of(tree, content)) == pytest.approx([60, 10, 40], abs=1e-4)
    del tree["scene"]
    with pytest.raises(InputError, match="2 scenes and names none"):
        read_glb(glb_of(tree, content))


@pytest.mark.parametrize(
    ("component", "kind", "normalized"),
    [(5120, "i1", True), (5121, "u1", False), (5122, "<i2", True), (5123, "<u2", True), (5123, "<u2", False)],
)
def test_quantized_values_are_read(component: int, kind: str, normalized: bool) -> None:
    """KHR_mesh_quantization: integers, or shares of the largest, four bytes apart."""
    most = np.iinfo(kind).max
    unit = (BOX.vertices_m > 0).astype(kind) * most
    step = -(-unit.shape[1] * unit.itemsize // 4) * 4
    stored = b"".join(row.tobytes().ljust(step, b"\0") for row in unit)
    tree, content = tree_of(extensionsRequired=["KHR_mesh_quantization"])
    tree["accessors"][0] |= {"componentType": component, "normalized": normalized, "bufferView": 2}
    tree["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(content), "byteLength": len(stored), "byteStride": step}
    )
    scale = 0.03 if normalized else 0.03 / most
    tree["nodes"] = [{"mesh": 0, "scale": [scale] * 3}]
    assert sizes_mm(glb_of(tree, content + stored)) == pytest.approx([30] * 3, rel=1e-6)


def test_strips_fans_and_sparse_values_are_read() -> None:
    square = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float), np.array([[0, 1, 2]]))
    areas = {}
    for mode, corners in ((5, [0, 1, 2, 3]), (6, [0, 1, 3, 2]), (4, [0, 1, 3, 0, 3, 2])):
        tree, content = tree_of(square)
        stored = np.array(corners, "<u2").tobytes()
        tree["accessors"][1] |= {"bufferView": 2, "count": len(corners)}
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(content), "byteLength": len(stored)})
        tree["meshes"][0]["primitives"][0]["mode"] = mode
        vertices, faces = read_glb(glb_of(tree, content + stored))
        a, b, c = vertices[faces].swapaxes(0, 1)
        areas[mode] = np.cross(b - a, c - a).sum(axis=0) / 2
    assert areas[5] == pytest.approx(areas[4])
    assert areas[6] == pytest.approx(areas[4])
    tree, content = tree_of()
    rows, values = np.array([3], "<u2").tobytes() + b"\0\0", np.array([[0.5, 0, 0]], "<f4").tobytes()
    tree["bufferViews"] += [
        {"buffer": 0, "byteOffset": len(content), "byteLength": 2},
        {"buffer": 0, "byteOffset": len(content) + 4, "byteLength": 12},
    ]
    tree["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 2, "componentType": 5123},
        "values": {"bufferView": 3},
    }
    assert read_glb(glb_of(tree, content + rows + values))[0][3] == pytest.approx([0.5, 0, 0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "extension 'EXT_meshopt_compression'"),
        ({"extensionsRequired": ["KHR_materials_unlit"]}, ""),
        ({"nodes": [{"mesh": 0, "skin": 0}]}, "skin"),
        ({"nodes": [{"mesh": 0, "weights": [0.5]}]}, "morph targets"),
        ({"nodes": [{"children": [0]}]}, "in a circle"),
        ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 2]}]}, "a quaternion of length 2; expected length one"),
        ({"nodes": [{"mesh": 0, "matrix": [*[1, 0, 0, 1] * 3, 0, 0, 0, 1]}]}, "that distorts"),
        ({"nodes": [{"mesh": 0, "matrix": [*[1, 0, 0, 0, 0] * 3, 1], "scale": [2, 2, 2]}]}, "next to parts"),
        ({"asset": {"version": "2.0", "minVersion": "2.1"}}, r"needs glTF 2\.1"),
        ({"asset": {"version": "3.0"}}, r"needs glTF 3\.0"),
        ({"nodes": [{"mesh": 7}]}, "names meshes 7; there are 1"),
        ({"nodes": [{"mesh": -1}]}, "names meshes -1"),
        ({"buffers": [{"byteLength": 9, "uri": "part.bin"}]}, "keeps data elsewhere"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 4}] * 2}, "reaches beyond the data"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 10**9}] * 2, "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 10**7, "type": "VEC3"}]}, "is cut short"),
        ({"accessors": [{"componentType": 5126, "count": 8, "type": "VEC3"}] * 2}, "has no data"),
    ],
)  # fmt: skip
def test_what_glb_files_need_is_read_or_named(changes: dict[str, Any], words: str) -> None:
    data = glb_of(*tree_of(**changes))
    if not words:
        assert len(read_glb(data)[1]) == 12
        return
    with pytest.raises(InputError, match=words):
        read_glb(data)


# --- 3MF ----------------------------------------------------------------------------------------------

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"


def mesh_xml(*meshes: Mesh) -> str:
    vertices, faces, start = "", "", 0
    for mesh in meshes:
        vertices += "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices_mm)
        faces += "".join(
            f'<triangle v1="{a + start}" v2="{b + start}" v3="{c + start}"/>'
            for a, b, c in mesh.faces.tolist()
        )
        start += len(mesh.vertices_m)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"


def package(path: Path, resources: str, build: str, head: str = "", **files: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
        archive.writestr(
            "3D/3dmodel.model",
            f'<model unit="millimeter" xmlns="{CORE}" {head}><resources>{resources}</resources>'
            f"<build>{build}</build></model>",
        )
    return path


BESIDE = Mesh(cube(10).vertices_m + np.array([0.05, 0, 0]), cube().faces)
ITEM, TWO = '<item objectid="1"/>', f'<object id="1" type="model">{mesh_xml(cube(), BESIDE)}</object>'


def prusa(kind: str) -> dict[str, str]:
    return {
        "Metadata/Slic3r_PE_model.config": '<config><object id="1"><metadata type="object" key="name" '
        'value="a"/><volume firstid="0" lastid="11"><metadata type="volume" key="volume_type" '
        f'value="ModelPart"/></volume><volume firstid="12" lastid="23">{kind}</volume></object></config>'
    }


def volume_type(value: str) -> dict[str, str]:
    return prusa(f'<metadata type="volume" key="volume_type" value="{value}"/>')


@pytest.mark.parametrize("kind", ["ParameterModifier", "SupportBlocker", "SupportEnforcer", "1"])
def test_volumes_of_prusaslicer_that_are_not_the_object(kind: str, tmp_path: Path) -> None:
    files = volume_type(kind)
    if kind == "1":  # of old releases
        files = prusa('<metadata type="volume" key="modifier" value="1"/>')
    mesh = read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **files))
    assert inspect(mesh).volume_mm3 == pytest.approx(8000)
    assert np.ptp(mesh.bounds_m, axis=0) == pytest.approx([0.02] * 3)
    assert mesh.notes[0].startswith("left out: 1 volume of kind ")
    whole = read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **volume_type("ModelPart")))
    assert (inspect(whole).bodies, whole.notes) == (2, ())
    with pytest.raises(InputError, match="has a negative volume"):
        read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **volume_type("NegativeVolume")))


@pytest.mark.parametrize(
    ("subtype", "found"),
    [
        ("normal_part", 9000),
        ("modifier_part", 8000),
        ("support_blocker", 8000),
        ("support_enforcer", 8000),
        ("negative_part", "has a negative volume"),
    ],
)
def test_parts_of_bambu_studio(subtype: str, found: float | str, tmp_path: Path) -> None:
    """As it writes them: parts in a model of their own, what each is for in a file of settings."""
    production = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
    parts = f'<object id="1">{mesh_xml(cube())}</object><object id="2">{mesh_xml(BESIDE)}</object>'
    files = {
        "3D/Objects/object_1.model": f'<model unit="millimeter" xmlns="{CORE}"><resources>{parts}</resources>'
        "<build/></model>",
        "Metadata/model_settings.config": '<config><object id="8"><metadata key="name" value="a"/>'
        f'<part id="1" subtype="normal_part"/><part id="2" subtype="{subtype}"/></object></config>',
    }
    path = 'p:path="/3D/Objects/object_1.model"'
    whole = f'<object id="8" type="model"><components><component {path} objectid="1"/>'
    whole += f'<component {path} objectid="2"/></components></object>'
    head = f'xmlns:p="{production}" requiredextensions="p"'
    outcome = outcome_of(package(tmp_path / "a.3mf", whole, '<item objectid="8"/>', head, **files))
    assert found in outcome if isinstance(found, str) else outcome == pytest.approx(found)


@pytest.mark.parametrize("kind", ["support", "solidsupport", "other", "surface"])
def test_objects_of_other_types_are_not_of_the_model(kind: str, tmp_path: Path) -> None:
    two = (
        f'<object id="1">{mesh_xml(cube())}</object><object id="2" type="{kind}">{mesh_xml(BESIDE)}</object>'
    )
    mesh = read_mesh(package(tmp_path / "a.3mf", two, f'{ITEM}<item objectid="2"/>'))
    assert inspect(mesh).volume_mm3 == pytest.approx(8000)
    assert mesh.notes == (f"left out: 1 object of type {kind!r}",)
    with pytest.raises(InputError, match="holds nothing to build"):
        read_mesh(package(tmp_path / "a.3mf", two, '<item objectid="2"/>'))
    twice = read_mesh(package(tmp_path / "a.3mf", two, f'{ITEM}<item objectid="1" printable="0"/>'))
    assert twice.notes == ("left out: 1 object not to be printed",)
    assert inspect(twice).bodies == 1


@pytest.mark.parametrize(
    ("head", "inside", "words"),
    [
        ('xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" requiredextensions="b"',
         "", "beamlattice/2017"),
        ('requiredextensions="sc"', "", "requires the extension 'sc'"),
        ('xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" requiredextensions="m"',
         "", ""),
        ('xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"',
         "<b:beamlattice/>", "holds a beamlattice"),
    ],
)  # fmt: skip
def test_extensions_of_3mf(head: str, inside: str, words: str, tmp_path: Path) -> None:
    one = f'<object id="1">{mesh_xml(cube()).replace("</mesh>", inside + "</mesh>")}</object>'
    outcome = outcome_of(package(tmp_path / "a.3mf", one, ITEM, head))
    assert words in str(outcome)
    if not words:
        assert outcome == pytest.approx(8000)


@pytest.mark.parametrize(
    ("resources", "build", "words"),
    [
        (TWO + TWO, ITEM, "has several objects '1'"),
        (TWO, "", "holds nothing to build$"),
        (TWO.replace('x="10', 'x="10,', 1), ITEM, "is not a number; expected one such as"),
        (TWO.replace('x="10', 'x="1_0', 1), ITEM, "is not a number"),
        (TWO.replace('v1="1"', 'v1="1.5"', 1), ITEM, "'1.5' is not a number; expected an integer"),
    ],
)
def test_what_3mf_does_not_allow_is_named(resources: str, build: str, words: str, tmp_path: Path) -> None:
    """lib3mf refuses them, too, or reads another solid."""
    with pytest.raises(InputError, match=words):
        read_mesh(package(tmp_path / "a.3mf", resources, build))


def test_relations_name_the_root_model(tmp_path: Path) -> None:
    model = f'<model unit="millimeter" xmlns="{CORE}"><resources><object id="1">{mesh_xml(BESIDE)}</object>'
    model += f"</resources><build>{ITEM}</build></model>"
    relation = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    for target, found in (("/part/real.model", 1000), ("/3D/3dmodel.model", 8000)):
        relations = (
            '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
            f'<Relationship Target="{target}" Id="r" Type="{relation}"/></Relationships>'
        )
        files = {"part/real.model": model, "_rels/.rels": relations}
        path = package(tmp_path / "a.3mf", f'<object id="1">{mesh_xml(cube())}</object>', ITEM, **files)
        assert outcome_of(path) == pytest.approx(found)
    files["_rels/.rels"] = relations.replace("3dmodel.model", "none.model")
    with pytest.raises(InputError, match=r"holds no model /3d/none\.model"):
        read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **files))


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
        read_mesh(tmp_path / "inside" / "link.stl", below=tmp_path / "inside")
