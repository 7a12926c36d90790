"""From a picture to a print: any drawing, at the size that was asked for, as a solid that prints."""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage

import mnist3d
from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.ink.bridges import join_bodies, stroke_width_px, thinnest_stroke_px
from mnist3d.solid import SizedInk, SolidSize, sized_ink
from mnist3d.sources import FolderSource, SyntheticSource
from mnist3d.sources.picture_files import decode_page
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import WARNINGS, Mesh, as_mesh, check_manifold, inspect, on_base_plate, print_advice
from tests.command_line import call, program
from tests.pages import ROOT

PEN = (15, 15, 40)
SUN, WALL, GRASS = (255, 165, 0), (255, 235, 150), (60, 170, 60)


def word(width: int = 22) -> Image.Image:
    """Handwriting of five pieces: an l, two i with their dots."""
    picture = Image.new("RGB", (800, 400), "white")
    draw = ImageDraw.Draw(picture)
    for x, top in ((200, 80), (350, 180), (500, 180)):
        draw.line([(x, top), (x, 320)], fill=PEN, width=width)
    for x in (350, 500):
        draw.ellipse([x - width / 2, 120 - width / 2, x + width / 2, 120 + width / 2], fill=PEN)
    return picture


def child() -> Image.Image:
    """A house with an outline and pale walls, an orange sun, grass: three pieces, all of them filled."""
    picture = Image.new("RGB", (800, 600), "white")
    draw = ImageDraw.Draw(picture)
    draw.ellipse([560, 60, 700, 200], fill=SUN)
    draw.rectangle([120, 250, 380, 480], fill=WALL, outline=(0, 0, 0), width=8)
    draw.rectangle([60, 520, 740, 550], fill=GRASS)
    return picture


def photographed(picture: Image.Image) -> Image.Image:
    """What a phone makes of a page: uneven warm light, noise, blur."""
    page = np.asarray(picture.resize((1200, 900)), float)
    rows, columns = np.mgrid[:900, :1200]
    light = 0.5 + 0.5 * (0.7 * columns / 1200 + 0.3 * rows / 900)
    shot = page * light[..., None] * np.array([0.93, 0.89, 0.82])
    shot += np.random.default_rng(0).normal(0, 3, page.shape)
    blurred = Image.fromarray(np.clip(shot, 0, 255).astype(np.uint8))
    return blurred.filter(ImageFilter.GaussianBlur(1))


def inked(picture: Any, **options: Any) -> SizedInk:
    size = SolidSize(**{name: options.pop(name) for name in list(options) if name.endswith("_mm")})
    return sized_ink(picture, None, size, **options)


def pieces(mask: np.ndarray) -> int:
    return int(ndimage.label(mask, np.ones((3, 3)))[1])


def size_mm(mesh: Mesh) -> np.ndarray:
    return np.ptp(mesh.vertices_m, axis=0) * 1000


# --- what is ink ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seen", [lambda each: each, photographed], ids=["drawing", "photograph"])
def test_a_coloured_drawing_keeps_all_colours(seen: Callable[[Image.Image], Image.Image]) -> None:
    mask = inked(seen(child()), width_mm=100).mask
    assert pieces(mask) == 3
    # House, sun and grass have no holes: pale yellow walls are as much ink as their black outline.
    assert np.array_equal(ndimage.binary_fill_holes(mask), mask)
    whole = 260 * 230 + math.pi * 70**2 + 680 * 30
    rows, columns = np.nonzero(mask)
    share = len(rows) / (np.ptp(rows) + 1) / (np.ptp(columns) + 1)
    assert share == pytest.approx(whole / (680 * 490), rel=0.03)


def test_the_edge_of_black_ink_is_where_grey_levels_have_it() -> None:
    grey = word().convert("L").filter(ImageFilter.GaussianBlur(1.5))
    coloured = grey.convert("RGB")
    ImageDraw.Draw(coloured).ellipse([600, 250, 680, 330], fill=(255, 240, 120))
    plain, found = (inked(each, pixel_mm=0.2).mask for each in (grey.convert("RGB"), coloured))
    left = np.s_[:, :580]
    assert pieces(found) == pieces(plain) + 1
    assert np.count_nonzero(found[left] ^ plain[left]) <= 0.06 * np.count_nonzero(plain[left])


def test_a_transparent_logo_keeps_light_colours() -> None:
    logo = Image.new("RGBA", (400, 400))
    draw = ImageDraw.Draw(logo)
    draw.rectangle([60, 60, 160, 160], fill=(20, 40, 160, 255))
    draw.rectangle([240, 240, 340, 340], fill=(255, 220, 40, 255))
    assert pieces(inked(logo).mask) == 2


@pytest.mark.parametrize("mode", ["RGBA", "RGB", "L"])
def test_a_logo_may_be_mostly_ink(mode: str, tmp_path: Path) -> None:
    logo = Image.new("RGBA", (600, 600), (255, 255, 255, 0))
    ImageDraw.Draw(logo).ellipse([20, 20, 580, 580], fill=(200, 0, 80, 255))
    white = Image.new("RGBA", logo.size, "white")
    picture = logo if mode == "RGBA" else Image.alpha_composite(white, logo).convert(mode)
    mesh = mnist3d.solidify(picture, mnist3d.SolidSpec(profile="flat"), height_mm=40)
    disc_mm2 = math.pi * 20**2
    assert check_manifold(mesh).volume_mm3 == pytest.approx(disc_mm2 * size_mm(mesh)[2], rel=0.03)
    # A channel that is black in most of the picture shows no paper.
    with contextlib.suppress(ItemError):
        mnist3d.solidify(picture, threshold="local")


def test_a_sheet_on_a_light_desk_is_no_logo() -> None:
    sheet = Image.new("RGB", (800, 600), (252, 252, 252))
    sheet.paste((232, 230, 226), (60, 40, 740, 560))
    letter = word().resize((600, 300))
    sheet.paste(Image.fromarray(np.minimum(np.asarray(letter), 230)), (100, 150))
    assert pieces(inked(sheet).mask) == 5


def test_a_photograph_of_a_word_keeps_all_letters_and_dots() -> None:
    assert pieces(inked(photographed(word()), width_mm=100).mask) == 5
    # A source of digits expects one digit.
    with pytest.raises(ItemError, match="digit"):
        mnist3d.ink.even_out(np.asarray(photographed(word()).convert("L")))


def test_small_parts_near_the_edge_of_a_photographed_page_are_kept() -> None:
    page = word()
    ImageDraw.Draw(page).line([(770, 150), (770, 180)], fill=PEN, width=12)  # 3 % of the page from its edge
    desk = Image.new("RGB", (1200, 800), (95, 62, 40))
    desk.paste(page, (200, 200))
    assert pieces(inked(photographed(desk), width_mm=100).mask) == 6


@pytest.mark.parametrize("surroundings", [0, 200])
def test_strokes_that_run_to_the_edge_of_a_photographed_page_are_kept(surroundings: int) -> None:
    page = word()
    draw = ImageDraw.Draw(page)
    draw.line([(0, 370), (800, 370)], fill=PEN, width=16)  # the ground
    at = 775 if surroundings else 790  # up to 1.5 % from the edge of a page on a desk, ink is its edge
    draw.line([(at, 40), (at, 60)], fill=PEN, width=14)
    desk = Image.new("RGB", (800 + 2 * surroundings, 400 + 2 * surroundings), (95, 62, 40))
    desk.paste(page, (surroundings, surroundings))
    mask = inked(photographed(desk), pixel_mm=0.2).mask
    assert pieces(mask) == 7
    columns = np.flatnonzero(mask.any(axis=0))
    scale = 1200 / desk.width
    assert np.ptp(columns) > (800 - 40) * scale * mask.shape[1] / 1200


def test_a_finger_on_a_photographed_page_is_refused() -> None:
    page = word()
    ImageDraw.Draw(page).ellipse([-80, 150, 90, 230], fill=(190, 140, 120))
    with pytest.raises(ItemError, match="reaches the edge of the page; expected paper there"):
        inked(photographed(page))


@pytest.mark.parametrize(
    "corners", [[(600, 0), (800, 0), (800, 120)], [(0, 0), (60, 0), (60, 400), (0, 400)]]
)
def test_what_lies_beside_a_photographed_page_is_no_ink(corners: list[tuple[int, int]]) -> None:
    page = word()
    ImageDraw.Draw(page).polygon(corners, fill=(40, 30, 20))
    assert pieces(inked(photographed(page)).mask) == 5


def test_specks_that_are_left_out_are_counted() -> None:
    dirty = word()
    for x in range(60, 160, 20):
        dirty.putpixel((x, 370), (0, 0, 0))
    assert inked(dirty, width_mm=100).notes == ("left out 5 specks of ink below 4 mm²",)
    assert inked(word(), width_mm=100).notes == ()


def test_a_picture_of_108_megapixels_is_reduced_with_a_note(tmp_path: Path) -> None:
    large = Image.new("L", (12_000, 9_000), 255)
    ImageDraw.Draw(large).line([(3000, 2000), (9000, 2000), (5000, 7000)], fill=10, width=500)
    large.convert("RGB").save(tmp_path / "large.jpg", quality=60)
    found = inked(tmp_path / "large.jpg")
    assert found.notes == ("the picture of 12,000 x 9,000 pixels was reduced to 3,000 x 2,250",)
    small = inked(large.resize((1200, 900)))
    assert found.spec.pixel_pitch_mm == pytest.approx(small.spec.pixel_pitch_mm)
    assert np.count_nonzero(found.mask ^ small.mask) < 0.02 * np.count_nonzero(small.mask)


def test_a_picture_whose_memory_is_not_allowed_is_reduced(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setenv("TACTILE_TOOLKIT_UNPACKED_MIB", "2")
    word().save(tmp_path / "word.png")
    assert decode_page(tmp_path / "word.png", 0).size == (800, 400)  # 3 bytes of RGB fit, 11 would not


# --- its size -------------------------------------------------------------------------------------


def test_the_same_picture_has_the_same_size_however_it_is_given(tmp_path: Path) -> None:
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
    sizes = {name: size_mm(mnist3d.solidify(picture)) for name, picture in kinds.items()}
    assert call("mnist3d", "solidify", tmp_path / "word.png", "--out", tmp_path / "word.stl") == 0
    sizes["command"] = size_mm(mnist3d.read_mesh(tmp_path / "word.stl"))
    # 800 px are 100 mm; the ink is 322 px wide and 241 px high.
    for name, found in sizes.items():
        assert found[:2] == pytest.approx((322 / 8, 241 / 8), abs=0.3), name
    meshes = [mnist3d.solidify(kinds[name]) for name in ("path", "PIL", "RGB", "RGBA")]
    assert all(np.array_equal(mesh.vertices_m, meshes[0].vertices_m) for mesh in meshes)


@pytest.mark.parametrize(
    ("size", "axis", "length_mm"),
    [({"height_mm": 60.0}, 1, 60), ({"width_mm": 25.0}, 0, 25), ({"pixel_mm": 0.2}, 1, 48.2)],
)
@pytest.mark.parametrize("draw", [word, child])
def test_the_solid_is_as_large_as_was_asked(
    draw: Callable[[], Image.Image], size: dict[str, float], axis: int, length_mm: float
) -> None:
    if draw is child and "pixel_mm" in size:
        length_mm = 98.2
    mesh = mnist3d.solidify(draw(), **size)
    assert inspect(mesh).is_solid
    # A pixel of paper beside the ink is no pixel of the solid; a length is that of the solid.
    assert size_mm(mesh)[axis] == pytest.approx(length_mm, abs=0.3 if "pixel_mm" in size else 1e-3)
    if "pixel_mm" not in size:
        middle = mesh.bounds_m.mean(axis=0)[:2] * 1000
        assert middle == pytest.approx((0, 0), abs=1e-3)


@pytest.mark.parametrize("side_px", [70, 800])
@pytest.mark.parametrize("spec", [None, mnist3d.SolidSpec(profile="flat")])
def test_rough_pictures_and_sharp_corners_have_the_size_that_was_asked_for(
    side_px: int, spec: mnist3d.SolidSpec | None, tmp_path: Path
) -> None:
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
def test_what_cannot_be_made_is_named(options: dict[str, Any], message: str) -> None:
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
    # A width that was asked for is the greatest.
    narrow = join_bodies(ink, width / 2)
    assert np.count_nonzero(narrow & ~ink) < 0.8 * np.count_nonzero(joined & ~ink)


def test_a_base_plate_joins_the_parts_and_lies_flat() -> None:
    plain = mnist3d.solidify(word(), width_mm=90)
    on_plate = mnist3d.solidify(word(), width_mm=90, base_mm=2)
    before, after = inspect(plain), inspect(on_plate)
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


def test_a_base_plate_needs_a_solid() -> None:
    plain = mnist3d.solidify(SyntheticSource().image(7).pixels)
    with pytest.raises(ItemError):
        on_base_plate(Mesh(plain.vertices_m, plain.faces[1:]), 2.0)


# --- the command ----------------------------------------------------------------------------------


def test_a_folder_of_pictures_makes_a_file_each_and_names_what_failed(tmp_path: Path, capsys: Any) -> None:
    folder, out = tmp_path / "mine", tmp_path / "prints"
    folder.mkdir()
    word().save(folder / "word.png")
    child().save(folder / "child.jpg")
    Image.new("L", (300, 300), 255).save(folder / "empty.png")
    three = [word(width).convert("L") for width in (20, 30, 40)]
    three[0].save(folder / "pages.tif", save_all=True, append_images=three[1:])
    arguments = ("solidify", folder, "--out", out, "--format", "3mf", "--preview", "--json", "-w", 1)
    assert call("mnist3d", *arguments) == 1
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    names = ["child.3mf", "pages-1.3mf", "pages-2.3mf", "pages-3.3mf", "word.3mf"]
    assert [each["file"] for each in document["files"]] == names
    assert [each["problem"] for each in document["failed"]] == ["no-ink"]
    assert "failed: empty: " in printed.err
    for each in document["files"]:
        report = inspect(mnist3d.read_mesh(out / each["file"]))
        assert report.volume_mm3 == pytest.approx(each["volume_mm3"], rel=1e-5)
        with Image.open(out / each["file"].replace(".3mf", "-preview.png")) as preview:
            assert preview.size[0] > 1000
    written = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert call("mnist3d", *arguments) == 1  # kept
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()} == written


def test_each_warning_says_what_was_found_and_what_to_do(tmp_path: Path, capsys: Any) -> None:
    word(8).save(tmp_path / "word.png")
    out = tmp_path / "word.stl"
    assert call("mnist3d", "solidify", tmp_path / "word.png", "--out", out, "--height-mm", 15) == 0
    printed = capsys.readouterr().out
    for name in ("separate-bodies", "small-contact"):
        assert f"word.stl: {name}: " in printed
        assert f"(see docs/warnings.md#{name})" in printed
    assert "--base-mm 2" in printed
    # Another size is another content.
    again = ("solidify", tmp_path / "word.png", "--out", out, "--height-mm", 40)
    assert call("mnist3d", *again) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (
        call("mnist3d", *again, "--overwrite", "--base-mm", 2, "--thickness-mm", 3, "--edge-profile", "flat")
        == 0
    )
    found = inspect(mnist3d.read_mesh(out))
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
def test_names_that_cannot_be_used_are_named(
    arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
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
    # Names that are patterns for a shell are names.
    (tmp_path / "a1.stl").write_bytes(b"another")
    source.rename(tmp_path / "a[1].png")
    Image.new("L", (90, 90), 255).save(tmp_path / "a*.png")
    names = [tmp_path / "a[1].png", tmp_path / "a*.png"]
    assert call("mnist3d", "solidify", *names, "--out", tmp_path, "--overwrite") == 1
    assert (tmp_path / "a1.stl").read_bytes() == b"another"
    assert inspect(mnist3d.read_mesh(tmp_path / "a[1].stl")).is_solid
    assert ((tmp_path / "a[1].png").read_bytes(), preview.read_bytes()) == before


def test_light_strokes_on_a_dark_board(tmp_path: Path) -> None:
    board = Image.eval(word(), lambda level: 255 - level)
    plain, found = mnist3d.solidify(word()), mnist3d.solidify(board)
    assert np.allclose(size_mm(found), size_mm(plain), atol=0.1)
    board.save(tmp_path / "board.png")
    out = tmp_path / "board.stl"
    assert call("mnist3d", "solidify", tmp_path / "board.png", "--invert", "--out", out) == 0
    assert np.allclose(size_mm(mnist3d.read_mesh(out)), size_mm(plain), atol=0.1)


# --- warnings -------------------------------------------------------------------------------------


def test_every_warning_has_a_section_and_a_cure() -> None:
    page = (ROOT / "docs" / "warnings.md").read_text(encoding="utf-8")
    headings = [line.removeprefix("## ") for line in page.splitlines() if line.startswith("## ")]
    assert headings == list(WARNINGS)
    assert [line.partition(":")[0] for line in print_advice(WARNINGS)] == list(WARNINGS)


def test_walls_need_two_lines_of_the_nozzle() -> None:
    assert mnist3d.PrintProfile().min_wall_mm == 0.8
    assert mnist3d.PrintProfile(nozzle_mm=0.6).min_wall_mm == pytest.approx(1.2)
    assert mnist3d.PrintProfile(nozzle_mm=0.6, min_wall_mm=0.9).min_wall_mm == 0.9
    with pytest.raises(InputError, match="nozzle_mm"):
        mnist3d.PrintProfile(nozzle_mm="thin")  # type: ignore[arg-type]


def test_a_wider_nozzle_finds_thinner_walls(tmp_path: Path, capsys: Any) -> None:
    wall = mnist3d.solidify(word(8), mnist3d.SolidSpec(profile="flat"), pixel_mm=0.2)
    mnist3d.write_mesh(tmp_path / "wall.stl", wall)
    width = inspect(wall).thinnest_wall_mm
    for nozzle_mm, is_thin in ((width / 2 - 0.05, False), (width / 2 + 0.05, True)):
        assert call("mnist3d", "validate", tmp_path / "wall.stl", "--nozzle-mm", nozzle_mm) == 0
        assert ("thin-wall" in capsys.readouterr().out) is is_thin


def test_digits_with_a_small_first_layer_are_cured_by_a_plate(tmp_path: Path) -> None:
    source = SyntheticSource()
    thin = [number for number in range(0, 1400, 70) if _touches_little(source.image(number).pixels)]
    assert thin
    for number in thin[:2]:
        digit = mnist3d.solidify(source.image(number).pixels)
        assert inspect(on_base_plate(digit, 2.0)).warnings == ()


def _touches_little(pixels: np.ndarray) -> bool:
    return "small-contact" in inspect(mnist3d.solidify(pixels)).warnings


# --- data sets of any drawings --------------------------------------------------------------------


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("words")
    for name, draw in (("li", word), ("house", child), ("10", lambda: word(40))):
        for number in range(5):
            (folder / name).mkdir(exist_ok=True)
            draw().save(folder / name / f"p{number}.png")
    photographed(word()).save(folder / "li" / "photo.jpg")
    return folder


def test_folders_are_classes_and_divide_into_train_and_test(words: Path, tmp_path: Path, capsys: Any) -> None:
    catalog = FolderSource(str(words)).catalog()
    assert catalog.class_names == ("10", "house", "li")
    assert np.bincount(catalog.labels).tolist() == [5, 5, 6]
    out = tmp_path / "set"
    options = ("--source", "folder", "--images", words, "--split", "all", "--vertices", 500, "--out", out)
    assert call("mnist3d", "generate", *options) == 0
    told = capsys.readouterr().out
    assert "10: 4, house: 4, li: 5" in told
    assert "separate-bodies: 13" in told
    assert "(--base-mm 2 of `mnist3d export` and `solidify`)" in told
    assert mnist3d.load(out, "train").label_names == ("10", "house", "li")
    rows = [row for split in ("train", "test") for row in mnist3d.load(out, split)]
    assert [len(mnist3d.load(out, split)) for split in ("train", "test")] == [13, 3]
    assert {row.file for row in rows} == {path.relative_to(words).as_posix() for path in words.rglob("*.*")}
    assert all(row.file.startswith(f"{catalog.class_names[row.label]}/") for row in rows)
    # The dots of the letters stay.
    assert {check_manifold(as_mesh(row)).bodies for row in rows if row.label == 2} == {5}
    for command in (("verify", out), ("validate", out), ("card", out)):
        assert call("mnist3d", *command) == 0
    card = (out / "README.md").read_text(encoding="utf-8")
    assert "four fifths" in card
    assert "handwritten digits" not in card
    capsys.readouterr()
    assert call("mnist3d", "generate", *options[:4], "--split", "printed_train", "--out", out) == 2
    assert "expected one of train, test, or all" in capsys.readouterr().err


def test_folders_of_digits_stay_digits(tmp_path: Path) -> None:
    for label in "17":
        (tmp_path / "mine" / label).mkdir(parents=True)
        Image.fromarray(SyntheticSource().image(0).pixels).save(tmp_path / "mine" / label / "a.png")
    source = FolderSource(str(tmp_path / "mine"))
    assert source.catalog().class_names == tuple("0123456789")
    assert source.catalog().labels.tolist() == [1, 7]
    assert "classes" not in source.fingerprint()
    generate(DigitSetSpec(source, mnist3d.SolidSpec(target_vertices=300)), str(tmp_path / "set"))
    digits = mnist3d.load(tmp_path / "set", "train")
    assert sorted(row.file or "" for row in digits) == ["1/a.png", "7/a.png"]


def test_other_sources_store_no_names_of_files(tmp_path: Path) -> None:
    spec = DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=300), limit=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    (digit,) = mnist3d.load(tmp_path / "set", "test")
    assert digit.file is None
    assert "name: file" not in (tmp_path / "set" / "README.md").read_text(encoding="utf-8")


def test_pictures_that_are_added_need_another_command_which_works(
    words: Path, tmp_path: Path, capsys: Any
) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    for folder in (old, new):
        for name in ("10", "house", "li"):
            (folder / name).mkdir(parents=True)
    word().save(old / "li" / "a.png")
    word(30).save(new / "li" / "b.png")

    def make(folder: Path) -> int:
        out = tmp_path / f"{folder.name}-set"
        options = ("--source", "folder", "--images", folder, "--vertices", 500, "--out", out)
        return call("mnist3d", "generate", *options)

    assert (make(old), make(new), make(old)) == (0, 0, 0)
    word(30).save(old / "li" / "b.png")
    capsys.readouterr()
    assert make(old) == 2
    assert "next: to add pictures" in (told := capsys.readouterr().err)
    assert "mnist3d merge OLD NEW --renumber --out BOTH" in told
    sets = (tmp_path / "old-set", tmp_path / "new-set")
    both = tmp_path / "both"
    assert call("mnist3d", "merge", *sets, "--renumber", "--out", both) == 0
    assert [row.file for row in mnist3d.load(both, "train")] == ["li/a.png", "li/b.png"]


def test_select_writes_the_chosen_rows_only(tmp_path: Path, capsys: Any) -> None:
    spec = DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=300), per_class=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    out = tmp_path / "some"
    assert call("mnist3d", "select", tmp_path / "set", "--labels", "3,5", "--out", out) == 0
    whole, some = mnist3d.load(tmp_path / "set", "test"), mnist3d.load(out, "test")
    chosen = [row for row in whole if row.label in (3, 5)]
    assert [row.id for row in some] == [row.id for row in chosen]
    assert all(np.array_equal(a.vertices_m, b.vertices_m) for a, b in zip(some, chosen, strict=True))
    assert call("mnist3d", "verify", out) == 0
    assert call("mnist3d", "select", tmp_path / "set", "--out", tmp_path / "no") == 2
    assert "expected filters such as --ids" in capsys.readouterr().err


@pytest.mark.parametrize("setting", [("HF_HUB_OFFLINE", "1"), ("HF_ENDPOINT", "http://127.0.0.1:9")])
def test_a_dry_upload_needs_no_network(setting: tuple[str, str], tmp_path: Path) -> None:
    spec = DigitSetSpec(SyntheticSource(), mnist3d.SolidSpec(target_vertices=300), limit=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    # The client reads its settings when it is imported.
    command = program("mnist3d", "upload", tmp_path / "set", "YOU/digits", "--dry-run", "--json")
    settings = {**os.environ, "HF_HOME": str(tmp_path / "hf"), "HF_TOKEN": "", setting[0]: setting[1]}
    done = subprocess.run(command, env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["exists"] is None
    assert {"README.md", "manifest.json"} < set(document["to_send"])
    assert document["bytes_to_send"] == document["bytes"] > 10_000
    assert "note: no connection to the Hub" in done.stderr
    # A damaged folder is named without the Hub, too.
    (tmp_path / "set" / "README.md").write_text("no card", encoding="utf-8")
    done = subprocess.run(command, env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert "README.md" in done.stderr
