"""The command ``export``."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

import mnist3d
from tactile_toolkit.mesh import check_manifold, read_mesh
from tests import command_line
from tests.tactile_toolkit.toy import folder_bytes

call = command_line.call


def test_one_file_per_object(digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("tactile", "export", digits_set, "--split", "test", "--out", tmp_path / "out") == 0
    printed = capsys.readouterr()
    assert f"10 files in {tmp_path / 'out'}" in printed.out
    assert "each read back as a solid" in printed.out
    assert "writing: 10 of 10" in printed.err
    files = sorted((tmp_path / "out").iterdir())
    assert [path.name.split("-")[:2] for path in files] == [["test", label] for label in "0123456789"]
    assert all(check_manifold(read_mesh(path)).problem is None for path in files)


def test_other_formats_and_scales(digits_set: Path, tmp_path: Path) -> None:
    """``printing/test_singles.py`` tests that each format is read back."""
    choice = ("--split", "test", "--labels", "3", "--quiet")
    assert call("tactile", "export", digits_set, *choice, "--out", tmp_path / "stl") == 0
    options = ("--format", "ply", "--scale", "1.5", "--out", tmp_path / "ply")
    assert call("tactile", "export", digits_set, *choice, *options) == 0
    (stl,), (ply,) = (list((tmp_path / name).iterdir()) for name in ("stl", "ply"))
    assert ply.suffix == ".ply"
    sizes = [np.ptp(read_mesh(path).bounds_m, axis=0) for path in (stl, ply)]
    assert sizes[1] == pytest.approx(sizes[0] * 1.5, rel=1e-4)


def test_bodies_have_the_density_and_the_friction_asked_for(digits_set: Path, tmp_path: Path) -> None:
    digits = mnist3d.load(digits_set, "test")
    (digit,) = digits[digits.labels == 3]
    material = ("--density-kg-m3", 500, "--friction", 0.25)
    documents = {}
    for ending, suffix in (("mjcf", "xml"), ("urdf", "urdf")):
        out = tmp_path / ending
        options = ("--ids", digit.id, *material, "--format", ending, "--out", out, "-q")
        assert call("tactile", "export", digits_set, *options) == 0
        (file,) = out.rglob(f"*.{suffix}")
        documents[ending] = ElementTree.parse(file)
    exact = digit.mesh.copy()
    exact.density = 500
    (inertial,), (mass,), (turning,), (contact,) = (
        documents[ending].iter(tag)
        for ending, tag in (
            ("mjcf", "inertial"), ("urdf", "mass"), ("urdf", "inertia"), ("urdf", "lateral_friction"),
        )
    )  # fmt: skip
    axes = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
    for mass_kg, moments in (
        (inertial.attrib["mass"], inertial.attrib["fullinertia"].split()),
        (mass.attrib["value"], [turning.attrib[name] for name in axes]),
    ):
        assert float(mass_kg) == pytest.approx(exact.mass, rel=1e-3)
        inertia = [exact.moment_inertia[axis] for axis in axes.values()]
        assert list(map(float, moments)) == pytest.approx(inertia, rel=1e-3, abs=1e-4 * max(inertia))
    frictions = {geom.get("friction", "none").split()[0] for geom in documents["mjcf"].iter("geom")} - {
        "none"
    }
    assert {contact.attrib["value"], *frictions} == {"0.25"}


def test_all_splits_ids_and_json(
    digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("tactile", "export", digits_set, "--out", tmp_path, "--json", "--quiet") == 0
    document = json.loads(capsys.readouterr().out)
    assert {file["split"] for file in document["files"]} == {"test", "holdout"}
    assert {file["file"] for file in document["files"]} == {path.name for path in tmp_path.iterdir()}
    assert document["failed"] == []
    some = document["files"][3]["id"]
    assert call("tactile", "export", digits_set, "--ids", some, "--out", tmp_path, "--json", "--quiet") == 0
    (file,) = json.loads(capsys.readouterr().out)["files"]
    assert (file["id"], file["state"]) == (some, "kept")


def test_plates(digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--split", "test", "--plate", "130x130", "--gap-mm", "2", "--out", tmp_path)
    assert call("tactile", "export", digits_set, *options) == 0
    printed = capsys.readouterr()
    assert "wrote 10 objects on" in printed.out
    assert "plates.csv lists where each object lies" in printed.out
    for stage in ("measuring: 10 of 10", "writing:"):
        assert stage in printed.err
    with (tmp_path / "plates.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert sorted(row["label"] for row in rows) == list("0123456789")
    assert {row["file"] for row in rows} == {path.name for path in tmp_path.glob("*.3mf")}
    before = folder_bytes(tmp_path)
    assert call("tactile", "export", digits_set, *options, "--json", "--quiet") == 0
    document = json.loads(capsys.readouterr().out)
    assert {plate["state"] for plate in document["plates"]} == {"kept"}
    assert [row["name"] for row in document["objects"]] == [row["name"] for row in rows]
    assert folder_bytes(tmp_path) == before


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("plate", [(), ("--plate", "200x200")])
def test_dry_run_writes_nothing(
    plate: tuple[str, ...], digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert call("tactile", "export", digits_set, *plate, "--limit", "2", "--out", out, "--dry-run") == 0
    printed = capsys.readouterr().out
    assert "would write 4" in printed
    assert "nothing was written" in printed
    assert not out.exists()


def test_other_files_are_refused_unless_overwritten(
    digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("tactile", "export", digits_set, "--limit", "1", "--out", tmp_path, "--quiet")
    assert call(*options) == 0
    before = folder_bytes(tmp_path)
    assert call(*options, "--scale", "2") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert folder_bytes(tmp_path) == before
    assert call(*options, "--scale", "2", "--overwrite") == 0
    assert folder_bytes(tmp_path) != before


@pytest.mark.thorough
def test_broken_meshes_are_named_and_the_rest_is_written(
    digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A data set of others, in which one mesh has a hole."""
    import pyarrow as pa
    from pyarrow import parquet

    (source,) = (digits_set / "data").glob("test-*.parquet")
    table = parquet.ParquetFile(source).read(use_threads=False)
    faces = table.column("mesh.faces").to_pylist()
    faces[4] = faces[4][3:]
    column = table.schema.get_field_index("mesh.faces")
    kind = table.schema.field(column)
    broken = table.set_column(column, kind, pa.array(faces, kind.type))
    parquet.write_table(broken, tmp_path / "broken.parquet")
    name = f"train-{table['label'][4].as_py()}-{table['id'][4].as_py():05d}"
    for plate in ((), ("--plate", "250x250")):
        out = tmp_path / f"out{len(plate)}"
        assert call("tactile", "export", tmp_path / "broken.parquet", *plate, "--out", out) == 1
        printed = capsys.readouterr()
        assert "not-manifold" in printed.err
        assert "9 files" in printed.out if not plate else "wrote 9 objects" in printed.out
        assert f"failed: {name}" in printed.err


def test_tables_for_other_libraries(
    digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import datasets
    import pandas as pd
    import polars

    out = tmp_path / "flat"
    words = ("--format", "flat", "--out", out, "--workers", "1", "--json", "-q")
    assert call("tactile", "export", digits_set, *words) == 0
    made = json.loads(capsys.readouterr().out)["splits"]
    assert {split: facts["rows"] for split, facts in made.items()} == {"test": 10, "holdout": 10}
    digits = mnist3d.load(digits_set, split="test")
    plain = ["id", "label", "label_name", "writer", "volume_m3", "source", "size_x_m", "size_y_m", "size_z_m"]
    frame = pd.read_parquet(out / "data" / "test-00000-of-00001.parquet")
    assert list(frame.columns) == [*plain, "mesh"]
    table = polars.read_parquet(out / "data" / "test-*.parquet")
    assert table.drop("mesh").to_dicts() == frame.drop(columns="mesh").to_dict("records")
    rows = datasets.load_dataset(str(out), split="test")
    assert isinstance(rows.features["mesh"], datasets.Mesh)
    assert rows.features["label"].names == list(digits.label_names)
    assert frame.label_name.tolist() == [digits.label_names[label] for label in digits.labels]
    for digit, row, file in zip(digits, rows, frame.mesh, strict=True):
        assert (row["id"], row["label"], row["volume_m3"]) == (digit.id, digit.label, digit.volume_m3)
        stored = trimesh.load_mesh(io.BytesIO(file["bytes"]), file_type="glb")
        for mesh in (stored, row["mesh"].to_mesh()):
            x, up, back = np.asarray(mesh.vertices).T  # glTF has y up, and -z points away
            np.testing.assert_array_equal(np.stack([x, -back, up], axis=1), digit.vertices_m)
            np.testing.assert_array_equal(mesh.faces, digit.faces)
        size = [row[name] for name in ("size_x_m", "size_y_m", "size_z_m")]
        np.testing.assert_allclose(size, digit.mesh.extents)


@pytest.mark.thorough
def test_tables_are_a_data_set_folder(
    digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "flat"
    words = ("tactile", "export", digits_set, "--format", "flat", "--out", out, "--workers", "1", "-q")
    assert call(*words) == 0
    before = folder_bytes(out)
    assert {"README.md", "manifest.json", "previews/tables.png"} <= set(before)
    for command, *further in (("verify",), ("card",), ("info", "--json")):
        assert call("tactile", command, out, *further) == 0, capsys.readouterr().err
    assert folder_bytes(out) == before, "card and checks agree with the export"
    assert '"operation": "export"' in capsys.readouterr().out
    card = before["README.md"].decode()
    assert "license: mit" in card, "as drawn digits are"
    assert "MIT, as the toolkit: the data set contains no one's handwriting." in card
    table = out / "data" / "holdout-00000-of-00001.parquet"
    table.write_bytes(table.read_bytes()[:-9])
    assert call("tactile", "verify", out) == 3
    assert "holdout-00000-of-00001.parquet: sha256 is" in capsys.readouterr().err
    assert call(*words) == 0
    assert folder_bytes(out) == before
    assert call("mnist3d", "validate", out) == 2
    assert "was made by `export` for other programs" in capsys.readouterr().err


@pytest.mark.thorough
def test_scenes_keep_the_positions_of_objects(tmp_path: Path) -> None:
    import datasets

    import starstruck_gen

    scenes = tmp_path / "scenes"
    making = ("--scenes", "train=3", "--workers", "1", "--quiet", "--out", scenes)
    assert command_line.call("starstruck", "generate", *making) == 0
    out = tmp_path / "flat"
    assert command_line.call("tactile", "export", scenes, "--format", "flat", "--out", out, "-q") == 0
    rows = datasets.load_dataset(str(out), split="train")
    for row, scene in zip(rows, starstruck_gen.load(scenes, split="train"), strict=True):
        stored = [(entry["shape"], entry["x_m"], entry["y_m"]) for entry in row["placements"]]
        assert stored == [(placed.shape, placed.x_m, placed.y_m) for placed in scene.placements]
        assert row["star_count"] == scene.star_count
        assert row["mesh"].to_mesh().volume == pytest.approx(scene.mesh.volume, rel=1e-6)
    assert command_line.call("tactile", "verify", out) == 0
    assert command_line.call("tactile", "info", out) == 0
    wrench = tmp_path / "wrench"
    assert command_line.call("env-assets", "wrench", "--out", wrench, "-q") == 0
    tables = ("--format", "flat", "--out", tmp_path / "wrenches", "-q")
    assert command_line.call("tactile", "export", wrench, *tables) == 0
    assert command_line.call("tactile", "verify", tmp_path / "wrenches") == 0


@pytest.mark.thorough
def test_the_plate_for_calibration_is_one_solid_whose_shapes_have_their_stated_sizes(
    digits_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--split", "test", "--calibration-plate", "--out", tmp_path / "plate")
    assert call("tactile", "export", digits_set, *options, "--format", "3mf", "--json") == 0
    (made,) = json.loads(capsys.readouterr().out)["files"]
    names = {"calibration-plate.3mf", "calibration-plate.png", "press-here.md"}
    assert {path.name for path in (tmp_path / "plate").iterdir()} == names == set(made["files"])
    mesh = read_mesh(tmp_path / "plate" / "calibration-plate.3mf")
    verdict = check_manifold(mesh)
    assert verdict.problem is None
    assert verdict.bodies == 1
    assert np.ptp(mesh.bounds_m, axis=0)[:2] * 1e3 == pytest.approx([116, 100], abs=1e-3)
    shape = trimesh.Trimesh(mesh.vertices_m * 1e3, mesh.faces)

    def heights_mm(points: list[tuple[float, float]]) -> list[float]:
        rays = np.column_stack([points, np.full(len(points), 50.0)])
        points_mm, ray, _ = shape.ray.intersects_location(rays, np.tile([0.0, 0, -1], (len(points), 1)))
        return [points_mm[ray == number, 2].max() for number in range(len(points))]

    # A ball of 4 mm on the left; treads of 0.8 mm on the right; flanks of 30 and 60 degrees; the base.
    assert heights_mm([(-42, -34), (-40, -34)]) == pytest.approx([12, 8 + np.sqrt(12)], abs=0.01)
    assert np.diff(heights_mm([(38, -34), (42, -34), (46, -34)])) == pytest.approx(0.8, abs=1e-3)
    left, higher, right, lower = heights_mm([(10, -33), (12, -33), (18, -33), (18.5, -33)])
    assert (higher - left) / 2 == pytest.approx(np.tan(np.radians(30)), abs=1e-3)
    assert (right - lower) / 0.5 == pytest.approx(np.tan(np.radians(60)), abs=2e-3)
    assert heights_mm([(0, -10)]) == pytest.approx([4], abs=1e-3)
    sheet = (tmp_path / "plate" / "press-here.md").read_text()
    assert sheet.count("\n| 20 | ") == 1
    # Other options are refused.
    for wrong in (("--format", "flat"), ("--plate", "256x256"), ("--scale", "2"), ("--limit", "1")):
        assert call("tactile", "export", digits_set, *options, *wrong) == 2
