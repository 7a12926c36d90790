"""3MF, the file that slicers prefer: a zip archive with one XML model (3MF core specification 1.3).

A file that is written here holds things to build, each with a name and its place on the plate. A thing of
several parts (an object and its tag, say) is one assembly, so that a slicer that moves it moves all of it.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "BuildItem",
    "CORE",
    "MM_PER_UNIT",
    "MODEL_PATH",
    "Package",
    "Part",
    "read_build",
    "read_threemf",
    "write_build",
    "write_threemf",
]

MM_PER_UNIT = {
    "micron": 0.001,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_NS = {"m": CORE}
_PATH = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}path"
_DEEPEST = 32
_MOST_PARTS = 100_000
_MOST_BYTES = 2 * 2**30
MODEL_PATH = "3D/3dmodel.model"

Surface = tuple["NDArray[np.float64]", "NDArray[np.int32]"]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One closed surface with a name.

    Attributes
    ----------
    name : str
        What slicers list.
    vertices_mm : ndarray of float, shape (V, 3)
        Corners in mm, in the frame of its item.
    faces : ndarray of int32, shape (F, 3)
        Rows of ``vertices_mm``, counter-clockwise seen from outside.
    """

    name: str
    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """One model of a package: its objects by id, and what its unit is."""

    element: ElementTree.Element
    objects: dict[str, ElementTree.Element]
    mm_per_unit: float


class Package:
    """The models of an archive. Slicers keep the objects of a plate in models of their own.

    Those are named by paths inside the archive (3MF production extension); nothing else is ever opened.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._names = {name.lower().lstrip("/"): name for name in archive.namelist()}
        self._models: dict[str, _Model] = {}
        self._parts = 0
        models = [name for name in archive.namelist() if name.lower().endswith(".model")]
        if not models:
            message = "the archive holds no .model file"
            raise ValueError(message)
        self._root = self._model(MODEL_PATH if MODEL_PATH in models else models[0])

    def built(self) -> Iterator[tuple[str, tuple[Part, ...]]]:
        """Give the name and the parts of each thing to build, where they will be built, mm."""
        mm_per_unit = self._root.mm_per_unit
        for element in self._root.element.iterfind("m:build/m:item", _NS):
            model, identity = self._named(element, self._root)
            found = self._parts_of(model, identity)
            parts = self._moved(found, model.mm_per_unit / mm_per_unit, element)
            yield model.objects[identity].get("name", ""), tuple(_scaled(part, mm_per_unit) for part in parts)

    def _named(self, element: ElementTree.Element, here: _Model) -> tuple[_Model, str]:
        """Return the model and the id of the object that an item or a component names."""
        path, identity = element.get(_PATH), str(element.get("objectid"))
        model = here if path is None else self._model(path)
        if identity not in model.objects:
            message = f"object {identity!r}{f' of {path}' if path else ''} is missing"
            raise ValueError(message)
        return model, identity

    def _parts_of(self, model: _Model, identity: str, depth: int = 0) -> list[Part]:
        """Return the parts of an object, in the unit of its model."""
        self._parts += 1
        if depth > _DEEPEST or self._parts > _MOST_PARTS:
            message = f"object {identity!r} holds itself, or more than {_MOST_PARTS:,} parts"
            raise ValueError(message)
        element = model.objects[identity]
        mesh = element.find("m:mesh", _NS)
        if mesh is not None:
            return [Part(element.get("name", ""), *_surface_of(mesh))]
        parts = []
        for component in element.iterfind("m:components/m:component", _NS):
            other, name = self._named(component, model)
            inner = self._parts_of(other, name, depth + 1)
            parts += self._moved(inner, other.mm_per_unit / model.mm_per_unit, component)
        return parts

    def _moved(self, parts: list[Part], ratio: float, element: ElementTree.Element) -> list[Part]:
        """Take parts over from a model whose unit is ``ratio`` of the unit here, to where they are put."""
        return [_placed(_scaled(part, ratio), element.get("transform")) for part in parts]

    def _model(self, path: str) -> _Model:
        name = self._names.get(path.lower().lstrip("/"))
        if name is None:
            message = f"the archive holds no {path}"
            raise ValueError(message)
        if name not in self._models:
            size = sum(self._archive.getinfo(each).file_size for each in {*self._models, name})
            if size > _MOST_BYTES:
                message = f"its models take {size:,} bytes unpacked; expected at most {_MOST_BYTES:,}"
                raise ValueError(message)
            element = ElementTree.fromstring(self._archive.read(name))
            objects = {str(each.get("id")): each for each in element.iterfind("m:resources/m:object", _NS)}
            unit = MM_PER_UNIT[element.get("unit", "millimeter")]
            self._models[name] = _Model(element, objects, unit)
        return self._models[name]


def _scaled(part: Part, factor: float) -> Part:
    return part if factor == 1 else Part(part.name, part.vertices_mm * factor, part.faces)


def _placed(part: Part, transform: str | None) -> Part:
    return Part(part.name, *_moved((part.vertices_mm, part.faces), transform))


def _surface_of(mesh: ElementTree.Element) -> Surface:
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


@dataclass(frozen=True, slots=True, eq=False)
class BuildItem:
    """One thing to build: its parts stay together.

    Attributes
    ----------
    name : str
        What slicers list.
    parts : tuple of Part
        At least one.
    offset_mm : tuple of float
        Where the origin of the parts lies on the plate: x right, y back, z up.
    """

    name: str
    parts: tuple[Part, ...]
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


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
    return _joined([(part.vertices_mm, part.faces) for item in read_build(data) for part in item.parts])


def read_build(data: bytes) -> list[BuildItem]:
    """Read what the file says to build, thing by thing.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    list of BuildItem
        In the order of the file. Parts are where they will be built: each ``offset_mm`` is zero.

    Raises
    ------
    ValueError, KeyError, zipfile.BadZipFile, xml.etree.ElementTree.ParseError
        The archive, the model or a number in it is damaged.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [BuildItem(name, parts) for name, parts in Package(archive).built()]


def write_threemf(vertices_mm: NDArray[np.float64], faces: NDArray[np.int32], name: str = "") -> bytes:
    """Pack one object into a 3MF archive; the same mesh always gives the same bytes.

    Parameters
    ----------
    vertices_mm : ndarray of float64, shape (V, 3)
    faces : ndarray of int32, shape (F, 3)
    name : str
        What slicers list.

    Returns
    -------
    bytes
    """
    return write_build([BuildItem(name, (Part(name, vertices_mm, faces),))])


def write_build(items: Sequence[BuildItem]) -> bytes:
    """Pack a plate of things into a 3MF archive; the same things always give the same bytes.

    Parameters
    ----------
    items : sequence of BuildItem
        In the order in which slicers list them.

    Returns
    -------
    bytes
    """
    resources, build = [], []
    count = 0
    for item in items:
        texts = _resources_of(item, count)
        count += len(texts)
        resources += texts
        build.append(f'<item objectid="{count}"{_transform(item.offset_mm)}/>')
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" xmlns="{CORE}">'
        f"<resources>{''.join(resources)}</resources><build>{''.join(build)}</build></model>"
    )
    return _archive({"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONS, MODEL_PATH: model})


def _resources_of(item: BuildItem, used: int) -> list[str]:
    """Write the objects of one item, numbered from ``used + 1``; the last one is what is built."""
    texts = [_mesh_text(part, used + place) for place, part in enumerate(item.parts, 1)]
    if len(texts) == 1:
        return texts
    components = "".join(f'<component objectid="{used + place}"/>' for place in range(1, len(texts) + 1))
    number = used + len(texts) + 1
    whole = f"<components>{components}</components>"
    return [*texts, f'<object id="{number}" type="model"{_name(item.name)}>{whole}</object>']


def _mesh_text(part: Part, number: int) -> str:
    corners = "".join(
        f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in part.vertices_mm.tolist()
    )
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in part.faces.tolist())
    return (
        f'<object id="{number}" type="model"{_name(part.name)}><mesh><vertices>{corners}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )


def _name(name: str) -> str:
    return f" name={quoteattr(name)}" if name else ""


def _transform(offset_mm: tuple[float, float, float]) -> str:
    if not any(offset_mm):
        return ""
    x, y, z = (f"{value:.9g}" for value in offset_mm)
    return f' transform="1 0 0 0 1 0 0 0 1 {x} {y} {z}"'


def _archive(files: dict[str, str]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), text, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _joined(surfaces: list[Surface]) -> Surface:
    counts = np.cumsum([0] + [len(vertices) for vertices, _ in surfaces])
    vertices = [np.zeros((0, 3)), *(vertices for vertices, _ in surfaces)]
    faces = [
        np.zeros((0, 3), np.int32),
        *(f + np.int32(n) for (_, f), n in zip(surfaces, counts, strict=False)),
    ]
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)
