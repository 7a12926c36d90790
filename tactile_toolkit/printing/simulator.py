"""Bodies for simulators: MJCF, URDF and USD with true mass and inertia, and convex parts for contacts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import indent
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from manifold3d import CrossSection
from scipy.spatial.transform import Rotation

from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.printing.print_options import Physics
from tactile_toolkit.value_types import Float64

if TYPE_CHECKING:
    from manifold3d import Manifold


_DIRECTIONS = [
    np.array([math.cos(angle), math.sin(angle)]) for angle in np.linspace(0, math.pi, 12, endpoint=False)
]
_OUTLINE_MM = 0.02  # finer details of an outline are ignored

# Larger than any plate, and small enough for half planes in double precision.
_FAR_MM = 1e5
_MIN_MM3 = 1e-6  # smaller remainders of a cut are not parts

TOO_LIGHT = "too-light"
"""Problem of a solid; those of other meshes are :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`."""

# MuJoCo refuses bodies with a smaller moment of inertia.
_MIN_MOMENT_KG_M2 = 1e-14

_USD_INDENT = " " * 4

# Moments of inertia by name in URDF, in the order of MJCF.
_MOMENTS = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}


def convex_parts(
    mesh: Mesh, *, excess: float = 1.08, most: int = 64, tolerance_mm: float = 0.1
) -> list[Mesh]:
    """Cut a solid into parts and return their convex hulls.

    The part whose hull adds most volume is cut first, until the volume of all hulls is ``excess`` times that
    of the solid, or there are about ``most`` parts. The hulls contain the solid except for corners, which are
    smoothed by ``tolerance_mm``. Equal meshes give equal parts.

    Raises ItemError for a mesh that does not bound a solid.
    """
    solid = require_solid(mesh).manifold
    parts = _parts(solid)
    whole_mm3 = solid.volume()
    for _ in range(most):  # limits the cuts, which may split off chips that are not parts
        if len(parts) >= most or sum(hull.volume() for *_, hull in parts) <= excess * whole_mm3:
            break
        _, part, _ = parts.pop(int(np.argmax([added_mm3 for added_mm3, *_ in parts])))
        normal, offset_mm = _best_cut(part.project().simplify(_OUTLINE_MM))
        for half in part.split_by_plane((*normal.tolist(), 0.0), offset_mm):
            parts += _parts(half)
    smooth = [(hull, hull.simplify(tolerance_mm).hull()) for *_, hull in parts]
    # Smoothing removes chips that are thinner than the tolerance.
    return [Mesh.from_manifold(exact if simple.is_empty() else simple) for exact, simple in smooth]


def _parts(solid: Manifold) -> list[tuple[float, Manifold, Manifold]]:
    """Return the bodies of a solid: the volume that the hull of each adds, the body, and its hull."""
    bodies = [(part, part.hull()) for part in solid.decompose() if part.volume() > _MIN_MM3]
    return [(hull.volume() - part.volume(), part, hull) for part, hull in bodies]


def _best_cut(outline: CrossSection) -> tuple[Float64, float]:
    """Return the line, normal and offset in mm, with the least area between the halves and their hulls.

    It passes through the corner that is deepest in a bay. Without a bay, the added volume lies above the
    outline, as over a stroke of changing width: then the line halves the length.
    """
    corners = np.concatenate([np.asarray(piece) for piece in outline.to_polygons()])
    depths_mm = _depths_mm(outline, corners)
    deepest = corners[int(depths_mm.argmax())]
    cuts = []
    directions = _DIRECTIONS
    if depths_mm.max() <= _OUTLINE_MM:  # no bay
        directions = directions[:0]
    for number, normal in enumerate(directions):
        far = normal * _FAR_MM
        along = np.array([-normal[1], normal[0]]) * _FAR_MM
        start = normal * float(normal @ deepest)
        corner = start - along, start - along + far, start + along + far, start + along
        half = CrossSection([np.array(corner)])
        halves = (outline ^ half, outline - half)
        if not any(piece.is_empty() for piece in halves):
            area = sum(piece.hull().area() for piece in halves for piece in piece.decompose())
            cuts.append((area, number))
    if cuts:
        normal = _DIRECTIONS[min(cuts)[1]]
        return normal, float(normal @ deepest)
    normal = max(_DIRECTIONS, key=lambda direction: float(np.ptp(corners @ direction)))
    along = corners @ normal
    return normal, float(along.min() + along.max()) / 2


def _depths_mm(outline: CrossSection, corners: Float64) -> Float64:
    """Return the depth of each corner of an outline below its convex hull, shape (N,), mm."""
    hull = np.asarray(outline.hull().to_polygons()[0])
    along = np.roll(hull, -1, axis=0) - hull
    inwards = np.stack([-along[:, 1], along[:, 0]], axis=1)
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    depths: Float64 = ((corners[:, None] - hull[None]) * inwards[None]).sum(axis=2).min(axis=1)
    return depths


@dataclass(frozen=True, slots=True)
class RigidBody:
    """A rigid body in metres and kilograms, in the frame of its mesh.

    ``inertia_kg_m2``, shape (3, 3), is about the centre of mass ``center_m``, along the axes of the mesh.
    """

    name: str
    mesh: Mesh
    parts: tuple[Mesh, ...]
    mass_kg: float
    center_m: Float64
    inertia_kg_m2: Float64
    friction: float


def body_of(name: str, mesh: Mesh, physics: Physics) -> RigidBody:
    """Compute mass and inertia of a filled solid, and divide it into convex parts.

    Raises ItemError for a mesh that is not a solid, or that is too light for MuJoCo.
    """
    parts = tuple(convex_parts(mesh))
    measured = mesh.to_trimesh()
    measured.density = physics.density_kg_m3
    properties = measured.mass_properties
    center_m = np.asarray(properties.center_mass, np.float64)
    inertia_kg_m2 = np.asarray(properties.inertia, np.float64)
    least = float(np.linalg.eigvalsh(inertia_kg_m2)[0])
    if least < _MIN_MOMENT_KG_M2:
        raise ItemError(
            TOO_LIGHT,
            f"its least moment of inertia is {least:.2g} kg m²; MuJoCo takes bodies from "
            f"{_MIN_MOMENT_KG_M2:g} kg m² on; next: a larger --scale or --density-kg-m3",
        )
    return RigidBody(name, mesh, parts, float(properties.mass), center_m, inertia_kg_m2, physics.friction)


def model_files(name: str, mesh: Mesh, ending: str, physics: Physics) -> dict[str, bytes]:
    """Return the files of a body by path; the model is last, after the files that it refers to."""
    body = body_of(name, mesh, physics)
    if ending == ".urdf":
        return _pack_urdf(body, name)
    if ending == ".xml":
        return {f"{name}.xml": pack_mjcf([(body, (0.0, 0.0))], name)}
    return {f"{name}{ending}": _pack_usd(body)}


def pack_mjcf(
    bodies: Sequence[tuple[RigidBody, tuple[float, float]]], model: str, floor: bool = False
) -> bytes:
    """Write bodies, each with its position on the ground in metres, as one self-contained MJCF file.

    ``floor`` adds a ground plane and light. Equal bodies give equal bytes.
    """
    # An infinite plane, with 5 cm between grid lines.
    light = _tag("light", pos="0 0 1", dir="0 0 -1", directional="true")
    ground = []
    if floor:
        ground = [light, _tag("geom", name="floor", type="plane", size="0 0 0.05")]
    assets = []
    elements = []
    for body, (x_m, y_m) in bodies:
        parts = {f"{body.name}-{number:02d}": part for number, part in enumerate(body.parts)}
        faces = " ".join(map(str, body.mesh.faces.ravel().tolist()))
        assets.append(_tag("mesh", name=body.name, vertex=_text(body.mesh.vertices_m.ravel()), face=faces))
        assets += [
            _tag("mesh", name=name, vertex=_text(part.vertices_m.ravel())) for name, part in parts.items()
        ]
        moments = _text(body.inertia_kg_m2[entry] for entry in _MOMENTS.values())
        # Group 2 is drawn and group 3 is not, by convention of the models of MuJoCo.
        drawn = {"type": "mesh", "contype": "0", "conaffinity": "0", "group": "2", "mass": "0"}
        # Torsional and rolling friction are the defaults of MuJoCo.
        friction = _text((body.friction, 0.005, 1e-4))
        collision = {"type": "mesh", "group": "3", "mass": "0", "friction": friction}
        elements.append(
            _tag(
                "body",
                _tag("freejoint", name=f"{body.name}-free"),
                _tag("inertial", pos=_text(body.center_m), mass=_text((body.mass_kg,)), fullinertia=moments),
                _tag("geom", name=body.name, mesh=body.name, **drawn),
                *(_tag("geom", name=name, mesh=name, **collision) for name in parts),
                name=body.name,
                pos=_text((x_m, y_m, 0.0)),
            )
        )
    world = _tag("worldbody", *ground, *elements)
    return _written(_tag("mujoco", _tag("asset", *assets), world, model=model))


def _pack_urdf(body: RigidBody, folder: str) -> dict[str, bytes]:
    """Return a URDF file and its meshes, OBJ in metres, by path; the URDF file is last."""
    meshes = {"visual": body.mesh} | {f"part-{number:02d}": part for number, part in enumerate(body.parts)}
    files = {
        f"{folder}/{name}.obj": str(mesh.to_trimesh().export(file_type="obj", header=None)).encode()
        for name, mesh in meshes.items()
    }
    moments = {name: _text((body.inertia_kg_m2[entry],)) for name, entry in _MOMENTS.items()}
    inertial = _tag(
        "inertial",
        _tag("origin", xyz=_text(body.center_m), rpy="0 0 0"),
        _tag("mass", value=_text((body.mass_kg,))),
        _tag("inertia", **moments),
    )
    shapes = [
        _tag("collision" if number else "visual", _tag("geometry", _tag("mesh", filename=path)))
        for number, path in enumerate(files)
    ]
    contact = _tag("contact", _tag("lateral_friction", value=_text((body.friction,))))
    link = _tag("link", inertial, *shapes, contact, name=body.name)
    # Otherwise MuJoCo before 4.0 ignores the folders of meshes.
    paths = _tag("mujoco", _tag("compiler", strippath="false"))
    return {**files, f"{folder}.urdf": _written(_tag("robot", paths, link, name=body.name))}


def _pack_usd(body: RigidBody) -> bytes:
    """Write a body as a USD text file, in metres and kilograms."""
    prim = re.sub(r"\W|^(?=\d)", "_", body.name, flags=re.ASCII)  # USD allows no other names
    moments, axes = np.linalg.eigh(body.inertia_kg_m2)
    # The sign of an axis is arbitrary: its largest component is made positive.
    axes = axes * np.sign(np.take_along_axis(axes, np.abs(axes).argmax(axis=0)[None], axis=0))
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    x, y, z, w = Rotation.from_matrix(axes).as_quat(canonical=True)
    friction = [f"float physics:{kind}Friction = {_text((body.friction,))}" for kind in ("dynamic", "static")]
    collision = (
        'uniform token purpose = "guide"',
        'uniform token physics:approximation = "convexHull"',
        f"rel material:binding:physics = </{prim}/material>",
    )
    schemas = ("PhysicsCollisionAPI", "PhysicsMeshCollisionAPI", "MaterialBindingAPI")
    text = _prim(
        "Xform",
        prim,
        ("PhysicsRigidBodyAPI", "PhysicsMassAPI"),
        f"float physics:mass = {_text((body.mass_kg,))}",
        f"point3f physics:centerOfMass = ({_text(body.center_m, ', ')})",
        f"float3 physics:diagonalInertia = ({_text(moments, ', ', 7)})",
        # Few digits, because LAPACK rounds differently between processors.
        f"quatf physics:principalAxes = ({_text((w, x, y, z), ', ', 6)})",
        _prim("Material", "material", ("PhysicsMaterialAPI",), *friction),
        _prim("Mesh", "visual", (), *_usd_surface(body.mesh)),
        *(
            _prim("Mesh", f"part_{number:02d}", schemas, *_usd_surface(part), *collision)
            for number, part in enumerate(body.parts)
        ),
    )
    head = f'defaultPrim = "{prim}"\nkilogramsPerUnit = 1\nmetersPerUnit = 1\nupAxis = "Z"\n'
    return f"#usda 1.0\n(\n{indent(head, _USD_INDENT)})\n{text}\n".encode()


def _prim(kind: str, name: str, schemas: Sequence[str], *content: str) -> str:
    """Write a prim of USD: its schemas, attributes and children."""
    listed = ", ".join(f'"{schema}"' for schema in schemas)
    applied = ""
    if schemas:
        applied = f" (\n{_USD_INDENT}prepend apiSchemas = [{listed}]\n)"
    inside = indent("\n".join(content), _USD_INDENT)
    return f'\ndef {kind} "{name}"{applied}\n{{\n{inside}\n}}'


def _usd_surface(mesh: Mesh) -> list[str]:
    points = ", ".join(f"({_text(row, ', ')})" for row in mesh.vertices_m)
    return [
        'uniform token subdivisionScheme = "none"',
        f"int[] faceVertexCounts = [{', '.join(['3'] * len(mesh.faces))}]",
        f"int[] faceVertexIndices = [{', '.join(map(str, mesh.faces.ravel().tolist()))}]",
        f"point3f[] points = [{points}]",
    ]


def _text(values: Iterable[float], between: str = " ", digits: int = 9) -> str:
    return between.join(f"{float(value):.{digits}g}" for value in values)


def _tag(tag: str, /, *children: ElementTree.Element, **attributes: str) -> ElementTree.Element:
    element = ElementTree.Element(tag, attributes)
    element.extend(children)
    return element


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"
