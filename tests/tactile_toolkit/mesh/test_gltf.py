"""GLB files of other programs: read as specified by glTF 2.0, or refused with the reason."""

from __future__ import annotations

import io
import json
import math
import struct
from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.mesh.files import pack_mesh, unpack_mesh
from tactile_toolkit.mesh.gltf import read_glb

BOX = Mesh.from_trimesh(trimesh.creation.box((0.03, 0.02, 0.005)))


def glb_of(tree: dict[str, Any], content: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(content), b"BIN\0") + content
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def tree_of(mesh: Mesh = BOX, **changes: Any) -> tuple[dict[str, Any], bytes]:
    """Return a GLB file of a mesh, y up, with changes to its JSON."""
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
    """A flat part is thin along y in the file, and along z after reading."""
    shape = Mesh(BOX.vertices_m + np.array([0.1, 0.2, 0.3]), BOX.faces)
    data = pack_mesh(shape, ".glb")
    there = trimesh.load_scene(io.BytesIO(data), file_type="glb").to_mesh()
    assert there.bounds == pytest.approx(np.array([[0.085, 0.2975, -0.21], [0.115, 0.3025, -0.19]]), abs=1e-7)
    assert unpack_mesh(data, ".glb").bounds_m == pytest.approx(shape.bounds_m, abs=1e-7)
    assert sizes_mm(glb_of(*tree_of())) == pytest.approx([30, 5, 20], abs=1e-4)


def test_nodes_transform_their_meshes() -> None:
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
        ({"nodes": [{"mesh": 0, "matrix": [*[1, 0, 0, 0, 0] * 3, 1], "scale": [2, 2, 2]}]}, "both a matrix"),
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
def test_required_extensions_are_read_or_named(changes: dict[str, Any], words: str) -> None:
    data = glb_of(*tree_of(**changes))
    if not words:
        assert len(read_glb(data)[1]) == 12
        return
    with pytest.raises(InputError, match=words):
        read_glb(data)
