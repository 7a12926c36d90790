"""Build plates: each object is on one once, apart from others, named, and where the table says."""

from __future__ import annotations

import csv
import io
import itertools
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, check_manifold
from tactile_toolkit.mesh.threemf import BuildItem, read_build, write_build
from tactile_toolkit.pictures import Pen
from tactile_toolkit.printing.exports import write_plates
from tactile_toolkit.printing.file_export import PrintObject
from tactile_toolkit.printing.plate_layouts import PlacedObject, PlateLayout, arrange, draw_map
from tactile_toolkit.printing.print_options import BEDS_MM, PlateSpec
from tests.tactile_toolkit.printing.solids import box, ell, mesh_of, named, ring
from tests.tactile_toolkit.toy import folder_bytes

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
FEW = [ell(40, 9), ring(20, 14), box(20, 12), ell(30, 12), box(8, 50), ring(11, 5), box(13, 13)]
SMALL = PlateSpec(100, 80, 3.0, 0.0)


def lay_out(objects: list[PrintObject], spec: PlateSpec, scale: float = 1.0) -> PlateLayout:
    return arrange(objects, spec, scale)


def solid_of(placed: PlacedObject) -> Any:
    return placed.item.on_plate().to_manifold().translate(placed.offset_mm)


def require_apart(solids: list[Any], gap_mm: float) -> None:
    for one, other in itertools.combinations(solids, 2):
        assert one.min_gap(other, gap_mm + 1) >= gap_mm - 1e-6


@st.composite
def meshes(draw: st.DrawFn) -> list[Mesh]:
    side = st.floats(1, 40)
    one = st.one_of(
        st.builds(box, side, side),
        st.builds(lambda s, share: ell(s, s * share), side, st.floats(0.1, 0.9)),
        st.builds(lambda r, share: ring(r, r * share), st.floats(2, 20), st.floats(0.1, 0.9)),
    )
    return draw(st.lists(one, min_size=1, max_size=9))


@settings(max_examples=settings.default.max_examples // 5)
@given(shapes=meshes(), gap_mm=st.sampled_from([0.0, 0.7, 3.0, 5.5]), margin_mm=st.sampled_from([0.0, 8.3]))
def test_objects_keep_the_gap_the_pose_and_to_the_plate(shapes, gap_mm, margin_mm):
    spec = PlateSpec(106.5, 77, gap_mm, margin_mm)
    layout = lay_out(named(shapes), spec)
    placed = [item for plate in layout.plates for item in plate]
    assert sorted(item.item.id for item in placed) == list(range(len(shapes)))
    assert max(layout.shares) <= 1 + 1e-9
    for plate in layout.plates:
        solids = [solid_of(item) for item in plate]
        require_apart(solids, gap_mm)
        for thing in solids:
            low_x, low_y, low_z, high_x, high_y, _ = thing.bounding_box()
            assert low_x >= margin_mm - 1e-6
            assert low_y >= margin_mm - 1e-6
            assert high_x <= spec.width_mm - margin_mm + 1e-6
            assert high_y <= spec.depth_mm - margin_mm + 1e-6
            assert low_z == pytest.approx(0, abs=1e-9)
        boxes = np.array([thing.bounding_box() for thing in solids])
        middle_mm = (boxes[:, :2].min(axis=0) + boxes[:, 3:5].max(axis=0)) / 2
        assert middle_mm == pytest.approx((spec.width_mm / 2, spec.depth_mm / 2), abs=1e-6)
    for item, shape in ((item, shapes[item.item.id]) for item in placed):
        # Moved, neither turned nor mirrored.
        moved = np.asarray(item.item.on_plate().vertices_m)
        assert moved - moved[0] == pytest.approx(shape.vertices_m - shape.vertices_m[0], abs=1e-12)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("plate", "shape"),
    [
        ("256x256", (1320, 1320)),
        ("1000x70", (400, 4120)),
        ("70x1000", (4120, 400)),
        ("5x5", (1320, 1320)),
        ("10000x10000", (4120, 4120)),
    ],
)
def test_pixels_of_maps_grow_with_the_plate(plate: str, shape: tuple[int, int]) -> None:
    spec = PlateSpec.parse(plate, margin_mm=0)
    picture = np.asarray(Image.open(io.BytesIO(draw_map(PlateLayout(spec, 1.0, ((),)), 1))).convert("L"))
    assert picture.shape[0] == shape[0]
    title_px = Pen.text_size(f"plate 1 of 1: 0 objects, {spec.text}", 40)[0] / 2
    assert picture.shape[1] == pytest.approx(max(shape[1], title_px + 120), abs=2)
    # The plate is paper with lines on it, not only lines.
    middle = picture[60 : shape[0] - 60, 60 : shape[1] - 60]
    assert (middle > 235).mean() > 0.8


def written_on(monkeypatch: pytest.MonkeyPatch, layout: PlateLayout) -> list[str]:
    """Return all texts on the map of the first plate."""
    written: list[str] = []
    write = Pen.write

    def noted(*arguments: Any, **options: Any) -> None:
        written.append(arguments[2])
        write(*arguments, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Pen, "write", noted)
        draw_map(layout, 1)
    return written


@pytest.mark.thorough
def test_words_that_have_no_room_are_left_out_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    written = written_on(monkeypatch, lay_out(named([box(1.5, 1.5)] * 40), PlateSpec(256, 256, 0.5, 0.0)))
    assert written[:26] == [f"{at_mm}" for at_mm in range(0, 256, 20)] * 2
    *words, foot, title = written[26:]
    shown = len(words) // 2
    assert 0 < shown < 40
    assert f"; {40 - shown} without words, for want of space: plates.csv lists them" in foot
    assert title == "plate 1 of 1: 40 objects, 256 x 256 mm, gap 0.5 mm, margin 0 mm"
    assert {*zip(words[::2], words[1::2], strict=True)} < {
        (f"{number % 3}", f"{number}") for number in range(40)
    }


def test_words_on_a_map_name_the_split_where_ids_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    maps = []
    for other in (named([box(40, 40)], "train"), named([box(40, 40)] * 2, "train")[1:]):
        layout = lay_out([*named([box(40, 40)]), *other], SMALL)
        maps.append(written_on(monkeypatch, layout))
    assert maps[0].count("train") == maps[0].count("test") == 1
    assert not {"train", "test"} & set(maps[1])


def test_objects_move_from_where_they_are_stored_to_their_place() -> None:
    stored = [box(40, 20), ell(30, 6), box(10, 50)]
    moved = [
        Mesh(mesh.vertices_m + np.array((0.07, -0.02, 0), np.float32) * number, mesh.faces)
        for number, mesh in enumerate(stored)
    ]
    ((*plate,),) = lay_out(named(moved), SMALL).plates
    assert len(plate) == 3
    for placed in plate:
        now_mm = 1000 * moved[placed.item.id].vertices_m + placed.offset_mm
        np.testing.assert_allclose(now_mm.min(axis=0), (placed.x_mm, placed.y_mm, 0), atol=1e-3)


@pytest.mark.parametrize(
    ("shape", "spec", "words"),
    [
        (box(101, 10), SMALL, "it needs 101.0 x 10.0 mm, the plate has 100 x 80 mm;"),
        (box(10, 80.1), SMALL, "it needs 10.0 x 80.1 mm"),
        (box(10, 90), SMALL, "it needs 10.0 x 90.0 mm"),
        (box(90, 10), PlateSpec(100, 80), "the plate has 100 x 80 mm less 7 mm at each edge"),
        (box(10, 70), PlateSpec(100, 80), "next: give a larger --plate, a smaller --margin-mm or --scale"),
    ],
)
def test_objects_larger_than_the_plate_are_named(shape, spec, words, tmp_path):
    objects = named([box(5, 5), shape])
    with pytest.raises(InputError, match="test-1-00001 does not fit on the plate") as caught:
        lay_out(objects, spec)
    assert words in str(caught.value)
    assert len(lay_out(objects, spec, scale=0.5).plates[0]) == 2


def test_a_plate_has_a_millimetre_within_its_margins_at_least() -> None:
    assert PlateSpec(1, 1, 0, 0).inner_mm == (1, 1)
    assert PlateSpec(15, 21).inner_mm == (1, 7)
    for sides_mm in ((14.9, 21), (21, 14.9)):
        with pytest.raises(InputError, match="and 1 mm left of the plate"):
            PlateSpec(*sides_mm)


def test_what_fits_one_side_only_fits_that_side() -> None:
    for spec in (SMALL, PlateSpec(114, 94)):
        ((placed,),) = lay_out(named([box(99, 10)]), spec).plates
        assert (placed.x_mm, placed.y_mm) == pytest.approx((spec.width_mm / 2 - 49.5, spec.depth_mm / 2 - 5))


def test_beds_have_names() -> None:
    assert PlateSpec.parse("Prusa-MK4") == PlateSpec(250, 210)
    assert PlateSpec() == PlateSpec.parse("bambu-a1"), "unless it is said, the commonest printers"
    # `bed_exclude_area` of Bambu's X1 and P1 is 0x0, 18x0, 18x28, 0x28.
    assert PlateSpec.parse("bambu-x1").corner_mm == PlateSpec.parse("bambu-p1").corner_mm == (18, 28)
    assert PlateSpec.parse("bambu-a1").corner_mm == PlateSpec(256, 256).corner_mm == (0, 0)
    assert PlateSpec.parse("250x210", gap_mm=1, margin_mm=0) == PlateSpec(250, 210, 1, 0)
    # As stated by the makers.
    sides = {"bambu-a1-mini": 180, "bambu-a1": 256, "bambu-p1": 256, "bambu-x1": 256, "ender-3": 220}
    assert {name: BEDS_MM[name] for name in sides} == {name: (side, side) for name, side in sides.items()}
    with pytest.raises(InputError, match=r"expected .* prusa-mk4, .*; did you mean 'prusa-mk4'\?"):
        PlateSpec.parse("prusa-mk5")


@pytest.mark.parametrize("margin_mm", [-1.0, 49.6, float("nan"), float("inf")])
def test_margins_that_leave_no_plate_are_refused(margin_mm: float) -> None:
    with pytest.raises(InputError, match="margin_mm "):
        PlateSpec(100, 100, 3, margin_mm)


@pytest.mark.parametrize("text", ["256", "256x", "ax3", "1e3x5", "-5x5", "5x5x5", ""])
def test_plates_of_another_form_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="plate is"):
        PlateSpec.parse(text)


@pytest.mark.parametrize(
    ("plate", "gap_mm"), [("0x5", 3), ("99999x5", 3), ("5x5", -1), ("5x5", float("nan"))]
)
def test_plates_and_gaps_that_no_printer_has_are_refused(plate: str, gap_mm: float) -> None:
    with pytest.raises(InputError, match="expected"):
        PlateSpec.parse(plate, gap_mm=gap_mm)


def test_a_plate_holds_named_objects_at_the_positions_of_the_table(tmp_path: Path) -> None:
    made = write_plates(lay_out(named(FEW), SMALL), str(tmp_path))
    rows = list(csv.DictReader(io.StringIO((tmp_path / "plates.csv").read_text())))
    assert sorted(int(row["id"]) for row in rows) == list(range(len(FEW)))
    assert len(made.objects) == len(rows)
    names = {path.name for path in tmp_path.iterdir()}
    numbers = range(1, len(made.files) + 1)
    assert names == {"plates.csv", *(f"plate-{n:02d}.{kind}" for n in numbers for kind in ("3mf", "png"))}
    for plate in made.files:
        mine = [row for row in rows if row["file"] == plate.file]
        items = read_build((tmp_path / plate.file).read_bytes()).items
        assert [item.name for item in items] == [row["name"] for row in mine]
        for item, row in zip(items, mine, strict=True):
            low, high = item.mesh.bounds_m * 1e3
            found = (low[0], low[1], high[0] - low[0], high[1] - low[1])
            columns = ("x_mm", "y_mm", "width_mm", "depth_mm")
            assert found == pytest.approx([float(row[column]) for column in columns], abs=1e-3)
            verdict = check_manifold(item.mesh)
            assert verdict.problem is None
            assert verdict.volume_mm3 == pytest.approx(float(row["volume_mm3"]), abs=2e-3)
            assert high[2] == pytest.approx(float(row["height_mm"]), abs=1e-3)


def test_the_model_keeps_to_the_core_specification(tmp_path: Path) -> None:
    write_plates(lay_out(named(FEW[:3]), SMALL), str(tmp_path))
    with zipfile.ZipFile(tmp_path / "plate-01.3mf") as archive:
        assert archive.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]
        root = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
    assert root.tag == f"{CORE}model"
    assert root.get("unit") == "millimeter"
    objects = {element.get("id"): element for element in root.iter(f"{CORE}object")}
    assert len(objects) == 3
    for identity, element in objects.items():
        assert int(identity or 0) > 0
        for triangle in element.iter(f"{CORE}triangle"):
            assert len({triangle.get(corner) for corner in ("v1", "v2", "v3")}) == 3
    for item in root.iter(f"{CORE}item"):
        assert objects[item.get("objectid")].find(f"{CORE}mesh") is not None
        matrix = [float(number) for number in (item.get("transform") or "1 0 0 0 1 0 0 0 1 0 0 0").split()]
        assert matrix[:9] == [1, 0, 0, 0, 1, 0, 0, 0, 1]
        assert matrix[11] == 0


@pytest.mark.parametrize("name", ["a", "<&\"'>", "ä 七"])
def test_names_come_back_as_they_were(name: str) -> None:
    shape = box(2, 3, 4)
    (back,) = read_build(write_build([BuildItem(name, shape, (7.0, 8.0, 0.5))])).items
    assert back.name == name
    assert back.mesh.vertices_mm.min(axis=0).tolist() == [7, 8, 0.5]


def test_the_map_shows_every_object_where_it_lies(tmp_path: Path) -> None:
    layout = lay_out(named(FEW), SMALL)
    write_plates(layout, str(tmp_path))
    for number, plate in enumerate(layout.plates, 1):
        picture = np.asarray(Image.open(tmp_path / f"plate-{number:02d}.png").convert("RGB")).astype(int)
        px_per_mm = 1200 / 100
        assert picture.shape == (round(80 * px_per_mm) + 120, 1200 + 120, 3)
        empty = np.array([0xF4, 0xF2, 0xEC])
        for placed in plate:
            for ring_mm in placed.outline.rings:
                x, y = ring_mm.T + np.array([[placed.x_mm], [placed.y_mm]])
                rows, columns = 60 + (80 - y) * px_per_mm, 60 + x * px_per_mm
                seen = picture[rows.astype(int).clip(0, 1079), columns.astype(int).clip(0, 1319)]
                # Outlines are drawn dark.
                assert (seen.sum(axis=1) < 650).all()
        assert (np.abs(picture - empty).sum(axis=2) < 12).mean() > 0.1


@pytest.mark.thorough
def test_going_on_keeps_plates_and_overwriting_leaves_no_stale_ones(tmp_path: Path) -> None:
    many, few = lay_out(named([*FEW, *FEW]), SMALL), lay_out(named(FEW[:2]), SMALL)
    out = str(tmp_path)
    write_plates(many, out)
    whole = folder_bytes(tmp_path)
    (tmp_path / "plate-01.3mf").unlink()
    (tmp_path / "plates.csv").unlink()
    made = write_plates(many, out)
    assert made.files[0].state == "written"
    assert {plate.state for plate in made.files[1:]} <= {"kept"}
    assert folder_bytes(tmp_path) == whole
    with pytest.raises(InputError, match="--overwrite"):
        write_plates(few, out)
    assert folder_bytes(tmp_path) == whole
    for name in ("mine.txt", "plate-2024.png", "plate-77.3mf"):
        (tmp_path / name).write_text("keep")
    view = write_plates(few, out, overwrite=True, dry_run=True)
    made = write_plates(few, out, overwrite=True)
    assert "plate-02.3mf" in made.removed
    assert made.removed == view.removed
    assert {path.name for path in tmp_path.iterdir()} == {
        *("mine.txt", "plate-2024.png", "plate-77.3mf"),
        "plates.csv",
        "plate-01.3mf",
        "plate-01.png",
    }


@pytest.mark.parametrize("sides_mm", [(500, 5), (5, 500)])
def test_a_plate_that_reads_back_otherwise_is_removed_and_not_in_the_table(sides_mm, tmp_path):
    """An object that changes between measuring and writing is not where it should be."""
    shapes = iter([box(5, 5), *[box(*sides_mm)] * 9])
    layout = lay_out([PrintObject("odd", "", "", 1, lambda: next(shapes))], SMALL)
    (tmp_path / "plate-01.png").write_bytes(b"old")
    made = write_plates(layout, str(tmp_path), overwrite=True)
    (failure,) = made.failed
    assert (failure.name, failure.problem) == ("plate-01.3mf", "off-plate")
    assert "odd reaches beyond the plate or its margin" in failure.detail
    assert made.objects == ()
    assert [path.name for path in tmp_path.iterdir()] == ["plates.csv"]


def test_a_dry_run_names_existing_files(tmp_path: Path) -> None:
    write_plates(lay_out(named(FEW), SMALL), str(tmp_path))
    with pytest.raises(InputError, match="--overwrite"):
        write_plates(lay_out(named(FEW[:2]), SMALL), str(tmp_path), dry_run=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        write_plates(lay_out(named(FEW), SMALL), str(tmp_path / "file"), overwrite=True, dry_run=True)
    (tmp_path / "folders" / "plates.csv").mkdir(parents=True)
    with pytest.raises(InputError, match=r"plates.csv': Is a directory"):
        write_plates(lay_out(named(FEW), SMALL), str(tmp_path / "folders"), dry_run=True)


def test_bodies_that_lie_apart_stay_together() -> None:
    pair = manifold3d.Manifold.cube((5, 5, 5)) + manifold3d.Manifold.cube((5, 5, 5)).translate((20, 0, 3))
    ((placed,),) = lay_out(named([mesh_of(pair)]), SMALL).plates
    assert placed.outline.size_mm == pytest.approx((25, 5))
    assert len(placed.outline.rings) == 2


def test_no_label_becomes_a_formula(tmp_path: Path) -> None:
    (thing,) = named([box(10, 10)])
    made = write_plates(lay_out([replace(thing, label="=1+1")], SMALL), str(tmp_path))
    table = (tmp_path / "plates.csv").read_text(encoding="utf-8")
    (row,) = csv.DictReader(table.splitlines())
    assert (row["label"], made.objects[0]["label"]) == ("'=1+1", "=1+1")
