"""3MF, the file that slicers prefer: a zip archive with one XML model (3MF core specification 1.3)."""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MM_PER_UNIT", "read_threemf", "write_threemf"]

MM_PER_UNIT = {
    "micron": 0.001,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_NS = {"m": _CORE}
_MODEL_PATH = "3D/3dmodel.model"
_CONTENT_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>"
)
_RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="model" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
_EPOCH = (1980, 1, 1, 0, 0, 0)

Surface = tuple["NDArray[np.float64]", "NDArray[np.int32]"]


def read_threemf(data: bytes) -> Surface:
    """Read every object that the file says to build.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    vertices_mm : ndarray of float64, shape (V, 3)
    faces : ndarray of int32, shape (F, 3)

    Raises
    ------
    ValueError, KeyError, zipfile.BadZipFile, xml.etree.ElementTree.ParseError
        The archive, the model or a number in it is damaged.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        models = [name for name in archive.namelist() if name.lower().endswith(".model")]
        if not models:
            message = "the archive holds no .model file"
            raise ValueError(message)
        path = _MODEL_PATH if _MODEL_PATH in models else models[0]
        root = ElementTree.fromstring(archive.read(path))
    mm_per_unit = MM_PER_UNIT[root.get("unit", "millimeter")]
    objects = {str(element.get("id")): element for element in root.iterfind("m:resources/m:object", _NS)}
    placed = [
        _moved(_surface_of(str(item.get("objectid")), objects), item.get("transform"))
        for item in root.iterfind("m:build/m:item", _NS)
    ]
    vertices, faces = _joined(placed)
    return vertices * mm_per_unit, faces


def write_threemf(vertices_mm: NDArray[np.float64], faces: NDArray[np.int32]) -> bytes:
    """Pack one object into a 3MF archive; the same mesh always gives the same bytes.

    Parameters
    ----------
    vertices_mm : ndarray of float64, shape (V, 3)
    faces : ndarray of int32, shape (F, 3)

    Returns
    -------
    bytes
    """
    corners = "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in vertices_mm.tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces.tolist())
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}">'
        f'<resources><object id="1" type="model"><mesh><vertices>{corners}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object></resources>"
        '<build><item objectid="1"/></build></model>'
    )
    parts = {"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONS, _MODEL_PATH: model}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), text, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _surface_of(name: str, objects: dict[str, ElementTree.Element], depth: int = 0) -> Surface:
    if name not in objects or depth > 32:
        message = f"object {name!r} is missing or holds itself"
        raise ValueError(message)
    element = objects[name]
    mesh = element.find("m:mesh", _NS)
    if mesh is not None:
        return _mesh_of(mesh)
    parts = element.iterfind("m:components/m:component", _NS)
    return _joined(
        [
            _moved(_surface_of(str(part.get("objectid")), objects, depth + 1), part.get("transform"))
            for part in parts
        ]
    )


def _mesh_of(mesh: ElementTree.Element) -> Surface:
    corners = [[float(v.attrib[axis]) for axis in "xyz"] for v in mesh.iterfind("m:vertices/m:vertex", _NS)]
    triangles = [
        [int(t.attrib[corner]) for corner in ("v1", "v2", "v3")]
        for t in mesh.iterfind("m:triangles/m:triangle", _NS)
    ]
    return np.array(corners, dtype=np.float64).reshape(-1, 3), np.array(triangles, np.int32).reshape(-1, 3)


def _moved(surface: Surface, transform: str | None) -> Surface:
    if transform is None:
        return surface
    matrix = np.array([float(number) for number in transform.split()]).reshape(4, 3)
    vertices, faces = surface
    if np.linalg.det(matrix[:3]) < 0:
        faces = faces[:, ::-1]
    return vertices @ matrix[:3] + matrix[3], faces


def _joined(surfaces: list[Surface]) -> Surface:
    counts = np.cumsum([0] + [len(vertices) for vertices, _ in surfaces])
    vertices = [np.zeros((0, 3)), *(vertices for vertices, _ in surfaces)]
    faces = [
        np.zeros((0, 3), np.int32),
        *(f + np.int32(n) for (_, f), n in zip(surfaces, counts, strict=False)),
    ]
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)
