"""Each option of an import changes what is imported, or is refused, in every format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from realtouch.importing.import_sources import IMPORTS
from tactile_toolkit.errors import InputError
from tests.realtouch import bags, factories
from tests.realtouch.images_of_others import line, picture, write_table

EXPORTED = ("flat", "webdataset", "lerobot", "oxt", "replay", "fota", "anytouch")
FRAME = ((0.0, -1.0, 0.0, 0.01), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
AT_A_DESK = ("folder", "video", "lerobot")  # single pictures, recordings, and recordings with columns
NO = "nosuch"
COLUMNS: dict[str, Any] = {
    "image": NO,
    "label": NO,
    "round": NO,
    "object_id": NO,
    "position": (NO, "y"),
    "pose": (NO,),
    "split": NO,
    "time": NO,
    "extra": (("new", NO),),
    "length_unit": "mm",
    "angle_unit": "deg",
    "time_unit": "ms",
    "quaternion_order": "wxyz",
    "euler": "xyz",
    "rotvec": True,
    "frame": FRAME,
}
ALIGNMENT: dict[str, Any] = {
    "method": "linear",
    "max_gap_ms": 7.0,
    "time_offset_s": 3.0,
    "duration_tolerance": 0.5,
}
LIMITS = {"max_left_out"}  # which intact sources do not reach
SPEC: dict[str, Any] = {
    "layout": NO,
    "table": "table.csv",
    "streams": ("force.csv",),
    "cut": "contact",
    "classes": ("first", "second"),
    "split": "other",
}


def folder(home: Path) -> None:
    for number in range(3):
        (home / f"{number}.jpg").write_bytes(picture(40 * number))
    write_table(home, [line(f"{number}.jpg") for number in range(3)])


def video(home: Path) -> None:
    pytest.importorskip("av", reason="needs av, of the extra video")
    frames = np.random.default_rng(0).integers(0, 256, (6, 24, 32, 3), np.uint8)
    (home / "a.avi").write_bytes(factories.encode_avi(frames))


def hdf5(home: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="needs h5py, of the extra hdf5")
    with h5py.File(home / "a.hdf5", "w") as file:
        file["tactile"] = np.random.default_rng(0).integers(0, 256, (6, 24, 32, 3), np.uint8)
        file["time_s"] = np.arange(6) / 25


def rosbag(home: Path) -> None:
    pytest.importorskip("rosbags", reason="needs rosbags, of the extra ros")
    bags.write(home / "run.bag", "ros1", bags.samples(bags.Messages("ros1")))


MADE: dict[str, Callable[[Path], None]] = {"folder": folder, "video": video, "hdf5": hdf5, "rosbag": rosbag}


@pytest.fixture(scope="session")
def source_of(single_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that makes a small source of a format, once."""
    made: dict[str, Path] = {}

    def source(layout: str) -> Path:
        if layout not in made:
            home = tmp_path_factory.mktemp(layout)
            if layout in EXPORTED:
                realtouch.export(single_folder, home, layout, split="train", limit=1)  # type: ignore[arg-type]
            else:
                MADE[layout](home)
            made[layout] = home
        return made[layout]

    return source


def test_every_option_and_format_is_tried() -> None:
    assert {field.name for field in fields(realtouch.ImportColumns)} == {*COLUMNS}
    assert {field.name for field in fields(realtouch.Alignment)} == {*ALIGNMENT}
    assert {field.name for field in fields(realtouch.ImportSpec)} == {*SPEC, *LIMITS, "columns", "alignment"}
    assert {*IMPORTS} == {*EXPORTED, *MADE}


@pytest.mark.parametrize("group", ["spec", "columns", "alignment"])
@pytest.mark.parametrize(
    "layout",
    [name if name in AT_A_DESK else pytest.param(name, marks=pytest.mark.thorough) for name in IMPORTS],
)
def test_an_option_changes_the_import_or_is_refused(
    layout: str, group: str, source_of: Callable[[str], Path], tmp_path: Path
) -> None:
    source = source_of(layout)
    write_table(tmp_path, [{"file": "nothing.avi", "note": "x"}], "table.csv")
    write_table(tmp_path, [{"time_s": t / 100, "force_n": t} for t in range(100)], "force.csv")
    columns = realtouch.ImportColumns()
    if layout == "hdf5":
        columns = replace(columns, image="tactile")
    spec = realtouch.ImportSpec(layout, columns)
    usual = realtouch.preview_import(source, spec)
    options = {"spec": SPEC, "columns": COLUMNS, "alignment": ALIGNMENT}[group]
    without_effect = []
    for name, value in options.items():
        if name == "table":
            value = str(tmp_path / value)
        if name == "streams":
            value = tuple(str(tmp_path / path) for path in value)
        try:
            if group == "spec":
                changed = replace(spec, **{name: value})
            elif group == "columns":
                changed = replace(spec, columns=replace(columns, **{name: value}))
            else:
                changed = replace(spec, alignment=realtouch.Alignment(**{name: value}))
            if realtouch.preview_import(source, changed) == usual:
                without_effect.append(name)
        except InputError:
            continue
    assert not without_effect
