"""GLB, the binary form of glTF 2.0, in metres; read and written with z up.

glTF has y up: meshes are rotated on reading, and a node rotates them on writing, so that a part lies flat in
every viewer. trimesh is not used for reading, because it ignores what it does not know, or reads it as zeros.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator

import numpy as np

from tactile_toolkit import arithmetic, cache
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Surface, join_surfaces, placed
from tactile_toolkit.value_types import AnyArray, AnyDtype, Float32, Float64, Int32, JsonValue

# glTF uses the numbers of OpenGL.
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_VERTEX_BUFFER, _INDEX_BUFFER = 34962, 34963
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_QUANTIZATION = "KHR_mesh_quantization"
# These do not change the shape.
_APPEARANCE = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp", "EXT_texture_")
# Turns z up into y up, column by column; exact in floating point.
_Y_UP = (1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_PER_BYTE = 4
# Parts of the transform of a node, instead of a matrix.
_PARTS = {"translation", "rotation", "scale"}
_LENGTH_TOLERANCE = 1e-3


def read_glb(data: bytes) -> Surface:
    """Read the triangles of the default scene, in metres with z up.

    Raises InputError for invalid files and unsupported features.
    """
    magic, version, size = struct.unpack_from("<4sII", data.ljust(12, b"\0"))
    if magic != b"glTF" or version != 2:
        raise InputError("the file is not binary glTF of version 2")
    if size > len(data):
        raise InputError(f"the file is cut short: it has {len(data):,} of {size:,} bytes")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= size:
        length, kind = struct.unpack_from("<I4s", data, at)
        chunks.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    text = chunks.get(b"JSON", b"")
    # Python needs at most 24 bytes for each byte of JSON, less than the limit for unpacked files.
    document = _Document(json.loads(text), chunks.get(b"BIN\0", b""), len(data))
    vertices, faces = join_surfaces(list(document.placed()))
    return arithmetic.moved(vertices, _Z_UP.T), faces


class _Document:
    """The JSON tree of a file, whose values may have any type, and its binary data."""

    def __init__(self, tree: JsonValue, content: bytes, file_bytes: int) -> None:
        self._tree, self._content, self._file_bytes = tree, content, file_bytes
        self._placed_bytes = 0
        needed = str(tree["asset"].get("minVersion", tree["asset"]["version"]))
        if needed.partition(".")[0] != "2" or ("minVersion" in tree["asset"] and needed != "2.0"):
            raise InputError(f"the file needs glTF {needed[:40]}; expected 2.0")
        for name in tree.get("extensionsRequired", ()):
            if name != _QUANTIZATION and not name.startswith(_APPEARANCE):
                raise InputError(
                    f"the file requires the extension {name[:80]!r}, which is not supported",
                    next="export it without that",
                )

    def _item(self, kind: str, number: JsonValue) -> JsonValue:
        items = self._tree.get(kind, [])
        # Python accepts negative indices.
        if not (isinstance(number, int) and 0 <= number < len(items)):
            raise InputError(f"the file names {kind} {number!r}; there are {len(items):,}, counted from 0")
        return items[number]

    def placed(self) -> Iterator[Surface]:
        """Yield the surfaces of the default scene, each transformed by its node."""
        scenes = self._tree.get("scenes", [])
        if "scene" not in self._tree and len(scenes) != 1:
            raise InputError(
                f"the file has {len(scenes):,} scenes and names none as its default; expected one",
                next="export a single scene",
            )
        roots = self._item("scenes", self._tree.get("scene", 0)).get("nodes", [])
        waiting = [(root, np.eye(4)) for root in reversed(roots)]
        visited = set()
        while waiting:
            number, above = waiting.pop()
            node = self._item("nodes", number)
            if number in visited:
                raise InputError(f"node {number} is placed twice, or in a circle")
            visited.add(number)
            whole = above @ _matrix(node)
            waiting += [(child, whole) for child in reversed(node.get("children", []))]
            if "skin" in node or "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
                raise InputError(f"node {number} has a skin or instances, which are not supported")
            if "mesh" in node:
                yield from self._moved(node, self._item("meshes", node["mesh"]), whole)

    def _moved(self, node: JsonValue, mesh: JsonValue, matrix: Float64) -> Iterator[Surface]:
        if any(node.get("weights", mesh.get("weights", ()))):
            raise InputError("a mesh is a blend of shapes (morph targets), which is not supported")
        for primitive in mesh["primitives"]:
            if primitive.get("mode", _TRIANGLES) not in (_TRIANGLES, _STRIP, _FAN):
                continue  # points and lines have no surface
            vertices, faces = self._triangles(primitive)
            # The same surface can be placed any number of times.
            self._placed_bytes += vertices.nbytes + faces.nbytes
            cache.require_unpackable(_PER_BYTE * self._placed_bytes, "what the file places", self._file_bytes)
            yield placed((vertices, faces), matrix[:3, :3].T, matrix[:3, 3])

    def _triangles(self, primitive: JsonValue) -> Surface:
        vertices = self._values(primitive["attributes"]["POSITION"], "VEC3").astype(np.float64)
        corners = np.arange(len(vertices))
        if "indices" in primitive:
            corners = self._values(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
            named = f"vertices {corners.min()} to {corners.max()}"
            raise InputError(f"triangles name {named}, counted from 0; there are {len(vertices):,}")
        mode = primitive.get("mode", _TRIANGLES)
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise InputError(f"triangles have {len(corners):,} corners; expected a multiple of 3")
            return vertices, corners.reshape(-1, 3).astype(np.int32)
        first = np.arange(max(len(corners) - 2, 0))
        odd = first % 2
        rows = [first, first + 1 + odd, first + 2 - odd]
        if mode == _FAN:
            rows = [first + 1, first + 2, np.zeros_like(first)]
        return vertices, corners[np.stack(rows, axis=1)].astype(np.int32)

    def _values(self, number: JsonValue, kind: str) -> AnyArray:
        """Return the values of an accessor, shape (count, width)."""
        accessor = self._item("accessors", number)
        if accessor["type"] != kind:
            raise InputError(f"accessor {number} is {accessor['type']!r}; expected {kind!r}")
        count = accessor["count"]
        component = np.dtype(_COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._view(accessor, count, component, _WIDTHS[kind])
        elif "sparse" in accessor:
            cache.require_unpackable(
                _WIDTHS[kind] * 8 * count, f"accessor of {count:,} values", self._file_bytes
            )
            values = np.zeros((count, _WIDTHS[kind]), component)
        else:
            raise InputError(f"accessor {number} has no data: an extension that is not supported holds them")
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            values = values.copy()
            index_type = np.dtype(_COMPONENTS[sparse["indices"]["componentType"]])
            rows = self._view(sparse["indices"], sparse["count"], index_type, 1)[:, 0]
            values[rows] = self._view(sparse["values"], sparse["count"], component, _WIDTHS[kind])
        if accessor.get("normalized") and component.kind != "f":
            return np.maximum(values / np.iinfo(component).max, -1.0)
        return values

    def _view(self, at: JsonValue, count: int, component: AnyDtype, width: int) -> AnyArray:
        """Return values from a part of the binary chunk, shape (count, width)."""
        view = self._item("bufferViews", at["bufferView"])
        if "uri" in self._item("buffers", view["buffer"]) or view["buffer"] != 0:
            raise InputError("the file keeps data elsewhere; expected all data in its binary chunk")
        row = component.itemsize * width
        step = view.get("byteStride", row)
        start = at.get("byteOffset", 0)
        size = view["byteLength"]
        first = view.get("byteOffset", 0) + start
        end = first + step * (count - 1) + row
        if count < 1 or step < row or start < 0 or first < start or end > first - start + size:
            raise InputError("an accessor reaches beyond the data that it names")
        if end > len(self._content):
            raise InputError(f"the file is cut short: it has {len(self._content):,} of {end:,} bytes of data")
        whole = np.frombuffer(self._content, np.uint8, end - first, first)
        rows = np.lib.stride_tricks.as_strided(whole, (count, row), (step, 1), writeable=False)
        return np.ascontiguousarray(rows).view(component)


def _matrix(node: JsonValue) -> Float64:
    """Return the transform of a node, shape (4, 4), for column vectors."""
    matrix = np.eye(4)
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
        if _PARTS & node.keys() or (matrix[3] != (0, 0, 0, 1)).any():
            raise InputError("a node has a matrix that distorts, or both a matrix and parts of one")
        return matrix
    if "rotation" in node:
        length = math.hypot(*node["rotation"])
        if not abs(length - 1) <= _LENGTH_TOLERANCE:
            raise InputError(f"a node is turned by a quaternion of length {length:.4g}; expected length one")
        from scipy.spatial.transform import Rotation  # few files need it, and it takes 0.3 s to import

        matrix[:3, :3] = Rotation.from_quat(node["rotation"]).as_matrix()
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def pack_glb(vertices: Float32, faces: Int32) -> bytes:
    """Pack a mesh, in metres with z up, as GLB with one buffer and a node that rotates it to y up."""
    corners = faces.ravel().astype("<u2")
    kind = _UINT16
    if len(vertices) > np.iinfo(np.uint16).max:
        corners = faces.ravel().astype("<u4")
        kind = _UINT32
    buffer = vertices.tobytes() + corners.tobytes()
    # Both chunks are padded to multiples of four, this one with zeros and the JSON with spaces (glTF 2.0,
    # section 4.4.3).
    buffer += bytes(-len(buffer) % 4)
    low_high = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": _Y_UP}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": len(vertices), "type": "VEC3", **low_high},
            {"bufferView": 1, "componentType": kind, "count": len(corners), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": vertices.nbytes, "target": _VERTEX_BUFFER},
            {
                "buffer": 0,
                "byteOffset": vertices.nbytes,
                "byteLength": corners.nbytes,
                "target": _INDEX_BUFFER,
            },
        ],
        "buffers": [{"byteLength": len(buffer)}],
    }
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
