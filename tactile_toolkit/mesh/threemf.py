"""3MF, the preferred format of slicers: a zip archive of XML models (3MF core specification 1.3).

trimesh is not used for reading, because it skips missing objects, accepts malformed numbers and has no
limits, so that a damaged file becomes another solid without a warning. lib3mf has no wheels for Linux on
aarch64, and does not know the volumes of slicers.
"""

from __future__ import annotations

import io
import zipfile
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from tactile_toolkit import cache
from tactile_toolkit.columns import units
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh, Surface, join_surfaces, placed
from tactile_toolkit.mesh.plain_formats import numbers_of
from tactile_toolkit.value_types import Float64
from tactile_toolkit.wording import with_count

SCHEMAS = "http://schemas.microsoft.com/3dmanufacturing"
CORE = f"{SCHEMAS}/core/2015/02"
MODEL_PATH = "3D/3dmodel.model"
RELATIONS_PATH = "_rels/.rels"
MODEL_RELATION = f"{SCHEMAS}/2013/01/3dmodel"
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
    f'Type="{MODEL_RELATION}"/></Relationships>'
)

# The earliest date of a zip archive; with the time of writing, equal items would give different files.
_EPOCH = (1980, 1, 1, 0, 0, 0)
_UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "inch": "in",
    "foot": "ft",
    "meter": "m",
}
_PRODUCTION = f"{SCHEMAS}/production/2015/06"
_PATH = f"{_PRODUCTION} path"

# Extensions that a file may require: paths between models, and those without shapes.
_KNOWN = (CORE, _PRODUCTION, f"{SCHEMAS}/material/2015/02", f"{SCHEMAS}/trianglesets/2021/07")

# Shapes of other extensions, which a file need not require.
_SHAPES = ("beamlattice", "booleanshape", "displacementmesh", "levelset", "slicestack")

# Slicers describe the volumes of an object: PrusaSlicer as ranges of triangles, Bambu Studio and OrcaSlicer
# as its components.
_VOLUMES_PATHS = ("metadata/slic3r_pe_model.config", "metadata/model_settings.config")
_BODY_VOLUMES = ("modelpart", "normal_part")
_NEGATIVE_VOLUMES = ("negativevolume", "negative_part")

# A file of a few bytes can contain itself, or unpack to any size.
_DEEPEST = 32
_MAX_PARTS = 20_000

# Upper bounds of the memory for each byte of XML and of the result, and for each element.
_PER_BYTE, _PER_ELEMENT = 4, 160
_PIECE_BYTES = 1 << 20
_UNMOVED = "1 0 0 0 1 0 0 0 1 0 0 0"


class Build(NamedTuple):
    """Objects that a file places on the plate.

    ``items`` are in order of the file and at their final positions: each ``offset_mm`` is zero. ``left_out``
    describes parts of the file that do not belong to the model. ``unit`` is that of the root model, a key of
    ``units.MM_PER_UNIT``.
    """

    items: list[BuildItem]
    left_out: tuple[str, ...]
    unit: str


@dataclass(slots=True, eq=False)
class _Object:
    """An object of a model, or the build itself: a surface in mm, or components.

    A component is a reference, a path and an id, and a transform in mm. Only objects of type "model" belong
    to the model.
    """

    name: str = ""
    type: str = "model"
    surface: Surface | None = None
    parts: list[tuple[tuple[str, str], Float64]] = field(default_factory=list)


class _Package:
    """The objects of all models of an archive, by path and id; the build of a model has an empty id.

    Models are read tag by tag, because a tree of a million vertices would take a gigabyte. Slicers store the
    objects of a plate in separate models, named by paths inside the archive (3MF production extension).
    """

    def __init__(self, archive: zipfile.ZipFile, file_bytes: int) -> None:
        self._file_bytes = file_bytes
        self._objects: dict[tuple[str, str], _Object] = {}
        self._tags = self._placed_parts = self._built_bytes = 0
        self._left_out = Counter[tuple[str, str]]()
        self._units: dict[str, str] = {}
        self._namespaces: dict[str | None, str] = {}
        self._target = ""
        # For objects of the root model: the kind of a component by its id, and of ranges of triangles.
        self._parts: dict[tuple[str, str], str] = {}
        self._ranges: dict[str, list[tuple[int, int, str]]] = {}
        entries = {_plain(entry.filename): entry for entry in archive.infolist()}
        models = [path for path in entries if path.endswith(".model")]
        if not models:
            raise InputError("the archive holds no .model file")
        known = [path for path in (RELATIONS_PATH, *_VOLUMES_PATHS) if path in entries]
        size = sum(entries[path].file_size for path in (*models, *known))
        cache.require_unpackable(_PER_BYTE * size, f"3MF file: XML of {size:,} bytes", file_bytes)
        for path in known:
            self._read(archive, entries[path], self._begin_other)
        self._root = self._target
        if not self._root:
            self._root = MODEL_PATH.lower()
            if self._root not in models:
                self._root = models[0]
        if self._root not in models:
            raise InputError(f"the archive holds no model /{self._root}, which it names as its root")
        for self._path in models:
            self._last = self._objects[self._path, ""] = _Object()
            self._points, self._corners = array("d"), array("i")
            self._read(archive, entries[self._path], self._begin)

    def _read(
        self, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, begin: Callable[[str, dict[str, str]], None]
    ) -> None:
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.StartElementHandler = begin
        parser.EndElementHandler = self._end
        parser.StartNamespaceDeclHandler = self._namespaces.__setitem__
        parser.StartDoctypeDeclHandler = self._refuse_names_for_text
        with archive.open(entry) as stream:
            while piece := stream.read(_PIECE_BYTES):
                before = self._tags
                parser.Parse(piece)
                if len(piece) == _PIECE_BYTES and self._tags == before:
                    # Attributes take 30 times as much memory, and are parsed again with each piece.
                    raise InputError(f"XML of {_PIECE_BYTES:,} bytes in which no element ends")
        parser.Parse(b"", True)

    def _begin_other(self, tag: str, attributes: Mapping[str, str]) -> None:
        """Read the name of the root model, or the purpose of volumes."""
        match tag.rpartition(" ")[2]:
            case "Relationship" if attributes.get("Type") == MODEL_RELATION:
                self._target = _plain(attributes["Target"])
            case "object":
                self._number = attributes["id"]
            case "volume":
                first, last = int(attributes["firstid"]), int(attributes["lastid"])
                self._ranges.setdefault(self._number, []).append((first, last, "modelpart"))
            case "part":
                self._parts[self._number, attributes["id"]] = attributes.get("subtype", "normal_part").lower()
            case "metadata" if self._ranges.get(getattr(self, "_number", "")):
                first, last, kind = self._ranges[self._number][-1]
                if attributes.get("key") == "volume_type":
                    kind = attributes["value"].lower()
                if attributes.get("key") == "modifier" and attributes["value"] == "1" and kind == "modelpart":
                    kind = "parametermodifier"  # in releases before 2.3
                self._ranges[self._number][-1] = first, last, kind
        self._count_tag(2)

    def _begin(self, tag: str, attributes: Mapping[str, str]) -> None:
        # The parser keeps all names, so unknown ones cost more.
        cost = 1
        match tag.removeprefix(f"{CORE} "):
            case "vertex":
                self._points.extend(numbers_of([attributes["x"], attributes["y"], attributes["z"]], float))
            case "triangle":
                self._corners.extend(numbers_of([attributes["v1"], attributes["v2"], attributes["v3"]], int))
            case "object":
                named = self._path, attributes["id"]
                if named in self._objects:
                    raise InputError(
                        f"/{self._path} has several objects {attributes['id'][:40]!r}; expected one"
                    )
                self._last = self._objects[named] = _Object(
                    attributes.get("name", ""), attributes.get("type", "model")
                )
            case "build":
                self._last = self._objects[self._path, ""]
            case "item" if attributes.get("printable") in ("0", "false"):
                if self._path == self._root:
                    self._left_out["objects", "not to be printed"] += 1
            case "component" | "item":
                numbers = numbers_of(attributes.get("transform", _UNMOVED).split(), float)
                # Each model has its own unit.
                matrix = np.array(numbers).reshape(4, 3) * np.array([[1], [1], [1], [self._mm_per_unit]])
                self._last.parts.append(
                    ((_plain(attributes.get(_PATH, self._path)), attributes["objectid"]), matrix)
                )
            case "model":
                self._begin_model(attributes)
            case "mesh" | "vertices" | "triangles" | "resources" | "components":
                pass
            case _:
                cost = 3
                name = tag.rpartition(" ")[2]
                if name in _SHAPES:
                    raise InputError(f"the model holds a {name}, which is not supported")
        self._count_tag(cost)

    def _begin_model(self, attributes: Mapping[str, str]) -> None:
        unit = attributes.get("unit", "millimeter")
        if unit not in _UNITS:
            raise InputError(f"the unit is {unit[:40]!r}; expected one of {', '.join(_UNITS)}")
        self._units[self._path] = _UNITS[unit]
        self._mm_per_unit = units.MM_PER_UNIT[_UNITS[unit]]
        for prefix in attributes.get("requiredextensions", "").split():
            extension = self._namespaces.get(prefix, prefix)
            if extension not in _KNOWN:
                raise InputError(
                    f"the file requires the extension {extension[:120]!r}, which is not supported",
                    next="export it as a plain solid",
                )

    def _count_tag(self, cost: int) -> None:
        self._tags += cost
        if self._tags % 1024 < 3:
            what = f"3MF file: XML of more than {self._tags:,} elements"
            cache.require_unpackable(_PER_ELEMENT * self._tags, what, self._file_bytes)

    def _end(self, tag: str) -> None:
        if tag == f"{CORE} mesh":
            vertices = np.array(self._points, np.float64).reshape(-1, 3) * self._mm_per_unit
            self._last.surface = (vertices, np.array(self._corners, np.int32).reshape(-1, 3))
            self._points, self._corners = array("d"), array("i")

    def _refuse_names_for_text(self, *_: object) -> None:
        """Refuse entities, which 3MF does not have: a few bytes expand to any size."""
        raise InputError("the model has a document type; expected plain XML")

    def build(self) -> Build:
        """Return each object at its final position, its components joined."""
        items = []
        for named, matrix in self._objects[self._root, ""].parts:
            surfaces = list(self._placed(named, matrix))
            if surfaces:
                vertices_mm, faces = join_surfaces(surfaces)
                items.append(BuildItem(self._objects[named].name, Mesh(vertices_mm / MM_PER_M, faces)))
        left_out = tuple(
            f"left out: {with_count(count, things)} {kind}"
            for (things, kind), count in self._left_out.items()
            if count
        )
        if not items:
            raise InputError("; ".join(["the file holds nothing to build", *left_out]))
        return Build(items, left_out, self._units[self._root])

    def _placed(self, named: tuple[str, str], matrix: Float64, depth: int = 0) -> Iterator[Surface]:
        """Yield the transformed surfaces of an object."""
        if named not in self._objects:
            raise InputError(f"the archive holds no object {named[1]!r} of /{named[0]}")
        thing = self._objects[named]
        if self._units[named[0]] != self._units[self._root]:
            raise InputError(  # readers differ in which unit applies
                f"/{named[0]} is in {self._units[named[0]]}, and /{self._root} in {self._units[self._root]}; "
                "expected one unit"
            )
        if thing.type != "model":
            self._left_out["objects", f"of type {thing.type[:40]!r}"] += 1
            return
        # A few bytes can refer to the same object any number of times.
        self._placed_parts += 1
        self._built_bytes += sum(values.nbytes for values in thing.surface or ())
        if depth > _DEEPEST or self._placed_parts > _MAX_PARTS:
            raise InputError(f"object {named[1]!r} holds itself, or more than {_MAX_PARTS:,} parts")
        cache.require_unpackable(
            _PER_BYTE * self._built_bytes, "3MF file: the content of its objects", self._file_bytes
        )
        own = None
        if thing.surface is not None:
            own = self._without_volumes(named, thing.surface)
        parts = [part for part in thing.parts if self._is_body(self._parts.get((named[1], part[0][1])))]
        below = (surface for part in parts for surface in self._placed(*part, depth + 1))
        for surface in below if own is None else [own]:
            yield placed(surface, matrix[:3], matrix[3])

    def _is_body(self, kind: str | None) -> bool:
        """Return whether a volume belongs to the object; InputError for a negative volume."""
        if kind in _NEGATIVE_VOLUMES:
            raise InputError(
                "an object has a negative volume, which slicers subtract",
                next="subtract it in the slicer or in a CAD program, and export the result",
            )
        if kind is None or kind in _BODY_VOLUMES:
            return True
        self._left_out["volumes", f"of kind {kind[:40]!r}"] += 1
        return False

    def _without_volumes(self, named: tuple[str, str], surface: Surface) -> Surface:
        """Return a surface without the triangles of volumes that do not belong to the object."""
        vertices_mm, faces = surface
        ranges = self._ranges.get(named[1], []) if named[0] == self._root else []
        is_body = np.ones(len(faces), bool)
        for first, last, kind in ranges:
            is_body[max(first, 0) : last + 1] &= self._is_body(kind)
        if is_body.all():
            return surface
        used, corners = np.unique(faces[is_body], return_inverse=True)
        return vertices_mm[used], corners.reshape(-1, 3).astype(np.int32)


def _plain(path: str) -> str:
    return path.lower().lstrip("/")


def read_build(data: bytes) -> Build:
    """Read the objects that a file places on the plate.

    Raises InputError, ValueError, KeyError, zipfile.BadZipFile or xml.parsers.expat.ExpatError where the
    archive, the model or a number in it is damaged; InputError if it needs an unsupported feature, or
    exceeds the limit when unpacked.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        try:
            cache.require_plain_archive(archive)
        except ValueError as error:
            raise InputError(str(error)) from error
        return _Package(archive, len(data)).build()


@dataclass(frozen=True, slots=True, eq=False)
class BuildItem:
    """An object on the plate, with the name that slicers show.

    ``offset_mm`` is where the origin of its vertices lies on the plate: x right, y back, z up.
    """

    name: str
    mesh: Mesh
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


def write_build(items: Sequence[BuildItem]) -> bytes:
    """Return the bytes of a 3MF file with objects, in the order in which slicers list them."""
    build = ""
    for number, item in enumerate(items, 1):
        x, y, z = (f"{value:.9g}" for value in item.offset_mm)
        moved = f' transform="1 0 0 0 1 0 0 0 1 {x} {y} {z}"' * any(item.offset_mm)
        build += f'<item objectid="{number}"{moved}/>'
    resources = "".join(_object(item, number) for number, item in enumerate(items, 1))
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" xmlns="{CORE}">'
        f"<resources>{resources}</resources><build>{build}</build></model>"
    )
    files = {"[Content_Types].xml": _CONTENT_TYPES, RELATIONS_PATH: _RELATIONS, MODEL_PATH: model}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), text, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _object(item: BuildItem, number: int) -> str:
    # Nine digits represent each float32 exactly, and stored meshes are float32; -0 becomes 0.
    vertices = (item.mesh.vertices_mm + 0.0).tolist()
    corners = "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in vertices)
    faces = item.mesh.faces.tolist()
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    name = ""
    if item.name:
        name = f" name={quoteattr(item.name)}"
    return (
        f'<object id="{number}" type="model"{name}><mesh><vertices>{corners}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )
