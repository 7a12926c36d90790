"""The format of recordings is recognised by their content."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import realtouch
from realtouch.formats.exports import ExportLayout
from realtouch.importing.import_options import IMPORT_LAYOUTS
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.recognition import recognised
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import IMAGE_SUFFIX
from tests.mutations import mutated

FILES = {
    "video": ("takes/a.avi", b"RIFF\x00\x00\x00\x00AVI "),
    "hdf5": ("a.h5", b"\x89HDF\r\n\x1a\n"),
    "flat": ("a.parquet", b"PAR1"),
    "webdataset": ("a.tar", b"\0" * 257 + b"ustar\x0000"),
    "folder": ("mug/a.png", b"\x89PNG"),
    "lerobot": ("meta/info.json", b"{}"),
    "replay": ("b.zarr/.zgroup", b"{}"),
    "oxt": ("b.zarr/data/left_tactile_type_gel/.zarray", b"{}"),
    "anytouch": ("train_bg.txt", b""),
    "fota": ("train/count.txt", b"1"),
    "rosbag": ("run/run_0.mcap", b"\x89MCAP0\r\n"),
}
OTHERS = {"pickle": ("dataset_0.pkl", b"\x80\x04"), "text": ("notes.txt", b"hello")}


def place(home: Path, layout: str) -> Path:
    path, content = (FILES | OTHERS)[layout]
    (home / path).parent.mkdir(parents=True, exist_ok=True)
    (home / path).write_bytes(content)
    return home / path


def test_every_format_has_a_reader_and_a_mark() -> None:
    assert tuple(IMPORTS) == IMPORT_LAYOUTS
    assert set(FILES) == set(IMPORT_LAYOUTS)


@pytest.mark.parametrize("layout", FILES)
def test_a_folder_is_recognised(layout: str, tmp_path: Path) -> None:
    path = place(tmp_path, layout)
    (tmp_path / ".DS_Store").write_bytes(b"x")
    (tmp_path / "README.md").write_text("notes")
    found = recognised(str(tmp_path))
    assert found.layout == layout
    assert found.by in path.as_posix()


@pytest.mark.parametrize("layout", ["video", "hdf5", "flat", "webdataset", "rosbag"])
@pytest.mark.parametrize("name", ["as it was", "renamed.bin"])
def test_a_file_is_recognised_by_how_it_begins(layout: str, name: str, tmp_path: Path) -> None:
    path = place(tmp_path, layout)
    if name != "as it was":
        path = path.rename(tmp_path / name)
    assert recognised(str(path)).layout == layout


@pytest.mark.parametrize(("member", "layout"), [("left_tactile_type_gel", "oxt"), ("tactile", "replay")])
def test_a_zip_is_recognised_by_its_arrays(member: str, layout: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zarr.zip", "w") as archive:
        archive.writestr(".zgroup", "{}")
        archive.writestr(f"data/{member}/.zarray", "{}")
    assert recognised(str(tmp_path / "a.zarr.zip")).layout == layout


def test_a_table_belongs_to_the_files_beside_it(tmp_path: Path) -> None:
    place(tmp_path, "video")
    (tmp_path / "labels.csv").write_text("file,label\n")
    assert recognised(str(tmp_path)).layout == "video"


@pytest.mark.parametrize(
    ("layouts", "name", "words"),
    [
        (("video", "webdataset"), "", r"several formats: webdataset \(a.tar\), video .*; next: name one"),
        (("text",), "", "--format"),
        (("text",), "notes.txt", "--format"),
        (("pickle",), "", r"'dataset_0.pkl' is a pickle, which is not read .*next: write each"),
        (("pickle",), "dataset_0.pkl", r"'dataset_0.pkl' is a pickle, which is not read .*next: write each"),
        # Sparsh keeps touches in pickles, and the image of the gel at rest beside them.
        (("folder", "pickle"), "", r"'dataset_0.pkl' is a pickle.*`--format folder` imports"),
    ],
)
def test_what_is_not_recognised_is_named(layouts, name, words, tmp_path):
    for layout in layouts:
        place(tmp_path, layout)
    with pytest.raises(InputError, match=words):
        recognised(str(tmp_path / name))


@pytest.mark.parametrize("name", ["run.mcap", "a.mp4", "a"])
def test_an_empty_file_is_called_so_whatever_its_name(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match="is an empty file; next: copy"):
        recognised(str(tmp_path / name))


@pytest.mark.parametrize("layout", [layout for layout in get_args(ExportLayout) if layout != "minari"])
def test_an_export_is_recognised_by_its_manifest(layout: str, single_folder: Path, tmp_path: Path) -> None:
    realtouch.export(single_folder, tmp_path / "out", layout, split="train", limit=1)  # type: ignore[arg-type]
    expected = "folder" if layout in IMAGE_SUFFIX else layout
    assert recognised(str(tmp_path / "out")).layout == expected


def test_a_set_needs_no_import(single_folder: Path, tmp_path: Path) -> None:
    realtouch.select(single_folder, tmp_path / "out", split="train", limit=1)
    with pytest.raises(InputError, match=r"is a data set already; it needs no import"):
        realtouch.import_touches(tmp_path / "out", tmp_path / "again")


FOREIGN = {
    "run_0.db3.zstd": (b"\x28\xb5\x2f\xfd", "is a file compressed by Zstandard; next: unpack it by `zstd -d"),
    "trial.mat": (b"MATLAB 5.0 MAT-file", "is a file of MATLAB; next: read it by scipy.io"),
    "poses.npy": (b"\x93NUMPY\x01\x00", "is a file of NumPy; next: write its arrays to an HDF5 file"),
    "sheet.xlsx": (b"PK\x03\x04", "is a workbook of Excel; next: save each sheet as CSV"),
}


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("name", FOREIGN)
def test_known_formats_that_are_not_read_are_named(name: str, named: bool, tmp_path: Path) -> None:
    content, words = FOREIGN[name]
    (tmp_path / name).write_bytes(content)
    (tmp_path / "metadata.yaml").write_text("x: 1")
    with pytest.raises(InputError, match=f"'{name}' {words}"):
        recognised(str(tmp_path / name if named else tmp_path))


def test_arrays_of_npz_are_named_and_the_advice_works(tmp_path: Path) -> None:
    pytest.importorskip("h5py", reason="needs h5py")
    path = tmp_path / "episode.npz"
    pictures = np.zeros((3, 8, 8, 3), np.uint8)
    np.savez(path, tactile=pictures, force=np.zeros((3, 6)))
    words = r"a file of NumPy, with the arrays tactile uint8 \(3, 8, 8, 3\), force float64 \(3, 6\); next"
    with pytest.raises(InputError, match=words) as caught:
        recognised(str(path))
    (program,) = re.findall(r'python -c "(.*?)"', str(caught.value))
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    columns = realtouch.ImportColumns(image="tactile")
    shown = realtouch.preview_import(tmp_path / "arrays.hdf5", realtouch.ImportSpec(columns=columns))
    assert shown.touches == 3


@pytest.mark.thorough
def test_any_damage_of_npz_gives_a_message(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, pictures=np.zeros((3, 8, 8, 3), np.uint8), force=np.zeros((3, 6)))
    whole = path.read_bytes()
    for seed in range(500):
        path.write_bytes(mutated(whole, seed))
        with pytest.raises(InputError):
            recognised(str(path))
