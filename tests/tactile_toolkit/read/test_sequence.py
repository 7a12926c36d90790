"""All data sets have the same interface for selecting, dividing, comparing and converting."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, strategies as st

import mnist3d
import realtouch
import starstruck_gen
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import Record, RecordDataset, Row, RowGroup, Shard, ShardedTable
from tests.realtouch import factories

LABELS = np.repeat([0, 1, 2], [50, 30, 20])


class Rows(RecordDataset[Record]):
    """Rows of ids, labels and numbers."""


def written(folder: Path, **columns: Any) -> Rows:
    folder.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), folder / "train-00000-of-00001.parquet", row_group_size=7)
    return opened(folder)


def opened(folder: Path) -> Rows:
    shard = Shard(str(folder / "train-00000-of-00001.parquet"))
    return Rows(ShardedTable((shard,)), label_names=("a", "b", "c"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rows") / "some"
    numbers = np.random.default_rng(0).permutation(100)
    value = pa.array([None if n % 10 == 0 else float(n) for n in range(100)])
    lists = pa.array([[float(n), float("nan")] for n in range(100)])
    written(path, id=numbers, label=LABELS, value=value, name=[f"n{n}" for n in range(100)], points=lists)
    return path


@pytest.fixture
def rows(folder: Path) -> Rows:
    return opened(folder)


@pytest.fixture(scope="module")
def every_set(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A small data set of each kind, and data sets without files."""
    place = tmp_path_factory.mktemp("kinds")
    spec = mnist3d.SolidSpec(target_vertices=400)
    made = mnist3d.DigitSetSpec(SyntheticSource(), spec, per_class=1)
    mnist3d.generate(made, place / "digits", splits=("test",))
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 12),)), place / "scenes")
    rounds = [factories.make_round(number, 4, (48, 32), (12, 16)) for number in range(4)]
    factories.write_set(place / "images", {"train": factories.single_rows(rounds)}, "single")
    factories.write_set(place / "clips", {"train": factories.seq_rows(rounds)}, "seq")
    images, clips = realtouch.load(place / "images"), realtouch.load(place / "clips")
    return {
        "digits": mnist3d.load(str(place / "digits")),
        "scenes": starstruck_gen.load(str(place / "scenes")),
        "endless": starstruck_gen.SceneDataset(size=12, seed=5),
        "images": images,
        "touches": images.touches(),
        "clips": clips,
        "touches of clips": clips.touches(),
    }


KINDS = ("digits", "scenes", "endless", "images", "touches", "clips", "touches of clips")


@pytest.mark.parametrize("kind", KINDS)
def test_one_vocabulary(every_set: dict[str, Any], kind: str) -> None:
    items = every_set[kind]
    assert items.labels.dtype == np.int64
    assert items.labels.tolist() == [item.label for item in items]
    label = int(items.labels[-1])
    expected = [item for item in items if item.label == label]
    for wanted in ((label,), (items.label_names[label],), ([label],), (np.array([label]),)):
        assert list(items.filter_labels(*wanted)) == expected
    assert list(items.filter(lambda item: item.label == label)) == expected
    assert [len(view) for view in items.by_label().values()] == np.bincount(
        items.labels, minlength=len(items.label_names)
    ).tolist()
    assert items.select(range(3)) == items[:3] == items.select(iter([0, 1, 2]))
    mixed = items.shuffle(4)
    assert sorted(map(items.index, mixed)) == list(range(len(items)))
    assert items.sample(3, 4) == mixed[:3]
    first, second = items.split(0.5, seed=4)
    assert first + second == mixed
    some = first[::2] + second[:1]
    assert list(some.filter_labels(label)) == [item for item in some if item.label == label]
    table = items.to_pandas()
    assert table["label"].tolist() == items.labels.tolist()
    assert type(items).__name__ in repr(items)
    assert "\n" not in repr(items)


class Tensor:
    """An object with the protocol by which NumPy reads tensors."""

    def __init__(self, values: Any) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype)

    def __index__(self) -> int:
        return int(self.values)


@pytest.mark.parametrize("kind", KINDS)
def test_tensors_select_like_lists_and_arrays(every_set: dict[str, Any], kind: str) -> None:
    items = every_set[kind]
    for chosen in ([2, 0], [-1], [], [True] + [False] * (len(items) - 2) + [True]):
        expected = items[chosen]
        for given_index in (Tensor(chosen), np.array(chosen, bool if True in chosen else int)):
            found = items[given_index]
            assert type(found) is type(items)
            assert found == expected == items.select(given_index)
    assert items.select(iter([2, 0])) == items[[2, 0]]
    for index in (Tensor(1), np.int64(1), np.array(1), np.uint8(1)):
        assert items[index] == items[1]
    for wrong in (Tensor([0.5]), Tensor([[0]]), np.array(0.5), "0"):
        with pytest.raises(TypeError):
            items[wrong]
    if kind == "images":
        record = items[1]
        assert np.array_equal(record.sensor_image[Tensor([1, 0])], record.sensor_image[[1, 0]])
        poses = record.gel_pose_cell_frame
        assert np.array_equal(poses[Tensor([1, 0])].position_m, poses[[1, 0]].position_m)
        assert np.array_equal(poses[np.array(1)].translation, poses[1].translation)
    if kind == "clips":
        clips = items[1].sensor_video
        assert np.array_equal(clips[Tensor([1, 0])][0][Tensor([3, 1])], clips[1][[3, 1]])


@pytest.mark.parametrize("kind", KINDS)
def test_items_and_sets_compare_by_value(every_set: dict[str, Any], kind: str) -> None:
    items = every_set[kind]
    copy = pickle.loads(pickle.dumps(items))
    assert copy == items
    assert hash(copy) == hash(items)
    assert items[:3] == items[[0, 1, 2]] != items[1:4]
    for place in (0, len(items) - 1):
        item, other = items[place], pickle.loads(pickle.dumps(items[place]))
        assert item == items[place] == other == pickle.loads(pickle.dumps(other))
        assert len({item, items[place], other}) == 1
        assert item in items
        assert other in copy
        assert (items.index(other), items.count(other)) == (place, 1)
        assert items.index(other, -len(items)) == place
        assert item != items[place - 1]
        assert item not in items[:place] + items[place + 1 :]
        with pytest.raises(ValueError, match=r"^$"):
            items.index(other, place + 1)
    twice = items[[1, 0, 1]]
    assert (twice.index(items[1]), twice.count(items[1])) == (0, 2)
    for stranger in (3, "3", None, object()):
        assert stranger not in items
        assert items.count(stranger) == 0
        assert items[0] != stranger
    assert items != list(items)


@pytest.mark.parametrize("kind", KINDS)
def test_items_are_found_by_their_ids(every_set: dict[str, Any], kind: str) -> None:
    data = every_set[kind]
    for item in (data[0], data[len(data) - 1]):
        assert data.by_id(item.id) == item
        assert data[::-1].by_id(item.id) == item
    item = data[1]
    without = data[[place for place in range(len(data)) if place != 1]]
    with pytest.raises(InputError, match=rf"there is no id {item.id!r}; next: give one such as ") as caught:
        without.by_id(item.id)
    assert repr(data[0].id) in str(caught.value)
    for wrong in ("nothing", 10**9, None):
        with pytest.raises(InputError, match=f"there is no id {wrong!r}; next: give one such as "):
            data.by_id(wrong)
    with pytest.raises(InputError, match="it is empty"):
        data[:0].by_id(item.id)


def test_equal_values_from_elsewhere_are_equal(every_set: dict[str, Any], tmp_path: Path) -> None:
    """Records stand for their values, not for the file that they are in; scenes without files too."""
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 12),), seed=5), tmp_path / "seed-5")
    stored, endless = starstruck_gen.load(str(tmp_path / "seed-5")), every_set["endless"]
    assert [one == other for one, other in zip(stored, endless, strict=True)] == [True] * 12
    assert {*stored} == {*endless}
    assert stored[0] != every_set["scenes"][0]
    assert endless != starstruck_gen.SceneDataset(size=12, seed=6)
    assert endless[0] != starstruck_gen.SceneDataset(size=12, seed=6)[0]


@given(
    st.recursive(
        st.none() | st.floats(width=32),
        lambda inner: st.lists(inner, max_size=3) | st.fixed_dictionaries({"a": inner}),
        max_leaves=5,
    ),
    st.data(),
)
def test_values_agree_with_their_pickled_arrow_copy(value: Any, data: st.DataObject) -> None:
    try:
        array = pa.array([value, value])
    except (pa.ArrowInvalid, pa.ArrowTypeError):  # of several types
        return
    group = RowGroup(pa.table({"value": array}))
    place = data.draw(st.integers(0, 1))
    copy = pickle.loads(pickle.dumps(Row(group, place)))
    assert Row(group, 1 - place).equals(copy)
    other = Row(RowGroup(pa.table({"value": pa.array([{"b": 0}])})), 0)
    assert not other.equals(copy)


def test_random_selections_are_the_same_everywhere(rows: Rows) -> None:
    """Golden values: shuffles of NumPy may change with its version, the stream of PCG64 may not."""
    assert rows.shuffle(7)[:8].ids.tolist() == rows.ids[[37, 6, 32, 96, 98, 24, 90, 23]].tolist()
    _ = [record.row.value("value") for record in rows[::-3]]
    assert rows.sample(5, 7).ids.tolist() == rows.shuffle(7).ids.tolist()[:5]
    assert rows.shuffle(7).ids.tolist() != rows.shuffle(8).ids.tolist()
    for wrong in (-1, 1.5, None, "3", True):
        with pytest.raises(InputError, match="expected an integer of at least 0"):
            rows.shuffle(wrong)  # type: ignore[arg-type]
    for wrong in (101, -1, 2.5):
        with pytest.raises(InputError, match="expected an integer from 0 to 100"):
            rows.sample(wrong, 0)  # type: ignore[arg-type]
    assert (len(rows.sample(0, 1)), len(rows.sample(100, 1))) == (0, 100)


@given(st.lists(st.floats(0, 0.4), min_size=1, max_size=4), st.integers(0, 99), st.booleans())
def test_splits_are_parts_of_the_right_sizes(shares: list[float], seed: int, stratify: bool) -> None:
    if sum(shares) > 1:
        shares = [share / sum(shares) for share in shares]
    rows = Rows(Labelled(), label_names=("a", "b", "c"))
    parts = rows.split(*shares, seed=seed, stratify=stratify)
    assert len(parts) in (len(shares), len(shares) + 1)
    taken = np.concatenate([part._rows for part in parts])
    assert sorted(taken.tolist()) == list(range(100))
    for part, share in zip(parts, shares, strict=False):
        assert abs(len(part) - 100 * share) < 1.0000001
        if stratify:
            counts = np.bincount(part.labels, minlength=3)
            assert (np.abs(counts - share * np.array([50, 30, 20])) < 3).all()
    assert [part._rows.tolist() for part in rows.split(*shares, seed=seed, stratify=stratify)] == [
        part._rows.tolist() for part in parts
    ]


class Labelled(ShardedTable):
    """A hundred rows without a file."""

    def __init__(self) -> None:
        super().__init__(())

    def __len__(self) -> int:
        return 100

    def column(self, name: str) -> Any:
        return LABELS


def test_tables_read_plain_columns_only(rows: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    read = Shard.read
    monkeypatch.setattr(Shard, "read", lambda self, **options: asked.append(options) or read(self, **options))
    table = rows[::-1].to_pandas()
    assert table.columns.tolist() == ["id", "label", "value", "name"]
    assert table["name"].tolist() == [f"n{n}" for n in range(99, -1, -1)]
    assert rows.column_names == ("id", "label", "value", "name", "points")
    assert {options["columns"][0] for options in asked} == {"id", "label", "value", "name"}
    known = np.array([n for n in range(100) if n % 10])
    figures = table.describe()["value"]
    assert (figures["min"], figures["max"], figures["count"]) == (1, 99, 90)
    assert figures["mean"] == pytest.approx(known.mean())


def test_a_hugging_face_set_shares_the_rows(every_set: dict[str, Any], rows: Rows) -> None:
    digits = every_set["digits"]
    shared = digits.to_hf()
    assert shared.features["label"].names == list(digits.label_names)
    assert shared[:]["id"] == digits.ids.tolist()
    np.testing.assert_array_equal(np.array(shared[3]["mesh.vertices"], np.float32), digits[3].vertices_m)
    mapped = digits.table.locate(3)[0].table.column("mesh.vertices").chunk(0)
    there = shared.data.column("mesh.vertices").chunk(0)
    assert there.values.values.buffers()[1].address == mapped.values.values.buffers()[1].address
    some = digits[[7, 2, 7]]
    assert some.to_hf()[:]["id"] == some.ids.tolist()
    assert (digits[5:] + digits[:2]).to_hf()[:]["id"] == (digits[5:] + digits[:2]).ids.tolist()
    assert digits[:0].to_hf().features == shared.features
    assert digits.to_hf()._fingerprint == shared._fingerprint != some.to_hf()._fingerprint
    assert rows.to_hf()[:]["id"] == rows.ids.tolist()
    endless = every_set["endless"][4:6]
    assert endless.to_hf()[:]["seed"] == [scene.seed for scene in endless]


@pytest.mark.parametrize("kind", ["touches", pytest.param("touches of clips", marks=pytest.mark.torch)])
def test_a_hugging_face_set_of_touches_has_a_row_each(every_set: dict[str, Any], kind: str) -> None:
    if kind == "touches of clips":
        pytest.importorskip("torchcodec", reason="datasets decodes clips with torchcodec (extra `torch`)")
    touches = every_set[kind][[9, 2, 15, 9]]
    shared = touches.to_hf()
    assert shared[:]["id"] == [touch.round_id for touch in touches]
    assert shared[:]["label"] == touches.labels.tolist()
    assert shared[:]["touch_index"] == touches.touch_indices.tolist()
    assert set(shared.column_names) == set(touches.column_names)
    np.testing.assert_array_equal(shared[:]["pos_in_cell"], [touch.pos_in_cell_m for touch in touches])
    if kind == "touches":
        np.testing.assert_array_equal(np.asarray(shared[2]["sensor_image"]), touches[2].image)
    else:
        stored = shared.data.column("sensor_video").take([shared._indices.column(0)[2].as_py()])
        assert stored[0].as_py()["bytes"] == bytes(touches[2].clip.data)
    assert touches[:0].to_hf().column_names == shared.column_names
    table = touches.to_pandas()
    np.testing.assert_array_equal(
        table[["x_m", "y_m"]].to_numpy(), [touch.pos_in_cell_m for touch in touches]
    )


def test_repr_describes_the_content(every_set: dict[str, Any], rows: Rows, tmp_path: Path) -> None:
    digits, touches = every_set["digits"], every_set["touches"]
    assert repr(digits[3:4]) == f"DigitDataset(1 digit of 'digits', split test, class {digits[3].label})"
    assert repr(touches[:4]) == "Touches(4 touches of 4 rounds of 'images', split train, class 0)"
    assert repr(rows[:60] + rows) == "Rows(160 rows of 'some', split train, classes a, b, c)"
    assert repr(rows[:0]) == "Rows(0 rows of 'some', split train, no classes)"
    assert repr(every_set["endless"][:2]) == "SceneDataset(2 scenes of seed 5, split train, classes 1, 2)"
    hub = Shard("/home/me/hub/datasets--me--my-digits/snapshots/0123/data/test-00000-of-00001.parquet")
    streamed = Shard("hf://datasets/me/my-digits@0123/data/test-00000-of-00001.parquet")
    assert ShardedTable((hub, streamed)).origins == [("'me/my-digits'", "test")] * 2
    hostile = written(tmp_path / "a\x1b[2Jb\u202e<b>", id=[1], label=[0])
    assert repr(hostile) == "Rows(1 row of 'a\\x1b[2Jb\\u202e<b>', split train, class a)"
    assert "<b>" not in hostile._repr_html_()
    (tmp_path / "bad").mkdir()
    broken = written(tmp_path / "bad", id=[1], label=[None])
    assert "classes unreadable" in repr(broken)


@pytest.mark.parametrize("kind", KINDS)
def test_notebooks_show_small_pictures(every_set: dict[str, Any], kind: str) -> None:
    items = every_set[kind]
    page = items._repr_html_()
    assert page.count("<img") == min(len(items), 8)
    assert len(page) < 400_000
    assert "<img" in items[0]._repr_html_()
    assert "<img" not in items[:0]._repr_html_()


def test_meshes_have_the_repr_of_trimesh(every_set: dict[str, Any]) -> None:
    digit = every_set["digits"][0]
    mesh = mnist3d.Mesh(digit.vertices_m, digit.faces)
    expected = repr(digit.mesh).replace("trimesh.Trimesh", "Mesh").replace("vertices.", "vertices_m.")
    assert repr(mesh) == expected


def test_the_only_split_is_opened(tmp_path: Path) -> None:
    rounds = [factories.make_round(number, 4, (48, 32)) for number in range(2)]
    rows = factories.single_rows(rounds)
    factories.write_set(tmp_path / "one", {"test": rows}, "single")
    factories.write_set(tmp_path / "two", {"test": rows, "train": rows[:1]}, "single")
    assert realtouch.load(tmp_path / "one") == realtouch.load(tmp_path / "one", "test")
    with pytest.raises(InputError, match=r"two' has the splits test, train; expected one of them"):
        realtouch.load(tmp_path / "two")
    assert len(realtouch.load(tmp_path / "two", "train")) == 1
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="is empty; expected a data set"):
        mnist3d.load(str(tmp_path / "none"))
