"""Everything that a source holds is imported, left out with the reason, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import realtouch
from realtouch.importing import import_plan, import_preview
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import EncodedImage, images
from tests.mutations import mutated
from tests.realtouch import factories
from tests.realtouch.images_of_others import line, picture, write_table, write_tar

PIXELS = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)


def encoded(kind: str, pixels: Any = PIXELS, **options: Any) -> bytes:
    return factories.encoded(pixels, kind, **options)


def write(home: Path, files: dict[str, bytes]) -> Path:
    for path, content in files.items():
        (home / path).parent.mkdir(parents=True, exist_ok=True)
        (home / path).write_bytes(content)
    return home


def imported(home: Path, out: Path, **options: Any) -> Any:
    return realtouch.import_touches(home, out, realtouch.ImportSpec(**options))


def test_pictures_of_every_format_are_read_without_loss(tmp_path: Path) -> None:
    kinds = {"bmp": "BMP", "tiff": "TIFF", "ppm": "PPM", "png": "PNG", "gif": "GIF", "jp2": "JPEG2000"}
    home = write(
        tmp_path / "home", {f"{ending}/a.{ending.upper()}": encoded(kind) for ending, kind in kinds.items()}
    )
    manifest = imported(home, tmp_path / "out")
    assert not manifest.skipped_reasons()
    assert manifest.total_statistics()["pictures"] == {
        f"{kind} stored as PNG, without loss": 1 for kind in ("BMP", "GIF", "JPEG2000", "PPM", "TIFF")
    }
    rounds = realtouch.load(tmp_path / "out", "train")
    assert rounds.label_names == tuple(sorted(kinds))
    for touch in rounds.touches():
        if touch.label != rounds.label_names.index("gif"):  # 256 colours
            np.testing.assert_array_equal(touch.image, PIXELS)
    assert manifest.spec["notes"] == ["the classes are the outermost folders, such as 'bmp' of 'bmp/a.BMP'"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (encoded("TIFF", save_all=True, append_images=[Image.fromarray(PIXELS)]), "of several pictures"),
        (encoded("TIFF", np.zeros((24, 32), np.uint16)), "of 16 bits a colour"),
        (encoded("TIFF", Image.fromarray(PIXELS).convert("CMYK")), "a TIFF with the colours CMYK"),
        (encoded("TIFF", tiffinfo={274: 6}), "ask to turn it"),
        (b"P6 32 24 65535\n" + bytes(24 * 32 * 6), "of 16 bits a colour"),
        (encoded("JPEG2000").replace(b"\7\1\1", b"\x0f\1\1"), "of 16 bits a colour"),
        (b"\0\0\0\x18ftypheic" + bytes(99), "the extra `heic`"),
        (encoded("BMP")[:99], "cannot be decoded"),
        (b"BM" + bytes(99), "cannot be decoded"),
    ],
)
def test_pictures_that_png_does_not_hold_are_left_out(
    content: bytes, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    formats = tuple(name for name in images.picture_formats() if name != "HEIF")
    monkeypatch.setattr(images, "picture_formats", lambda: formats)
    home = write(tmp_path / "home", {"a.tif": content, "b.jpg": picture(9)})
    (skipped,) = imported(home, tmp_path / "out").shards[0].skipped
    assert skipped.reason == "image"
    assert words in skipped.message


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("BMP", {}),
        ("TIFF", {}),
        ("TIFF", {"compression": "tiff_lzw"}),
        ("GIF", {}),
        ("PPM", {}),
        ("JPEG2000", {}),
        ("AVIF", {}),
    ],
)
def test_any_damage_of_a_picture_gives_a_picture_or_a_message(kind: str, options: dict[str, Any]) -> None:
    whole, refused = encoded(kind, **options), 0
    for seed in range(500):
        try:
            EncodedImage(EncodedImage(mutated(whole, seed)).storable()[0]).intact_size()
        except ValueError:
            refused += 1
    assert 0 < refused < 500


def test_files_that_are_not_read_are_listed(tmp_path: Path) -> None:
    files = {f"{name}/{number}.jpg": picture(number) for name in ("cup", "key") for number in range(2)}
    others = {
        "labels.txt": "not of the format folder",
        "cup/labels.json": "not of the format folder",
        "sheet.xlsx": "a workbook of Excel",
        "synced_data.npy": "a file of NumPy",
    }
    home = write(tmp_path / "home", files | dict.fromkeys(others, b"x") | {".hidden": b"", "__MACOSX/a": b""})
    logs = write(home, {f"log/{number}.log": b"" for number in range(7)})
    expected = {f"{path} ({reason})" for path, reason in others.items()}
    expected.add("7 files *.log, such as log/0.log (not of the format folder)")
    manifest = imported(logs, tmp_path / "out")
    assert set(manifest.spec["left_out"]) == expected
    shown = realtouch.preview_import(home)
    assert {name for name, use, _ in shown.columns if use == "left out"} == expected
    assert shown.notes == ["the classes are the outermost folders, such as 'cup' of 'cup/0.jpg'"]


def test_members_of_tars_that_are_not_read_are_listed(tmp_path: Path) -> None:
    members = [
        ("a.rgb.jpg", picture(1)),
        ("a.depth.png", encoded("PNG")),
        ("a.pose.npy", b"\x93NUMPY\0\1"),
        ("a.cls", b"3"),
        ("a.log", b"x" * (1 << 20) + b"x"),
    ]
    (tmp_path / "home").mkdir()
    write_tar(tmp_path / "home" / "train-000000.tar", members)
    columns = realtouch.ImportColumns(image="rgb.jpg", label="cls")
    manifest = imported(tmp_path / "home", tmp_path / "out", columns=columns)
    assert not manifest.skipped_reasons()
    assert manifest.spec["left_out"] == [
        "*.depth.png (an image that was not chosen)",
        "*.pose.npy (not text of at most 1 MiB)",
        "*.log (not text of at most 1 MiB)",
    ]


def test_pictures_that_no_table_names_are_listed(tmp_path: Path) -> None:
    home = write(tmp_path / "home", {f"{number}.jpg": picture(number) for number in range(3)})
    write_table(home, [line(f"{number}.jpg") for number in range(2)])
    assert imported(home, tmp_path / "out").spec["left_out"] == ["2.jpg (a picture that no table names)"]
    write_table(home, [{"file": "nothing"}], "other.csv")
    manifest = imported(home, tmp_path / "two", table=str(home / "index.csv"))
    assert (
        "other.csv (a table that was not named; see --table, --stream and --cut)" in manifest.spec["left_out"]
    )


def test_a_preview_counts_what_would_survive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {f"{name}/{number}.jpg": picture(number) for name in ("cup", "key") for number in range(4)}
    home = write(tmp_path / "home", files)
    write(home, {"cup/1.jpg": picture(1, (10, 10)), "key/2.jpg": b"no picture"})
    shown = realtouch.preview_import(home)
    assert (shown.touches, shown.rounds, shown.splits) == (6, 6, {"train": 6})
    assert {(reason, count) for reason, count, _ in shown.left_out} == {("size", 1), ("image", 1)}
    manifest = imported(home, tmp_path / "out")
    assert manifest.skipped_reasons() == {reason: count for reason, count, _ in shown.left_out}
    for path in files:
        (home / path).write_bytes(b"no picture")
    shown = realtouch.preview_import(home)
    assert shown.touches == 0
    assert shown.notes[-1] == "the import would be refused, as every touch would be left out"
    with pytest.raises(InputError):
        imported(home, tmp_path / "none")
    monkeypatch.setattr(import_preview, "_PREVIEW_BYTES", 25)
    assert "the pictures of 2 of 8 touches were read" in realtouch.preview_import(home).notes


def test_a_stream_is_aligned_with_pictures_that_have_times(tmp_path: Path) -> None:
    home = write(tmp_path / "home", {f"{number}.jpg": picture(number) for number in range(4)})
    start = 1_764_230_400_123_456_789
    times = [start + step * 40_000_000 for step in (2, 0, 1)]  # not in order
    rows = [{"file": f"{number}.jpg", "stamp_ns": time} for number, time in enumerate([*times, ""])]
    write_table(home, rows)
    samples = [
        {"stamp_ns": start + step * 10_000_000, "x_mm": step / 10, "force_n": 1.5 * step}
        for step in range(12)
    ]
    write_table(tmp_path, samples, "robot.csv")
    stream = tmp_path / "robot.csv"
    columns = realtouch.ImportColumns(time="stamp_ns")
    options: dict[str, Any] = {"streams": (str(stream),), "columns": columns}
    manifest = imported(home, tmp_path / "out", **options)
    forces = {
        touch.id: touch.extra["force_n"] for touch in realtouch.load(tmp_path / "out", "train").touches()
    }
    assert {name.partition("_")[0]: value for name, value in forces.items() if value == value} == {
        "0": 12.0,
        "1": 0.0,
        "2": 6.0,
    }
    assert manifest.spec["streams"][0][:3] == ["pictures", "robot", "12"]
    with pytest.raises(InputError, match="the times of the pictures, and they have none; next: name"):
        imported(home, tmp_path / "none", streams=(str(stream),))


def test_rounds_that_are_divided_are_stated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = write(tmp_path / "home", {f"{number}.jpg": picture(number) for number in range(6)})
    write_table(home, [line(f"{number}.jpg") | {"round": "one"} for number in range(6)])
    monkeypatch.setattr(import_plan, "_SHARD_BYTES", 2000)
    columns = realtouch.ImportColumns(round="round")
    manifest = imported(home, tmp_path / "out", columns=columns)
    count = len(realtouch.load(tmp_path / "out", "train"))
    assert count > 1
    assert manifest.spec["notes"] == [
        f"1 round of train became {count} of at most 2.0 kB each, such as 'one-0'"
    ]
