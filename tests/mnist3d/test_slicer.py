"""PrusaSlicer loads the files of this toolkit and slices them without repairs."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import mnist3d
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.catalog import RowFilter
from tactile_toolkit.mesh import Mesh, write_mesh
from tactile_toolkit.printing import ExportOptions
from tactile_toolkit.printing.exports import export_files, write_plates
from tactile_toolkit.printing.file_export import objects_of
from tactile_toolkit.printing.plate_layouts import PlacedObject, arrange
from tactile_toolkit.printing.print_options import PlateSpec
from tests.command_line import call
from tests.mnist3d.drawn_pictures import child, house, word
from tests.processes import PATIENCE_S

SLICER = shutil.which("prusa-slicer") or ""
pytestmark = [
    pytest.mark.slicer,
    pytest.mark.skipif(not SLICER, reason="PrusaSlicer's command line is not installed"),
]

LAYER_MM = 0.35
PLATE_MM = 200
PRINT = (
    *("--layer-height", str(LAYER_MM), "--first-layer-height", str(LAYER_MM), "--skirts", "0"),
    *("--fill-density", "0%", "--top-solid-layers", "0", "--bottom-solid-layers", "0", "--perimeters", "1"),
    *("--bed-shape", f"0x0,{PLATE_MM}x0,{PLATE_MM}x{PLATE_MM},0x{PLATE_MM}", "--gcode-label-objects"),
)


def slicer(*arguments: object) -> str:
    done = subprocess.run(
        [SLICER, *map(str, arguments)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@dataclass(frozen=True)
class Seen:
    """Report of the slicer about one object."""

    size_mm: tuple[float, ...]
    low_mm: tuple[float, ...]
    volume_mm3: float
    complaints: tuple[str, ...]


def seen_in(path: Path) -> list[Seen]:
    """Read ``--info``: sizes, and every line that it has only for meshes that need repair."""
    objects = []
    for block in slicer("--info", path).split(f"[{path.name}]")[1:]:
        values = dict(re.findall(r"^(\w+) = +(\S+)", block, re.MULTILINE))
        known = {"manifold", "number_of_facets", "number_of_parts", "volume"}
        known |= {f"{kind}_{axis}" for kind in ("size", "min", "max") for axis in "xyz"}
        complaints = [f"{name} = {value}" for name, value in values.items() if name not in known]
        complaints += [] if values["manifold"] == "yes" else [f"manifold = {values['manifold']}"]
        size_mm, low_mm = (
            tuple(float(values[f"{kind}_{axis}"]) for axis in "xyz") for kind in ("size", "min")
        )
        objects.append(Seen(size_mm, low_mm, float(values["volume"]), tuple(complaints)))
    return objects


def repairs_in(path: Path, work: Path) -> dict[str, tuple[int, ...]]:
    """Let the slicer write the loaded objects: its file states the repairs of each."""
    slicer("--export-3mf", "--dont-arrange", "-o", work / "again.3mf", path)
    with zipfile.ZipFile(work / "again.3mf") as archive:
        root = ElementTree.fromstring(archive.read("Metadata/Slic3r_PE_model.config"))
    return {
        next(
            entry.get("value", "") for entry in element.iter("metadata") if entry.get("key") == "name"
        ): tuple(int(count) for mesh in element.iter("mesh") for count in mesh.attrib.values())
        for element in root.iter("object")
    }


@dataclass(frozen=True)
class Sliced:
    """Work of the printer."""

    top_mm: dict[str, float]
    low_mm: tuple[float, float]
    high_mm: tuple[float, float]


def slice_file(path: Path, work: Path, *options: str) -> Sliced:
    target = work / f"{path.stem}.gcode"
    told = slicer("--export-gcode", *PRINT, *options, "-o", target, path)
    assert "Slicing result exported" in told
    for complaint in ("repair", "warning", "error", "open edges", "not manifold"):
        assert complaint not in told.lower(), told
    return _followed(target.read_text())


def _followed(gcode: str) -> Sliced:
    """Follow the nozzle: height of the last layer of each object, and how far plastic reaches."""
    z_mm, name, tops, points = 0.0, "", {}, []
    for line in gcode.splitlines():
        if line.startswith("; printing object "):
            name = line.removeprefix("; printing object ").rsplit(" id:", 1)[0]
        elif line.startswith(";Z:"):
            z_mm = float(line[3:])
        elif match := re.match(r"G1 X(\S+) Y(\S+) E", line):
            points.append((float(match[1]), float(match[2])))
            if name:  # a skirt is not part of an object
                tops[name] = max(tops.get(name, 0.0), z_mm)
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    return Sliced(tops, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])))


@pytest.fixture(scope="module")
def digits(tmp_path_factory: pytest.TempPathFactory) -> mnist3d.DigitDataset:
    folder = str(tmp_path_factory.mktemp("slicer") / "digits")
    spec = mnist3d.DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=2_000), per_class=1)
    mnist3d.generate(spec, folder, ("printed_test",))
    return mnist3d.load(folder, "printed_test")


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["stl", "3mf"])
def test_one_digit_of_each_class_loads_whole_and_in_size(kind, digits, tmp_path):
    made = export_files(
        objects_of(RowFilter.ALL.choose([("printed_test", digits)])), str(tmp_path), ExportOptions(kind)
    )
    assert sorted(file.label for file in made.files) == list("0123456789")
    for file in made.files:
        (seen,) = seen_in(tmp_path / file.file)
        assert seen.complaints == ()
        assert seen.size_mm == pytest.approx(file.size_mm, abs=2e-3)
        assert seen.low_mm[2] == 0
        assert seen.volume_mm3 == pytest.approx(file.volume_mm3, rel=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["stl", "3mf"])
def test_a_digit_slices_up_to_its_height_without_a_repair(kind, digits, tmp_path):
    (file,) = export_files(
        objects_of(RowFilter(labels=["8"]).choose([("printed_test", digits)])),
        str(tmp_path),
        ExportOptions(kind),
    ).files
    path = tmp_path / file.file
    sliced = slice_file(path, tmp_path)
    (top_mm,) = sliced.top_mm.values()
    assert top_mm == pytest.approx(file.size_mm[2], abs=LAYER_MM)
    reach = np.subtract(sliced.high_mm, sliced.low_mm)
    # The nozzle runs half a thread inside the outline.
    assert reach == pytest.approx(file.size_mm[:2], abs=0.7)
    (counts,) = repairs_in(path, tmp_path).values()
    assert set(counts) == {0}


def write_plate(
    digits: mnist3d.DigitDataset, labels: str, folder: Path
) -> tuple[tuple[PlacedObject, ...], Path]:
    spec = PlateSpec(PLATE_MM, PLATE_MM, 3.0)
    layout = arrange(objects_of(RowFilter(labels=list(labels)).choose([("printed_test", digits)])), spec)
    write_plates(layout, str(folder))
    (plate,) = layout.plates
    return plate, folder / "plate-01.3mf"


@pytest.mark.thorough
def test_a_plate_loads_with_every_name_in_its_place(digits: mnist3d.DigitDataset, tmp_path: Path) -> None:
    plate, path = write_plate(digits, "0123456789", tmp_path)
    seen = seen_in(path)
    boxes = [(placed.x_mm, placed.y_mm, *placed.outline.size_mm, placed.height_mm) for placed in plate]
    found = [(*one.low_mm[:2], *one.size_mm) for one in seen]
    assert sorted(found) == [pytest.approx(box, abs=2e-3) for box in sorted(boxes)]
    assert all(one.complaints == () for one in seen)
    repairs = repairs_in(path, tmp_path)
    assert set(repairs) == {placed.item.name for placed in plate}
    assert {count for counts in repairs.values() for count in counts} == {0}


@pytest.mark.thorough
@pytest.mark.parametrize(
    "shape", [(), ("--base-mm", 2), ("--bridge-mm", 3)], ids=["plain", "base", "bridges"]
)
@pytest.mark.parametrize("draw", [word, child, house])
def test_a_drawing_slices_after_one_command(draw: Callable[[], Any], shape: Any, tmp_path: Path) -> None:
    draw().save(tmp_path / "drawing.jpg")
    out = tmp_path / "drawing.3mf"
    assert call("mnist3d", "solidify", tmp_path / "drawing.jpg", "--out", out, "--height-mm", 60, *shape) == 0
    (seen,) = seen_in(out)
    assert seen.complaints == ()
    assert seen.size_mm[1] == pytest.approx(60 + 6 * ("--base-mm" in shape), abs=0.01)
    (top_mm,) = slice_file(out, tmp_path).top_mm.values()
    assert top_mm == pytest.approx(seen.size_mm[2], abs=LAYER_MM)
    (counts,) = repairs_in(out, tmp_path).values()
    assert set(counts) == {0}


@pytest.mark.thorough
def test_the_check_sees_a_broken_file(digits: mnist3d.DigitDataset, tmp_path: Path) -> None:
    """The assertions above fail for a surface from which three triangles are missing."""
    whole = Mesh.of(digits[0]).on_plate()
    write_mesh(tmp_path / "broken.stl", Mesh(whole.vertices_m, whole.faces[3:]))
    (seen,) = seen_in(tmp_path / "broken.stl")
    assert "manifold = no" in seen.complaints
    assert any(complaint.startswith("open_edges") for complaint in seen.complaints)
