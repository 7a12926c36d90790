"""From a picture to a print: any drawing, in the requested size, as a printable solid."""

from __future__ import annotations

import json
import math
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy import ndimage

import mnist3d
from mnist3d.ink.binarisation import join_bodies, stroke_width_px, thinnest_stroke_px
from mnist3d.sources import SyntheticSource
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import Mesh, PrintReport, check_manifold, with_flat_underside
from tactile_toolkit.mesh.printability import WARNINGS
from tests.command_line import call
from tests.mnist3d.drawn_pictures import child, house, pieces, size_mm, word
from tests.pages import ROOT

# --- its size -------------------------------------------------------------------------------------


def test_the_size_does_not_depend_on_the_form_of_the_picture(tmp_path: Path) -> None:
    word().save(tmp_path / "word.png")
    kinds = {
        "path": tmp_path / "word.png",
        "text": str(tmp_path / "word.png"),
        "PIL": word(),
        "RGB": np.asarray(word()),
        "floats": np.asarray(word()) / 255,
        "RGBA": np.asarray(word().convert("RGBA")),
        "grey": np.asarray(word().convert("L")),
    }
    made = {name: mnist3d.solidify(picture) for name, picture in kinds.items()}
    sizes = {name: size_mm(mesh) for name, mesh in made.items()}
    assert call("mnist3d", "solidify", tmp_path / "word.png", "--out", tmp_path / "word.stl") == 0
    sizes["command"] = size_mm(mnist3d.read_mesh(tmp_path / "word.stl"))
    # 800 px are 100 mm; the ink is 322 px wide and 241 px high.
    for name, found in sizes.items():
        assert found[:2] == pytest.approx((322 / 8, 241 / 8), abs=0.3), name
    for name in ("PIL", "RGB", "RGBA"):
        assert np.array_equal(made[name].vertices_m, made["path"].vertices_m), name


@pytest.mark.parametrize(
    ("size", "axis", "length_mm"),
    [({"height_mm": 60.0}, 1, 60), ({"width_mm": 25.0}, 0, 25), ({"pixel_mm": 0.2}, 1, 48.2)],
)
@pytest.mark.parametrize("draw", [word, child])
def test_the_solid_is_as_large_as_was_asked(draw, size, axis, length_mm):
    if draw is child and "pixel_mm" in size:
        length_mm = 98.2
    mesh = mnist3d.solidify(draw(), **size)
    assert PrintReport.of(mesh).is_solid
    # Pixels of paper beside the ink do not count; lengths are those of the solid.
    assert size_mm(mesh)[axis] == pytest.approx(length_mm, abs=0.3 if "pixel_mm" in size else 1e-3)
    if "pixel_mm" not in size:
        middle = mesh.bounds_m.mean(axis=0)[:2] * 1000
        assert middle == pytest.approx((0, 0), abs=1e-3)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("side_px", [70, 800])
@pytest.mark.parametrize("spec", [None, mnist3d.SolidSpec(profile="flat")])
def test_rough_pictures_and_sharp_corners_have_the_size_that_was_asked_for(side_px, spec, tmp_path):
    corners = Image.new("L", (800, 800), 255)
    ImageDraw.Draw(corners).polygon([(400, 60), (740, 740), (60, 740)], fill=0)
    small = corners.resize((side_px, side_px))
    on_plate = mnist3d.solidify(small, spec, height_mm=40, base_mm=2)
    assert size_mm(mnist3d.solidify(small, spec, height_mm=40))[1] == pytest.approx(40, abs=1e-3)
    assert size_mm(on_plate)[1] == pytest.approx(46, abs=1e-3)
    small.save(tmp_path / "corners.png")
    for ending in ("stl", "3mf"):
        out = tmp_path / f"corners.{ending}"
        assert call("mnist3d", "solidify", tmp_path / "corners.png", "--out", out, "--width-mm", 40) == 0
        assert size_mm(mnist3d.read_mesh(out))[0] == pytest.approx(40, abs=1e-2)


def test_a_digit_of_a_data_set_is_the_digit_of_solidify() -> None:
    pixels = SyntheticSource().image(7).pixels
    one, other = mnist3d.solidify(pixels), mnist3d.solidify(pixels, mnist3d.SolidSpec(), ink="dark")
    assert np.array_equal(one.vertices_m, other.vertices_m)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"height_mm": 60, "width_mm": 60}, "two sizes are given, height_mm and width_mm"),
        ({"height_mm": -1}, "height_mm of the size of the solid is -1"),
        ({"base_mm": 0}, "base_mm is 0"),
        ({"threshold": "some"}, "threshold is 'some'; expected one of auto, local, global"),
        ({"ink": "blue"}, "ink is 'blue'"),
        ({"width_mm": 1e5}, "the solid would be"),
    ],
)
def test_impossible_solids_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        mnist3d.solidify(word(), **options)


@pytest.mark.parametrize("shape", [(9, 9, 2), (9, 9, 5), (9, 9, 9, 3)])
def test_arrays_that_are_no_picture_are_named(shape: tuple[int, ...]) -> None:
    with pytest.raises(ItemError, match="shape"):
        mnist3d.solidify(np.zeros(shape, np.uint8))


# --- one piece ------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [8, 22, 40])
def test_bridges_are_as_wide_as_the_strokes(width: int) -> None:
    ink = np.asarray(word(width).convert("L")) < 128
    assert stroke_width_px(ink) == pytest.approx(width, rel=0.15)
    assert thinnest_stroke_px(ink) <= stroke_width_px(ink)
    joined = join_bodies(ink, 1000)
    assert pieces(joined) == 1
    bridges = ndimage.binary_dilation(joined & ~ink, iterations=1)
    deepest = ndimage.distance_transform_edt(bridges).max()
    assert 2 * deepest <= width + 4
    # A requested width is a maximum.
    narrow = join_bodies(ink, width / 2)
    assert np.count_nonzero(narrow & ~ink) < 0.8 * np.count_nonzero(joined & ~ink)


def test_a_base_plate_joins_the_parts_and_lies_flat() -> None:
    plain = mnist3d.solidify(word(), mnist3d.SolidSpec(), width_mm=90)
    on_plate = mnist3d.solidify(word(), mnist3d.SolidSpec(), width_mm=90, base_mm=2)
    before, after = PrintReport.of(plain), PrintReport.of(on_plate)
    assert (before.bodies, after.bodies, after.is_solid) == (5, 1, True)
    assert "separate-bodies" in before.warnings
    assert not {"separate-bodies", "small-contact", "overhang"} & set(after.warnings)
    # 3 mm around the solid, round corners of 2 mm.
    assert size_mm(on_plate)[:2] == pytest.approx(size_mm(plain)[:2] + 6, abs=1e-3)
    width, depth, height = size_mm(on_plate)
    assert height == pytest.approx(2 + size_mm(plain)[2] / 2, abs=1e-3)
    assert after.contact_mm2 == pytest.approx(width * depth - (4 - math.pi) * 4, rel=1e-3)
    half = check_manifold(plain).volume_mm3 / 2
    assert after.volume_mm3 == pytest.approx(2 * after.contact_mm2 + half, rel=2e-3)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("further", [("--thickness-mm", 5, "--edge-profile", "linear"), ()])
def test_all_parts_of_a_drawing_stand_on_the_plate(
    further: Any, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    monkeypatch.setattr("mnist3d.picture_prints._MANY_TRIANGLES", 1_000)
    house().save(tmp_path / "house.png")
    out = tmp_path / "house.stl"
    command = ("mnist3d", "solidify", tmp_path / "house.png", "--out", out, "--height-mm", 60, *further)
    assert call(*command) == 0
    found = check_manifold(mnist3d.read_mesh(out))
    assert found.lows_mm == (0.0,) * 6
    assert size_mm(mnist3d.read_mesh(out))[1:] == pytest.approx((60, 5 if further else 8), abs=1e-3)
    # The walls add no slivers, and even parts have few triangles.
    triangles = len(mnist3d.read_mesh(out).faces)
    assert triangles < 60_000
    assert f"it has {triangles:,} triangles, which slow slicers down; --vert" in capsys.readouterr().out
    assert not {"overhang", "small-contact", "floating-part"} & set(
        PrintReport.of(mnist3d.read_mesh(out)).warnings
    )
    assert call("mnist3d", "validate", out) == 0
    assert "--" not in capsys.readouterr().out.replace("---", "")


def test_parts_in_the_air_are_told_with_their_heights(tmp_path: Path, capsys: Any) -> None:
    solid = mnist3d.solidify(house(), mnist3d.SolidSpec(min_speck_mm2=0.5), height_mm=60)
    lows_mm = check_manifold(solid).lows_mm
    assert lows_mm[0] == 0
    assert 0.1 < lows_mm[1] < lows_mm[5] < 4
    mnist3d.write_mesh(tmp_path / "house.stl", solid)
    assert call("mnist3d", "validate", tmp_path / "house.stl") == 0
    heights = ", ".join(f"{low_mm:.2f}" for low_mm in lows_mm[1:])
    printed = " ".join(capsys.readouterr().out.split())
    assert f"floating-part: 5 of 6 parts begin above the plate, at {heights} mm; next: " in printed


def test_a_base_plate_needs_a_solid() -> None:
    plain = mnist3d.solidify(SyntheticSource().image(7).pixels)
    with pytest.raises(ItemError):
        with_flat_underside(Mesh(plain.vertices_m, plain.faces[1:]), 2.0)


# --- the command ----------------------------------------------------------------------------------


def test_a_folder_of_pictures_makes_a_file_each_and_names_what_failed(tmp_path: Path, capsys: Any) -> None:
    folder, out = tmp_path / "mine", tmp_path / "prints"
    folder.mkdir()
    word().save(folder / "word.jpg")
    Image.new("L", (300, 300), 255).save(folder / "empty.png")
    two = [word(width).convert("L").resize((400, 200)) for width in (20, 40)]
    two[0].save(folder / "pages.tif", save_all=True, append_images=two[1:])
    arguments = ("solidify", folder, "--out", out, "--format", "3mf", "--preview", "--json", "-w", 1)
    assert call("mnist3d", *arguments) == 1
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    names = ["pages-1.3mf", "pages-2.3mf", "word.3mf"]
    assert [each["file"] for each in document["files"]] == names
    assert [each["problem"] for each in document["failed"]] == ["no-ink"]
    assert "failed: empty: " in printed.err
    for each in document["files"]:
        report = PrintReport.of(mnist3d.read_mesh(out / each["file"]))
        assert report.volume_mm3 == pytest.approx(each["volume_mm3"], rel=1e-5)
        with Image.open(out / each["file"].replace(".3mf", "-preview.png")) as preview:
            assert preview.size[0] > 1000
    written = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert call("mnist3d", *arguments) == 1  # kept
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()} == written


def test_each_warning_has_a_measured_value_and_a_next_step(tmp_path: Path, capsys: Any) -> None:
    word(8).save(tmp_path / "word.png")
    out = tmp_path / "word.stl"
    assert call("mnist3d", "solidify", tmp_path / "word.png", "--out", out, "--height-mm", 10) == 0
    printed = capsys.readouterr().out
    for name in ("thin-wall", "separate-bodies", "small-contact"):
        assert f"word.stl: {name}: " in printed
        assert f"(see docs/warnings.md#{name})" in printed
    assert "--base-mm 2" in printed
    # A file of another size has other content.
    again = ("solidify", tmp_path / "word.png", "--out", out, "--height-mm", 40)
    assert call("mnist3d", *again) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (
        call("mnist3d", *again, "--overwrite", "--base-mm", 2, "--thickness-mm", 3, "--edge-profile", "flat")
        == 0
    )
    assert "the drawing is 51.1 x 40.0 mm, and its base plate is larger" in capsys.readouterr().out
    found = PrintReport.of(mnist3d.read_mesh(out))
    assert (found.bodies, found.warnings) == (1, ())
    assert found.size_mm[1:] == pytest.approx((46, 5), abs=0.3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("no.png",), "there is no such file"),
        (("a.png", "a.png", "--out", "x.stl"), "--out is the file 'x.stl', but there are 2 pictures"),
        (("a.png", "b/a.png"), "two pictures would make 'a.stl'"),
        (("a.png", "--out", "x.gcode"), "expected a folder, or a file that ends in .stl"),
        (("b",), "it holds 'notes.txt'; expected pictures only"),
    ],
)
def test_names_that_cannot_be_used_are_named(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "b").mkdir()
    word().save("a.png")
    word().save("b/a.png")
    (tmp_path / "b" / "notes.txt").touch()
    assert call("mnist3d", "solidify", *arguments) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("*.stl"))


def test_no_picture_and_no_other_file_is_replaced(tmp_path: Path, capsys: Any) -> None:
    source, preview = tmp_path / "a.png", tmp_path / "b-preview.png"
    word().save(source)
    word(30).save(preview)
    before = source.read_bytes(), preview.read_bytes()
    arguments = ("solidify", source, "--out", tmp_path / "a.stl", "--preview", "--overwrite")
    assert call("mnist3d", *arguments) == 0
    assert (tmp_path / "a-preview.png").is_file()
    assert call("mnist3d", "solidify", preview, "--out", tmp_path / "b.stl", "--preview", "--overwrite") == 2
    assert "is a picture and would be replaced" in capsys.readouterr().err
    # Patterns of a shell are valid names.
    (tmp_path / "a1.stl").write_bytes(b"another")
    source.rename(tmp_path / "a[1].png")
    Image.new("L", (90, 90), 255).save(tmp_path / "a*.png")
    names = [tmp_path / "a[1].png", tmp_path / "a*.png"]
    assert call("mnist3d", "solidify", *names, "--out", tmp_path, "--overwrite") == 1
    assert (tmp_path / "a1.stl").read_bytes() == b"another"
    assert PrintReport.of(mnist3d.read_mesh(tmp_path / "a[1].stl")).is_solid
    assert ((tmp_path / "a[1].png").read_bytes(), preview.read_bytes()) == before


def test_light_strokes_on_a_dark_board(tmp_path: Path) -> None:
    board = Image.eval(word(), lambda level: 255 - level)
    plain, found = mnist3d.solidify(word()), mnist3d.solidify(board)
    assert np.allclose(size_mm(found), size_mm(plain), atol=0.1)
    board.save(tmp_path / "board.png")
    out = tmp_path / "board.stl"
    assert call("mnist3d", "solidify", tmp_path / "board.png", "--foreground", "light", "--out", out) == 0
    assert np.allclose(size_mm(mnist3d.read_mesh(out)), size_mm(plain), atol=0.1)


# --- warnings -------------------------------------------------------------------------------------


def test_every_warning_has_a_section_and_a_cure() -> None:
    page = (ROOT / "docs" / "warnings.md").read_text(encoding="utf-8")
    headings = [line.removeprefix("## ") for line in page.splitlines() if line.startswith("## ")]
    assert headings == list(WARNINGS)
    assert [line.partition(":")[0] for line in mnist3d.PrintReport.advice(WARNINGS)] == list(WARNINGS)


def test_walls_need_two_lines_of_the_nozzle() -> None:
    assert mnist3d.PrintProfile().min_wall_mm == 0.8
    assert mnist3d.PrintProfile(nozzle_mm=0.6).min_wall_mm == pytest.approx(1.2)
    assert mnist3d.PrintProfile(nozzle_mm=0.6, min_wall_mm=0.9).min_wall_mm == 0.9
    with pytest.raises(InputError, match="nozzle_mm"):
        mnist3d.PrintProfile(nozzle_mm="thin")  # type: ignore[arg-type]


def test_a_wider_nozzle_finds_thinner_walls(tmp_path: Path, capsys: Any) -> None:
    wall = mnist3d.solidify(word(8), mnist3d.SolidSpec(profile="flat"), pixel_mm=0.2)
    mnist3d.write_mesh(tmp_path / "wall.stl", wall)
    width = PrintReport.of(wall).thinnest_wall_mm
    for nozzle_mm, is_thin in ((width / 2 - 0.05, False), (width / 2 + 0.05, True)):
        assert call("mnist3d", "validate", tmp_path / "wall.stl", "--nozzle-mm", nozzle_mm) == 0
        assert ("thin-wall" in capsys.readouterr().out) is is_thin


def test_digits_with_a_small_first_layer_are_cured_by_a_plate(tmp_path: Path) -> None:
    source = SyntheticSource()
    digits = (mnist3d.solidify(source.image(number).pixels) for number in range(0, 1400, 70))
    thin = islice((digit for digit in digits if "small-contact" in PrintReport.of(digit).warnings), 2)
    assert [PrintReport.of(with_flat_underside(digit, 2.0)).warnings for digit in thin] == [(), ()]
