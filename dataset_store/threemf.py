"""3MF, the file that slicers prefer: a zip archive with one XML model (3MF core specification 1.3).

A file that is written here holds things to build, each with a name and its place on the plate. A thing of
several parts (an object and its tag, say) is one assembly, so that a slicer that moves it moves all of it.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from dataset_store.threemf_package import CORE, MM_PER_UNIT, MODEL_PATH, Package, Part

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MM_PER_UNIT", "BuildItem", "Part", "read_build", "read_threemf", "write_build", "write_threemf"]

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
