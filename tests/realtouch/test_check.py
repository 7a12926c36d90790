"""Planted faults are found, with their touches; clean recordings have no findings."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import realtouch
import starstruck_gen
import tactile_sim
from realtouch.checks.checking import GELSIGHT_MINI
from realtouch.checks.rules import RULES, count_markers, outlying_steps
from tactile_sim.optics.taxim import taxim_package
from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder, read_manifest
from tests.command_line import call
from tests.real_input import SHARED, needs_shared
from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth
from tests.realtouch.test_partial_damage import spoil_pages

SIZE, TOUCHES, FRAMES = (64, 48), 6, (20, 24)
Rows = dict[str, list[dict[str, Any]]]
Truth = list[RoundTruth]
BOTH_KINDS = pytest.mark.parametrize("kind", ["single", pytest.param("seq", marks=pytest.mark.thorough)])


def recorded(
    seed: int = 0, rounds: int = 6, size: tuple[int, int] = SIZE, touches: int = TOUCHES
) -> list[RoundTruth]:
    """Make rounds as a camera sees them: with noise, so that no two pictures are equal."""
    return deepcopy(_recorded(seed, rounds, size, touches))


@cache
def _recorded(seed: int, rounds: int, size: tuple[int, int], touches: int) -> list[RoundTruth]:
    numbers = range(20 * seed, 20 * seed + rounds)
    return [factories.make_round(number, touches, size, FRAMES, noise=1.0) for number in numbers]


def written(
    folder: Path,
    kind: str,
    truth: Truth,
    edit: Callable[[Rows], object] = lambda _rows: None,
    *,
    encode: Callable[[np.ndarray], bytes] = factories.encode_jpeg,
) -> Path:
    """Write all rounds but the last as train, that one as test."""
    if kind == "single":
        rows = {
            "train": factories.single_rows(truth[:-1], encode),
            "test": factories.single_rows(truth[-1:], encode),
        }
    else:
        rows = {"train": factories.seq_rows(truth[:-1]), "test": factories.seq_rows(truth[-1:])}
    edit(rows)
    return factories.write_set(folder, rows, kind)


def found_in(folder: Path, **options: Any) -> dict[str, list[str]]:
    """Return the touches of each rule that is broken, by the number of the round and the touch."""
    result = realtouch.check(folder, **options)
    names = {record.id: number for split in ("train", "test") for number, record in _rounds(folder, split)}
    found: dict[str, list[str]] = {}
    for each in result.findings:
        assert len(each.touches) <= 20
        assert each.count >= len(each.touches) > 0
        assert each.found
        assert each.expected
        assert each.next
        touches = [name.rpartition("/")[2].rpartition(":") for name in each.touches]
        found[each.rule] = [f"{names[name]}:{touch}" for name, _, touch in touches]
    return found


def _rounds(folder: Path, split: str) -> list[tuple[int, Any]]:
    return list(enumerate(realtouch.load(folder, split)))


@BOTH_KINDS
@pytest.mark.parametrize(("seed", "size"), [(0, (64, 64)), (3, (320, 240))])
def test_clean_recordings(kind: str, seed: int, size: tuple[int, int], tmp_path: Path) -> None:
    rounds = 6 - 3 * (size[0] > 64)
    result = realtouch.check(written(tmp_path, kind, recorded(seed, rounds, size)))
    assert result.findings == ()
    assert (result.rounds, result.touches) == (rounds, rounds * TOUCHES)
    assert result.decoded >= result.touches


@BOTH_KINDS
def test_a_gel_of_one_colour_has_content_by_its_noise(kind: str, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    truth = recorded()
    for touch in (touch for each in truth for touch in each.touches):
        touch.pixels[:] = 110 + random.normal(0, 1.5, touch.pixels.shape)
    assert found_in(written(tmp_path, kind, truth)) == {}


def brighter(truth: Truth) -> None:
    for touch in truth[1].touches[3:]:
        touch.pixels[:] = np.clip(touch.pixels * 1.3, 0, 255)


def flash(truth: Truth) -> None:
    pixels = truth[1].touches[2].pixels
    pixels[:] = np.clip(pixels * 1.3, 0, 255)


def swapped_round(truth: Truth) -> None:
    for touch in truth[1].touches:
        touch.pixels[:] = touch.pixels[..., ::-1].copy()


def swapped_touches(truth: Truth) -> None:
    for touch in truth[2].touches[:2]:
        touch.pixels[:] = touch.pixels[..., ::-1].copy()


def drifting(truth: Truth) -> None:
    for number, each in enumerate(truth):
        object.__setattr__(each, "gel_id", 1)
        for touch in each.touches:
            touch.pixels[:] = np.clip(touch.pixels + 5.0 * number, 0, 255)


def with_markers(truth: Truth) -> None:
    for touch in truth[3].touches:
        for y in range(4, SIZE[1], 8):
            for x in range(4, SIZE[0], 8):
                touch.pixels[:, y - 1 : y + 1, x - 1 : x + 1] //= 3


def constant(truth: Truth) -> None:
    truth[0].touches[2].pixels[:] = 90
    truth[0].touches[4].pixels[:] = np.random.default_rng(0).integers(0, 4, truth[0].touches[4].pixels.shape)


PICTURES: dict[str, tuple[Callable[[Truth], None], str, list[str]]] = {
    "exposure": (brighter, "exposure-jumps", ["1:3"]),
    "flash": (flash, "exposure-jumps", ["1:2"]),
    "swapped round": (swapped_round, "swapped-channels", [f"1:{touch}" for touch in range(TOUCHES)]),
    "swapped touches": (swapped_touches, "swapped-channels", ["2:0", "2:1"]),
    "drift": (drifting, "gel-drift", ["0:0-5", "4:0-5"]),
    "markers": (with_markers, "mixed-markers", ["3:0-5"]),
    "empty": (constant, "empty-pictures", ["0:2", "0:4"]),
}


@BOTH_KINDS
@pytest.mark.parametrize("plant", PICTURES)
def test_faults_of_pictures(plant: str, kind: str, tmp_path: Path) -> None:
    change, rule, touches = PICTURES[plant]
    truth = recorded()
    change(truth)
    assert sorted(found_in(written(tmp_path, kind, truth)).items()) == [(rule, touches)]


def frozen(truth: Truth) -> None:
    pixels = truth[1].touches[3].pixels
    pixels[5:9] = pixels[5]


def poses_at_rest(truth: Truth) -> None:
    touch = truth[2].touches[1]
    touch.position_m[:], touch.quaternion[:] = touch.position_m[0], touch.quaternion[0]


def far_frame(truth: Truth) -> None:
    truth[1].touches[2].position_m[7] += 0.05


def turned_frame(truth: Truth) -> None:
    truth[1].touches[2].quaternion[7] = [0.0, 1.0, 0.0, 0.0]


def same_turns(truth: Truth) -> None:
    truth[1].touches[2].quaternion[::2] *= -1  # the same rotations


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (frozen, {"frozen-frames": ["1:3"], "moving-poses": ["1:3"]}),
        (poses_at_rest, {"still-poses": ["2:1"]}),
        (far_frame, {"pose-jumps": ["1:2"]}),
        (turned_frame, {"pose-jumps": ["1:2"]}),
        (same_turns, {}),
    ],
)
def test_faults_of_clips(change: Callable[[Truth], None], found: object, tmp_path: Path) -> None:
    truth = recorded()
    change(truth)
    assert found_in(written(tmp_path, "seq", truth)) == found


def media(row: dict[str, Any]) -> list[dict[str, Any]]:
    name = next(name for name in ("sensor_image", "sensor_video") if name in row)
    return row[name]


def copy_touch(source: dict[str, Any], touch: int, target: dict[str, Any], to: int) -> None:
    for name in (
        *filter(lambda name: name.startswith(("gel_", "sensor", "video", "time", "touch")), source),
    ):
        target[name] = list(target[name])
        target[name][to] = source[name][touch]


def repeated(rows: Rows) -> None:
    copy_touch(rows["train"][0], 1, rows["train"][2], 4)


def shared_picture(rows: Rows) -> None:
    copy_touch(rows["train"][1], 3, rows["test"][0], 2)


def shared_object(rows: Rows) -> None:
    rows["test"][0]["object_id"] = rows["train"][3]["object_id"]


def no_bytes(rows: Rows) -> None:
    media(rows["train"][1])[3] = {"bytes": b"", "path": "none"}
    media(rows["train"][2])[0] = {"bytes": None, "path": None}


def cut_short(rows: Rows) -> None:
    entry = media(rows["train"][1])[3]
    entry["bytes"] = entry["bytes"][:40]


@BOTH_KINDS
@pytest.mark.parametrize(
    ("edit", "found"),
    [
        (repeated, {"duplicate-pictures": ["0:1", "2:4"]}),
        (shared_picture, {"shared-pictures": ["0:2", "1:3"]}),
        (shared_object, {"shared-objects": ["0:0-5", "3:0-5"]}),
        (no_bytes, {"empty-pictures": ["1:3", "2:0"]}),
        (cut_short, {"unreadable-touches": ["1:3"]}),
    ],
)
def test_faults_of_stored_bytes(edit, found, kind, tmp_path):
    assert found_in(written(tmp_path, kind, recorded(), edit)) == found


def one_frozen(rows: Rows) -> None:
    for touch in (2, 3, 4):
        media(rows["train"][1])[touch] = media(rows["train"][1])[1]


def frozen_at_rest(rows: Rows) -> None:
    one_frozen(rows)
    position = rows["train"][1]["gel_pose_cell_frame.position"]
    position[2:5] = [position[1]] * 3


def same_pose(rows: Rows) -> None:
    for name in ("gel_pose_cell_frame.position", "gel_pose_cell_frame.quaternion"):
        rows["train"][1][name] = [rows["train"][1][name][0]] * TOUCHES


def far_touch(rows: Rows) -> None:
    position = rows["train"][1]["gel_pose_cell_frame.position"]
    position[2] = position[2] * 1000.0  # in millimetres


@pytest.mark.parametrize(
    ("edit", "found"),
    [
        (one_frozen, {"frozen-frames": ["1:2", "1:3", "1:4"], "moving-poses": ["1:2", "1:3", "1:4"]}),
        (frozen_at_rest, {"frozen-frames": ["1:2", "1:3", "1:4"]}),
        (same_pose, {"still-poses": [f"1:{touch}" for touch in range(TOUCHES)]}),
        (far_touch, {"pose-jumps": ["1:2"]}),
    ],
)
def test_faults_of_images(edit: Callable[[Rows], None], found: object, tmp_path: Path) -> None:
    assert found_in(written(tmp_path, "single", recorded(), edit)) == found


def test_sets_without_poses_objects_and_gels(tmp_path: Path) -> None:
    truth = recorded()
    swapped_touches(truth)
    rows = factories.single_rows(truth)
    one_frozen({"train": rows})
    absent = ("gel_pose_cell_frame.position", "gel_pose_cell_frame.quaternion", "object_id", "info.gel_id")
    folder = factories.write_set(tmp_path, {"train": rows}, "single", Layout(leave_out=absent))
    findings = {each.rule: each.count for each in realtouch.check(folder).findings}
    assert findings == {"frozen-frames": 3, "swapped-channels": 2}


def gap(rows: Rows) -> None:
    times = rows["train"][2]["time_stamp_rel_seq"][1]
    times[9:] = [time + np.timedelta64(40, "ms") for time in times[9:]]


def jitter(rows: Rows) -> None:
    times = rows["train"][2]["time_stamp_rel_seq"][1]
    times[9] += np.timedelta64(20, "ms")


def backwards(rows: Rows) -> None:
    times = rows["train"][2]["time_stamp_rel_seq"][1]
    times[8], times[9] = times[9], times[8]


def other_rate(rows: Rows) -> None:
    times = rows["train"][2]["time_stamp_rel_seq"][1]
    times[:] = [times[0] + (time - times[0]) * 11 // 10 for time in times]


def no_time(rows: Rows) -> None:
    rows["train"][2]["time_stamp_rel_seq"][1][4] = None


@pytest.mark.parametrize(
    ("edit", "found"),
    [
        (gap, {"dropped-frames": ["2:1"]}),
        (jitter, {}),
        (backwards, {"times-run-back": ["2:1"]}),
        (no_time, {"times-run-back": ["2:1"]}),
        (other_rate, {"two-clocks": ["2:1"]}),
    ],
)
def test_faults_of_times(edit: Callable[[Rows], None], found: object, tmp_path: Path) -> None:
    assert found_in(written(tmp_path, "seq", recorded(), edit)) == found


def test_thresholds_are_options_and_workers_find_the_same(tmp_path: Path) -> None:
    folder = written(tmp_path, "seq", recorded(), gap)
    results = [realtouch.check(folder, workers=workers) for workers in (1, 3)]
    assert results[0].findings == results[1].findings
    assert results[0].decoded == results[1].decoded
    assert found_in(folder, limits=realtouch.CheckLimits(gap=2.5)) == {}
    assert found_in(folder, split="test") == {}
    with pytest.raises(InputError, match="frozen"):
        realtouch.CheckLimits(frozen=1)


def brighter_from(first: int, truth: Truth) -> Truth:
    for touch in (touch for each in truth[first:] for touch in each.touches):
        touch.pixels[:] = np.clip(touch.pixels * 1.3, 0, 255)
    return [replace(each, gel_id=1) for each in truth]


def test_a_step_between_rounds(tmp_path: Path) -> None:
    assert found_in(written(tmp_path, "seq", brighter_from(2, recorded()))) == {"exposure-jumps": ["2:0-5"]}


def test_a_step_of_the_limit_counts_and_the_way_back_does_not() -> None:
    levels = np.array([50, 50, 62, 62, 50, 50], np.float32)
    cells = np.broadcast_to(levels[:, None, None, None], (6, 12, 16, 3))
    assert outlying_steps(cells, 12.0) == [(2, 12.0)]
    assert outlying_steps(cells, 12.1) == []


def test_rounds_of_one_image_are_compared_with_their_neighbours(tmp_path: Path) -> None:
    truth = recorded(rounds=16, touches=1)
    assert found_in(written(tmp_path / "clean", "single", truth)) == {}
    found = found_in(written(tmp_path / "step", "single", brighter_from(9, truth)))
    assert found == {"exposure-jumps": ["9:0"]}


def test_damaged_rows_do_not_hide_the_others(tmp_path: Path) -> None:
    truth = recorded()
    swapped_touches(truth)
    rows = {"train": factories.single_rows(truth)}
    folder = factories.write_set(tmp_path, rows, "single", Layout(group_rows=1))
    file = next((folder / "data").glob("train-*"))
    spoil_pages(file, 1, "id")
    findings = {each.rule: each.touches for each in realtouch.check(folder).findings}
    assert findings["unreadable-touches"] == ("row 1:0-0",)
    assert findings["swapped-channels"] == (f"{truth[2].id}:0", f"{truth[2].id}:1")


@pytest.mark.parametrize("order", [1, -1])
def test_a_set_wholly_in_another_order_is_known_by_the_colours_of_the_sensor(order, tmp_path):
    gel = Image.fromarray(np.array(GELSIGHT_MINI, np.uint8).reshape(4, 4, 3))
    smooth = np.asarray(gel.resize(SIZE, Image.Resampling.BICUBIC)).astype(np.float64)
    truth = recorded()
    for touch in (touch for each in truth for touch in each.touches):
        # Content that the factory adds to its gel is kept.
        relief = touch.pixels - factories._gel(SIZE)
        touch.pixels[:] = np.clip(smooth + relief, 0, 255)[..., ::order]
    result = realtouch.check(written(tmp_path, "single", truth))
    found = [(each.rule, each.count) for each in result.findings]
    assert found == [("swapped-channels", len(truth) * TOUCHES)] * (order == -1)


@pytest.mark.sim
def test_the_colours_of_the_sensor_are_those_of_its_calibration() -> None:
    pytest.importorskip("taxim", reason="needs taxim, of the extra sim")
    bare = 255 * taxim_package().background
    rows, columns = (side // 4 for side in bare.shape[:2])
    averages = bare.reshape(4, rows, 4, columns, 3).mean(axis=(1, 3)).reshape(16, 3)
    assert (np.rint(averages) == GELSIGHT_MINI).all()


@needs_shared
@pytest.mark.parametrize("size", ["320x240", "64x64"])
@pytest.mark.parametrize("order", [1, -1])
def test_sample_images_of_the_published_sets(size: str, order: int, tmp_path: Path) -> None:
    (file,) = (SHARED / "touches").glob(f"*real*{size}.jpeg")
    pixels = np.asarray(Image.open(file).convert("RGB")).astype(np.int16)[..., ::order]
    random = np.random.default_rng(0)

    def noisy(_pixels: np.ndarray) -> bytes:
        return factories.encode_jpeg(
            np.clip(pixels + random.normal(0, 1.5, pixels.shape), 0, 255).astype(np.uint8)
        )

    folder = written(tmp_path, "single", recorded(rounds=3), encode=noisy)
    assert list(found_in(folder)) == ["swapped-channels"] * (order == -1)


def test_rendered_touches_of_equal_surfaces_are_no_fault(tmp_path: Path) -> None:
    scenes, touches = tmp_path / "scenes", tmp_path / "touches"
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 2), ("test", 1)))
    starstruck_gen.generate(spec, str(scenes))
    plan = tactile_sim.TouchPlan(1, 16, seed=3)
    tactile_sim.generate(str(scenes), tactile_sim.TouchSetSpec((64, 64), "depth", plan=plan), touches)
    assert realtouch.check(touches).findings == ()
    # A round that occurs twice is a duplicate nevertheless.
    file = next((touches / "data").glob("train-*"))
    table = pq.read_table(file)
    pq.write_table(pa.concat_tables([table, table.slice(1, 1)]), tmp_path / "twice.parquet")
    result = realtouch.check(tmp_path / "twice.parquet")
    assert [(each.rule, each.count) for each in result.findings] == [("duplicate-pictures", 32)]


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = recorded()
    swapped_round(truth)
    folder = written(tmp_path / "set", "single", truth, one_frozen)
    assert call("realtouch", "check", folder, "--pictures", tmp_path / "drawn", "--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert [each["rule"] for each in document["findings"]] == [
        "frozen-frames",
        "swapped-channels",
        "moving-poses",
    ]
    assert not document["ok"]
    assert len(document["pictures"]) == 3
    for path in document["pictures"]:
        with Image.open(path) as image:
            assert image.width > 300
    assert call("realtouch", "check", folder, "--split", "test") == 0
    assert "nothing was found" in capsys.readouterr().out
    assert call("realtouch", "check", tmp_path / "drawn") == 2
    assert "realtouch import" in capsys.readouterr().err


def test_findings_are_left_out_of_a_selection(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Near duplicates and objects in two splits; the manifest says which rounds left, and why."""
    truth = recorded(size=(160, 120))
    truth[0] = replace(truth[0], object_id=truth[5].object_id)
    folder = written(tmp_path / "set", "single", truth)
    assert call("realtouch", "resize", folder, "--size", "80x60", "--out", tmp_path / "small", "-q") == 0
    assert call("tactile", "merge", folder, tmp_path / "small", "--out", tmp_path / "both", "-q") == 0
    rules = {finding.rule for finding in realtouch.check(tmp_path / "both").findings}
    assert rules == {"near-duplicates", "shared-objects"}
    capsys.readouterr()
    assert call("realtouch", "check", tmp_path / "both", "--json") == 1
    document = tmp_path / "findings.json"
    document.write_text(capsys.readouterr().out)
    out = tmp_path / "clean"
    assert call("tactile", "select", tmp_path / "both", "--without", document, "--out", out) == 0
    assert "near-duplicates: touches of 6 rounds were left out" in capsys.readouterr().out
    assert call("tactile", "verify", out, "-q") == 0
    assert realtouch.check(out).ok
    kept = [realtouch.load(out, split) for split in ("train", "test")]
    assert not set(kept[0].object_ids) & set(kept[1].object_ids)
    assert len(kept[1]) == 1
    entries = read_manifest(open_folder(str(out))).spec["options"]["without"]
    assert {
        "rule": "shared-objects",
        "split": "train",
        "row": 0,
        "round": truth[0].id,
        "touches": None,
    } in entries
    # A finding that is removed is ignored; those of another set, and other documents, are refused.
    findings = json.loads(document.read_text())
    kept_rules = [finding for finding in findings["findings"] if finding["rule"] == "shared-objects"]
    document.write_text(json.dumps({"findings": kept_rules}))
    realtouch.select(tmp_path / "both", tmp_path / "objects", without=document)
    assert len(realtouch.load(tmp_path / "objects", "train")) == 8
    other = written(tmp_path / "other", "single", recorded(seed=3))
    with pytest.raises(InputError, match=r"names .* as row 0 of split 'train', which .*other' does not have"):
        realtouch.select(other, tmp_path / "none", without=document)
    document.write_text("[]")
    assert call("tactile", "select", folder, "--without", document, "--out", tmp_path / "none") == 2
    assert "--without" in (said := capsys.readouterr().err)
    assert "cannot be read as findings" in said
    assert not (tmp_path / "none").exists()


def test_each_rule_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "howto" / "check.md").read_text(encoding="utf-8")
    for name, rule in RULES.items():
        assert (
            f"| `{name}` | {rule.title} | {rule.expected.format(**asdict(realtouch.CheckLimits()))} |\n"
            in page
        )


@pytest.mark.parametrize(("size", "noise"), [((64, 64), 6), ((320, 240), 3), ((640, 480), 1)])
def test_markers_are_counted_at_any_size_and_noise_is_not_counted(size: tuple[int, int], noise: int) -> None:
    random = np.random.default_rng(0)
    width, height = size
    gel = factories._gel(size) + random.normal(0, noise, (height, width, 3))
    assert count_markers(np.clip(gel, 0, 255).astype(np.uint8)) == 0
    y, x = np.mgrid[0:height, 0:width]
    rows, columns = (np.arange(7) + 0.5) * height / 7, (np.arange(9) + 0.5) * width / 9
    away = np.hypot(y - rows[:, None, None, None], x - columns[:, None, None]).min(axis=(0, 1))
    dots = np.clip(0.016 * width - away + 0.5, 0, 1)
    marked = np.clip(gel * (1 - 0.6 * dots[..., None]), 0, 255).astype(np.uint8)
    assert abs((count_markers(marked) or 0) - 63) <= 2
