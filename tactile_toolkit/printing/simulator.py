"""Bodies for simulators: MJCF, URDF and USD with true mass and inertia, and convex parts for contacts.

A simulator that is given the mesh alone takes its convex hull for contacts, and may take another mass.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_toolkit.mesh.convex import convex_parts
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.printing.spec import Physics


@dataclass(frozen=True, slots=True)
class Body:
    """One rigid body, metres, kilograms, in the frame of its mesh.

    ``inertia_kg_m2``, shape (3, 3), is about the centre of mass ``center_m``, along the axes of the mesh.
    """

    name: str
    mesh: Mesh
    parts: tuple[Mesh, ...]
    mass_kg: float
    center_m: NDArray[np.float64]
    inertia_kg_m2: NDArray[np.float64]
    friction: float


def body_of(name: str, mesh: Mesh, physics: Physics) -> Body:
    """Weigh an evenly filled solid and cut it into convex parts; raises ItemError where it is none."""
    parts = tuple(convex_parts(mesh))
    measured = mesh.to_trimesh()
    measured.density = physics.density_kg_m3
    properties = measured.mass_properties
    center_m = np.asarray(properties.center_mass, np.float64)
    inertia_kg_m2 = np.asarray(properties.inertia, np.float64)
    return Body(name, mesh, parts, float(properties.mass), center_m, inertia_kg_m2, physics.friction)


def model_files(name: str, mesh: Mesh, ending: str, physics: Physics) -> dict[str, bytes]:
    """Write a solid as a body: the files by path, the model last, behind what it refers to."""
    body = body_of(name, mesh, physics)
    if ending == ".urdf":
        return _pack_urdf(body, name)
    return {f"{name}{ending}": pack_mjcf([(body, (0.0, 0.0))], name) if ending == ".xml" else _pack_usd(body)}


def pack_mjcf(bodies: Sequence[tuple[Body, tuple[float, float]]], model: str, floor: bool = False) -> bytes:
    """Write bodies, each with its place on the ground in metres, as one MJCF file that needs no other.

    ``floor`` adds a plane to lie on, and light. The same bodies give the same bytes.
    """
    # The plane without end, and 5 cm between the lines that are drawn on it.
    light = _tag("light", pos="0 0 1", dir="0 0 -1", directional="true")
    ground = [light, _tag("geom", name="floor", type="plane", size="0 0 0.05")] if floor else []
    assets, elements = [], []
    for body, (x_m, y_m) in bodies:
        parts = {f"{body.name}-{number:02d}": part for number, part in enumerate(body.parts)}
        faces = " ".join(map(str, body.mesh.faces.ravel().tolist()))
        assets.append(_tag("mesh", name=body.name, vertex=_text(body.mesh.vertices_m.ravel()), face=faces))
        assets += [
            _tag("mesh", name=name, vertex=_text(part.vertices_m.ravel())) for name, part in parts.items()
        ]
        i = body.inertia_kg_m2
        moments = _text((i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]))
        # Group 2 is drawn and group 3 is not, as in the models that MuJoCo's own viewer comes with.
        drawn = {"type": "mesh", "contype": "0", "conaffinity": "0", "group": "2", "mass": "0"}
        # Against turning and rolling, MuJoCo's own defaults.
        felt = {"type": "mesh", "group": "3", "mass": "0", "friction": _text((body.friction, 0.005, 1e-4))}
        elements.append(
            _tag(
                "body",
                _tag("freejoint", name=f"{body.name}-free"),
                _tag("inertial", pos=_text(body.center_m), mass=_text((body.mass_kg,)), fullinertia=moments),
                _tag("geom", name=body.name, mesh=body.name, **drawn),
                *(_tag("geom", name=name, mesh=name, **felt) for name in parts),
                name=body.name,
                pos=_text((x_m, y_m, 0.0)),
            )
        )
    world = _tag("worldbody", *ground, *elements)
    return _written(_tag("mujoco", _tag("asset", *assets), world, model=model))


def _pack_urdf(body: Body, folder: str) -> dict[str, bytes]:
    """Write a body as a URDF file and its meshes, OBJ in metres, by path; the URDF file is the last one."""
    files = {f"{folder}/visual.obj": _obj(body.mesh)}
    files |= {f"{folder}/part-{number:02d}.obj": _obj(part) for number, part in enumerate(body.parts)}
    i = body.inertia_kg_m2
    moments = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
    inertial = _tag(
        "inertial",
        _tag("origin", xyz=_text(body.center_m), rpy="0 0 0"),
        _tag("mass", value=_text((body.mass_kg,))),
        _tag("inertia", **{name: _text((i[place],)) for name, place in moments.items()}),
    )
    shapes = [
        _tag("collision" if number else "visual", _tag("geometry", _tag("mesh", filename=path)))
        for number, path in enumerate(files)
    ]
    contact = _tag("contact", _tag("lateral_friction", value=_text((body.friction,))))
    link = _tag("link", inertial, *shapes, contact, name=body.name)
    return {**files, f"{folder}.urdf": _written(_tag("robot", link, name=body.name))}


_USD = """#usda 1.0
(
    defaultPrim = "{prim}"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "{prim}" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
)
{{
    float physics:mass = {mass}
    point3f physics:centerOfMass = ({center})
    float3 physics:diagonalInertia = ({moments})
    quatf physics:principalAxes = ({axes})

    def Material "material" (
        prepend apiSchemas = ["PhysicsMaterialAPI"]
    )
    {{
        float physics:dynamicFriction = {friction}
        float physics:staticFriction = {friction}
    }}
{meshes}}}
"""
_USD_MESH = """
    def Mesh "{name}"{schemas}
    {{
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [{counts}]
        int[] faceVertexIndices = [{faces}]
        point3f[] points = [{points}]{collision}
    }}
"""
_USD_SCHEMAS = """ (
        prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI", "MaterialBindingAPI"]
    )"""
_USD_COLLISION = """
        uniform token purpose = "guide"
        uniform token physics:approximation = "convexHull"
        rel material:binding:physics = <{path}/material>"""


def _pack_usd(body: Body) -> bytes:
    """Write a body as one USD file in words, metres and kilograms."""
    prim = re.sub(r"\W|^(?=\d)", "_", body.name, flags=re.ASCII)  # USD knows no other names
    moments, axes = np.linalg.eigh(body.inertia_kg_m2)
    # An axis and its opposite are one: taken is the one whose largest share is positive.
    axes = axes * np.sign(np.take_along_axis(axes, np.abs(axes).argmax(axis=0)[None], axis=0))
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    x, y, z, w = Rotation.from_matrix(axes).as_quat(canonical=True)
    felt = (_USD_SCHEMAS, _USD_COLLISION.format(path=f"/{prim}"))
    parts = [(f"part_{number:02d}", part, *felt) for number, part in enumerate(body.parts)]
    meshes = [
        _USD_MESH.format(
            name=name,
            schemas=schemas,
            counts=", ".join(["3"] * len(mesh.faces)),
            faces=", ".join(map(str, mesh.faces.ravel().tolist())),
            points=", ".join(f"({_text(row, ', ')})" for row in mesh.vertices_m),
            collision=collision,
        )
        for name, mesh, schemas, collision in [("visual", body.mesh, "", ""), *parts]
    ]
    return _USD.format(
        prim=prim,
        mass=_text((body.mass_kg,)),
        center=_text(body.center_m, ", "),
        moments=_text(moments, ", ", 7),
        axes=_text((w, x, y, z), ", ", 6),  # LAPACK rounds otherwise on other processors
        friction=_text((body.friction,)),
        meshes="".join(meshes),
    ).encode()


def _obj(mesh: Mesh) -> bytes:
    out = io.StringIO()
    for row in np.asarray(mesh.vertices_m, np.float64).tolist():
        out.write("v {:.9g} {:.9g} {:.9g}\n".format(*row))
    for corners in (mesh.faces + 1).tolist():
        out.write("f {} {} {}\n".format(*corners))
    return out.getvalue().encode()


def _text(values: Iterable[Any], between: str = " ", digits: int = 9) -> str:
    return between.join(f"{float(value):.{digits}g}" for value in values)


def _tag(tag: str, /, *children: ElementTree.Element, **attributes: str) -> ElementTree.Element:
    element = ElementTree.Element(tag, attributes)
    element.extend(children)
    return element


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"
