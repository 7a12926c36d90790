"""Files of formats that people have are called by their names, with a step, by all readers."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from mnist3d.sources.digit_arrays import read_idx
from mnist3d.sources.picture_files import decode_page
from tactile_sim.twin.sources import read_image
from tactile_toolkit.columns.known_formats import KnownFormat
from tactile_toolkit.columns.tables import Table
from tactile_toolkit.errors import InputError, ToolkitError


def archive(*names: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as written:
        for name in names:
            written.writestr(name, b"content")
    return stream.getvalue()


FILES = {
    "": ("an empty file", b""),
    "lfs": ("a pointer of Git LFS", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n"),
    "page.html": ("a web page", b"\n<!DOCTYPE html><html></html>"),
    "run.bag": ("a ROS bag", b"#ROSBAG V2.0\nE"),
    "run_0.mcap": ("a ROS bag", b"\x89MCAP0\r\n\x01"),
    "run_0.db3": ("a ROS bag or another SQLite database", b"SQLite format 3\0\x10"),
    "svhn.mat": ("a file of MATLAB", b"MATLAB 5.0 MAT-file, Platform: GLNXA64"),
    "new.mat": (
        "a file of MATLAB",
        b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(512) + b"\x89HDF\r\n\x1a\n",
    ),
    "usps.h5": ("an HDF5 file", b"\x89HDF\r\n\x1a\n\0"),
    "a.npy": ("a file of NumPy", b"\x93NUMPY\x01\0v\0{'descr'"),
    "a.npz": (r"a file of NumPy arrays \(NPZ\)", archive("x.npy", "y.npy")),
    "m.pt": ("a file of PyTorch, which is not read because", archive("archive/data.pkl", "archive/version")),
    "old.pt": ("a pickle, which is not read because", b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."),
    "t.xlsx": ("a workbook of Excel", archive("[Content_Types].xml", "xl/workbook.xml")),
    "t.xls": ("an old workbook of Excel", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1\0"),
    "a.arrow": ("an Arrow file", b"ARROW1\0\0"),
    "a.tar": ("a tar archive", b"name".ljust(257, b"\0") + b"ustar\x0000"),
    "a.zip": ("a ZIP archive", archive("pictures/1.png")),
    "usps.bz2": ("an archive or a compressed file", b"BZh91AY&SY"),
    "run_0.db3.zstd": ("a file compressed by Zstandard", b"\x28\xb5\x2f\xfd\x04"),
    "logo.svg": (
        "an SVG file",
        b'<?xml version="1.0"?>\n<!-- x -->\n<svg xmlns="http://www.w3.org/2000/svg">',
    ),
    "a.pdf": ("a PDF", b"%PDF-1.7"),
    "a.mp4": ("a video", b"\0\0\0 ftypisom\0\0"),
}
"""Name, what it is called, and its beginning."""


@pytest.mark.parametrize("name", FILES)
def test_readers_call_files_by_their_format(name: str, tmp_path: Path) -> None:
    words, content = FILES[name]
    path = tmp_path / (name or "empty")
    path.write_bytes(content)
    readers = {
        "digits": lambda: read_idx(path, 0x803),
        "picture": lambda: decode_page(path, 0),
        "image": lambda: read_image(path),
        "table": lambda: Table(f"{name}.parquet", lambda: io.BytesIO(content)).scan(),
    }
    if name == "logo.svg":
        del readers["picture"]  # reads it, with the extra
    for reader, read in readers.items():
        with pytest.raises(ToolkitError, match=f"(is|found) {words}.*; next: ") as caught:
            read()
        assert "intact copy" not in str(caught.value), reader


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"word":"seven","drawing":[[[1,2],[3,4]]]}\n', "strokes in JSON"),
        (b'[{"label": 3}]', "text in JSON"),
        (b"label,pixel0,pixel1\n5,0,0\n", "a table of pixels"),
    ],
)
def test_pictures_in_text_are_named(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "digits").write_bytes(content)
    with pytest.raises(ToolkitError, match=f"{words}; expected a picture; next: "):
        decode_page(tmp_path / "digits", 0)


def test_a_damaged_file_of_a_known_picture_format_is_not_another_format(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    assert KnownFormat.of_file(tmp_path / "a.png") is None
    with pytest.raises(ToolkitError, match="replace it by an intact copy"):
        decode_page(tmp_path / "a.png", 0)


def test_a_table_with_bars_is_read_and_commas_come_first() -> None:
    def read(text: str) -> list[str]:
        return Table("a.csv", lambda: io.BytesIO(text.encode())).names

    assert read("file|x\na.png|1\n") == ["file", "x"]
    assert read("a|b|c,d\n1,2\n") == ["a|b|c", "d"]
    with pytest.raises(InputError, match="is a workbook of Excel; expected a table; next: save each sheet"):
        Table("t.csv", lambda: io.BytesIO(FILES["t.xlsx"][1])).scan()
