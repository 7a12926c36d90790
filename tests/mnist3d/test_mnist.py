from __future__ import annotations

import gc
import gzip
import hashlib
import importlib.util
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mnist3d.ink.grey_levels import enlarge, fit
from mnist3d.sources import DigitSource
from mnist3d.sources.digit_arrays import MnistSource, download_mnist
from mnist3d.sources.digit_source import NO_WRITER
from tactile_toolkit.errors import MissingExtraError, RemoteError
from tests.mnist3d.mnist_files import PREFIXES, bars, idx, name_of, write
from tests.mnist3d.sources import refusal
from tests.real_input import SHARED, needs_shared

CASES = SHARED / "cases" / "solid"


@pytest.mark.parametrize("end", ["", ".gz"])
@pytest.mark.parametrize("mark", ["-", "."])
@pytest.mark.parametrize("folder", [".", "MNIST/raw", "raw"])
def test_every_layout_gives_the_same_digits(tmp_path: Path, folder: str, mark: str, end: str) -> None:
    write(tmp_path / folder, mark=mark, end=end)
    write(tmp_path / "plain")
    made: DigitSource = MnistSource(str(tmp_path))
    plain = MnistSource(str(tmp_path / "plain"))
    assert made.fingerprint() == plain.fingerprint()
    np.testing.assert_array_equal(made.image(3).pixels, plain.image(3).pixels)


def test_training_digits_come_before_test_digits(tmp_path: Path) -> None:
    (first, first_labels), (then, then_labels) = bars(5, 1), bars(3, 2)
    write(tmp_path, "train", first, first_labels)
    write(tmp_path, "test", then, then_labels)
    both = MnistSource(str(tmp_path))
    catalog = both.catalog()
    assert catalog.ids.tolist() == list(range(8))
    assert catalog.labels.tolist() == [*first_labels, *then_labels]
    assert set(catalog.writers.tolist()) == {NO_WRITER}
    found = [both.image(digit_id) for digit_id in range(8)]
    fingerprint = both.fingerprint()
    for name in ("images", "labels"):
        (tmp_path / name_of("test", name)).unlink()
    train = MnistSource(str(tmp_path))
    assert train.catalog().labels.tolist() == first_labels.tolist()
    for digit_id in range(5):
        digit, alone = found[digit_id], train.image(digit_id)
        assert (digit.id, digit.label, digit.writer) == (digit_id, alone.label, NO_WRITER)
        np.testing.assert_array_equal(digit.pixels, alone.pixels)
    assert fingerprint != train.fingerprint()
    write(tmp_path / "test", "test", then, then_labels)
    for digit_id in range(5, 8):
        digit, alone = found[digit_id], MnistSource(str(tmp_path / "test")).image(digit_id - 5)
        assert (digit.id, digit.label) == (digit_id, alone.label)
        np.testing.assert_array_equal(digit.pixels, alone.pixels)


def test_ink_is_dark_and_where_it_was(tmp_path: Path) -> None:
    write(tmp_path)
    pixels = MnistSource(str(tmp_path)).image(2).pixels
    assert pixels.shape == (500, 500)
    assert pixels.dtype == np.uint8
    rows, columns = np.nonzero(pixels < 128)
    scale = 500 / 28
    assert pixels[0, 0] == 255
    assert pixels[pixels < 128].mean() < 10
    np.testing.assert_allclose([rows.min(), rows.max() + 1], [4 * scale, 12 * scale], atol=4)
    np.testing.assert_allclose([columns.min(), columns.max() + 1], [12 * scale, 16 * scale], atol=4)


def test_the_fingerprint_follows_from_the_content_alone(tmp_path: Path) -> None:
    for name in "abc":
        write(tmp_path / name, end=".gz" if name == "b" else "")
    write(tmp_path / "d", labels=bars(4, 99)[1])
    # Compression is detected by the content, not by the name.
    plain, packed = (tmp_path / "b" / name_of("test", "labels", end=end) for end in ("", ".gz"))
    packed.rename(plain)
    for path in (tmp_path / "c").iterdir():
        path.rename(f"{path}.gz")
    a, b, c, d = (MnistSource(str(tmp_path / name)).fingerprint() for name in "abcd")
    assert a == b == c != d
    assert str(tmp_path) not in repr(a)


def test_a_folder_without_files_of_mnist(tmp_path: Path) -> None:
    absent = refusal(MnistSource(str(tmp_path / "no")))
    assert absent.startswith(f"{tmp_path}/no: found no folder, expected train-images-idx3-ubyte")
    (tmp_path / "notes.txt").touch()
    message = refusal(MnistSource(str(tmp_path)))
    assert "found ['notes.txt'], expected train-images-idx3-ubyte or the same with .gz" in message
    assert "--download" in message


@pytest.mark.parametrize("kind", ["images", "labels"])
def test_half_a_pair(tmp_path: Path, kind: str) -> None:
    write(tmp_path)
    (tmp_path / name_of("test", kind)).unlink()
    assert f"expected {name_of('test', kind)} or" in refusal(MnistSource(str(tmp_path)))


IMAGES, LABELS = map(idx, bars(4))
PACKED = gzip.compress(IMAGES, mtime=0)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("images-idx3-ubyte", LABELS + bytes(99), "found magic number 2049, expected 2051"),
        ("labels-idx1-ubyte", IMAGES, "found magic number 2051, expected 2049"),
        ("images-idx3-ubyte", IMAGES[:-1], "found 3135 bytes or more of numbers, expected 3136 for"),
        ("images-idx3-ubyte", IMAGES + bytes(3), "found 3137 bytes or more of numbers, expected 3136 for"),
        ("labels-idx1-ubyte", b"", "expected an intact IDX file"),
        ("images-idx3-ubyte", LABELS[:12], "found a file that cannot be read (damaged or cut off)"),
        *(("images-idx3-ubyte", PACKED[:kept], "found a file that cannot be read") for kept in (5, 40, -4)),
        ("images-idx3-ubyte", PACKED[:12] + bytes(4) + PACKED[16:], "found a file that cannot be read"),
        ("labels-idx1-ubyte", idx(bars(3)[1]), "found 3 labels for 4 images"),
        ("labels-idx1-ubyte", idx(np.array([1, 2, 10, 11], np.uint8)), "label 11 in row 3, expected digits"),
        ("images-idx3-ubyte", idx(np.zeros((4, 32, 32), np.uint8)), "(32, 32) pixels, expected (28, 28)"),
    ],
)
def test_an_unusable_file_is_named(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    write(tmp_path)
    (tmp_path / f"t10k-{name}").write_bytes(content)
    message = refusal(MnistSource(str(tmp_path)))
    assert f"t10k-{name}: " in message
    assert words in message


def slanted_edge(slope: float, contrast: float) -> NDArray[np.uint8]:
    """Draw a half plane of ink, antialiased; contrast above 1 clips its greys, as MNIST's are clipped."""
    fine = (np.arange(28 * 16) + 0.5) / 16
    inside = fine[:, None] < 14 + slope * (fine[None, :] - 14)
    grey = inside.reshape(28, 16, 28, 16).mean(axis=(1, 3))
    return np.rint(255 * np.clip(0.5 - (grey - 0.5) * contrast, 0, 1)).astype(np.uint8)


def blocks(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Enlarge to 500 x 500 px by repeating pixels."""
    index = np.arange(500) * 28 // 500
    return pixels[np.ix_(index, index)]


def edge_error_px(pixels: NDArray[np.uint8], slope: float) -> float:
    """Return the greatest distance of the outline from the expected straight line, away from the border."""
    from skimage.measure import find_contours

    contour = max(find_contours(pixels.astype(float), 127.5), key=len) + 0.5
    y, x = contour[(np.abs(contour - 250) < 150).all(axis=1)].T
    return float(np.abs((y - 250) - slope * (x - 250)).max() / np.hypot(1, slope))


@pytest.mark.parametrize("slope", [0.1, 0.25, 0.5, 0.9])
def test_slanted_edges_have_no_stairs(slope: float) -> None:
    small = slanted_edge(slope, contrast=1)
    assert edge_error_px(blocks(small), slope) > 8
    assert edge_error_px(enlarge(small, (500, 500)), slope) < 1.5
    clipped = slanted_edge(slope, contrast=2)
    assert edge_error_px(enlarge(clipped, (500, 500)), slope) < edge_error_px(blocks(clipped), slope) / 2


def turns(pixels: NDArray[np.uint8]) -> float:
    """Return the number of full turns of the outline, measured in steps of 6 px: 1 for a disc."""
    from skimage.measure import find_contours

    contour = max(find_contours(np.pad(pixels, 2, constant_values=255).astype(float), 127.5), key=len)
    length = np.r_[0, np.cumsum(np.hypot(*np.diff(contour, axis=0).T))]
    at = np.arange(0, length[-1], 6.0)
    steps = np.diff([np.interp(at, length, contour[:, 0]), np.interp(at, length, contour[:, 1])])
    angles = np.unwrap(np.arctan2(steps[0], steps[1]))
    return float(np.abs(np.diff(angles)).sum() / (2 * np.pi))


def test_a_disc_stays_a_disc() -> None:
    y, x = np.mgrid[:28, :28] - 13.5
    small = np.clip((np.hypot(x, y) - 8 + 0.5) * 255, 0, 255).astype(np.uint8)
    pixels = enlarge(small, (500, 500))
    radius = np.sqrt((pixels < 128).sum() / np.pi)
    assert radius == pytest.approx(8 * 500 / 28, rel=0.02)
    assert turns(pixels) < 1.25
    np.testing.assert_array_equal(pixels, pixels.T)
    np.testing.assert_array_equal(pixels, pixels[::-1, ::-1])


@pytest.mark.parametrize("value", [0, 255])
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (28, 28), (300, 499)])
def test_flat_images_stay_flat(value: int, shape: tuple[int, int]) -> None:
    sheet = fit(np.full(shape, value, np.uint8))
    assert sheet.shape == (500, 500)
    inked = int((sheet < 128).sum())
    assert inked == (0 if value else round(500 * shape[0] / max(shape)) * round(500 * shape[1] / max(shape)))


def test_download_needs_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torchvision", None)
    monkeypatch.setitem(sys.modules, "torchvision.datasets", None)
    with pytest.raises(
        MissingExtraError, match=r"Downloading MNIST needs .*'torchvision'.*the extra `torch`"
    ):
        download_mnist(str(tmp_path / "new"))
    assert not (tmp_path / "new").exists()


def test_download_is_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torchvision", None)
    write(tmp_path, "train")
    write(tmp_path, "test", end=".gz")
    download_mnist(str(tmp_path))


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Keep the server's log out of the tests' output."""


@pytest.fixture
def mirror(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder behind a web server on this machine, the only mirror of torchvision."""
    from torchvision.datasets import MNIST

    served = tmp_path / "served"
    for part in PREFIXES:
        write(served, part, end=".gz")
    sums = [(path.name, hashlib.md5(path.read_bytes()).hexdigest()) for path in sorted(served.iterdir())]
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(served)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    monkeypatch.setattr(MNIST, "mirrors", [f"http://127.0.0.1:{server.server_port}/"])
    monkeypatch.setattr(MNIST, "resources", sums)
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.mark.torch
@pytest.mark.skipif(
    not importlib.util.find_spec("torchvision"), reason="needs torchvision, of the extra torch"
)
class TestDownload:
    def test_files_arrive_where_the_source_finds_them(self, tmp_path, mirror, capsys):
        root = tmp_path / "new" / "mnist"
        download_mnist(str(root))
        assert MnistSource(str(root)).fingerprint() == MnistSource(str(mirror)).fingerprint()
        assert [path.name for path in root.iterdir()] == ["MNIST"]
        assert capsys.readouterr().out == ""

    # urllib leaves the connection of a refused request to the garbage collector, which complains.
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    def test_a_missing_file_is_named(self, tmp_path: Path, mirror: Path) -> None:
        (mirror / name_of("test", "labels", end=".gz")).unlink()
        root = tmp_path / "new"
        with pytest.raises(RemoteError) as caught:
            download_mnist(str(root))
        message = str(caught.value)
        assert message.startswith(f"MNIST could not be downloaded to {root} (Error downloading t10k-labels")
        assert "404" in message
        assert "expected its four files from ['http://127.0.0.1:" in message
        assert "next: check network and folder" in message
        del caught
        gc.collect()

    def test_a_damaged_file_is_fetched_again(self, tmp_path: Path, mirror: Path) -> None:
        path = mirror / name_of("train", "images", end=".gz")
        whole = path.read_bytes()
        path.write_bytes(whole[:-9])
        with pytest.raises(RemoteError, match="File not found or corrupted"):
            download_mnist(str(tmp_path / "new"))
        path.write_bytes(whole)
        download_mnist(str(tmp_path / "new"))
        assert MnistSource(str(tmp_path / "new")).fingerprint() == MnistSource(str(mirror)).fingerprint()

    def test_a_folder_that_cannot_be_made(self, tmp_path: Path, mirror: Path) -> None:
        (tmp_path / "file").touch()
        with pytest.raises(RemoteError, match=r"to .*file \(.*Not a directory.* and a folder with 70 MB"):
            download_mnist(str(tmp_path / "file"))
        assert mirror.is_dir()


@needs_shared
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x01_emnist", "found ['emnist-digits-train-images-idx3-ubyte.gz', "),
        ("x04_letters", "found label 12 in row 0, expected digits from 0 to 9"),
        ("x02_unpacked_gz", ""),
    ],
)
def test_files_of_public_reports(name: str, words: str) -> None:
    """EMNIST is transposed and has letters; torchvision unpacks files, or names uncompressed ones."""
    source = MnistSource(str(CASES / name))
    if words:
        assert words in refusal(source)
    else:
        assert len(source.catalog().ids) == 4
