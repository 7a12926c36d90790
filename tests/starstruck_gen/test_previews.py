"""Pictures of scenes: the rejected positions are those of the sampler, drawn where they were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import starstruck_gen
from starstruck_gen import SamplingExhausted, SceneSpec, sample_scene, scene_rng
from starstruck_gen.make import GenerateSpec, generate
from starstruck_gen.placement import COLLISION_TESTS
from starstruck_gen.previews import REJECTED, draw_one, draw_trace, plan_previews, traced
from starstruck_gen.sampling import SceneTrace, trace_scene
from starstruck_gen.scene import centre_px, draw_scene
from tactile_toolkit.catalog.choose import Choice
from tactile_toolkit.catalog.spec import PreviewSpec
from tactile_toolkit.errors import InputError
from tests.starstruck_gen.strategies import specs

CROWDED = SceneSpec(stars=(3,), distractors=(5, 5), attempts=12)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("previews") / "scenes"
    generate(GenerateSpec(CROWDED, (("train", 9), ("test", 2)), seed=4), str(out))
    return out


def rejected_scene(seed: int = 0) -> SceneTrace:
    return next(
        trace
        for number in range(seed, seed + 100)
        if (trace := trace_scene(CROWDED, scene_rng(number))).scene.restarts and len(trace.rejected) > 5
    )


def red_px(pixels: np.ndarray) -> int:
    """Count pixels in the colour of rejected positions; edges of stars come near it by chance."""
    return int((np.abs(pixels.astype(int) - REJECTED).max(axis=2) < 30).sum())


@given(specs(), st.integers(0, 2**62))
def test_tracing_changes_nothing_and_tells_every_rejected_position(spec, seed):
    spec = replace(spec, attempts=20, restarts=20)
    try:
        scene = sample_scene(spec, scene_rng(seed))
    except SamplingExhausted:
        assume(False)
    trace = trace_scene(spec, scene_rng(seed))
    assert trace.scene == scene
    clear = COLLISION_TESTS[spec.collision]
    standing = set(scene.placements)
    for lost in trace.rejected:
        assert not clear(lost.candidate, lost.blocker, spec.clearance_m)
        assert lost.given_up == (lost.blocker not in standing)
        assert abs(lost.candidate.x_m) <= spec.half_area_m[0]
        assert abs(lost.candidate.y_m) <= spec.half_area_m[1]
    taken = sum(scene.attempts) - len(trace.rejected)
    # Every position drawn was taken or rejected; layouts that were given up took some, too.
    assert taken >= len(scene.placements)
    if not scene.restarts:
        assert taken == len(scene.placements)
        assert not any(lost.given_up for lost in trace.rejected)
        order = {placement: number for number, placement in enumerate(scene.placements)}
        blockers = [order[lost.blocker] for lost in trace.rejected]
        per_object = [tried - 1 for tried in scene.attempts]
        owners = [number for number, lost in enumerate(per_object) for _ in range(lost)]
        assert all(blocker < owner for blocker, owner in zip(blockers, owners, strict=True))
        for owner, lost in zip(owners, trace.rejected, strict=True):
            assert lost.candidate.shape == scene.placements[owner].shape


def test_an_unknown_class_cannot_be_traced():
    with pytest.raises(InputError, match="star_count is 9"):
        trace_scene(SceneSpec(), scene_rng(0), 9)


@pytest.mark.parametrize("px_per_mm", [4.0, pytest.param(6.5, marks=pytest.mark.thorough)])
def test_crosses_mark_the_rejected_positions_and_nothing_else_changes(px_per_mm):
    trace = rejected_scene()
    drawn = np.asarray(draw_trace(trace.scene.placements, trace.rejected, CROWDED, px_per_mm)).astype(int)
    bare = np.asarray(draw_trace(trace.scene.placements, (), CROWDED, px_per_mm)).astype(int)
    size = (drawn.shape[1], drawn.shape[0])
    changed = np.abs(drawn - bare).max(axis=2) > 40
    near = np.zeros_like(changed)
    for lost in trace.rejected:
        column, row = centre_px(lost.candidate, size, px_per_mm * 1e3)
        if not lost.given_up:
            assert np.abs(drawn[int(row), int(column)] - REJECTED).max() < 60
        assert changed[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2].any()
        reach = px_per_mm * 11
        rows, columns = np.ogrid[: size[1], : size[0]]
        near |= np.hypot(rows - row, columns - column) <= reach
    assert changed.any()
    assert not (changed & ~near).any()


def test_only_positions_of_the_scene_itself_are_red():
    trace = rejected_scene()
    given_up = [replace(lost, given_up=True) for lost in trace.rejected]
    bare = red_px(np.asarray(draw_trace(trace.scene.placements, (), CROWDED, 5.0)))
    assert red_px(np.asarray(draw_trace(trace.scene.placements, given_up, CROWDED, 5.0))) <= bare
    assert red_px(np.asarray(draw_trace(trace.scene.placements, trace.rejected, CROWDED, 5.0))) > bare + 50


def test_the_plain_picture_is_as_before():
    scene = sample_scene(SceneSpec(), scene_rng(5))
    picture = np.asarray(draw_scene(scene.placements, (0.12, 0.12), 4.0))
    assert picture.shape == (480, 480, 3)
    assert np.array_equal(picture, np.asarray(scene.draw()))
    for placement in scene.placements:
        column, row = centre_px(placement, (480, 480), 4000.0)
        colour = (214, 140, 20) if placement.is_star else (92, 110, 132)
        assert tuple(picture[int(row), int(column)]) == colour


def test_a_stored_scene_tells_what_was_rejected_while_it_was_made(folder, monkeypatch):
    for record in starstruck_gen.load(str(folder), "train"):
        trace = traced(record, CROWDED)
        assert trace is not None
        assert trace.scene == record.scene
        assert traced(record, None) is None
        assert traced(record, replace(CROWDED, cell_m=(0.13, 0.12))) is None
        assert traced(record, replace(CROWDED, stars=(1,))) is None
    monkeypatch.setattr(starstruck_gen.SceneRecord, "seed", -5)  # as another tool may have stored it
    assert traced(record, CROWDED) is None
    with pytest.raises(InputError, match="seed of a scene is -5; expected an integer from 0"):
        scene_rng(-5)


def test_without_a_specification_the_scene_is_drawn_all_the_same(folder):
    record = starstruck_gen.load(str(folder), "train")[0]
    with_spec = draw_one(record, CROWDED, "t")
    without = draw_one(record, None, "t")
    assert red_px(with_spec) > red_px(without) + 50
    shard = next((folder / "data").glob("train-*.parquet"))
    (planned,) = plan_previews(str(shard), PreviewSpec(kinds=("scene",))).pictures
    assert planned.draw().shape == with_spec.shape


def test_the_oblique_view_shows_every_object_in_its_colour(folder):
    record = starstruck_gen.load(str(folder), "train")[0]
    right = draw_one(record, CROWDED, "t")[:, 630:].astype(int)
    tops = {}
    for name, colour in (("star", (214, 140, 20)), ("other", (92, 110, 132))):
        share = right / np.array(colour)
        tops[name] = ((np.ptp(share, axis=2) < 0.06) & (share.mean(axis=2) > 0.6)).sum()
    stars, others = record.star_count, record.distractor_count
    assert tops["star"] > 300 * stars
    assert tops["other"] > 300 * others


def test_a_published_set_without_placements_is_drawn_from_its_meshes(folder, tmp_path):
    import pyarrow.parquet as pq

    shard = next((folder / "data").glob("train-*.parquet"))
    table = pq.ParquetFile(shard).read(use_threads=False)
    kept = [name for name in table.column_names if name in ("id", "label") or name.startswith("mesh")]
    pq.write_table(table.select(kept), tmp_path / "train.parquet")
    record = starstruck_gen.load(str(tmp_path / "train.parquet"))[0]
    assert not record.has_placements
    plan = plan_previews(str(tmp_path / "train.parquet"), PreviewSpec(kinds=("sheet", "scene")))
    assert plan.pictures[1].what.endswith("from above and obliquely")
    for planned in plan.pictures:
        pixels = planned.draw().astype(int)
        assert pixels.std() > 10
        assert (pixels[..., 0] - pixels[..., 2]).max() < 60  # nothing is as yellow as a star


def test_digits_are_no_scenes(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    from starstruck_gen.gallery import plan_gallery
    from tactile_toolkit.read.columns import feature_metadata, label_feature, vectors_type

    columns = {
        "id": pa.array([1], pa.int64()),
        "label": pa.array([3], pa.int64()),
        "mesh.vertices": pa.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]], vectors_type(pa.float32())),
        "mesh.faces": pa.array([[[0, 1, 2]]], vectors_type(pa.int32())),
    }
    places = {}
    for names in (tuple("0123456789"), ("1", "2", "3", "4")):
        table = pa.table(columns).replace_schema_metadata(feature_metadata({"label": label_feature(names)}))
        places[names] = str(tmp_path / f"train-{len(names)}.parquet")
        pq.write_table(table, places[names])
    digits, scenes = places.values()
    assert plan_gallery(Choice(scenes)).size == 1
    assert (
        plan_previews(scenes, PreviewSpec(kinds=("sheet",))).pictures[0].what == "1 scene of train from above"
    )
    with pytest.raises(InputError, match=r"holds digits; .*next: run `mnist3d preview "):
        plan_previews(digits, PreviewSpec())
    with pytest.raises(InputError, match=r"holds digits; .*next: run `mnist3d gallery "):
        plan_gallery(Choice(digits))


def test_sheets_show_each_scene_in_the_row_of_its_class(tmp_path):
    out = tmp_path / "mixed"
    generate(GenerateSpec(SceneSpec(), (("train", 12),), seed=1), str(out), ("train",))
    (planned,) = plan_previews(str(out), PreviewSpec(kinds=("sheet",), per_class=3)).pictures
    assert (planned.name, planned.what) == ("mixed-train-sheet.png", "9 scenes of train from above")
    pixels = planned.draw()
    places = []
    for record in list(starstruck_gen.load(str(out)))[:9]:
        tile = np.asarray(draw_scene(record.placements, (0.12, 0.12), 1.25))
        windows = np.lib.stride_tricks.sliding_window_view(pixels, (150,), axis=1)
        rows, columns = np.nonzero((windows[75:] == tile[75].T).all(axis=(2, 3))[: pixels.shape[0] - 150 + 1])
        (place,) = [
            (row, column)
            for row, column in zip(rows, columns, strict=True)
            if np.array_equal(pixels[row : row + 150, column : column + 150], tile)
        ]
        places.append((record.star_count, place))
    tops = {count: {row for each, (row, _) in places if each == count} for count in (1, 2, 3)}
    assert all(len(rows) == 1 for rows in tops.values())
    assert max(tops[1]) < max(tops[2]) < max(tops[3])


def test_the_usual_pictures_are_sheets_of_all_splits(folder):
    plan = plan_previews(str(folder), PreviewSpec())
    assert [picture.name for picture in plan.pictures] == ["scenes-train-sheet.png", "scenes-test-sheet.png"]
    assert len(plan_previews(str(folder), PreviewSpec(kinds=("all",))).pictures) == 3


def test_bad_input_is_named(folder, tmp_path):
    with pytest.raises(InputError, match="does not exist; expected a folder"):
        plan_previews(str(tmp_path / "absent"), PreviewSpec())
    with pytest.raises(InputError, match="no Parquet files"):
        plan_previews(str(tmp_path), PreviewSpec())
    with pytest.raises(InputError, match="no split 'holdout'"):
        plan_previews(str(folder), PreviewSpec(split="holdout"))
    with pytest.raises(InputError, match="no object with id 77"):
        plan_previews(str(folder), PreviewSpec(ids=(1, 77)))
    with pytest.raises(InputError, match="per_class of the previews is 0"):
        PreviewSpec(per_class=0)


def test_a_cross_is_as_tall_as_it_is_wide():
    lost = rejected_scene().rejected[0]
    lost = replace(lost, candidate=lost.candidate._replace(x_m=0.0, y_m=0.0), given_up=True)
    bare, crossed = (np.asarray(draw_trace((), some, CROWDED, 5.0)).astype(int) for some in ((), (lost,)))
    marked = np.abs(crossed - bare).max(axis=2) > 40
    rows, columns = np.nonzero(marked)
    assert abs(np.ptp(rows) - np.ptp(columns)) <= 1
    cross = marked[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    assert np.mean(cross == cross[:, ::-1]) > 0.8


def test_the_room_of_an_object_reaches_half_the_clearance_around_it():
    spec = replace(CROWDED, collision="circles", clearance_m=0.004)
    placement = rejected_scene().scene.placements[0]._replace(x_m=0.0, y_m=0.0)
    bare, drawn = (np.asarray(draw_trace(some, (), spec, 8.0)).astype(int) for some in ((), (placement,)))
    rows, columns = np.nonzero(np.abs(drawn - bare).max(axis=2) > 20)
    width_px = 8.0 * 1e3 * (2 * placement.radius_m + spec.clearance_m)
    assert np.ptp(columns) + 1 == pytest.approx(width_px, abs=2)
    assert np.ptp(rows) + 1 == pytest.approx(width_px, abs=2)
