"""3MF files of other programs: read as the specification of 3MF says, or refused with the reason."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, PrintReport, read_mesh
from tactile_toolkit.mesh.files import unpack_mesh
from tests.tactile_toolkit.mesh.solid_files import cube, outcome_of

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
IN_PARTS = f'xmlns:p="{PRODUCTION}" requiredextensions="p"'


def mesh_xml(*meshes: Mesh) -> str:
    vertices, faces, start = "", "", 0
    for mesh in meshes:
        vertices += "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices_mm)
        faces += "".join(
            f'<triangle v1="{a + start}" v2="{b + start}" v3="{c + start}"/>'
            for a, b, c in mesh.faces.tolist()
        )
        start += len(mesh.vertices_m)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"


def package(
    path: Path, resources: str, build: str, head: str = "", unit: str = "millimeter", **files: str
) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
        archive.writestr(
            "3D/3dmodel.model",
            f'<model unit="{unit}" xmlns="{CORE}" {head}><resources>{resources}</resources>'
            f"<build>{build}</build></model>",
        )
    return path


BESIDE = Mesh(cube(10).vertices_m + np.array([0.05, 0, 0]), cube().faces)
ITEM, TWO = '<item objectid="1"/>', f'<object id="1" type="model">{mesh_xml(cube(), BESIDE)}</object>'


def prusa(kind: str) -> dict[str, str]:
    return {
        "Metadata/Slic3r_PE_model.config": '<config><object id="1"><metadata type="object" key="name" '
        'value="a"/><volume firstid="0" lastid="11"><metadata type="volume" key="volume_type" '
        f'value="ModelPart"/></volume><volume firstid="12" lastid="23">{kind}</volume></object></config>'
    }


def volume_type(value: str) -> dict[str, str]:
    return prusa(f'<metadata type="volume" key="volume_type" value="{value}"/>')


@pytest.mark.parametrize("kind", ["ParameterModifier", "SupportBlocker", "SupportEnforcer", "1"])
def test_volumes_of_prusaslicer_that_are_not_the_object(kind: str, tmp_path: Path) -> None:
    files = volume_type(kind)
    if kind == "1":  # of old releases
        files = prusa('<metadata type="volume" key="modifier" value="1"/>')
    mesh = read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **files))
    assert PrintReport.of(mesh).volume_mm3 == pytest.approx(8000)
    assert np.ptp(mesh.bounds_m, axis=0) == pytest.approx([0.02] * 3)
    assert mesh.notes[0].startswith("left out: 1 volume of kind ")
    whole = read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **volume_type("ModelPart")))
    assert (PrintReport.of(whole).bodies, whole.notes) == (2, ())
    with pytest.raises(InputError, match="has a negative volume"):
        read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **volume_type("NegativeVolume")))


@pytest.mark.parametrize(
    ("subtype", "found"),
    [
        ("normal_part", 9000),
        ("modifier_part", 8000),
        ("support_blocker", 8000),
        ("support_enforcer", 8000),
        ("negative_part", "has a negative volume"),
    ],
)
def test_parts_of_bambu_studio(subtype: str, found: float | str, tmp_path: Path) -> None:
    """Bambu Studio stores the parts in a model of their own, and their purpose in a file of settings."""
    parts = f'<object id="1">{mesh_xml(cube())}</object><object id="2">{mesh_xml(BESIDE)}</object>'
    files = {
        "3D/Objects/object_1.model": f'<model unit="millimeter" xmlns="{CORE}"><resources>{parts}</resources>'
        "<build/></model>",
        "Metadata/model_settings.config": '<config><object id="8"><metadata key="name" value="a"/>'
        f'<part id="1" subtype="normal_part"/><part id="2" subtype="{subtype}"/></object></config>',
    }
    path = 'p:path="/3D/Objects/object_1.model"'
    whole = f'<object id="8" type="model"><components><component {path} objectid="1"/>'
    whole += f'<component {path} objectid="2"/></components></object>'
    outcome = outcome_of(package(tmp_path / "a.3mf", whole, '<item objectid="8"/>', IN_PARTS, **files))
    assert found in outcome if isinstance(found, str) else outcome == pytest.approx(found)


@pytest.mark.parametrize("kind", ["support", "solidsupport", "other", "surface"])
def test_objects_of_other_types_are_left_out(kind: str, tmp_path: Path) -> None:
    two = (
        f'<object id="1">{mesh_xml(cube())}</object><object id="2" type="{kind}">{mesh_xml(BESIDE)}</object>'
    )
    mesh = read_mesh(package(tmp_path / "a.3mf", two, f'{ITEM}<item objectid="2"/>'))
    assert PrintReport.of(mesh).volume_mm3 == pytest.approx(8000)
    assert mesh.notes == (f"left out: 1 object of type {kind!r}",)
    with pytest.raises(InputError, match="holds nothing to build"):
        read_mesh(package(tmp_path / "a.3mf", two, '<item objectid="2"/>'))
    twice = read_mesh(package(tmp_path / "a.3mf", two, f'{ITEM}<item objectid="1" printable="0"/>'))
    assert twice.notes == ("left out: 1 object not to be printed",)
    assert PrintReport.of(twice).bodies == 1


@pytest.mark.parametrize(
    ("head", "inside", "words"),
    [
        ('xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" requiredextensions="b"',
         "", "beamlattice/2017"),
        ('requiredextensions="sc"', "", "requires the extension 'sc'"),
        ('xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" requiredextensions="m"',
         "", ""),
        ('xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"',
         "<b:beamlattice/>", "holds a beamlattice"),
    ],
)  # fmt: skip
def test_extensions_of_3mf(head: str, inside: str, words: str, tmp_path: Path) -> None:
    one = f'<object id="1">{mesh_xml(cube()).replace("</mesh>", inside + "</mesh>")}</object>'
    outcome = outcome_of(package(tmp_path / "a.3mf", one, ITEM, head))
    assert words in str(outcome)
    if not words:
        assert outcome == pytest.approx(8000)


@pytest.mark.parametrize(
    ("resources", "build", "words"),
    [
        (TWO + TWO, ITEM, "has several objects '1'"),
        (TWO, "", "holds nothing to build$"),
        (TWO, '<item objectid="9"/>', "holds no object '9'"),
        (TWO.replace('x="10', 'x="10,', 1), ITEM, "is not a number; expected one such as"),
        (TWO.replace('x="10', 'x="ten', 1), ITEM, "is not a number"),
        (TWO.replace('x="10', 'x="1_0', 1), ITEM, "is not a number"),
        (TWO.replace('v1="1"', 'v1="1.5"', 1), ITEM, "'1.5' is not a number; expected an integer"),
    ],
)
def test_errors_in_3mf_files_are_named(resources: str, build: str, words: str, tmp_path: Path) -> None:
    """lib3mf refuses them, too, or reads another solid."""
    with pytest.raises(InputError, match=words):
        read_mesh(package(tmp_path / "a.3mf", resources, build))


def test_relations_name_the_root_model(tmp_path: Path) -> None:
    model = f'<model unit="millimeter" xmlns="{CORE}"><resources><object id="1">{mesh_xml(BESIDE)}</object>'
    model += f"</resources><build>{ITEM}</build></model>"
    relation = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    for target, found in (("/part/real.model", 1000), ("/3D/3dmodel.model", 8000)):
        relations = (
            '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
            f'<Relationship Target="{target}" Id="r" Type="{relation}"/></Relationships>'
        )
        files = {"part/real.model": model, "_rels/.rels": relations}
        path = package(tmp_path / "a.3mf", f'<object id="1">{mesh_xml(cube())}</object>', ITEM, **files)
        assert outcome_of(path) == pytest.approx(found)
    files["_rels/.rels"] = relations.replace("3dmodel.model", "none.model")
    with pytest.raises(InputError, match=r"holds no model /3d/none\.model"):
        read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **files))


TETRAHEDRON = (
    '<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/>'
    '<vertex x="0" y="1" z="0"/><vertex x="0" y="0" z="1"/></vertices><triangles>'
    '<triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/><triangle v1="0" v2="3" v3="2"/>'
    '<triangle v1="1" v2="2" v3="3"/></triangles></mesh></object>'
)


@pytest.mark.parametrize(
    ("unit", "mm"), [("millimeter", 1), ("inch", 25.4), ("meter", 1000), ("micron", 0.001)]
)
def test_a_model_is_read_in_its_own_unit(unit: str, mm: float, tmp_path: Path) -> None:
    path = package(tmp_path / "a.3mf", TETRAHEDRON, ITEM, unit=unit)
    found = unpack_mesh(path.read_bytes(), ".3mf")
    assert np.ptp(found.bounds_m, axis=0) == pytest.approx([mm / 1000] * 3)


def test_components_and_items_are_placed(tmp_path: Path) -> None:
    pair = (
        '<object id="2"><components><component objectid="1"/>'
        '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 -5 0 0"/></components></object>'
    )
    item = '<item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 7"/>'
    mesh = read_mesh(package(tmp_path / "pair.3mf", TETRAHEDRON + pair, item))
    report = PrintReport.of(mesh)
    assert (report.is_solid, report.bodies) == (True, 2)
    assert report.volume_mm3 == pytest.approx(2 * 8 / 6)
    assert mesh.bounds_m * 1000 == pytest.approx(np.array([[-12, 0, 7], [2, 2, 9]]))


def with_parts(path: Path, component: str, **units: str) -> Path:
    """Write a file as Bambu Studio does: objects are in models of their own, here each in its unit."""
    body = TETRAHEDRON.replace('x="1"', 'x="2"').replace('y="1"', 'y="2"').replace('z="1"', 'z="2"')
    parts = {
        f"3D/Objects/{name}.model": f'<model unit="{unit}" xmlns="{CORE}"><resources>{body}</resources>'
        "<build/></model>"
        for name, unit in units.items()
    }
    whole = f'<object id="2" type="model"><components>{component}</components></object>'
    item = '<item objectid="2" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
    return package(path, whole, item, IN_PARTS, **parts)


def test_objects_in_models_of_their_own_are_found(tmp_path: Path) -> None:
    component = '<component p:path="/3D/Objects/a.model" objectid="1" transform="1 0 0 0 1 0 0 0 1 0 5 0"/>'
    found = read_mesh(with_parts(tmp_path / "a.3mf", component, a="millimeter", b="inch"))
    assert found.bounds_m * 1e3 == pytest.approx(np.array([[10, 5, 0], [12, 7, 2]]))
    assert PrintReport.of(found).is_solid


A_MODEL = 'p:path="/3D/Objects/a.model"'


@pytest.mark.parametrize(
    ("component", "unit", "words"),
    [
        # lib3mf uses the unit of the root for all models; in the specification, each model has its own.
        (
            f"{A_MODEL} objectid='1'",
            "centimeter",
            r"/3d/objects/a\.model is in cm, and /3d/3dmodel\.model in mm",
        ),
        (
            'p:path="/3D/Objects/none.model" objectid="1"',
            "millimeter",
            "holds no object '1' of /3d/objects/none.model",
        ),
        ('p:path="../../../../etc/passwd" objectid="1"', "millimeter", "holds no"),
        (f'{A_MODEL} objectid="9"', "millimeter", "holds no object '9' of /3d/objects/a.model"),
        ('p:path="/3D/3dmodel.model" objectid="2"', "millimeter", "holds itself"),
        ('objectid="2"', "millimeter", "holds itself"),
    ],
)
def test_components_that_cannot_be_placed_are_named(component, unit, words, tmp_path):
    with pytest.raises(InputError, match=words):
        read_mesh(with_parts(tmp_path / "a.3mf", f"<component {component}/>", a=unit))


def test_packages_without_a_model_or_with_invalid_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.3mf"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
    with pytest.raises(InputError, match=r"a\.3mf.*holds no \.model file"):
        read_mesh(path)
    with pytest.raises(InputError, match=r"a\.3mf: not a readable 3MF file"):
        read_mesh(package(path, TETRAHEDRON.replace('v1="1"', f'v1="{2**32}"'), ITEM))
