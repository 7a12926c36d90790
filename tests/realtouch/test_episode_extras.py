"""Further columns of touches in exports of episodes: forces, markers, contact points."""

from __future__ import annotations

import io
import json
import zipfile
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import realtouch
from realtouch.formats.lerobot_import import find_lerobot
from realtouch.formats.zarr_recordings import find_oxt, find_replay
from realtouch.importing.source_files import Ledger
from realtouch.importing.source_touches import Recording
from tactile_toolkit import store
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.touch import decode_image
from tests.realtouch.factories import encoded
from tests.realtouch.found import per_frame

FORCE = "observation.force_n"


def with_extras(source: Path, home: Path, columns: dict[str, list[Any]]) -> Path:
    """Write the rounds of a set with further columns, one entry for each round."""
    found = sorted((source / "data").glob("train-*.parquet"))
    rows = pa.concat_tables([pq.read_table(path) for path in found])
    for name, values in columns.items():
        rows = rows.append_column(name, pa.array(values, pa.list_(pa.float64()) if "none" in name else None))
    (home / "data").mkdir(parents=True)
    pq.write_table(rows, home / "data" / "train-00000-of-00001.parquet", row_group_size=1)
    return home


def found(find: Any, home: Path) -> list[Recording]:
    return list(find(store.open_folder(str(home)), realtouch.ImportColumns(), None, Ledger()))


def exported(home: Path, out: Path) -> tuple[pa.Table, dict[str, Any], dict[str, Any]]:
    """Return frames, features and statistics of the LeRobotDataset."""
    realtouch.export(home, out, "lerobot")
    info, stats = (
        json.loads((out / "lerobot" / "meta" / f"{name}.json").read_text()) for name in ("info", "stats")
    )
    return pq.read_table(out / "lerobot" / "data"), info["features"], stats


def test_columns_with_an_entry_per_touch_are_features(single_folder: Path, tmp_path: Path) -> None:
    """Numbers, vectors, texts and booleans; missing values are NaN or an empty text."""
    random = np.random.default_rng(4)
    force = random.normal(size=(3, 5, 3)).tolist()
    count: list[list[int | None]] = [[1, 2, None, 4, 5]] * 3
    force[1][2] = None
    note = [["a", None, "c", "d", "e"]] * 3
    is_good = [[True, False, True, True, False]] * 3
    extras: dict[str, list[Any]] = {
        "height": [[[1.0]] * 5] * 3,
        "force_n": force,
        "count": count,
        "note": note,
        "good/bad": is_good,
        "none": [[None] * 5] * 3,
    }
    home = with_extras(single_folder, tmp_path / "home", {f"extra.{name}": extras[name] for name in extras})
    frames, features, stats = exported(home, tmp_path / "out")
    expected = np.array([[np.nan] * 3 if each is None else each for touches in force for each in touches])
    np.testing.assert_array_equal(np.array(frames[FORCE].to_pylist()), expected)
    assert features[FORCE] == {"dtype": "float64", "shape": [3], "names": None}
    np.testing.assert_array_equal(frames["observation.count"].to_numpy(), [1, 2, np.nan, 4, 5] * 3)
    assert features["observation.count"]["dtype"] == "float64"
    assert frames["observation.note"].to_pylist() == ["a", "", "c", "d", "e"] * 3
    assert features["observation.note"]["dtype"] == "string"
    assert frames["observation.good_bad"].to_pylist() == is_good[0] * 3
    assert features["observation.good_bad"]["dtype"] == "bool"
    assert set(frames.column_names) == set(features) == {*stats, "observation.note"} | {"observation.note"}
    for statistic, value in (("mean", np.nanmean(expected, 0)), ("max", np.nanmax(expected, 0))):
        np.testing.assert_allclose(stats[FORCE][statistic], value, rtol=1e-12)
    assert stats["observation.good_bad"]["mean"] == [0.6]
    assert frames["observation.height"].to_pylist() == [1.0] * 15
    episode = pq.read_table(tmp_path / "out" / "lerobot" / "meta" / "episodes").to_pylist()[1]
    np.testing.assert_allclose(episode[f"stats/{FORCE}/min"], np.nanmin(expected[5:10], 0), rtol=1e-12)
    recordings = found(find_lerobot, tmp_path / "out" / "lerobot")
    for number, each in enumerate(recordings):
        np.testing.assert_array_equal(per_frame(each, "force_n"), expected[5 * number : 5 * number + 5])
        assert per_frame(each, "note").tolist() == ["a", None, "c", "d", "e"]
        assert per_frame(each, "good/bad").tolist() == is_good[number]


def test_columns_with_an_entry_per_frame_are_features(seq_folder, truth, tmp_path):
    """Next to columns of whole clips; a name that is taken by a feature of ours is changed."""
    random = np.random.default_rng(4)
    lengths = [[touch.frames for touch in each.touches] for each in truth]
    force = [[random.normal(size=(length, 3)).tolist() for length in round_] for round_ in lengths]
    level = [[list(range(length)) for length in round_] for round_ in lengths]
    warmth = random.normal(size=(3, 5)).tolist()
    columns = {"extra_seq.force_n": force, "extra_seq.state": level, "extra.temperature": warmth}
    home = with_extras(seq_folder, tmp_path / "home", columns)
    frames, features, _ = exported(home, tmp_path / "out")
    flat = np.concatenate([np.array(touch) for touches in force for touch in touches])
    np.testing.assert_array_equal(np.array(frames[FORCE].to_pylist()), flat)
    assert features["observation.state"]["shape"] == [7]
    assert features["observation.state_"] == {"dtype": "int64", "shape": [1], "names": None}
    assert frames["observation.state_"].to_pylist() == frames["frame_index"].to_pylist()
    repeated = np.repeat(np.ravel(warmth), np.ravel(lengths))
    np.testing.assert_array_equal(frames["observation.temperature"].to_numpy(), repeated)
    recordings = found(find_lerobot, tmp_path / "out" / "lerobot")
    for each, touch, value in zip(recordings, chain(*force), chain(*warmth), strict=True):
        np.testing.assert_array_equal(per_frame(each, "force_n"), touch)
        assert each.values["temperature"] == value
        assert per_frame(each, "state").tolist() == list(range(each.frames))


def test_vectors_of_another_length_are_named(single_folder: Path, tmp_path: Path) -> None:
    markers = [[[1.0, 2.0]] * 5, [[1.0, 2.0]] * 4 + [[1.0] * 3], [[1.0, 2.0]] * 5]
    home = with_extras(single_folder, tmp_path / "home", {"extra.markers": markers})
    with pytest.raises(IntegrityError, match=r"row 1, field 'extra.markers': vectors of 2 and of 3 values"):
        realtouch.export(home, tmp_path / "out", "lerobot")
    markers[1] = [[1.0] * 3] * 5
    home = with_extras(single_folder, tmp_path / "other", {"extra.markers": markers})
    with pytest.raises(IntegrityError, match="vectors of 3 values; expected 2, as in the first touch"):
        realtouch.export(home, tmp_path / "out", "lerobot")


def test_large_integers_with_gaps_are_not_rounded(single_folder, truth, tmp_path):
    """Formats without missing values store NaN instead, which only floats can hold."""
    count = len(truth[0].touches)
    stamps = [2**60 + 1, None, *range(count - 2)]
    home = with_extras(single_folder, tmp_path / "home", {"extra.stamp_ns": [stamps] * 3})
    assert realtouch.load(home, "train")[0].extra["stamp_ns"].tolist() == stamps
    for layout in ("lerobot", "replay", "oxt"):
        with pytest.raises(IntegrityError, match=r"stamp_ns.*integers of 2\*\*53 or more, some missing"):
            realtouch.export(home, tmp_path / layout, layout)  # type: ignore[arg-type]


def with_depth(source: Path, home: Path) -> tuple[Path, list[np.ndarray]]:
    """Write the rounds of a set of images with maps of depth; return those, in metres."""
    (row, *_) = pq.read_table(source / "data").slice(0, 1).to_pylist()
    height, width = decode_image(row["sensor_image"][0]["bytes"]).shape[:2]
    random = np.random.default_rng(5)
    counts = random.integers(0, 2**16, (3, 5, height, width), np.uint16)
    files: list[list[dict[str, Any]]] = []
    for maps in counts:
        files.append([{"bytes": encoded(depth, "PNG"), "path": None} for depth in maps])
    return with_extras(source, home, {"depth_um": files}), list(counts.reshape(15, height, width) / 1e6)


def test_maps_of_depth_have_a_unit(single_folder: Path, tmp_path: Path) -> None:
    home, depths_m = with_depth(single_folder, tmp_path / "home")
    frames, features, stats = exported(home, tmp_path / "out")
    height, width = depths_m[0].shape
    assert features["observation.images.depth"] == {
        "dtype": "image",
        "shape": [height, width, 1],
        "names": ["height", "width", "channels"],
        "info": {"is_depth_map": True, "depth_unit": "m"},
    }
    for image, depth_m in zip(frames["observation.images.depth"].to_pylist(), depths_m, strict=True):
        shown_m = np.asarray(Image.open(io.BytesIO(image["bytes"])))
        assert shown_m.dtype == np.float32
        np.testing.assert_allclose(shown_m, depth_m, rtol=1e-7)
    depth_stats = stats["observation.images.depth"]
    assert np.shape(depth_stats["mean"]) == (1, 1, 1)
    np.testing.assert_allclose(np.ravel(depth_stats["mean"]), np.mean(depths_m), rtol=1e-6)
    np.testing.assert_allclose(np.ravel(depth_stats["max"]), np.max(depths_m), rtol=1e-6)
    (again, *_) = found(find_lerobot, tmp_path / "out" / "lerobot")
    assert again.left_out == ("observation.images.depth",)
    realtouch.export(home, tmp_path / "oxt", "oxt")
    with zipfile.ZipFile(tmp_path / "oxt" / "oxt" / "touches.zarr.zip") as group:
        assert not any("depth" in name for name in group.namelist())


def test_a_map_of_another_size_is_named(single_folder: Path, tmp_path: Path) -> None:
    home, _ = with_depth(single_folder, tmp_path / "home")
    (path,) = (home / "data").glob("*.parquet")
    table = pq.read_table(path)
    maps = table["depth_um"].to_pylist()
    maps[1][4]["bytes"] = encoded(np.zeros((2, 3), np.uint16), "PNG")
    place = table.schema.get_field_index("depth_um")
    table = table.set_column(place, "depth_um", pa.array(maps, table.schema.field("depth_um").type))
    pq.write_table(table, path, row_group_size=1)
    with pytest.raises(IntegrityError, match=r"row 1, touch 4, field 'depth_um': a map \(2, 3\)"):
        realtouch.export(home, tmp_path / "out", "lerobot")


@pytest.mark.parametrize(("layout", "find"), [("oxt", find_oxt), ("replay", find_replay)])
def test_columns_are_arrays_of_groups(layout, find, seq_folder, truth, tmp_path):
    """A group states which columns concern whole clips."""
    force = [
        [[[frame, 2.0, 3.0] for frame in range(touch.frames)] for touch in each.touches] for each in truth
    ]
    note, warmth = [["a", "b", None, "d", "e"]] * 3, [[1.0, 2, np.nan, 4, 5]] * 3
    columns = {"extra_seq.force_n": force, "extra.temperature": warmth, "extra.note": note}
    realtouch.export(with_extras(seq_folder, tmp_path / "home", columns), tmp_path / "out", layout)
    recordings = found(find, tmp_path / "out" / layout)
    for each, force_n, *both in zip(recordings, chain(*force), chain(*warmth), chain(*note), strict=True):
        np.testing.assert_array_equal(per_frame(each, "force_n"), force_n)
        for name, value in zip(("temperature", "note"), both, strict=True):
            np.testing.assert_array_equal(each.values[name], value)
