"""Writing 3MF; equal items give equal bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from tactile_toolkit.mesh.mesh import Mesh

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
    places = (item.mesh.vertices_mm + 0.0).tolist()
    corners = "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in places)
    faces = item.mesh.faces.tolist()
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    name = ""
    if item.name:
        name = f" name={quoteattr(item.name)}"
    return (
        f'<object id="{number}" type="model"{name}><mesh><vertices>{corners}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )
