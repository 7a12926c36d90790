"""3MF, the file that slicers prefer: a zip archive with one XML model (3MF core specification 1.3).

Read here and not by trimesh: that skips an object that is missing, takes a number up to the first letter that
is none, and knows no bounds, so that a damaged file becomes another solid without a word.
"""

from __future__ import annotations

import io
import zipfile
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import IO
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.arithmetic import moved
from tactile_toolkit.bounds import require_plain_archive, require_unpackable
from tactile_toolkit.mesh.mesh import Surface, joined

_MM_PER_UNIT = {
    "micron": 1e-3,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1e3,
}
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_NS = {"m": _CORE}
_MESH, _VERTEX, _TRIANGLE = (f"{{{_CORE}}}{name}" for name in ("mesh", "vertex", "triangle"))
_KEPT = {
    f"{{{_CORE}}}{name}"
    for name in ("model", "resources", "object", "mesh", "components", "component", "build", "item")
}
_KNOWN = {*_KEPT, _VERTEX, _TRIANGLE, f"{{{_CORE}}}vertices", f"{{{_CORE}}}triangles"}
_PATH = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}path"
_MODEL_PATH = "3D/3dmodel.model"

# A file of a few bytes can name itself as its own part, or unpack to any size.
_DEEPEST = 32
_MOST_PARTS = 20_000
# Memory that reading takes, at most: for each byte of XML and of what is built, and for each element.
_PER_BYTE, _PER_ELEMENT = 4, 160
_PIECE_BYTES = 1 << 20
_LONGEST_TRANSFORM = 1000


@dataclass(frozen=True, slots=True, eq=False)
class BuildItem:
    """One thing to build, by the name that slicers list.

    ``offset_mm`` is where the origin of its vertices lies on the plate: x right, y back, z up.
    """

    name: str
    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """One model of a package: its objects by id, and its unit."""

    element: ElementTree.Element
    objects: dict[str, ElementTree.Element]
    surfaces: dict[ElementTree.Element, Surface]
    mm_per_unit: float


class _Package:
    """The models of an archive."""

    # Slicers keep the objects of a plate in models of their own, named by paths inside the archive (3MF
    # production extension); nothing else is ever opened.

    def __init__(self, archive: zipfile.ZipFile, file_bytes: int) -> None:
        self._archive = archive
        self._file_bytes = file_bytes
        self._names = {name.lower().lstrip("/"): name for name in archive.namelist()}
        self._models: dict[str, _Model] = {}
        self._parts = 0
        self._built_bytes = 0

    def built(self) -> Iterator[BuildItem]:
        """Yield each thing to build where it will be built, all its parts as one."""
        models = [name for name in self._archive.namelist() if name.lower().endswith(".model")]
        if not models:
            raise ValueError("the archive holds no .model file")
        root = self._model(_MODEL_PATH if _MODEL_PATH in models else models[0])
        for item in root.element.iterfind("m:build/m:item", _NS):
            model, identity = self._named(item, root)
            vertices, faces = joined(list(self._placed(item, root)))
            yield BuildItem(model.objects[identity].get("name", ""), vertices * root.mm_per_unit, faces)

    def _model(self, path: str) -> _Model:
        name = self._names.get(path.lower().lstrip("/"))
        if name is None:
            raise ValueError(f"the archive holds no {path}")
        if name not in self._models:
            size = sum(self._archive.getinfo(each).file_size for each in {*self._models, name})
            require_unpackable(_PER_BYTE * size, f"3MF file: XML of {size:,} bytes", self._file_bytes)
            with self._archive.open(name) as stream:
                element, surfaces = _parsed(stream, self._file_bytes)
            objects = {str(each.get("id")): each for each in element.iterfind("m:resources/m:object", _NS)}
            unit = _MM_PER_UNIT[element.get("unit", "millimeter")]
            self._models[name] = _Model(element, objects, surfaces, unit)
        return self._models[name]

    def _named(self, element: ElementTree.Element, here: _Model) -> tuple[_Model, str]:
        """Return the model and the id of the object that an item or a component names."""
        path, identity = element.get(_PATH), str(element.get("objectid"))
        model = here if path is None else self._model(path)
        if identity not in model.objects:
            raise ValueError(f"object {identity!r}{f' of {path}' if path else ''} is missing")
        return model, identity

    def _placed(self, element: ElementTree.Element, here: _Model, depth: int = 0) -> Iterator[Surface]:
        """Yield the surfaces of what an item or component names, where it puts them, in the unit of here."""
        model, identity = self._named(element, here)
        self._count_part(identity, depth)
        matrix = np.eye(4, 3)
        if element.get("transform") is not None:
            words = element.attrib["transform"][:_LONGEST_TRANSFORM].split()
            matrix = np.array([float(number) for number in words]).reshape(4, 3)
        # Each model of a package has a unit of its own.
        ratio = model.mm_per_unit / here.mm_per_unit
        mirrored = np.linalg.det(matrix[:3]) < 0
        thing = model.objects[identity]
        mesh = thing.find("m:mesh", _NS)
        components = thing.iterfind("m:components/m:component", _NS)
        parts = (part for component in components for part in self._placed(component, model, depth + 1))
        for vertices, faces in parts if mesh is None else [model.surfaces[mesh]]:
            # A few bytes can name the same object again and again, and have it moved at every level.
            self._count_part(identity, depth, vertices.nbytes + faces.nbytes)
            placed = moved(vertices * ratio, matrix[:3]) + matrix[3]
            yield placed, faces[:, ::-1] if mirrored else faces

    def _count_part(self, identity: str, depth: int, size_bytes: int = 0) -> None:
        self._parts += 1
        self._built_bytes += size_bytes
        if depth > _DEEPEST or self._parts > _MOST_PARTS:
            raise ValueError(f"object {identity!r} holds itself, or more than {_MOST_PARTS:,} parts")
        require_unpackable(_PER_BYTE * self._built_bytes, "3MF file: what it builds", self._file_bytes)


class _Builder(ElementTree.TreeBuilder):
    """Builds the tree of a model; meshes become arrays, and elements without a meaning here are emptied.

    As elements, a million vertices would take a gigabyte.
    """

    def __init__(self, file_bytes: int) -> None:
        super().__init__()
        self._file_bytes = file_bytes
        self.elements = 0
        self._points, self._corners = array("d"), array("q")
        self.surfaces: dict[ElementTree.Element, Surface] = {}

    def doctype(self, *_: str | None) -> None:
        """Refuse what 3MF does not have: names for text, which a few bytes repeat to any size."""
        raise ValueError("the model has a document type; expected plain XML")

    def end(self, tag: str) -> ElementTree.Element:
        element = super().end(tag)
        # The parser keeps all names that it has met, of which those that it need not know are many.
        self.elements += 1 if tag in _KNOWN else 3
        if self.elements % 1024 < 3:
            what = f"3MF file: XML of more than {self.elements:,} elements"
            require_unpackable(_PER_ELEMENT * self.elements, what, self._file_bytes)
        if tag == _VERTEX:
            self._points.extend([float(element.attrib[axis]) for axis in "xyz"])
        elif tag == _TRIANGLE:
            self._corners.extend([int(element.attrib[corner]) for corner in ("v1", "v2", "v3")])
        elif tag == _MESH:
            faces = np.array(self._corners, np.int64)
            if len(faces) and not (faces.min() >= -(2**31) and faces.max() < 2**31):
                raise ValueError("a triangle names a vertex by a number of more than 32 bits")
            vertices = np.array(self._points, np.float64).reshape(-1, 3)
            self.surfaces[element] = (vertices, faces.astype(np.int32).reshape(-1, 3))
            self._points, self._corners = array("d"), array("q")
        if tag not in _KEPT:
            element.clear()
        return element


def _parsed(
    stream: IO[bytes], file_bytes: int
) -> tuple[ElementTree.Element, dict[ElementTree.Element, Surface]]:
    builder = _Builder(file_bytes)
    parser = ElementTree.XMLParser(target=builder)
    while piece := stream.read(_PIECE_BYTES):
        before = builder.elements
        parser.feed(piece)
        if len(piece) == _PIECE_BYTES and builder.elements == before:
            # Attributes take 30 times as much memory, and are looked through again with each piece.
            raise ValueError(f"XML of {_PIECE_BYTES:,} bytes in which no element ends")
    return parser.close(), builder.surfaces


def read_build(data: bytes) -> list[BuildItem]:
    """Read what a file says to build, in its order and where it will be built: each ``offset_mm`` is zero.

    Raises ValueError, KeyError, zipfile.BadZipFile or xml.etree.ElementTree.ParseError where the archive, the
    model or a number in it is damaged; InputError where it unpacks to more than the limit.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        require_plain_archive(archive)
        return list(_Package(archive, len(data)).built())


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
# The first date that a zip archive can hold: with the time of writing, no two files would be the same.
_EPOCH = (1980, 1, 1, 0, 0, 0)


def write_build(items: Sequence[BuildItem]) -> bytes:
    """Pack things, in the order in which slicers list them; the same things always give the same bytes."""
    build = ""
    for number, item in enumerate(items, 1):
        x, y, z = (f"{value:.9g}" for value in item.offset_mm)
        moved = f' transform="1 0 0 0 1 0 0 0 1 {x} {y} {z}"' if any(item.offset_mm) else ""
        build += f'<item objectid="{number}"{moved}/>'
    resources = "".join(_object(item, number) for number, item in enumerate(items, 1))
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}">'
        f"<resources>{resources}</resources><build>{build}</build></model>"
    )
    files = {"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONS, _MODEL_PATH: model}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), text, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _object(item: BuildItem, number: int) -> str:
    # Nine digits give every float32 back exactly, and stored meshes are float32.
    corners = "".join(
        f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in item.vertices_mm.tolist()
    )
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in item.faces.tolist())
    name = f" name={quoteattr(item.name)}" if item.name else ""
    return (
        f'<object id="{number}" type="model"{name}><mesh><vertices>{corners}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )
