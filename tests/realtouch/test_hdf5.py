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
from tactile_toolkit.errors import InputError, ToolkitError
from tests.mutations import mutated
from tests.realtouch.found import per_frame

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
        (objects, "values of type object"),
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


@pytest.mark.thorough
def test_any_damage_gives_recordings_or_a_message(tmp_path: Path) -> None:
    source = write(tmp_path / "a.h5", (0, 1))
    whole, refused = source.read_bytes(), 0
    for seed in range(500):
        source.write_bytes(mutated(whole, seed))
        try:
            for found in recordings(source):
                list(IMPORTS["hdf5"].contents([found.location(0, found.frames)]))
        except ToolkitError:
            refused += 1
    assert 0 < refused < 500
