"""Recordings after public reports: each gives the result of the reference, or an error message."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import realtouch
from realtouch.importing.source_files import path_of
from tactile_toolkit.errors import InputError
from tests.real_input import SHARED, needs_shared

pytestmark = needs_shared
CASES = SHARED / "cases" / "data"

REFUSED = {
    "ends_falling": "4, 3, 6; expected integers that rise to 6",
    "jpegxl": "the codec 'imagecodecs_jpegxl'",
    "grey16": "16 bits",
    "exif_turned": "to turn it",
    "quaternion_not_unit": "a quaternion of length 2; expected length one",
    "unsorted": "no image; expected one of|the same key as in sample",
}
COLUMNS: dict[str, dict[str, Any]] = {
    "no_labels": {"label": ""},
    "hf_metadata": {"image": "file_name"},
    "quaternion_not_unit": {"pose": ("px", "py", "pz", "qx", "qy", "qz", "qw")},
    "own_sensor": {"round": "session"},
}


def cases(kind: str) -> list[Any]:
    return [pytest.param(kind, path.name, id=path.name) for path in sorted((CASES / kind).glob("*"))]


def expected_pixels(kind: str, source: Path) -> list[Any]:
    """Return the images of a source of the most frequent size, as Pillow decodes them, in order."""
    if kind == "folders":
        files = sorted(each for each in source.rglob("*") if each.suffix.lower() in (".jpg", ".png"))
        found = [Image.open(io.BytesIO(file.read_bytes())) for file in files]
    else:
        found = []
        for tar in sorted(source.glob("*.tar")):
            with tarfile.open(tar) as archive:
                members = [each for each in archive if each.name.endswith(".jpg") and each.name[:2] != "._"]
                found += [Image.open(io.BytesIO(archive.extractfile(each).read())) for each in members]
    sizes = [image.size for image in found]
    common = max(sizes, key=sizes.count)
    return [np.asarray(image.convert("RGB")) for image in found if image.size == common]


@pytest.mark.parametrize(("kind", "name"), [*cases("folders"), *cases("tars")])
def test_images_equal_those_of_pillow(kind: str, name: str, tmp_path: Path) -> None:
    source, layout = CASES / kind / name, "folder" if kind == "folders" else "webdataset"
    columns = realtouch.ImportColumns(**COLUMNS.get(name, {}))

    def make() -> Any:
        return realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(layout, columns))  # type: ignore[arg-type]

    if name in REFUSED:
        with pytest.raises(InputError, match=REFUSED[name]):
            make()
        return
    make()
    touches = realtouch.load(tmp_path / "out", "train").touches()
    wanted = expected_pixels(kind, source)
    assert len(touches) == len(wanted)
    for touch, pixels in zip(touches, wanted, strict=True):
        if name == "cmyk":  # which decoders convert differently
            assert touch.image.shape == pixels.shape
        else:
            np.testing.assert_allclose(touch.image.astype(int), pixels, atol=3, err_msg=path_of(touch.id))
    labels = {-1} if name == "no_labels" else set(range(len(wanted))) if kind == "tars" else {0}
    assert set(touches.labels.tolist()) == labels


@pytest.mark.parametrize(("kind", "name"), cases("replay"))
def test_buffers_equal_those_of_zarr(kind: str, name: str, tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="needs zarr")
    source = CASES / kind / name
    columns = realtouch.ImportColumns(image="img")
    if name in REFUSED:
        with pytest.raises(InputError, match=REFUSED[name]):
            realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec("replay", columns))
        return
    realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec("replay", columns))
    rounds = realtouch.load(tmp_path / "out", "train")
    touches = rounds.touches()
    group = zarr.open_group(source / "b.zarr", mode="r")
    assert np.cumsum(rounds.touch_counts).tolist() == group["meta/episode_ends"][:].tolist()
    images = np.asarray(group["data/img"][:], np.float64)
    images = np.moveaxis(images, 1, -1) if images.shape[-1] not in (1, 3) else images
    images *= {"float_0_1": 255, "uint16": 1 / 256}.get(name, 1)
    pixels = np.stack([touch.image for touch in touches])
    np.testing.assert_allclose(pixels, np.broadcast_to(images, pixels.shape), atol=1e-3)
    assert set(rounds.labels.tolist()) == ({-1} if name == "no_label" else {0})
    assert not rounds[0].row.has_poses


RECORDINGS = SHARED / "cases" / "recordings"
POSE = ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
# Source, options of the import, touches, and what the manifest states as not read.
IMPORTED: dict[str, tuple[str, dict[str, Any], int, list[str]]] = {
    "D20": ("D20/pics", {}, 9, []),
    "D22": (
        "D22/pics",
        {
            "columns": realtouch.ImportColumns(time="stamp_ns", round="take", pose=POSE),
            "table": str(RECORDINGS / "D22/images.csv"),
            "streams": (str(RECORDINGS / "D22/robot.csv"),),
        },
        10,
        [],
    ),
    "D08 a": ("D08/a.hdf5", {"columns": realtouch.ImportColumns(image="observation/images/tactile")}, 12, []),
    "D08 b": (
        "D08/b.hdf5",
        {"columns": realtouch.ImportColumns(image="observations/images/tactile")},
        12,
        ["compress_len (1, 12)"],
    ),
    "D11 MCAP": ("D11/mcapbag", {}, 8, []),
    "D11 SQLite": ("D11/db3bag", {}, 8, []),
    "D12": ("D12/035_power_drill/dataset_0", {}, 6, ["synced_data.npy (a file of NumPy)"]),
}


@pytest.mark.parametrize("name", IMPORTED)
def test_recordings_are_imported(name: str, tmp_path: Path) -> None:
    path, options, count, left_out = IMPORTED[name]
    if path.endswith(".hdf5"):
        pytest.importorskip("h5py", reason="needs h5py")
    if name.startswith("D11"):
        pytest.importorskip("rosbags", reason="needs rosbags")
    manifest = realtouch.import_touches(RECORDINGS / path, tmp_path / "out", realtouch.ImportSpec(**options))
    assert not manifest.skipped_reasons()
    assert manifest.spec.get("left_out", []) == left_out
    rounds = realtouch.load(tmp_path / "out", "train")
    touches = rounds.touches()
    assert len(touches) == count
    if name == "D20":
        assert rounds.label_names == ("cup", "fork", "key")
    if name == "D22":
        assert [touch.extra["force_n"] for touch in touches] == [4 * number for number in range(10)]
        assert rounds[0].row.has_poses
