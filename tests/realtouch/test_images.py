from __future__ import annotations

import io
import threading
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st
from PIL import Image

import realtouch
from tactile_toolkit.touch import EncodedImage, decode_image, encode_image
from tests.jpegs import jpeg_of_scans
from tests.mutations import mutated
from tests.realtouch.factories import encode_jpeg, encoded

PICTURES = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)


def smooth(height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x * 255 // width, y * 255 // height, (x + y) % 256], axis=-1).astype(np.uint8)


def pillow(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


@given(st.integers(1, 70), st.integers(1, 70), st.integers(10, 100), st.sampled_from([0, 1, 2]))
def test_pixels_equal_those_of_pillow(height: int, width: int, quality: int, sampling: int) -> None:
    data = encoded(smooth(height, width), "JPEG", quality=quality, subsampling=sampling)
    np.testing.assert_array_equal(decode_image(data), pillow(data))
    out = np.zeros((height, width, 3), np.uint8)
    assert decode_image(memoryview(data), out) is out
    np.testing.assert_array_equal(out, pillow(data))
    assert EncodedImage(data).size() == (height, width)


def test_grey_and_progressive_jpegs_are_rgb() -> None:
    pixels = smooth(20, 30)
    for data in (
        encoded(pixels, "JPEG", progressive=True),
        encoded(pixels, "JPEG", optimize=True),
        encoded(pixels[..., 0], "JPEG"),
    ):
        np.testing.assert_array_equal(decode_image(data), pillow(data))


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_lossless_formats_keep_their_pixels(kind: str) -> None:
    np.testing.assert_array_equal(decode_image(encoded(PICTURES, kind, lossless=True)), PICTURES)
    np.testing.assert_array_equal(decode_image(encode_image(PICTURES, "png")), PICTURES)


def test_same_pixels_give_the_same_bytes() -> None:
    assert encode_image(PICTURES) == encode_image(PICTURES.copy())
    assert np.abs(decode_image(encode_image(smooth(40, 40))).astype(int) - smooth(40, 40)).mean() < 4


@given(st.data())
def test_damaged_jpegs_raise_or_give_whole_pictures(data: st.DataObject) -> None:
    """Flipped or missing bytes raise ValueError; no picture is returned that is decoded in part."""
    intact = encode_jpeg(smooth(24, 32))
    whole = bytearray(intact)
    for _ in range(data.draw(st.integers(0, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(whole[: data.draw(st.integers(0, len(whole)))])
    try:
        pixels = decode_image(cut)
    except ValueError:
        assert cut != intact
        return
    assert cut == intact or not intact.startswith(cut), "a part of a picture was decoded"
    assert pixels.dtype == np.uint8
    assert pixels.ndim == 3
    assert pixels.shape[2] == 3


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.9, 0.99])
def test_a_cut_jpeg_is_never_decoded(keep: float) -> None:
    data = encode_jpeg(smooth(60, 80))
    with pytest.raises(ValueError, match="cannot be decoded"):
        decode_image(data[: int(keep * len(data))])


@pytest.mark.parametrize("size", [(12, 16), (32, 24), (24, 48), (48, 64)])
@pytest.mark.parametrize("kind", ["jpeg", "png"])
def test_a_picture_of_another_size_than_its_place_is_refused(kind: str, size: tuple[int, int]) -> None:
    """Smaller, turned and larger pictures are errors."""
    out = np.zeros((24, 32, 3), np.uint8)
    with pytest.raises(ValueError, match=f"an image of {size[1]} x {size[0]} pixels; expected 32 x 24"):
        decode_image(encode_image(smooth(*size), kind), out)


def test_images_without_a_closer_look_are_whole() -> None:
    """Whatever is wrong with an image of a batch, it is judged alone, or is as intact as alone."""
    rng = np.random.default_rng(0)
    first, second = (encode_jpeg(rng.integers(0, 255, (32, 32, 3), np.uint8)) for _ in range(2))
    cut = [second[:length] for length in range(0, len(second), 7)]
    strange = [
        b"",
        b"\xff\xda",
        second + b"\0",
        *[jpeg_of_scans(300)] * 2,
        encode_image(decode_image(first), "png"),
    ]
    changed = [mutated(second, seed) for seed in range(400)]
    images = [first, second, *cut, *strange, *changed, second, first]
    for start in (0, 1, 5):  # Arrow passes slices on
        judged = EncodedImage.doubtful(pa.array([b"before", *images], pa.binary()).slice(start + 1))
        damaged = range(2, 2 + len(cut) + len(strange))
        assert {number - start for number in damaged if number >= start} <= {*judged}
        assert {len(images) - start - 2, len(images) - start - 1}.isdisjoint(judged)
        for number in {*range(len(images) - start)} - {*judged}:
            EncodedImage(images[start + number]).intact_size()


def test_other_bytes_are_named() -> None:
    for data in (b"", b"GIF89a..", b"\xff\xd8\xff", b"RIFFxxxx"):
        with pytest.raises(ValueError, match="expected a"):
            decode_image(data)


def test_threads_share_a_round(single_folder: Path) -> None:
    images = realtouch.load(single_folder, "train")[0].sensor_image
    expected, wrong = images[:], []

    def read() -> None:
        for touch in range(5):
            if not np.array_equal(images[touch], expected[touch]):
                wrong.append(touch)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.parametrize("count", [1, 2, 5])
def test_fill_bytes_before_a_marker_are_skipped(count: int) -> None:
    """Any number of FF may stand before a marker (ITU T.81, B.1.1.2)."""
    data = encode_image(PICTURES)
    frame = data.index(b"\xff\xc0")
    for place in (2, frame):
        filled = data[:place] + b"\xff" * count + data[place:]
        assert EncodedImage(filled).size() == PICTURES.shape[:2]
        np.testing.assert_array_equal(decode_image(filled), decode_image(data))
