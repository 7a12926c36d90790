"""Fetching MNIST."""

from __future__ import annotations

import gc
import hashlib
import importlib.util
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from mnist3d.sources.mnist import MnistSource, download_mnist
from tactile_toolkit.errors import HubError, MissingExtraError, StorageError
from tests.mnist3d.mnist_files import PREFIXES, name_of, write


def test_download_needs_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torchvision", None)
    monkeypatch.setitem(sys.modules, "torchvision.datasets", None)
    with pytest.raises(MissingExtraError, match=r"Downloading MNIST needs .*'torchvision'.*\[torch\]"):
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
    """A folder behind a web server on this machine that torchvision takes for its only mirror."""
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
    def test_files_arrive_where_the_source_finds_them(
        self, tmp_path: Path, mirror: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        root = tmp_path / "new" / "mnist"
        download_mnist(str(root))
        assert MnistSource(str(root)).fingerprint() == MnistSource(str(mirror)).fingerprint()
        assert [path.name for path in root.iterdir()] == ["MNIST"]
        assert capsys.readouterr().out == ""

    # urllib leaves the connection of a refused request to the garbage collector, which complains.
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    def test_a_missing_file_leaves_nothing_behind(self, tmp_path: Path, mirror: Path) -> None:
        (mirror / name_of("test", "labels", end=".gz")).unlink()
        root = tmp_path / "new"
        with pytest.raises(HubError) as caught:
            download_mnist(str(root))
        message = str(caught.value)
        assert message.startswith(
            "MNIST could not be downloaded (Error downloading t10k-labels-idx1-ubyte.gz: "
        )
        assert "404" in message
        assert "expected its four files from ['http://127.0.0.1:" in message
        assert "next: check the network" in message
        assert list(root.iterdir()) == []
        del caught
        gc.collect()

    def test_a_damaged_file_leaves_nothing_behind(self, tmp_path: Path, mirror: Path) -> None:
        path = mirror / name_of("train", "images", end=".gz")
        path.write_bytes(path.read_bytes()[:-9])
        with pytest.raises(HubError, match="nothing was kept"):
            download_mnist(str(tmp_path / "new"))
        assert list((tmp_path / "new").iterdir()) == []

    def test_a_folder_that_cannot_be_made(self, tmp_path: Path, mirror: Path) -> None:
        (tmp_path / "file").touch()
        with pytest.raises(StorageError, match=r"file: MNIST could not be stored there .* expected a folder"):
            download_mnist(str(tmp_path / "file"))
        assert mirror.is_dir()
