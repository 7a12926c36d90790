"""HDF5 of laboratories: episodes by the path of their pictures, without access outside of the file."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.source_files import Ledger
from realtouch.importing.source_touches import Recording
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError
from tests.realtouch import factories
from tests.realtouch.found import per_frame, require_pictures_or_messages

h5py = pytest.importorskip("h5py", reason="needs h5py, of the extra hdf5")

RANDOM = np.random.default_rng(3)
PICTURES = RANDOM.integers(0, 256, (5, 8, 9, 3), np.uint8)
FORCE = RANDOM.normal(size=(5, 2))
TIMES = np.array([0, 0.1, 0.25, 0.3, 0.45])
PACKED: tuple[dict[str, Any], ...] = (
    {"chunks": (2, 5, 9, 3), "compression": "gzip", "shuffle": True, "fletcher32": True},
    {"chunks": (3, 8, 9, 2), "compression": "lzf"},
    {},
)


def write(path: Path, numbers: tuple[int, ...] = (0, 2, 10), pictures: Any = PICTURES) -> Path:
    """Write a file as robomimic does: a group for each demonstration."""
    with h5py.File(path, "w") as file:
        file.attrs["env"] = "bench"
        for number in numbers:
            group = file.create_group(f"data/demo_{number}")
            group.attrs["gain"] = [1.0, 2.5]
            group.create_dataset("obs/tactile", data=pictures, **PACKED[number % len(PACKED)])
            group["obs/force_n"] = FORCE + number
            group["label"] = np.full(5, number)
            group["time_s"] = TIMES
            group["obs/far"] = np.zeros((5, 300))
    return path


def recordings(source: Path, image: str = "obs/tactile") -> list[Recording]:
    columns = realtouch.ImportColumns(image=image)
    return list(IMPORTS["hdf5"].find(store.open_folder(str(source)), columns, None, Ledger()))


def test_each_group_with_the_pictures_is_an_episode(tmp_path: Path) -> None:
    source = write(tmp_path / "takes.hdf5")
    found = recordings(source)
    assert [each.name for each in found] == ["data/demo_0", "data/demo_2", "data/demo_10"]  # natural order
    for each, number in zip(found, (0, 2, 10), strict=True):
        assert each.values == {"env": "bench", "gain": [1.0, 2.5], "label": number}
        assert {*each.per_frame} == {"obs/force_n"}
        np.testing.assert_array_equal(per_frame(each, "obs/force_n"), FORCE + number)
        np.testing.assert_array_equal(each.time_s, TIMES)
        assert each.left_out == ("obs/far (5, 300)",)
    assert recordings(tmp_path)[0].name == "data/demo_0"
    write(tmp_path / "more.h5", (1,))
    names = [each.name for each in recordings(tmp_path)]
    assert names == ["more/data/demo_1", *(f"takes/data/demo_{number}" for number in (0, 2, 10))]
    columns = realtouch.ImportColumns(image="obs/tactile")
    manifest = realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(columns=columns))
    assert manifest.spec["left_out"] == ["obs/far (5, 300)"]
    shown = realtouch.preview_import(source, realtouch.ImportSpec(columns=columns)).columns
    assert ("obs/far (5, 300)", "left out", "") in shown
    touches = realtouch.load(tmp_path / "out", "train").touches()
    np.testing.assert_array_equal(np.stack([each.image for each in touches]), np.concatenate([PICTURES] * 3))
    assert touches.labels.tolist() == [0] * 5 + [2] * 5 + [10] * 5


@pytest.mark.parametrize(
    "pictures", [PICTURES / 255, np.moveaxis(PICTURES, -1, 1), PICTURES[..., :1].astype(np.uint16) * 257]
)
def test_pictures_are_converted_as_those_of_zarr(pictures: Any, tmp_path: Path) -> None:
    source = write(tmp_path / "a.h5", (5,), pictures)
    realtouch.import_touches(
        source, tmp_path / "out", realtouch.ImportSpec("hdf5", realtouch.ImportColumns(image="obs/tactile"))
    )
    found = np.stack([each.image for each in realtouch.load(tmp_path / "out", "train").touches()])
    wanted = PICTURES[..., :1].repeat(3, axis=-1) if pictures.shape[-1] == 1 else PICTURES
    np.testing.assert_array_equal(found, wanted)


def test_pictures_are_named_by_the_user(tmp_path: Path) -> None:
    source = write(tmp_path / "a.h5")
    for named in ({"label": "lable"}, {"extra": (("force_n", "lable"),)}, {"pose": ("lable",)}):
        with pytest.raises(InputError, match=r"no column 'lable'; did you mean 'label'.*found "):
            realtouch.preview_import(
                source, realtouch.ImportSpec(columns=realtouch.ImportColumns(image="obs/tactile", **named))
            )
    with pytest.raises(InputError, match="none was named as the pictures; found data/demo_0/obs/tactile"):
        recordings(source, "")
    for image in ("obs/tactil", "actile"):
        with pytest.raises(InputError, match=r"found data/demo_0/obs/tactile, data/demo_2.*--map image=PATH"):
            recordings(source, image)
    assert [each.name for each in recordings(source, "/data/demo_2/obs/tactile")] == ["a"]
    with pytest.raises(InputError, match="holds no HDF5 file"):
        recordings(tmp_path.parent / "none")
    (tmp_path / "b.h5").write_bytes(b"text")
    with pytest.raises(InputError, match=r"b.h5': not an intact file of HDF5"):
        recordings(tmp_path / "b.h5")


def linked(file: Any, secret: Path) -> None:
    file["outer/obs/tactile"] = h5py.ExternalLink(str(secret), "/data/demo_0/obs/tactile")


def soft(file: Any, secret: Path) -> None:
    file["outer/obs/tactile"] = h5py.SoftLink("/data/demo_0/obs/tactile")


def stored_outside(file: Any, secret: Path) -> None:
    outside = [(str(secret), 0, 200)]
    file.create_dataset("outer/obs/tactile", (1, 8, 8, 3), np.uint8, external=outside)


def virtual(file: Any, secret: Path) -> None:
    layout = h5py.VirtualLayout(PICTURES.shape, np.uint8)
    layout[...] = h5py.VirtualSource(str(secret), "data/demo_0/obs/tactile", PICTURES.shape)
    file.create_virtual_dataset("outer/obs/tactile", layout)


def lossy(file: Any, secret: Path) -> None:
    data = np.ones((5, 8, 9, 3), np.int32)
    file.create_dataset("outer/obs/tactile", data=data, chunks=(1, 8, 9, 3), scaleoffset=2)


def huge(file: Any, secret: Path) -> None:
    file.create_dataset("outer/obs/tactile", (10**9, 480, 640, 3), np.uint8, chunks=(1, 480, 640, 3))


def objects(file: Any, secret: Path) -> None:
    file["outer/obs/tactile"] = np.array(["a"], dtype=h5py.string_dtype())


@pytest.mark.parametrize(
    ("add", "words"),
    [
        (linked, "no dataset of pictures"),
        (soft, "no dataset of pictures"),
        (stored_outside, "its values lie in other files"),
        (virtual, "its values lie in other files"),
        (lossy, r"the filters number 6; expected shuffle, gzip"),
        (huge, "unpacks to 921,600,000,000,000 bytes"),
        (objects, "rows of bytes; expected pictures"),
    ],
)
def test_no_external_files_are_opened(add: Any, words: str, tmp_path: Path) -> None:
    secret = write(tmp_path / "secret" if add is stored_outside else tmp_path / "secret.h5", (0,))
    (tmp_path / "in").mkdir()
    with h5py.File(tmp_path / "in" / "a.h5", "w") as file:
        add(file, secret)
    with pytest.raises(InputError, match=words):
        recordings(tmp_path / "in")


def test_chunks_are_not_unpacked_beyond_their_size(tmp_path: Path) -> None:
    for content, words in (
        (zlib.compress(bytes(1 << 26), 9), "a damaged chunk; expected 512 bytes unpacked"),
        (zlib.compress(bytes(500)), "a damaged chunk"),
        (bytes(1 << 20), "a chunk of 1,048,576 bytes"),
    ):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            data = file.create_dataset("img", (8, 8, 8, 1), np.uint8, chunks=(8, 8, 8, 1), compression="gzip")
            data.id.write_direct_chunk((0, 0, 0, 0), content)
        (found,) = recordings(tmp_path / "a.h5", "img")
        with pytest.raises(InputError, match=words):
            list(IMPORTS["hdf5"].contents(list(found.images())))


JPEGS = [factories.encode_jpeg(pixels) for pixels in RANDOM.integers(0, 256, (5, 24, 32, 3), np.uint8)]


def of_any_length(file: Any, name: str) -> None:
    data = file.create_dataset(name, (len(JPEGS),), h5py.vlen_dtype(np.uint8))
    for number, jpeg in enumerate(JPEGS):
        data[number] = np.frombuffer(jpeg, np.uint8)


def in_chunks(file: Any, name: str) -> None:
    data = file.create_dataset(name, (len(JPEGS),), h5py.vlen_dtype(np.uint8), chunks=(2,), maxshape=(None,))
    for number, jpeg in enumerate(JPEGS):
        data[number] = np.frombuffer(jpeg, np.uint8)


def of_fixed_length(file: Any, name: str) -> None:
    file[name] = np.array(JPEGS)


def padded(file: Any, name: str) -> None:
    width = max(map(len, JPEGS))
    file[name] = np.stack([np.frombuffer(jpeg.ljust(width, b"\0"), np.uint8) for jpeg in JPEGS])
    file["compress_len"] = [list(map(len, JPEGS))]


@pytest.mark.parametrize("add", [of_any_length, in_chunks, of_fixed_length, padded])
def test_encoded_pictures_are_stored_unchanged(add: Any, tmp_path: Path) -> None:
    source = tmp_path / "a.hdf5"
    with h5py.File(source, "w") as file:
        add(file, "observations/images/top")
        file["observations/qpos"] = FORCE
    (found,) = recordings(source, "images/top")
    assert list(IMPORTS["hdf5"].contents(list(found.images()))) == JPEGS
    with pytest.raises(InputError, match=r"next: add --map image=observations/images/top$"):
        recordings(source, "")
    columns = realtouch.ImportColumns(image="images/top")
    manifest = realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(columns=columns))
    assert realtouch.verify(tmp_path / "out").ok
    outside = ["compress_len (outside the episodes)"] if add is padded else None
    assert manifest.spec.get("left_out") == outside
    (only,) = realtouch.load(tmp_path / "out", "train")
    assert [bytes(only.sensor_image.encoded(number)) for number in range(len(JPEGS))] == JPEGS


def test_rows_that_are_no_pictures_are_refused_or_left_out(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("notes", (3,), h5py.vlen_dtype(np.uint8))
        data[1] = np.frombuffer(b"hello", np.uint8)
        file["scores"] = np.zeros((4, 300), np.uint8)
        few = file.create_dataset("few", (3,), h5py.vlen_dtype(np.uint8))
        few[1] = np.frombuffer(JPEGS[0], np.uint8)
    for name in ("notes", "scores"):
        with pytest.raises(InputError, match="rows of bytes; expected pictures"):
            recordings(tmp_path / "a.h5", name)
    (found,) = recordings(tmp_path / "a.h5", "few")
    first, second, third = IMPORTS["hdf5"].contents(list(found.images()))
    assert second == JPEGS[0]
    assert str(first) == "row 0 holds no bytes, or too many; expected a picture"
    assert isinstance(third, ItemError)


def masked(path: Path, **masks: list[str]) -> Path:
    with h5py.File(write(path), "a") as file:
        file["data"].attrs["total"] = 15
        for name, names in masks.items():
            file[f"mask/{name}"] = np.array(names, "S")
    return path


def test_masks_are_splits(tmp_path: Path) -> None:
    parts = {"train": ["demo_2", "demo_0"], "valid": ["demo_10"]}
    source = masked(tmp_path / "a.hdf5", **parts, few=["demo_0"])
    columns = realtouch.ImportColumns(image="obs/tactile")
    shown = realtouch.preview_import(source, realtouch.ImportSpec(columns=columns))
    assert shown.splits == {"train": 10, "valid": 5}
    left_out = {name for name, use, _ in shown.columns if use == "left out"}
    why = "a mask; masks called train, valid or test are splits if each episode is in one"
    assert left_out == {f"mask/few ({why})", "obs/far (5, 300)"}
    assert "total" in {name for name, _, _ in shown.columns}
    with pytest.raises(InputError, match="split has no effect"):
        realtouch.preview_import(source, realtouch.ImportSpec(columns=columns, split="x"))
    gap = masked(tmp_path / "b.hdf5", train=["demo_2"], valid=["demo_10"])
    shown = realtouch.preview_import(gap, realtouch.ImportSpec(columns=columns))
    assert shown.splits == {"train": 15}
    assert {f"mask/train ({why})", f"mask/valid ({why})"} <= {name for name, _, _ in shown.columns}


@pytest.mark.thorough
def test_any_damage_gives_recordings_or_a_message(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "encoded.h5", "w") as file:
        in_chunks(file, "img")
    require_pictures_or_messages(tmp_path / "encoded.h5", "hdf5", "img")
    require_pictures_or_messages(write(tmp_path / "a.h5", (0, 1)), "hdf5", "obs/tactile")
