"""Further columns of a data set: they are read, kept by every conversion, and described in the card."""

from __future__ import annotations

import json
import pickle
import re
import tarfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from tactile_toolkit.errors import InputError, IntegrityError
from tests.command_line import call
from tests.realtouch import factories

FORCES = {"train": [[1.5, None, 3.25], [4.0, 5.5]], "test": [[6.0, 7.0]]}
COUNTS = {"train": [[1, 2, None], [2**40, 5]], "test": [[6, 7]]}
NOTES = {"train": [["dry", None, "wet"], ["a", "b"]], "test": [["", "c"]]}
GOOD = {"train": [[True, False, None], [True, True]], "test": [[False, False]]}
WRENCH = {"train": [[[1.0, 2.0], None, [3.0, None]], [[4.0, 5.0]] * 2], "test": [[[0.0, 1.0]] * 2]}
NUMBER = pa.float64()


def of_touches(split: str) -> dict[str, pa.Array]:
    """Columns with an entry for each touch; one has the name of a column of exports."""
    return {
        "extra.force_n": pa.array(FORCES[split], pa.list_(NUMBER)),
        "extra.count": pa.array(COUNTS[split], pa.list_(pa.int64())),
        "extra.operator.note": pa.array(NOTES[split], pa.list_(pa.string())),
        "extra.good": pa.array(GOOD[split], pa.list_(pa.bool_())),
        "extra.wrench": pa.array(WRENCH[split], pa.list_(pa.list_(NUMBER, 2))),
        "extra.ragged": pa.array(WRENCH[split], pa.list_(pa.list_(pa.float32()))),
        "extra.label": pa.array(FORCES[split], pa.list_(NUMBER)),
    }


def of_frames(split: str) -> dict[str, pa.Array]:
    """Columns with an entry for each frame: 100 round + 10 touch + frame, and vectors of it."""
    rows = [
        [
            [float(100 * number + 10 * touch + frame) for frame in range(length)]
            for touch, length in enumerate(lengths)
        ]
        for number, lengths in enumerate(LENGTHS[split])
    ]
    rows[0][0][0] = None
    vectors = [[[None if x is None else [x, -x] for x in touch] for touch in row] for row in rows]
    texts = [[[None if x is None else f"at {x:g}" for x in touch] for touch in row] for row in rows]
    return {
        "extra.force_n": pa.array(FORCES[split], pa.list_(NUMBER)),
        "extra_seq.time.ms": pa.array(rows, pa.list_(pa.list_(NUMBER))),
        "extra_seq.vector": pa.array(vectors, pa.list_(pa.list_(pa.list_(NUMBER, 2)))),
        "extra_seq.state": pa.array(texts, pa.list_(pa.list_(pa.string()))),
    }


LENGTHS = {
    split: [
        [touch.frames for touch in factories.make_round(number, count, (48, 36), (4, 6)).touches]
        for number, count in enumerate(counts)
    ]
    for split, counts in factories.BARE_TOUCHES.items()
}


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return factories.bare_set(tmp_path_factory.mktemp("images"), "single", extras=of_touches)


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return factories.bare_set(tmp_path_factory.mktemp("clips"), "seq", extras=of_frames)


def same(found: Any, expected: Any) -> None:
    np.testing.assert_array_equal(found, expected)
    assert not np.asarray(found).flags.writeable or np.asarray(found).ndim == 0


def test_columns_of_touches_are_read_with_their_gaps(images: Path) -> None:
    first, second = realtouch.load(images, "train")
    nan = np.nan
    assert list(first.extra) == ["force_n", "count", "operator.note", "good", "wrench", "ragged", "label"]
    same(first.extra["force_n"], [1.5, nan, 3.25])
    same(first.extra["count"], [1.0, 2.0, nan])
    same(second.extra["count"], np.array([2**40, 5]))
    assert second.extra["count"].dtype == np.int64
    assert first.extra["operator.note"].tolist() == ["dry", None, "wet"]
    assert first.extra["good"].tolist() == [True, False, None]
    assert second.extra["good"].dtype == bool
    same(first.extra["wrench"], [[1, 2], [nan, nan], [3, nan]])
    same(first.extra["ragged"], np.array([[1, 2], [nan, nan], [3, nan]], np.float32))
    assert first.extra["ragged"].dtype == np.float32
    touch = realtouch.load(images, "train").touches()[2]
    assert (touch.extra["force_n"], touch.extra["operator.note"]) == (3.25, "wet")
    same(touch.extra["wrench"], [3, nan])
    assert touch.label == -1


def test_columns_of_frames_are_read_touch_by_touch(clips: Path) -> None:
    _, second = realtouch.load(clips, "train")
    for touch, length in enumerate(LENGTHS["train"][1]):
        expected = 100.0 + 10 * touch + np.arange(length)
        same(second.extra["time.ms"][touch], expected)
        same(second.extra["vector"][touch], np.column_stack([expected, -expected]))
        same(realtouch.Touch(second, touch).extra["time.ms"], expected)
    first = realtouch.load(clips, "train")[0]
    assert np.isnan(first.extra["vector"][0][0]).all()
    assert first.extra["state"][0].tolist()[:2] == [None, "at 1"]


def test_a_column_is_read_on_first_use(images: Path, tmp_path: Path) -> None:
    record = realtouch.load(images, "train")[0]
    assert "force_n" in record.extra
    with pytest.raises(KeyError, match=r"no further column 'force'.*did you mean 'force_n'") as caught:
        record.extra["force"]
    assert isinstance(caught.value, InputError)
    assert isinstance(pickle.loads(pickle.dumps(caught.value)), KeyError)
    assert record.extra.get("force") is None
    assert not realtouch.load(factories.bare_set(tmp_path, "single"), "train")[0].extra


@pytest.mark.parametrize(
    ("column", "values", "problem"),
    [
        ("extra.force_n", pa.array([[1.0], [1.0, 2.0]]), "'extra.force_n': 1 touches; expected 3"),
        ("extra.force_n", pa.array([None, [1.0, 2.0]]), "'extra.force_n': "),
        ("extra.force_n", pa.array([[[1.0], [1.0, 2.0], []], [[1.0]] * 2]), "vectors of 0 and of 2 values"),
        ("extra.force_n", pa.array([1.0, 2.0]), "'extra.force_n': the column has the type double; expected"),
        (
            "extra.force_n",
            pa.array([[b"a"] * 3, [b"b"] * 2]),
            "type list<.*binary>; expected a number, a text",
        ),
        (
            "extra_seq.a",
            pa.array([[[1.0]] * 3, [[1.0]] * 2]),
            "touch 0, field 'extra_seq.a': 1 frame; expected",
        ),
        (
            "extra_seq.a",
            pa.array([[1.0] * 3, [1.0] * 2]),
            "expected a number, a text or a list of them, one per",
        ),
    ],
)
def test_damaged_columns_are_named(column: str, values: pa.Array, problem: str, tmp_path: Path) -> None:
    kind = "seq" if column.startswith("extra_seq") else "single"
    folder = factories.bare_set(
        tmp_path, kind, extras=lambda split: {column: values} if split == "train" else of_touches(split)
    )
    found = [str(each) for each in realtouch.verify(folder, "train").findings]
    assert any(re.search(problem, each) for each in found), found
    with pytest.raises(IntegrityError, match=problem):
        realtouch.load(folder, "train")[0].extra[column.split(".")[1]]


def equal(one: Any, other: Any) -> bool:
    return repr([np.asarray(part).tolist() for part in one]) == repr(
        [np.asarray(part).tolist() for part in other]
    )


@pytest.mark.parametrize("kind", ["images", "clips"])
@pytest.mark.parametrize(
    "convert",
    [
        lambda source, out: realtouch.select(source, out, contact=False),
        lambda source, out: realtouch.resize(source, out, 24, 18),
        lambda source, out: call("tactile", "merge", source, "--out", out) == 0,
        lambda source, out: call("tactile", "split", source, "--fractions", "1.0", "--out", out) == 0,
    ],
    ids=["select", "resize", "merge", "split"],
)
def test_conversions_keep_them(kind, convert, images, clips, tmp_path):
    source = {"images": images, "clips": clips}[kind]
    convert(source, tmp_path / "out")
    place = next(path for path in (tmp_path / "out" / "part-1", tmp_path / "out") if path.exists())
    made = {record.id: record for record in realtouch.load(place, "train")}
    for record in realtouch.load(source, "train"):
        for name in record.extra:
            assert equal(record.extra[name], made[record.id].extra[name]), name


def taken(values: Any, touches: list[int]) -> list[Any]:
    return [values[touch] for touch in touches]


@pytest.mark.parametrize("kind", ["images", "clips"])
def test_some_touches_keep_theirs(kind, images, clips, tmp_path, monkeypatch):
    source = {"images": images, "clips": clips}[kind]
    record = realtouch.load(source, "train")[0]
    chosen = record.with_touches([2, 0])
    alone = pickle.loads(pickle.dumps(realtouch.Touch(record, 2)))
    monkeypatch.setattr(
        "realtouch.touches.datasets._contacts_by_image",
        lambda touches, threads: SimpleNamespace(contact=touches.touch_indices != 1),
    )
    realtouch.select(source, tmp_path / "out", contact=True, split="train")
    kept = realtouch.load(tmp_path / "out", "train")[0]
    for name in record.extra:
        assert equal(chosen.extra[name], taken(record.extra[name], [2, 0]))
        assert equal([alone.extra[name]], [realtouch.Touch(record, 2).extra[name]])
        assert equal(kept.extra[name], taken(record.extra[name], [0, 2]))


def test_images_of_clips_have_the_values_of_their_frame(clips: Path, tmp_path: Path) -> None:
    realtouch.clips_to_images(clips, tmp_path / "out", "contact_start")
    for record, made in zip(
        realtouch.load(clips, "train"), realtouch.load(tmp_path / "out", "train"), strict=True
    ):
        frames = [clip.contact_index("contact_start") for clip in record.sensor_video]
        assert equal(made.extra["force_n"], record.extra["force_n"])
        for name in ("time.ms", "vector", "state"):
            of_frames = record.extra[name]
            assert equal(made.extra[name], [of_frames[touch][frame] for touch, frame in enumerate(frames)])
    assert realtouch.verify(tmp_path / "out").findings == ()


def test_features_state_their_types(images: Path, tmp_path: Path) -> None:
    datasets = pytest.importorskip("datasets")
    realtouch.select(images, tmp_path / "out", split="train")
    features = pq.read_schema(tmp_path / "out/data/train-00000-of-00001.parquet").metadata[b"huggingface"]
    stated = datasets.Features.from_dict(json.loads(features)["info"]["features"])
    assert stated["extra.wrench"] == datasets.List(datasets.List(datasets.Value("float64"), length=2))
    assert stated["label"].names == []
    rows = realtouch.load(images, "train").touches().to_hf()
    assert rows["extra.force_n"][:] == [1.5, None, 3.25, 4.0, 5.5]
    assert rows["extra.wrench"][1] is None


FLAT = {
    "force_n": [1.5, None, 3.25, 4.0, 5.5],
    "count": [1, 2, None, 2**40, 5],
    "operator.note": ["dry", None, "wet", "a", "b"],
    "good": [True, False, None, True, True],
    "wrench": [[1.0, 2.0], None, [3.0, None], [4.0, 5.0], [4.0, 5.0]],
    "extra_label": [1.5, None, 3.25, 4.0, 5.5],
}


@pytest.mark.parametrize("layout", ["flat", "png"])
def test_tables_of_exports_have_them_as_plain_columns(layout: Any, images: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    realtouch.export(images, out, layout, split="train")
    table = pq.read_table(out / "data/train-00000-of-00001.parquet")
    for name, values in FLAT.items():
        assert table[name].to_pylist() == values
    assert table["label"].to_pylist() == [-1] * 5
    assert realtouch.verify(out).findings == ()


@pytest.mark.parametrize("layout", ["webdataset", "fota"])
def test_tars_have_them_as_fields(layout: Any, images: Path, tmp_path: Path) -> None:
    realtouch.export(images, tmp_path, layout, split="train")
    with tarfile.open(next(tmp_path.rglob("*.tar"))) as tar:
        texts = [tar.extractfile(member).read() for member in tar if member.name.endswith(".json")]
    fields = [json.loads(text) for text in texts]
    for name, values in FLAT.items():
        assert [each[name] for each in fields] == values


def test_numbers_that_json_lacks(tmp_path: Path) -> None:
    numbers = [[np.nan, np.inf, -np.inf], [3.0, 3.0]]
    columns = {"train": pa.array(numbers), "test": pa.array([[1.0, 2.0]])}
    folder = factories.bare_set(
        tmp_path / "set", "single", extras=lambda split: {"extra.force_n": columns[split]}
    )
    realtouch.export(folder, tmp_path / "out", "webdataset", split="train")
    content = next((tmp_path / "out").rglob("*.tar")).read_bytes()
    found = re.findall(rb'"force_n":([^,}]*)', content)
    assert found == [b"null", b"1e999", b"-1e999", b"3.0", b"3.0"]
    assert [json.loads(number) for number in found[1:3]] == [np.inf, -np.inf]


def test_exports_of_clips_have_the_values_of_the_shown_frame(clips: Path, tmp_path: Path) -> None:
    realtouch.export(clips, tmp_path, "flat", split="train", frame="contact_start")
    table = pq.read_table(tmp_path / "data/train-00000-of-00001.parquet")
    expected = [
        touch.extra["time.ms"][touch.clip.contact_index("contact_start")]
        for touch in realtouch.load(clips, "train").touches()
    ]
    assert table["time.ms"].to_pylist() == expected
    assert table["vector"].to_pylist() == [[each, -each] for each in expected]
    assert table["force_n"].to_pylist() == FLAT["force_n"]


def test_a_new_size_of_pictures_needs_pixels_that_are_known(tmp_path: Path) -> None:
    points = {"train": pa.array([[[3.0, 4.0]] * 3, [[1.0, 2.0]] * 2]), "test": pa.array([[[1.0, 2.0]] * 2])}
    folder = factories.bare_set(
        tmp_path / "set", "single", extras=lambda split: {"extra.tip_px": points[split]}
    )
    with pytest.raises(InputError, match=r"has pixels in tip_px.*--map tip_px="):
        realtouch.resize(folder, tmp_path / "out", 8, 8)


def test_card_and_info_state_type_and_range(images: Path, clips: Path, tmp_path: Path, capsys: Any) -> None:
    realtouch.select(images, tmp_path / "images")
    card = (tmp_path / "images/README.md").read_text()
    assert "| `extra.force_n` | list of float64 | T | `force_n` of the source, 1.5 to 7 |" in card
    assert "| `extra.wrench` | list of float64[2] | T | `wrench` of the source, 0 to 5 |" in card
    assert "| `extra.operator.note` | list of string | T | `operator.note` of the source |" in card
    realtouch.select(clips, tmp_path / "clips", split="train")
    card = (tmp_path / "clips/README.md").read_text()
    assert "| `extra_seq.time.ms` | list of list of float64 | T x N; cut to N_i | `time.ms` of" in card
    summary = realtouch.summarise(realtouch.load(clips, "train"))
    assert summary.extra["vector"] == "float64[2] per frame"
    assert summary.extra["force_n"] == "float64 per touch"
    assert call("tactile", "info", tmp_path / "clips") == 0
    assert "extra vector" in capsys.readouterr().out


def test_torch_takes_numbers_as_targets(images: Path, clips: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
    pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")
    from realtouch.touch_tensors import TouchTensors

    rounds = realtouch.load(images, "train")
    loader = torch.utils.data.DataLoader(TouchTensors(rounds, target="extra.force_n"), batch_size=5)
    ((pictures, forces),) = loader
    assert pictures.shape == (5, 3, 36, 48)
    np.testing.assert_array_equal(forces.numpy(), np.float32([1.5, np.nan, 3.25, 4.0, 5.5]))
    _, vector = TouchTensors(rounds, target="extra.wrench")[0]
    assert vector.tolist() == [1.0, 2.0]
    with pytest.raises(InputError, match=r"no target 'extra\.operator\.note'; .*extra\.wrench"):
        TouchTensors(rounds, target="extra.operator.note")
    for of_set in (rounds, realtouch.load(clips, "train")):
        assert TouchTensors(of_set)[1][1] == -1
        assert TouchTensors(of_set, target=None)[1].shape[-3:] == (3, 36, 48)
    chosen = TouchTensors(realtouch.load(clips, "train"), target="extra.time.ms", frames="contact_end")
    touch = chosen.touches[4]
    assert chosen[4][1] == touch.extra["time.ms"][touch.clip.contact_index("contact_end")]
    with pytest.raises(InputError, match="which 'peak' needs"):
        TouchTensors(realtouch.load(clips, "train"), frames="peak")
