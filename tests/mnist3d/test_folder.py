from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from PIL import Image

from mnist3d.sources import DigitSource
from mnist3d.sources.digit_arrays import HwdPlusSource, MnistSource
from mnist3d.sources.digit_source import NO_WRITER
from mnist3d.sources.picture_folder import FolderSource
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.wording import natural_key
from tests.jpegs import jpeg_of_scans
from tests.mnist3d.mnist_files import bars, write
from tests.mnist3d.sources import refusal
from tests.real_input import SHARED, needs_shared

PICTURES = SHARED / "digits" / "png"


def bar(height: int = 500, width: int = 500) -> NDArray[np.uint8]:
    """A black bar in the upper left quarter of a white sheet: it shows every turn and every mirror."""
    sheet = np.full((height, width), 255, np.uint8)
    sheet[height // 5 : height // 2, width // 5 : width * 2 // 5] = 0
    return sheet


def ink_box(pixels: NDArray[np.uint8]) -> list[int]:
    rows, columns = np.nonzero(pixels < 128)
    return [int(rows.min()), int(rows.max()) + 1, int(columns.min()), int(columns.max()) + 1]


BOX = ink_box(bar())


def save(path: Path, pixels: NDArray[Any] | None = None, **options: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(bar() if pixels is None else pixels).save(path, **options)
    return path


def read(root: Path, ink: str = "auto") -> NDArray[np.uint8]:
    made = FolderSource(str(root), ink)
    assert len(made.catalog()) == 1
    pixels = made.image(0).pixels
    assert pixels.shape == (500, 500)
    assert pixels.dtype == np.uint8
    return pixels


def item_refusal(root: Path, reason: str, ink: str = "auto") -> str:
    with pytest.raises(ItemError) as caught:
        FolderSource(str(root), ink).image(0)
    assert caught.value.reason == reason
    assert "expected" in caught.value.message
    assert "; next: " in caught.value.message
    return caught.value.message


def test_ids_follow_label_then_natural_name(tmp_path: Path) -> None:
    for name in (
        *("3/b10.png", "3/b2.png", "0/z.jpg", "x_label1_writer12.png"),
        *("3/A.PNG", "3/B1.png", "0/writer7.bmp"),
    ):
        save(tmp_path / name)
    for name in ("3/.hidden.png", "3/notes.txt", ".git/1.png", "README.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    made: DigitSource = FolderSource(str(tmp_path))
    catalog = made.catalog()
    assert catalog.ids.tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert catalog.labels.tolist() == [0, 0, 1, 3, 3, 3, 3]
    assert catalog.writers.tolist() == [7, NO_WRITER, 12, *[NO_WRITER] * 4]
    for digit_id in range(7):
        digit = made.image(digit_id)
        assert (digit.id, digit.label) == (digit_id, catalog.labels[digit_id])
        assert digit.writer == catalog.writers[digit_id]


@given(st.lists(st.text("aB.-_109²٣", min_size=1), min_size=2, max_size=6))
def test_every_set_of_names_has_one_order(names: list[str]) -> None:
    backwards = names[::-1]
    assert sorted(names, key=natural_key) == sorted(backwards, key=natural_key)


@pytest.mark.parametrize("digit_id", [-1, 1])
@pytest.mark.parametrize("kind", [FolderSource, MnistSource, HwdPlusSource])
def test_unknown_id(tmp_path: Path, kind: type[DigitSource], digit_id: int) -> None:
    save(tmp_path / "3" / "a.png")
    write(tmp_path, images=bars(1)[0], labels=bars(1)[1])
    np.save(tmp_path / "images.npy", bar()[None])
    np.save(tmp_path / "labels.npy", [3])
    paths = [tmp_path]
    if kind is HwdPlusSource:
        paths = [tmp_path / "images.npy", tmp_path / "labels.npy"]
    with pytest.raises(ItemError, match=f"found id {digit_id}, expected 0 to 0") as caught:
        kind(*map(str, paths)).image(digit_id)
    assert caught.value.reason == "unknown-id"


@pytest.mark.parametrize(("paper", "ink"), [(60, 180), (180, 60)])
def test_two_grey_levels_become_black_and_white(tmp_path: Path, paper: int, ink: int) -> None:
    save(tmp_path / "7" / "a.png", np.where(bar() < 128, ink, paper).astype(np.uint8))
    made = FolderSource(str(tmp_path), ink="light" if ink > paper else "dark", threshold="global")
    np.testing.assert_array_equal(made.image(0).pixels, bar())


@pytest.mark.parametrize(
    "mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "I", "I;16", "F", "F1", "YCbCr"]
)
@pytest.mark.parametrize("light", [False, True])
def test_every_mode(tmp_path: Path, mode: str, light: bool) -> None:
    grey = 255 - bar() if light else bar()
    if mode == "I;16":
        picture = Image.fromarray(grey.astype(np.uint16) * 257)
    elif mode.startswith("F"):
        picture = Image.fromarray(grey.astype(np.float32) / (255 if mode == "F1" else 1))
    else:
        picture = Image.fromarray(grey).convert(mode)
    (tmp_path / "7").mkdir()
    name = "a.tif" if mode in ("CMYK", "YCbCr", "F", "F1", "I") else "a.png"
    # Pillow 11 cannot read its own YCbCr where it is not compressed.
    packed = {"compression": "tiff_adobe_deflate"} if mode == "YCbCr" else {}
    picture.save(tmp_path / "7" / name, **packed)
    np.testing.assert_array_equal(read(tmp_path), bar())


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
@pytest.mark.parametrize("ink_level", [0, 255])
def test_transparent_paper(tmp_path: Path, mode: str, ink_level: int) -> None:
    """Ink on a transparent background, whatever colour the transparent pixels have."""
    rgba = np.full((500, 500, 4), ink_level, np.uint8)
    rgba[..., 3] = 255 - bar()
    (tmp_path / "7").mkdir()
    Image.fromarray(rgba).convert(mode).save(tmp_path / "7" / "a.png")
    np.testing.assert_array_equal(read(tmp_path), bar())
    np.testing.assert_array_equal(read(tmp_path, "light" if ink_level else "dark"), bar())


@pytest.mark.parametrize(
    ("ink", "level", "expected"), [("auto", 250, 250), ("dark", 9, 9), ("light", 9, 246)]
)
def test_an_empty_page_stays_empty(tmp_path: Path, ink: str, level: int, expected: int) -> None:
    save(tmp_path / "7" / "a.png", np.full((500, 500), level, np.uint8))
    assert np.unique(read(tmp_path, ink)).tolist() == [expected]


@pytest.mark.parametrize(
    ("threshold", "ink", "reason", "found"),
    [
        ("auto", "auto", "no-ink", "no part of the page is as dark as ink"),
        ("global", "auto", "unclear-ink", "found 50% of the margin light"),
        ("global", "dark", "cut-off", "ink touches 50% of the border"),
        ("global", "light", "cut-off", "ink touches 50% of the border"),
    ],
)
def test_half_a_picture_is_no_digit(tmp_path, threshold, ink, reason, found):
    halves = np.repeat(np.array([[0] * 50 + [255] * 50], np.uint8), 100, axis=0)
    path = save(tmp_path / "7" / "a.png", halves)
    with pytest.raises(ItemError) as caught:
        FolderSource(str(tmp_path), ink, threshold).image(0)
    assert caught.value.reason == reason
    assert str(caught.value).startswith(f"{path}: ")
    assert found in str(caught.value)


@pytest.mark.parametrize("turn", range(1, 9))
def test_exif_orientation_is_followed(tmp_path: Path, turn: int) -> None:
    undo = {2: 0, 3: 3, 4: 1, 5: 5, 6: 2, 7: 6, 8: 4}
    stored = Image.fromarray(bar())
    if turn > 1:
        stored = stored.transpose(Image.Transpose(undo[turn]))
    exif = Image.Exif()
    exif[0x0112] = turn
    (tmp_path / "7").mkdir()
    stored.save(tmp_path / "7" / "a.png", exif=exif)
    np.testing.assert_array_equal(read(tmp_path), bar())


@pytest.mark.parametrize("size", [(1000, 1000), (1500, 1500), (250, 250), (100, 100), (30, 30)])
def test_other_sizes_are_fitted(tmp_path: Path, size: tuple[int, int]) -> None:
    save(tmp_path / "7" / "a.png", bar(*size))
    np.testing.assert_allclose(ink_box(read(tmp_path)), BOX, atol=max(1, 150 // size[0]))


@pytest.mark.parametrize("size", [(1000, 600), (100, 60)])
@pytest.mark.parametrize("upright", [True, False])
def test_aspect_is_kept_and_paper_fills_the_rest(tmp_path, size, upright):
    small = bar(*size) if upright else bar(*size).T
    save(tmp_path / "7" / "a.png", 255 - small)
    pixels = read(tmp_path) if upright else read(tmp_path).T
    assert (pixels[:, :99] == 255).all()
    assert (pixels[:, 401:] == 255).all()
    np.testing.assert_allclose(ink_box(pixels), [100, 250, 160, 220], atol=2)


class TestUnreadable:
    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"", "is an empty file; expected a picture"),
            (b"not a picture", "cannot be read as a picture (its content is of no known type)"),
        ],
    )
    def test_no_picture(self, tmp_path: Path, content: bytes, words: str) -> None:
        path = save(tmp_path / "7" / "a.png")
        path.write_bytes(content)
        assert item_refusal(tmp_path, "unreadable").startswith(f"{path}: {words}")

    @pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "gif", "tif", "webp"])
    @pytest.mark.parametrize("share", [0.3, 0.6])
    def test_cut_off(self, tmp_path: Path, suffix: str, share: float) -> None:
        noise = np.random.default_rng(0).integers(0, 256, (90, 90), np.uint8)
        path = save(tmp_path / "7" / f"a.{suffix}", noise)
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * share)])
        message = item_refusal(tmp_path, "unreadable")
        assert str(path) in message

    def test_gone_since_it_was_listed(self, tmp_path: Path) -> None:
        path = save(tmp_path / "7" / "a.png")
        (tmp_path / "7" / "b.png").symlink_to("nowhere.png")
        with pytest.raises(
            ItemError, match=r"7/b.png: cannot be read as a picture \(No such file or directory"
        ):
            FolderSource(str(tmp_path)).image(1)
        assert FolderSource(str(tmp_path)).image(0).label == int(path.parent.name)

    def test_too_large_to_be_a_digit(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        save(tmp_path / "7" / "a.png")
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100_000)
        assert "it has too many pixels" in item_refusal(tmp_path, "unreadable")

    def test_not_finite(self, tmp_path: Path) -> None:
        values = bar().astype(np.float32)
        values[3, 3] = np.nan
        path = save(tmp_path / "7" / "a.tif", values)
        assert item_refusal(tmp_path, "not-finite").startswith(f"{path}: found NaN or infinity in 1 pixel")

    def test_outside_the_grey_scale(self, tmp_path: Path) -> None:
        path = save(tmp_path / "7" / "a.tif", bar().astype(np.int32) - 9)
        assert item_refusal(tmp_path, "bad-pixels").startswith(f"{path}: found pixels from -9 to 246")


class TestRefusals:
    def test_no_folder(self, tmp_path: Path) -> None:
        message = refusal(FolderSource(str(tmp_path / "no")))
        assert message.startswith(f"{tmp_path}/no: cannot be listed (No such file or directory)")

    def test_a_file(self, tmp_path: Path) -> None:
        path = save(tmp_path / "a.png")
        assert refusal(FolderSource(str(path))).startswith(f"{path}: cannot be listed (Not a directory)")

    @pytest.mark.parametrize("folder", [".", "0"])
    def test_no_picture(self, tmp_path: Path, folder: str) -> None:
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "notes.txt").touch()
        message = refusal(FolderSource(str(tmp_path)))
        assert f"{tmp_path}: found no picture, expected {tmp_path}/<class>/*.png" in message

    def test_pictures_beside_the_folders_of_classes_that_are_no_digits(self, tmp_path: Path) -> None:
        for name in ("0/a.png", "ten/a.png", "a_label1.png"):
            save(tmp_path / name)
        message = refusal(FolderSource(str(tmp_path)))
        assert f"{tmp_path}: found 'a_label1.png', expected pictures in a folder for each class" in message

    def test_a_class_whose_name_is_not_text(self, tmp_path: Path) -> None:
        save(tmp_path / "a\u202eb" / "a.png")
        assert "expected the name of a class as plain text" in refusal(FolderSource(str(tmp_path)))

    def test_folders_inside_folders(self, tmp_path: Path) -> None:
        save(tmp_path / "0" / "more" / "a.png")
        assert f"{tmp_path}: found '0/more', expected pictures in a folder" in refusal(
            FolderSource(str(tmp_path))
        )

    def test_names_without_a_label(self, tmp_path: Path) -> None:
        for number in range(7):
            save(tmp_path / f"p{number}_label1{number}.png")
        message = refusal(FolderSource(str(tmp_path)))
        assert "found 'p0_label10.png', expected pictures in a folder" in message

    def test_unknown_ink(self, tmp_path: Path) -> None:
        save(tmp_path / "0" / "a.png")
        message = refusal(FolderSource(str(tmp_path), "blue"))
        assert "ink: found 'blue', expected one of auto, dark, light" in message


@pytest.mark.thorough
def test_a_picture_that_takes_long_or_much_memory_is_left_out(tmp_path, monkeypatch):
    monkeypatch.setenv("TACTILE_TOOLKIT_UNPACKED_MIB", "100")
    (tmp_path / "1").mkdir()
    (tmp_path / "1" / "slow.jpg").write_bytes(jpeg_of_scans(101))
    assert "a JPEG of 101 scans" in item_refusal(tmp_path, "unreadable")
    (tmp_path / "1" / "slow.jpg").unlink()
    Image.new("LA", (6_000, 6_000)).save(tmp_path / "1" / "large.png")
    assert "6000 x 6000 pixels unpacks to 144,000,000 bytes" in item_refusal(tmp_path, "unreadable")


def test_fingerprint_knows_content_names_and_no_path(tmp_path: Path) -> None:
    for root in "abcd":
        save(tmp_path / root / "0" / "x.png")
        save(tmp_path / root / "1" / "y.png", 255 - bar())
    (tmp_path / "c" / "1" / "y.png").rename(tmp_path / "c" / "1" / "z.png")
    save(tmp_path / "d" / "1" / "y.png", bar())
    prints = [FolderSource(str(tmp_path / root)).fingerprint() for root in "abcd"]
    assert prints[0] == prints[1]
    assert len({repr(value) for value in prints}) == 3
    assert FolderSource(str(tmp_path / "a"), "dark").fingerprint() != prints[0]
    assert str(tmp_path) not in repr(prints)


def test_fingerprint_of_a_file_that_cannot_be_opened(tmp_path: Path) -> None:
    save(tmp_path / "0" / "a.png")
    (tmp_path / "0" / "b.png").symlink_to("nowhere.png")
    with pytest.raises(InputError, match=r"0/b.png: cannot be opened \(No such file or directory\)"):
        FolderSource(str(tmp_path)).fingerprint()


def test_a_changed_folder_is_listed_again(tmp_path: Path) -> None:
    save(tmp_path / "1" / "b.png")
    made = FolderSource(str(tmp_path))
    assert made.catalog().labels.tolist() == [1]
    save(tmp_path / "0" / "a.png")
    os.utime(tmp_path / "1", ns=(1, 1))
    assert made.catalog().labels.tolist() == [0, 1]


@pytest.mark.thorough
@needs_shared
def test_real_pictures_come_back_as_they_are() -> None:
    made = FolderSource(str(PICTURES))
    catalog = made.catalog()
    assert np.bincount(catalog.labels).tolist() == [49, 50, 49, 47, 50, 50, 48, 49, 40, 41]
    paths = sorted(PICTURES.glob("*.png"))
    for digit_id in range(0, 473, 11):
        digit = made.image(digit_id)
        found = re.search(r"label(\d)_writer(\d)", paths[digit_id].name)
        assert found is not None
        assert (digit.label, digit.writer) == (int(found[1]), int(found[2]))
        assert catalog.writers[digit_id] == digit.writer
        with Image.open(paths[digit_id]) as picture:
            np.testing.assert_array_equal(digit.pixels, np.asarray(picture))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes have names here")
def test_links_and_pipes_in_the_folder_are_left_out_and_named(tmp_path: Path) -> None:
    """A link may lead to private files; reading a pipe would wait."""
    home = tmp_path / "home"
    outside = save(tmp_path / "7" / "a.png")
    inside = save(home / "7" / "a.png")
    (home / "7" / "b.png").symlink_to(outside)
    (home / "7" / "c.png").symlink_to(inside)
    os.mkfifo(home / "7" / "d.png")
    (tmp_path / "linked").symlink_to(home)  # a path that the user gives may be a link
    for root in (home, tmp_path / "linked"):
        made = FolderSource(str(root))
        assert made.catalog().labels.tolist() == [7, 7]
        left_out = {"7/b.png": "a link out of the folder", "7/d.png": "not a regular file"}
        assert made.fingerprint()["left_out"] == left_out
