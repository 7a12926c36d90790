"""3MF files of other programs: read as the specification of 3MF says, or refused with the reason."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, inspect, read_mesh
from tests.tactile_toolkit.mesh.solid_files import cube, outcome_of

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"


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


def package(path: Path, resources: str, build: str, head: str = "", **files: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
        archive.writestr(
            "3D/3dmodel.model",
            f'<model unit="millimeter" xmlns="{CORE}" {head}><resources>{resources}</resources>'
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
    assert inspect(mesh).volume_mm3 == pytest.approx(8000)
    assert np.ptp(mesh.bounds_m, axis=0) == pytest.approx([0.02] * 3)
    assert mesh.notes[0].startswith("left out: 1 volume of kind ")
    whole = read_mesh(package(tmp_path / "a.3mf", TWO, ITEM, **volume_type("ModelPart")))
    assert (inspect(whole).bodies, whole.notes) == (2, ())
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
    production = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
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
    head = f'xmlns:p="{production}" requiredextensions="p"'
    outcome = outcome_of(package(tmp_path / "a.3mf", whole, '<item objectid="8"/>', head, **files))
    assert found in outcome if isinstance(found, str) else outcome == pytest.approx(found)


@pytest.mark.parametrize("kind", ["support", "solidsupport", "other", "surface"])
def test_objects_of_other_types_are_left_out(kind: str, tmp_path: Path) -> None:
    two = (
        f'<object id="1">{mesh_xml(cube())}</object><object id="2" type="{kind}">{mesh_xml(BESIDE)}</object>'
    )
    mesh = read_mesh(package(tmp_path / "a.3mf", two, f'{ITEM}<item objectid="2"/>'))
    assert inspect(mesh).volume_mm3 == pytest.approx(8000)
    assert mesh.notes == (f"left out: 1 object of type {kind!r}",)
    with pytest.raises(InputError, match="holds nothing to build"):
        read_mesh(package(tmp_path / "a.3mf", two, '<item objectid="2"/>'))
    twice = read_mesh(package(tmp_path / "a.3mf", two, f'{ITEM}<item objectid="1" printable="0"/>'))
    assert twice.notes == ("left out: 1 object not to be printed",)
    assert inspect(twice).bodies == 1


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
