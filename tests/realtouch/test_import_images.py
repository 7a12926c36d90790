"""Images that are imported: intact, upright, of one size, and read again where they changed."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageOps

import realtouch
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.source_files import pictures_by_file
from realtouch.importing.source_touches import PictureLocation
from tactile_toolkit.errors import InputError, SpecMismatchError
from tests.realtouch.factories import encoded
from tests.realtouch.images_of_others import line, picture, write_table
from tests.tactile_toolkit.toy import folder_bytes


def test_few_pictures_of_a_file_are_read_before_the_first_is_used(tmp_path):
    """Each may be as large as an image can be."""
    read = list[int]()

    def noted(_home: object, _picture: PictureLocation, numbers: Any) -> Iterator[bytes]:
        for number in numbers:
            read.append(number)
            yield b"picture"

    pictures = pictures_by_file(noted, [PictureLocation(str(tmp_path), "a.avi", "", 5, 1, 1000)])
    assert next(pictures) == b"picture"
    assert read == list(range(5, 21))
    assert sum(1 for _ in pictures) == 999


def test_an_image_that_changed_in_place_is_read_again_with_check_alone(home, tmp_path, monkeypatch):
    """A second import compares names, sizes and the table; `check` compares the content of the images."""
    monkeypatch.setattr("realtouch.importing.import_plan._TOUCHES_PER_SHARD", 2)
    write_table(home, [line(f"pictures/{number}.jpg") for number in range(4)])
    out, read, contents = tmp_path / "out", list[str](), IMPORTS["folder"].contents
    manifest = realtouch.import_touches(home, out, realtouch.ImportSpec("folder"))
    before = {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in out.rglob("*") if file.is_file()}
    digests = [record.source_digest for record in manifest.shards]
    assert len(set(digests)) == 2
    assert None not in digests

    def noted(items: Iterator[PictureLocation]) -> Iterator[bytes | Exception]:
        every = list(items)
        for item, content in zip(every, contents(iter(every)), strict=True):
            read.append(item.path)
            yield content

    monkeypatch.setitem(IMPORTS, "folder", replace(IMPORTS["folder"], contents=noted))
    first, size = home / "pictures" / "0.jpg", (home / "pictures" / "0.jpg").stat().st_size
    assert (home / "pictures" / "1.jpg").stat().st_size == size
    for check in (False, True):
        assert realtouch.import_touches(home, out, realtouch.ImportSpec("folder"), check=check) == manifest
    whole = [f"pictures/{number}.jpg" for number in range(4)]
    assert read == 3 * whole  # for the size of all, twice, and for the check
    assert before == {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in before}
    first.write_bytes(picture(40))
    assert realtouch.import_touches(home, out, realtouch.ImportSpec("folder")) == manifest
    read.clear()
    realtouch.import_touches(home, out, realtouch.ImportSpec("folder"), check=True)
    assert read == [*whole, *whole, *whole[:2]]  # one shard of the two is made again
    (image,) = realtouch.load(out, "train")[0].sensor_image
    assert np.array_equal(image, np.full((24, 32, 3), 40))
    realtouch.import_touches(home, tmp_path / "whole", realtouch.ImportSpec("folder"))
    assert folder_bytes(out) == folder_bytes(tmp_path / "whole")
    first.unlink()  # it is listed without a size now, so the specification differs
    with pytest.raises(SpecMismatchError):
        realtouch.import_touches(home, out, realtouch.ImportSpec("folder"))


@pytest.mark.thorough
def test_images_that_programs_show_differently(tmp_path: Path) -> None:
    """Values above 8 bits would be clipped at 255; images marked as turned are turned by some readers."""
    upright = Image.new("RGB", (32, 24), (9, 9, 9))
    turned = Image.Exif()
    turned[0x0112] = 6
    upright.save(tmp_path / "turned.jpg", exif=turned)
    turned[0x0112] = 1
    upright.save(tmp_path / "upright.jpg", exif=turned)
    Image.fromarray(np.full((24, 32), 3000, np.uint16)).save(tmp_path / "deep.png")
    Image.new("L", (32, 24), 7).save(tmp_path / "grey.png")
    Image.new("1", (20_000, 20_000)).save(tmp_path / "bomb.png")
    upright.save(tmp_path / "other.tga")
    names = ("turned.jpg", "deep.png", "bomb.png", "other.tga", "upright.jpg", "grey.png")
    write_table(tmp_path, [{"file": f"./{name}", "label": 1} for name in names])
    manifest = realtouch.import_touches(tmp_path, tmp_path.parent / "seen", realtouch.ImportSpec("folder"))
    skipped = manifest.shards[0].skipped
    assert [(item.id, item.reason) for item in skipped] == [(number, "image") for number in range(4)]
    for item, words in zip(
        skipped, ("to turn it", "16 bits", "of at most 16,777,216 pixels", "PNG or WebP"), strict=True
    ):
        assert words in item.message
    seen = realtouch.load(tmp_path.parent / "seen", "train")
    assert [int(each.sensor_image[0].mean().round()) for each in seen] == [9, 7]


def _png(*chunks: tuple[bytes, bytes], late: bool = False) -> bytes:
    """Return a PNG with further chunks before its pixels, or after them."""
    content = encoded(Image.new("RGB", (32, 24), (9, 9, 9)), "PNG")
    more = b"".join(
        len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")
        for kind, data in chunks
    )
    place = content.index(b"IEND" if late else b"IDAT") - 4
    return content[:place] + more + content[place:]


def _turned_images() -> dict[str, bytes]:
    """Return images that are marked as turned, in all places where they can be."""
    exif = Image.Exif()
    exif[0x0112] = 6
    tiff = exif.tobytes()[6:]
    xmp = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
    far, upright = Image.Exif(), Image.new("RGB", (32, 24), (9, 9, 9))
    far[0x0112], far[0x010E] = 6, "x" * 9000
    comment = b"\xff\xfe" + (9000).to_bytes(2, "big") + bytes(8998)
    jpeg = encoded(upright, "JPEG", exif=exif)
    raw = f"\nexif\n{len(tiff) + 6:8}\n{(b'Exif' + bytes(2) + tiff).hex()}\n".encode()
    return {
        "near.jpg": jpeg,
        "far.jpg": jpeg[:2] + comment + jpeg[2:],
        "large.jpg": encoded(upright, "JPEG", exif=far),
        "xmp.jpg": encoded(upright, "JPEG", xmp=xmp),
        "exif.png": _png((b"eXIf", tiff)),
        "late.png": _png((b"eXIf", tiff), late=True),
        "raw.png": _png((b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(raw))),
        "xmp.png": _png((b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + xmp)),
        "exif.webp": encoded(upright, "WEBP", exif=exif, lossless=True),
        "xmp.webp": encoded(upright, "WEBP", xmp=xmp, lossless=True),
    }


def test_every_mark_of_a_turned_image_is_found(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    images = _turned_images()
    for content in images.values():  # otherwise the test has no effect
        with Image.open(io.BytesIO(content)) as image:
            assert ImageOps.exif_transpose(image).size == (24, 32)
    odd = Image.Exif()
    odd[0x0112] = 9  # which turns nothing
    other = encoded(Image.new("RGB", (32, 24)), "JPEG", exif=odd)
    # Bytes after the end marker are not part of an image.
    images |= {"odd.jpg": other, "text.jpg": picture(3) + b"Exif", "plain.png": _png()}
    for name, content in images.items():
        (home / name).write_bytes(content)
    write_table(home, [{"file": name, "label": 1} for name in images])
    manifest = realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder"))
    skipped = manifest.shards[0].skipped
    assert all("to turn it" in item.message for item in skipped)
    assert [item.id for item in skipped] == list(range(10))


def images(home: Path, *paths: str) -> Path:
    for number, path in enumerate(paths):
        (home / path).parent.mkdir(parents=True, exist_ok=True)
        (home / path).write_bytes(picture(20 * number))
    return home


def imported(home: Path, tmp_path: Path, **options: Any) -> dict[str, Any]:
    """Return the names of images and their labels, by split."""
    realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder", **options))
    found = {}
    for split in sorted(path.name.partition("-")[0] for path in (tmp_path / "out" / "data").iterdir()):
        rounds = realtouch.load(tmp_path / "out", split)
        names = dict(enumerate(rounds.label_names)) | {-1: None}
        found[split] = [(each.id, names[each.label]) for each in rounds]
    return found


@pytest.mark.parametrize(
    ("paths", "found"),
    [
        (
            ("mug/10.png", "mug/2.png", "fork/deep/er/1.JPG", "7.png", ".hidden/a.png", "mug/notes.txt"),
            {"train": [("fork_deep_er_1", "fork"), ("mug_2", "mug"), ("mug_10", "mug")]},
        ),
        (
            ("train/mug/1.png", "train/fork/2.png", "test/mug/3.png"),
            {"test": [("test_mug_3", "mug")], "train": [("train_fork_2", "fork"), ("train_mug_1", "mug")]},
        ),
        (("train/1.png", "test/2.png"), {"test": [("test_2", None)], "train": [("train_1", None)]}),
        (("b.png", "a.png"), {"train": [("a", None), ("b", None)]}),
        (
            ("Glas/1.png", "Müsli/1.png", "mu\u0308de/ß.png"),  # letters and marks decomposed, as on macOS
            {"train": [("Glas_1", "Glas"), ("Müsli_1", "Müsli"), ("müde_ß", "mu\u0308de")]},
        ),
        (("in/1.png", "in/deep/2.png"), {"train": [("in_1", None), ("in_deep_2", None)]}),
        (("train/1.png", "mug/2.png"), {"train": [("mug_2", "mug"), ("train_1", "train")]}),
    ],
)
def test_folders_are_classes_and_splits(paths, found, tmp_path):
    """An image beside the folders of classes is left out and listed."""
    assert imported(images(tmp_path / "home", *paths), tmp_path) == found


def test_images_whose_names_cannot_be_used_are_listed(tmp_path: Path) -> None:
    home = images(tmp_path / "home", "a.png", "b\nc.png")
    (home / "d\udcff.png").write_bytes(picture(9))
    manifest = realtouch.import_touches(
        home, tmp_path / "out", realtouch.ImportSpec("folder", max_left_out=1)
    )
    assert [each.reason for each in manifest.shards[0].skipped] == ["name"] * 2
    assert len(realtouch.load(tmp_path / "out", "train")) == 1


def test_the_number_of_images_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("realtouch.formats.media_files._MAX_IMAGES", 2)
    home = images(tmp_path / "home", "a.png", "b.png", "c.png")
    with pytest.raises(InputError, match="more than 2 images"):
        realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder"))
