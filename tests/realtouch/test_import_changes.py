"""Sources that change while they are imported, and agreement of a run with its preview."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from realtouch.importing import import_plan, import_sources, streams
from tactile_toolkit.columns import tables
from tactile_toolkit.errors import IntegrityError
from tests.realtouch.images_of_others import picture, write_table

pytest.importorskip("av", reason="needs PyAV, of the extra test")
from tests.realtouch.videos_of_others import write_video


def images(folder: Path, lines: Sequence[dict[str, Any]]) -> Path:
    """Write an image for each line of a table."""
    folder.mkdir()
    for number in range(len(lines)):
        (folder / f"{number}.png").write_bytes(picture(number))
    write_table(folder, [{"file": f"{number}.png", **line} for number, line in enumerate(lines)])
    return folder


def video(path: Path, count: int = 30) -> None:
    write_video(path, "mjpeg", count, "yuvj420p")


def change_after(monkeypatch: pytest.MonkeyPatch, module: Any, name: str, change: Any) -> None:
    """Call a function whenever another one has returned."""
    whole = getattr(module, name)

    def changed(*given: Any, **more: Any) -> Any:
        found = whole(*given, **more)
        change()
        return found

    monkeypatch.setattr(module, name, changed)


@pytest.mark.parametrize("cut", ["whole", "frames", "contact"])
def test_a_video_that_is_replaced_once_it_was_found(cut, tmp_path, monkeypatch):
    source = tmp_path / "source"
    source.mkdir()
    video(source / "a.avi")
    change_after(monkeypatch, import_sources, "find_source", lambda: video(source / "a.avi", 50))
    with pytest.raises(IntegrityError, match="was replaced or changed while it was imported"):
        realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(cut=cut))
    assert not list((tmp_path / "out").rglob("*.parquet"))


def test_a_stream_of_several_parts_that_changes_between_its_times_and_its_values(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "_BLOCK_BYTES", 512)
    source = tmp_path / "source"
    source.mkdir()
    video(source / "a.avi")
    write_table(source, [{"time_s": n / 100, "f": n} for n in range(100)], "a.force.csv")
    later = [{"time_s": n / 100, "f": -n} for n in range(120)]
    change_after(monkeypatch, streams, "open_stream", lambda: write_table(source, later, "a.force.csv"))
    with pytest.raises(IntegrityError, match=r"a\.force\.csv' was replaced or changed while it was read"):
        realtouch.import_touches(source, tmp_path / "out")


def test_rounds_that_are_divided_take_no_names_of_others(tmp_path, monkeypatch):
    rounds = ["a", "a", "a", "a-0", "a-1", "b"]
    source = images(tmp_path / "source", [{"round_id": each} for each in rounds])
    monkeypatch.setattr(import_plan, "_SHARD_BYTES", 1)
    realtouch.import_touches(source, tmp_path / "out")
    found = [touch.round.id for touch in realtouch.load(tmp_path / "out", "train").touches()]
    assert len(found) == len(set(found)) == len(rounds)
    assert {"a-0", "a-1", "b"} <= {*found}


@pytest.mark.parametrize("cut", ["whole", "frames"])
def test_the_size_of_videos_is_that_of_most_pictures(cut: str, tmp_path: Path) -> None:
    from tests.realtouch import videos_of_others

    source = tmp_path / "source"
    source.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(videos_of_others, "WIDTH", 32)
        video(source / "a.avi", 5)
    for name in "bc":
        video(source / f"{name}.avi", 5)
    manifest = realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(cut=cut))
    left_out = 1 if cut == "whole" else 5
    assert manifest.spec["options"]["image_size"] == [videos_of_others.WIDTH, videos_of_others.HEIGHT]
    assert len(realtouch.load(tmp_path / "out", "train").touches()) == 2 * left_out


def test_a_preview_states_the_use_of_each_column(tmp_path: Path) -> None:
    said = {"label": "mug", "id": 1, "touch": 2, "N" * 300: 3, "empty": "", "force_n": 4, "old": 5, "t_ms": 6}
    source = images(tmp_path / "source", [said] * 2)
    columns = realtouch.ImportColumns(extra=(("new", "old"),), time="t_ms")
    uses = {
        name: use
        for name, use, _ in realtouch.preview_import(source, realtouch.ImportSpec(columns=columns)).columns
    }
    realtouch.import_touches(source, tmp_path / "out", realtouch.ImportSpec(columns=columns))
    extra = realtouch.load(tmp_path / "out", "train").touches()[0].extra
    kept = {use.removeprefix("extra ").strip("'") for use in uses.values() if use.startswith("extra ")}
    assert kept | {"time_s"} == {*extra} == {"force_n", "new", "time_s"}
    assert {name for name, use in uses.items() if use == "left out"} == {"id", "touch", "N" * 300, "empty"}
    assert (uses["label"], uses["t_ms"], uses["file"]) == ("label", "time", "picture")


def test_a_table_that_names_a_video_outside_leaves_that_line_out(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for place in (source / "a.avi", tmp_path / "b.avi"):
        video(place, 5)
    lines = [{"file": "a.avi", "label": "mug"}, {"file": "../b.avi", "label": "fork"}]
    write_table(source, lines, "about.csv")
    realtouch.import_touches(source, tmp_path / "out")
    touches = realtouch.load(tmp_path / "out", "train").touches()
    assert [touch.round.id for touch in touches] == ["a"]
    assert np.asarray(touches.labels).tolist() == [1]


POSE = {"x_m": 0.01, "y_m": 0.02, "z_m": 0.001, "qx": 0, "qy": 0, "qz": 0, "qw": 1}


@pytest.mark.parametrize("layout", ["lerobot", "oxt", "fota", "webdataset", "flat"])
def test_extra_columns_called_like_those_of_a_format_come_back(layout: str, tmp_path: Path) -> None:
    said = {
        name: f"{name} of the user" for name in ("observation.state", "action", "in_contact", "index", "a/b")
    }
    source = images(tmp_path / "source", [{"label": "mug", **POSE, **said}] * 2)
    realtouch.import_touches(
        source, tmp_path / "set", realtouch.ImportSpec(columns=realtouch.ImportColumns(pose=tuple(POSE)))
    )
    realtouch.export(tmp_path / "set", tmp_path / "there", layout, split="train")
    realtouch.import_touches(tmp_path / "there", tmp_path / "back")
    touch = realtouch.load(tmp_path / "back", "train").touches()[1]
    assert {name: touch.extra[name] for name in touch.extra if name != "time_s"} == said
    np.testing.assert_allclose(touch.gel_pose.translation, [0.01, 0.02, 0.001], atol=1e-8)
