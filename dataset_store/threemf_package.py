"""Reading 3MF packages: the objects of all models in one archive (core and production specification)."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CORE", "MM_PER_UNIT", "MODEL_PATH", "Package", "Part"]

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
