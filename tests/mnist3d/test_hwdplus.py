from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mnist3d.sources import DigitSource
from mnist3d.sources.digit_arrays import HwdPlusSource
from mnist3d.sources.digit_source import NO_WRITER
from tactile_toolkit.errors import ItemError
from tests.mnist3d.sources import refusal
from tests.processes import printed_by
from tests.real_input import SHARED, needs_shared

SIDE = 500


def stack(count: int = 3, side: int = SIDE) -> NDArray[np.uint8]:
    """White sheets with a black bar, whose position shows the row, and one pixel of every level."""
    images = np.full((count, side, side), 255, np.uint8)
    for row in range(count):
        images[row, side // 4 : side // 2, side // 5 + row : side // 3 + row] = 0
        images[row, 0, :side] = np.arange(side) % 256
    return images


def source(
    folder: Path, images: NDArray[Any] | None = None, info: NDArray[Any] | None = None, **options: Any
) -> HwdPlusSource:
    images = stack() if images is None else images
    info = (
        np.column_stack([np.arange(len(images)) % 10, np.arange(len(images)) + 40]) if info is None else info
    )
    np.save(folder / "Images(500x500).npy", images)
    np.save(folder / "WriterInfo.npy", info)
    return HwdPlusSource(str(folder / "Images(500x500).npy"), str(folder / "WriterInfo.npy"), **options)


@pytest.mark.parametrize("writer_column", [None, 1])
def test_rows_are_ids_and_pixels_come_back_as_they_are(tmp_path: Path, writer_column: int | None) -> None:
    images = stack(5)
    made: DigitSource = source(tmp_path, images, writer_column=writer_column)
    catalog = made.catalog()
    assert catalog.ids.tolist() == catalog.labels.tolist() == [0, 1, 2, 3, 4]
    writers = [NO_WRITER] * 5 if writer_column is None else [40, 41, 42, 43, 44]
    assert catalog.writers.tolist() == writers
    for row in range(5):
        digit = made.image(row)
        assert (digit.id, digit.label, digit.writer) == (row, row, writers[row])
        assert digit.pixels.dtype == np.uint8
        np.testing.assert_array_equal(digit.pixels, images[row])


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize(
    ("dtype", "scale"),
    [
        *((dtype, 1) for dtype in ("u1", "<i2", ">u2", "i8", "u8", "f2", "<f4", ">f8")),
        *((dtype, 1 / 255) for dtype in ("f4", "f8")),
    ],
)
def test_every_dtype_and_order_gives_the_same_pixels(tmp_path, dtype, scale, order):
    images = (stack(2) * scale).astype(dtype, order=order)  # type: ignore[call-overload]
    made = source(tmp_path, images)
    for row in range(2):
        np.testing.assert_array_equal(made.image(row).pixels, stack(2)[row])


def test_the_grey_scale_of_floats_is_the_files_not_the_images(tmp_path: Path) -> None:
    """A black image in a file of 0 to 255 stays black, one in a file of 0 to 1 as well."""
    images = stack(5).astype(np.float32)
    images[2] = 1.0
    assert source(tmp_path, images).image(2).pixels.max() == 1
    images /= 255
    images[2] = 200.0
    with pytest.raises(ItemError, match="found pixels from 200 to 200, expected 0 to 1"):
        source(tmp_path, images).image(2)
    # The first and the last image and some between them are examined.
    images[:4] = np.nan
    np.testing.assert_array_equal(source(tmp_path, images).image(4).pixels, stack(5)[4])


@pytest.mark.parametrize(
    ("dtype", "value", "found"),
    [
        ("f4", np.nan, "NaN or infinity in 1 pixel"),
        ("f8", np.inf, "NaN or infinity in 1 pixel"),
        *((dtype, value, "pixels from") for dtype, value in (("i4", -1), ("u2", 256))),
        *((dtype, value, "pixels from") for dtype, value in (("f4", 255.6), ("f8", -0.6))),
    ],
)
def test_pixels_that_are_no_grey_levels(tmp_path: Path, dtype: str, value: float, found: str) -> None:
    images = stack().astype(dtype)
    images[1, 7, 9] = value
    made = source(tmp_path, images)
    with pytest.raises(ItemError, match=rf"Images.500x500.\.npy, row 1: found {found}.* expected") as caught:
        made.image(1)
    assert caught.value.reason == ("not-finite" if "NaN" in found else "bad-pixels")
    np.testing.assert_array_equal(made.image(0).pixels, stack()[0])


def test_other_sizes_are_fitted_onto_the_sheet(tmp_path: Path) -> None:
    pixels = source(tmp_path, stack(1, 28) // 255 * 255).image(0).pixels
    assert pixels.shape == (SIDE, SIDE)
    share = float((pixels < 128).mean())
    assert share == pytest.approx(float((stack(1, 28) < 128)[:, 1:].mean()), abs=0.05)


@pytest.mark.parametrize(
    "labels",
    [
        np.array([3, 0, 9], np.uint8),
        np.array([3, 0, 9], ">i8"),
        np.array([3.0, 0.0, 9.0]),
        np.array(["3", " 0", "9.0"]),
        np.array([b"3", b"0", b"9 "]),
        np.array([["3", "x"], ["0", "y"], ["9", "z"]]),
    ],
    ids=["u1", "big-endian", "float", "str", "bytes", "str table"],
)
def test_labels_of_every_kind(tmp_path: Path, labels: NDArray[Any]) -> None:
    assert source(tmp_path, info=labels).catalog().labels.tolist() == [3, 0, 9]


@pytest.mark.parametrize(
    ("labels", "found"),
    [
        (np.array([0, 10, 11]), "row 1, column 0: found 10, expected a digit from 0 to 9"),
        (np.array([0, 1, -1]), "row 2, column 0: found -1, expected a digit from 0 to 9"),
        (np.array([0, 1.5, 2]), "row 1, column 0: found 1.5, expected a digit from 0 to 9"),
        (np.array([np.nan, 1, 2]), "row 0, column 0: found nan, expected a digit from 0 to 9"),
        (np.array([1e300, 1, 2]), "row 0, column 0: found 1e+300, expected a digit from 0 to 9"),
        (np.array(["1", "two", "3"]), "column 0 holds text that is not a number, expected a digit"),
        (np.array([b"1", b"\xff", b"3"]), "column 0 holds text that is not a number, expected a digit"),
    ],
)
def test_labels_that_are_no_digits(tmp_path: Path, labels: NDArray[Any], found: str) -> None:
    message = refusal(source(tmp_path, info=labels))
    assert message.startswith(f"{tmp_path}/WriterInfo.npy: {found}")


@pytest.mark.parametrize("column", [-1, 0, 2, 99])
def test_writer_column_that_is_not_there(tmp_path: Path, column: int) -> None:
    message = refusal(source(tmp_path, writer_column=column))
    assert f"WriterInfo.npy: there is no writer column {column}; the file has" in message
    assert "the file has 2 columns" in message


@pytest.mark.parametrize(
    ("images", "info"),
    [
        (np.zeros((3, 500), np.uint8), None),
        (np.zeros((3, 50, 50, 3), np.uint8), None),
        (np.zeros((3, 100, 400), np.uint8), None),
        (np.zeros((0, 500, 500), np.uint8), None),
        (np.zeros((3, 20, 20), complex), None),
        (np.full((3, 20, 20), "a"), None),
        (None, np.zeros((3, 2, 2), int)),
        (None, np.zeros((0, 2))),
        (None, np.zeros(3, complex)),
    ],
)
def test_arrays_of_other_shapes_and_types(tmp_path: Path, images: Any, info: Any) -> None:
    message = refusal(source(tmp_path, images, np.zeros((3, 2), int) if info is None else info))
    if info is None:
        found = f"Images(500x500).npy: found shape {images.shape} of {images.dtype}, expected (N, 500, 500)"
    else:
        found = f"WriterInfo.npy: found shape {info.shape} of {info.dtype}, expected one row per image"
    assert found in message


def stored(values: Any) -> bytes:
    """Return a file of NumPy; of a dictionary, one with this header and 64 bytes."""
    stream = io.BytesIO()
    if isinstance(values, dict):
        np.lib.format.write_array_header_1_0(stream, values)
        stream.write(bytes(64))
    else:
        np.save(stream, values, allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize("name", ["Images(500x500).npy", "WriterInfo.npy"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        *((content, "") for content in (b"", b"PK\x03\x04 a zip archive", b"label,writer\n3,4\n")),
        *((kept, "") for kept in (7, 9, 20, 60)),
        (-5, "(mmap length"),
        (stored({"descr": "|u1", "fortran_order": False, "shape": (-3, 1)}), ""),
        (stored(np.array([[1, None]] * 3, object)), "Python objects"),  # which are never unpickled
        (None, "([Errno 2] No such file or directory"),
        ("folder", "([Errno 21] Is a directory"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, name: str, content: Any, words: str) -> None:
    made, path = source(tmp_path), tmp_path / name
    whole = path.read_bytes()
    path.unlink()
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(whole[:content] if isinstance(content, int) else content)
    message = refusal(made)
    assert message.startswith(f"{path}: cannot be read")
    assert words in message


def test_a_replaced_file_is_read_again(tmp_path: Path) -> None:
    made = source(tmp_path)
    assert made.catalog().labels.tolist() == [0, 1, 2]
    source(tmp_path, info=np.array([[7, 1, 1], [8, 1, 1], [9, 1, 1]]))
    assert made.catalog().labels.tolist() == [7, 8, 9]


def test_fingerprint_knows_content_and_no_path(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "abcd"]
    for folder in folders:
        folder.mkdir()
    changed = stack()
    changed[1, 250, 250] ^= 1
    prints = [
        source(folders[0]).fingerprint(),
        source(folders[1]).fingerprint(),
        source(folders[2], changed).fingerprint(),
        source(folders[3], writer_column=1).fingerprint(),
    ]
    assert prints[0] == prints[1]
    assert prints[0] != prints[2]
    assert prints[0] != prints[3]
    assert prints[0]["shape"] == [3, SIDE, SIDE]
    assert str(tmp_path) not in repr(prints)


def _sparse_source(folder: Path, count: int) -> HwdPlusSource:
    made = source(folder, stack(1), np.zeros((count, 1), np.uint8))
    with Path(made.images).open("wb") as stream:
        header = {"descr": "<f8", "fortran_order": False, "shape": (count, SIDE, SIDE)}
        np.lib.format.write_array_header_1_0(stream, header)
        stream.truncate(stream.tell() + count * SIDE * SIDE * 8)
    return made


_READ_WITHIN_LIMITS = """
    import resource, sys
    from mnist3d.sources.digit_arrays import HwdPlusSource
    made = HwdPlusSource(*sys.argv[1:3])
    made.catalog(), made.image(0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    made.catalog(), made.fingerprint()
    for row in range(0, 3000, 150):
        assert made.image(row).pixels.shape == (500, 500)
    print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    """6 GB of (sparse) float64 need only some MB more than one image."""
    made = _sparse_source(tmp_path, 3000)
    assert int(printed_by(_READ_WITHIN_LIMITS, made.images, made.writer_info)) < 30


@pytest.mark.thorough
@needs_shared
def test_real_layout_equals_the_pictures_of_the_same_digits() -> None:
    from PIL import Image

    layout = SHARED / "digits" / "hwd_layout"
    made = HwdPlusSource(str(layout / "Images(500x500).npy"), str(layout / "WriterInfo.npy"), writer_column=1)
    catalog = made.catalog()
    assert np.bincount(catalog.labels).tolist() == [10] * 10
    pictures = {}
    for path in sorted((SHARED / "digits" / "png").glob("*.png")):
        found = re.fullmatch(r"\d+_label(\d)_writer(\d+)", path.stem)
        assert found is not None
        with Image.open(path) as picture:
            pictures[np.asarray(picture).tobytes()] = (int(found[1]), int(found[2]))
    for row in catalog.ids.tolist():
        digit = made.image(row)
        assert pictures[digit.pixels.tobytes()] == (digit.label, digit.writer)
        assert digit.writer == catalog.writers[row]
