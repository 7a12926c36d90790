"""Files of pictures: every file is used or named, every page is a digit, every level counts."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from mnist3d.digit_generation import DigitSetSpec, generate, source_again
from mnist3d.digit_options import DigitPreviewSpec, SolidSpec
from mnist3d.digit_previews import plan_previews
from mnist3d.sources.picture_files import ENDINGS, is_picture_name, pages_of, read_picture
from mnist3d.sources.picture_folder import FolderSource
from tactile_toolkit.errors import ItemError
from tests.mnist3d.photographs import likeness, page, seven
from tests.mnist3d.test_folder import BOX, bar, ink_box, save
from tests.real_input import SHARED, needs_shared

SUBFILE = 254


def images(root: Path) -> list[NDArray[np.uint8]]:
    source = FolderSource(str(root))
    return [source.image(digit_id).pixels for digit_id in source.catalog().ids.tolist()]


def save_pages(path: Path, *pages: NDArray[np.uint8], **options: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    first, *others = (Image.fromarray(page) for page in pages)
    first.save(path, save_all=True, append_images=others, **options)
    return path


@pytest.mark.parametrize(
    ("ending", "form"),
    [
        ("PNG", "PNG"),
        ("jpg", "JPEG"),
        ("JFIF", "JPEG"),
        ("jpe", "JPEG"),
        ("TIF", "TIFF"),
        ("Gif", "GIF"),
        ("webp", "WEBP"),
        ("bmp", "BMP"),
        ("tga", "TGA"),
        ("TGA", "TGA"),
        ("avif", "AVIF"),
        ("jp2", "JPEG2000"),
        ("pnm", "PPM"),
        # The content of a file counts, not its name.
        ("png", "TIFF"),
        ("scan", "PNG"),
    ],
)
def test_every_ending_is_read(tmp_path: Path, ending: str, form: str) -> None:
    Image.init()
    if form not in Image.SAVE:
        pytest.skip(f"this Pillow does not write {form}")
    (tmp_path / "7").mkdir()
    Image.fromarray(bar()).save(tmp_path / "7" / f"a.{ending}", format=form)
    (pixels,) = images(tmp_path)
    assert np.abs(np.subtract(ink_box(pixels), BOX)).max() <= 1
    assert is_picture_name(f"a.{ending}") is (f".{ending.lower()}" in ENDINGS)


def test_heic_is_read_or_the_extra_named(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif", reason="needs pillow-heif, of the extra heic")
    heif.register_heif_opener()
    save_pages(tmp_path / "7" / "a.HEIC", np.repeat(bar()[..., None], 3, axis=2))
    (pixels,) = images(tmp_path)
    assert np.abs(np.subtract(ink_box(pixels), BOX)).max() <= 1


def test_an_unreadable_heic_is_named_with_a_next_step(tmp_path, monkeypatch):
    monkeypatch.setattr("tactile_toolkit.touch.picture_formats", lambda: ("PNG",))
    save(tmp_path / "7" / "a.png")
    path = save(tmp_path / "7" / "b.png").rename(tmp_path / "7" / "b.heic")
    path.write_bytes(b"\0\0\0\x18ftypheic")
    assert FolderSource(str(tmp_path)).catalog().labels.tolist() == [7, 7]
    with pytest.raises(
        ItemError, match=r"b\.heic.*of no known type.*the extra `heic`\), or store it as JPEG"
    ):
        FolderSource(str(tmp_path)).image(1)


def drawing(inside: str, size: str = 'viewBox="0 0 500 500"') -> str:
    top, bottom, left, right = BOX
    rect = f'<rect x="{left}" y="{top}" width="{right - left}" height="{bottom - top}"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{rect}{inside}</svg>'


@pytest.mark.parametrize(
    "head",
    ["", "\ufeff", '<?xml version="1.0"?>\n<!-- a bar -->\n', '<!DOCTYPE svg [<!ENTITY a "b">]>\n', "\n "],
)
def test_a_vector_drawing_is_drawn_without_the_files_it_names(tmp_path: Path, head: str) -> None:
    pytest.importorskip("pyvips", reason="needs pyvips, of the extra svg")
    Image.new("L", (9, 9)).save(tmp_path / "black.png")
    named = f'<image href="{tmp_path / "black.png"}" width="500" height="500"/>'
    (tmp_path / "set" / "7").mkdir(parents=True)
    (tmp_path / "set" / "7" / "a.svg").write_text(head + drawing(named), encoding="utf-8")
    (pixels,) = images(tmp_path / "set")
    assert np.abs(np.subtract(ink_box(pixels), BOX)).max() <= 1


BOMB = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 20}">' for n in range(1, 9))


@pytest.mark.parametrize(
    "text",
    [
        drawing("")[:-20],
        drawing("", 'width="0" height="9"'),
        drawing("", 'width="1e9" height="1" viewBox="0 0 1000000000 1"'),
        drawing("<g>" * 5000 + "</g>" * 5000),
        f'<!DOCTYPE svg [<!ENTITY e0 "aaaa">{BOMB}]>' + drawing("<text>&e8;</text>"),
    ],
)
def test_an_unusable_drawing_is_named(tmp_path: Path, text: str) -> None:
    pytest.importorskip("pyvips", reason="needs pyvips, of the extra svg")
    (tmp_path / "a.svg").write_text(text)
    with pytest.raises(ItemError, match=r"a\.svg: cannot be read as a picture") as caught:
        read_picture(tmp_path / "a.svg")
    assert caught.value.reason == "unreadable"


def test_the_extra_for_drawings_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvips", None)
    (tmp_path / "a.svg").write_text(drawing(""))
    words = r"SVG, a vector drawing, needs the package 'pyvips'.*next: pip install .*, or save it as PNG"
    with pytest.raises(ItemError, match=words):
        read_picture(tmp_path / "a.svg")


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (b'{"word": "seven", "drawing": [[[20, 200], [10, 10]]]}\n', "is a file of strokes .*next: draw it"),
        (b"%PDF-1.7", "is a PDF.*next: draw it"),
        (b"\x93NUMPY\x01\x00", "is a file of NumPy"),
        (b"nothing", "of no known type"),
    ],
)
def test_other_files_are_named_with_what_to_do(tmp_path: Path, start: bytes, words: str) -> None:
    (tmp_path / "seven.ndjson").write_bytes(start)
    with pytest.raises(ItemError, match=words):
        read_picture(tmp_path / "seven.ndjson")


@pytest.mark.parametrize("ending", ["tif", "gif", "webp", "png"])
def test_each_page_is_a_digit(tmp_path: Path, ending: str) -> None:
    pages = [bar(), bar()[::-1], bar()[:, ::-1]]
    save_pages(tmp_path / "1" / f"scan.{ending}", *pages, **({"lossless": True} if ending == "webp" else {}))
    save(tmp_path / "1" / "a.png", bar().T)
    save(tmp_path / "2" / "z.png")
    source = FolderSource(str(tmp_path))
    assert source.catalog().labels.tolist() == [1, 1, 1, 1, 2]
    for found, expected in zip(images(tmp_path), [bar().T, *pages, bar()], strict=True):
        assert ink_box(found) == ink_box(expected)
    assert source.fingerprint()["images"] == 5


def test_smaller_copies_and_masks_in_a_tiff_are_no_pages(tmp_path: Path) -> None:
    (tmp_path / "1").mkdir()
    first, copy, last = Image.fromarray(bar()), Image.fromarray(bar(100, 100)), Image.fromarray(bar()[::-1])
    copy.encoderinfo = {"tiffinfo": {SUBFILE: 1}}
    first.save(tmp_path / "1" / "a.tif", save_all=True, append_images=[copy, last])
    assert pages_of(tmp_path / "1" / "a.tif") == (0, 2)
    assert [ink_box(each) for each in images(tmp_path)] == [BOX, ink_box(bar()[::-1])]


def test_pages_of_an_animation_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page of a GIF is made from those before it: a thousand of them took the time of half a million."""
    pages = [np.roll(bar(), shift, axis=1) for shift in range(40)]
    path = save_pages(tmp_path / "a.gif", *pages)
    seek = GifImagePlugin.GifImageFile._seek
    decoded = []

    def counted(self: Any, frame: int, update_image: bool = True) -> None:
        decoded.append(frame)
        seek(self, frame, update_image)

    monkeypatch.setattr(GifImagePlugin.GifImageFile, "_seek", counted)
    for number, expected in enumerate(pages):
        assert number in pages_of(path)
        assert ink_box(read_picture(path, page=number)) == ink_box(expected)
    assert len(decoded) < 4 * len(pages)
    assert ink_box(read_picture(path, page=7)) == ink_box(pages[7]), "backwards, too"
    save_pages(path, *pages[::-1], duration=20)
    assert ink_box(read_picture(path, page=8)) == ink_box(pages[31]), "of the file that replaced it"


def test_a_preview_shows_all_pages(tmp_path: Path) -> None:
    path = save_pages(tmp_path / "scan.tif", bar(), bar()[::-1])
    plan = plan_previews(str(path), DigitPreviewSpec())
    assert [each.name for each in plan.pictures] == ["scan-1-steps.png", "scan-2-steps.png"]


@pytest.mark.parametrize("white", [255, 1023, 4095, 16_383, 65_535])
def test_levels_of_more_than_8_bits_are_kept(tmp_path: Path, white: int) -> None:
    """Cameras and scanners store 10, 12 and 14 bits in 16."""
    values = np.where(bar() > 0, white * 0.94, white * 0.08).astype(np.uint16)
    save(tmp_path / "7" / "a.png", values)
    (pixels,) = images(tmp_path)
    np.testing.assert_array_equal(pixels, bar())


def test_equal_greys_of_different_colours(tmp_path: Path) -> None:
    """Red ink on green paper, as dark as each other."""
    colours = np.where(seven()[..., None], [200, 30, 30], [0, 116, 40]).astype(np.uint8)
    save(tmp_path / "7" / "a.png", colours)
    (pixels,) = images(tmp_path)
    assert likeness(pixels < 128, seven(), 24) > 0.95


def test_other_files_are_named_except_those_of_operating_systems(tmp_path: Path) -> None:
    root = tmp_path / "own"
    save(root / "7" / "a.png")
    for name in ("7/notes.txt", "labels.csv", "7/Thumbs.db", "7/._a.png", "__MACOSX/7/._a.png", "7/@eaDir/x"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"x")
    (root / "7" / "b.jpg").write_bytes(b"broken")
    source = FolderSource(str(root))
    expected = {"7/notes.txt": "not a picture", "labels.csv": "not a picture"}
    assert source.fingerprint()["left_out"] == expected
    manifest = generate(DigitSetSpec(source, SolidSpec(target_vertices=2_000)), tmp_path / "set", workers=1)
    assert manifest.spec["source"]["left_out"] == expected
    (skipped,) = (item for shard in manifest.shards for item in shard.skipped)
    assert (skipped.reason, "7/b.jpg" in skipped.message) == ("unreadable", True)
    # Additional text files do not change digits.
    (root / "labels.csv").unlink()
    again = source_again(json.loads(json.dumps(manifest.spec["source"])), images=str(root), writer_info=None)
    assert again == source


def test_thresholds_are_part_of_a_source_where_they_are_chosen(tmp_path: Path) -> None:
    path = save(tmp_path / "7" / "a.png", page(seven()))
    usual, local = (FolderSource(str(tmp_path), threshold=word) for word in ("auto", "local"))
    assert "threshold" not in usual.fingerprint()
    assert source_again(local.fingerprint(), images=str(tmp_path), writer_info=None) == local
    for threshold in ("auto", "local", "global"):
        assert np.array_equal(read_picture(path, threshold=threshold) < 128, seven())


@needs_shared
@pytest.mark.parametrize(
    ("name", "sizes_mm"),
    [
        ("i00_plain", [(55, 61)]),
        ("i02_pages", [(10, 55), (10, 55), (50, 10)]),
        ("i03_12bit", [(55, 61)]),
        ("i03c_16bit", [(55, 61)]),
        ("i04_shadow", [(55, 61)]),
        ("i04b_hand", [(55, 61)]),
        ("i05_black_border", [(55, 61)]),
        ("i06_yellow_ink", [(55, 61)]),
        ("i06b_red_on_green", [(55, 61)]),
        ("i07_cmyk", [(55, 61)]),
        ("i07b_white_is_zero", [(55, 61)]),
        ("i07d_gain_map", [(55, 61)]),
        ("i08_mac_zip", [(55, 61)]),
        ("i09_desk", [(41, 46)]),
    ],
)
def test_pictures_of_public_reports(name: str, sizes_mm: list[tuple[int, int]]) -> None:
    """Expected sizes of the digits from their drawings; see the table of cases."""
    boxes = [ink_box(pixels) for pixels in images(SHARED / "cases" / "solid" / name)]
    found = [((right - left) * 0.2, (bottom - top) * 0.2) for top, bottom, left, right in boxes]
    np.testing.assert_allclose(found, sizes_mm, atol=1)


@needs_shared
def test_other_endings_of_public_reports() -> None:
    source = FolderSource(str(SHARED / "cases" / "solid" / "i01_other_endings"))
    assert len(source.catalog()) == 6
    for digit_id in (0, 1, 2, 4, 5):
        top, bottom, left, right = ink_box(source.image(digit_id).pixels)
        assert ((right - left) * 0.2, (bottom - top) * 0.2) == pytest.approx((55, 61), abs=1)
    with pytest.raises(ItemError, match=r"d\.HEIC: cannot be read"):
        source.image(3)
