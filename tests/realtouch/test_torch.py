"""Tensors, in this process and in workers of every start method."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError
from tests.processes import PATIENCE_S
from tests.realtouch import factories
from tests.realtouch.factories import RoundTruth

torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")

from realtouch.touch_tensors import TouchTensors  # noqa: E402

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore")]


def squared(touch: realtouch.Touch) -> int:
    """A target of a user, at the top level of the module so that it can be pickled."""
    return touch.label**2


@pytest.fixture
def images(single_folder: Path) -> Any:
    return TouchTensors(realtouch.load(single_folder, "train"))


def test_items_are_tv_tensors(images: Any, single_folder: Path, seq_folder: Path) -> None:
    from torchvision.tv_tensors import Image, Video

    touches = realtouch.load(single_folder, "train").touches()
    image, label = images[7]
    assert isinstance(image, Image)
    assert (tuple(image.shape), image.dtype, label) == ((3, 72, 96), torch.uint8, 1)
    np.testing.assert_array_equal(image.numpy().transpose(1, 2, 0), touches[7].image)

    clips = TouchTensors(realtouch.load(seq_folder, "train").touches().with_contact(), target="object_id")
    clip, object_id = clips[5]
    assert isinstance(clip, Video)
    expected = clips.touches[5]
    assert object_id == expected.object_id
    np.testing.assert_array_equal(clip.numpy().transpose(0, 2, 3, 1), expected.clip.frames())
    frame = TouchTensors(realtouch.load(seq_folder, "train"), target=None, frames="peak")[3]
    assert isinstance(frame, Image)
    np.testing.assert_array_equal(
        frame.numpy().transpose(1, 2, 0),
        realtouch.load(seq_folder, "train")[0].sensor_video[3].contact_frame("peak"),
    )


def test_targets(single_folder: Path) -> None:
    dataset = realtouch.load(single_folder, "train")
    touch = dataset.touches()[6]
    assert TouchTensors(dataset, target="round_id")[6][1] == touch.round_id
    np.testing.assert_allclose(
        TouchTensors(dataset, target="pos_in_cell")[6][1], touch.pos_in_cell_m, rtol=1e-6
    )
    np.testing.assert_allclose(
        TouchTensors(dataset, target="gel_position")[6][1], touch.gel_pose.translation, rtol=1e-6
    )
    assert TouchTensors(dataset, target=squared)[12][1] == 4
    with pytest.raises(InputError, match="no target 'taste'"):
        TouchTensors(dataset, target="taste")


@pytest.mark.parametrize("method", ["contact_start", "peak", "best", "contact_end"])
def test_the_pose_is_that_of_the_frame(method: str, seq_folder: Path) -> None:
    touches = realtouch.load(seq_folder, "train").touches().with_contact()
    data = TouchTensors(touches, target="gel_position", frames=method)
    clip = touches[4].clip
    frame = clip.contact_index(method)
    image, position_m = data[4]
    np.testing.assert_array_equal(image.numpy().transpose(1, 2, 0), clip[frame])
    assert position_m.dtype == torch.float32
    np.testing.assert_array_equal(position_m, clip.poses.position_m[frame].astype(np.float32))
    np.testing.assert_array_equal(data.__getitems__([4])[0][1], position_m)


def test_images_of_several_sizes_meet_in_the_transform(truth: list[RoundTruth], tmp_path: Path) -> None:
    from torchvision.transforms import v2

    rows = factories.single_rows([truth[0], factories.make_round(8, 5, (64, 48))])
    data = TouchTensors(
        realtouch.load(factories.write_set(tmp_path, {"train": rows}, "single")), v2.Resize((24, 32))
    )
    for (image, label), index in zip(data.__getitems__([7, 1, 8]), (7, 1, 8), strict=True):
        assert tuple(image.shape) == (3, 24, 32)
        assert torch.equal(image, data[index][0])
        assert label == data[index][1]


def test_damage_in_a_batch_is_named(truth: list[RoundTruth], tmp_path: Path) -> None:
    rows = factories.single_rows(truth)
    rows[1]["sensor_image"][2]["bytes"] = b"no picture"
    data = TouchTensors(realtouch.load(factories.write_set(tmp_path, {"train": rows}, "single")))
    with pytest.raises(IntegrityError, match=r"row 1, touch 2, field 'sensor_image'"):
        data.__getitems__([0, 7])


@pytest.mark.parametrize("target", [None, "label", "round_id", "pos_in_cell", "gel_position", squared])
def test_a_batch_made_at_once_is_that_of_its_items(single_folder: Path, target: Any) -> None:
    data = TouchTensors(realtouch.load(single_folder, "train"), target=target)
    order = [14, 3, 3, 0]
    given = data.collated(order)
    expected = torch.utils.data.default_collate([data[index] for index in order])
    assert type(given) is type(expected)
    if target is None:
        assert torch.equal(given, expected)
        return
    assert torch.equal(given[0], expected[0])
    assert given[0].is_contiguous()
    other = TouchTensors(data.touches, target=target, channels_last=True).collated(order)
    assert torch.equal(other[0], expected[0])
    assert other[0].is_contiguous(memory_format=torch.channels_last)
    assert type(given[1]) is type(expected[1])
    assert torch.equal(given[1], expected[1]) if target != "round_id" else given[1] == expected[1]
    assert pickle.loads(pickle.dumps(data)).collated([3])[0].shape == (1, *given[0].shape[1:])


def test_transforms_apply(single_folder: Path) -> None:
    from torchvision.transforms import v2

    pipeline = v2.Compose([v2.Resize((32, 32)), v2.ToDtype(torch.float32, scale=True)])
    data = TouchTensors(realtouch.load(single_folder, "train"), pipeline)
    for image, _ in (data[2], data.__getitems__([2])[0]):
        assert (tuple(image.shape), image.dtype) == ((3, 32, 32), torch.float32)
        assert 0 <= float(image.min()) <= float(image.max()) <= 1


@pytest.mark.own_process
def test_workers_that_are_forked_or_are_spawned(images: Any) -> None:
    _ = images[0]  # opened in the parent, too
    # A spawned process imports torch, which takes seconds.
    for method, workers in (("fork", 2), ("spawn", 1)):
        loader = torch.utils.data.DataLoader(
            images, batch_size=8, num_workers=workers, multiprocessing_context=method, timeout=PATIENCE_S
        )
        batches = list(loader)
        pixels = torch.cat([batch for batch, _ in batches])
        labels = torch.cat([label for _, label in batches])
        assert labels.tolist() == [0] * 5 + [1] * 5 + [2] * 5
        np.testing.assert_array_equal(pixels.numpy().transpose(0, 2, 3, 1), images.touches.images())


def test_touches_of_a_stream_are_read_where_they_lie(single_folder: Path) -> None:
    data = TouchTensors(realtouch.load(single_folder, "train", streaming=True), target=identity)
    touches = realtouch.load(single_folder, "train").touches()
    assert [where for _, where in (data[index] for index in range(len(data)))] == [
        (touch.label, touch.touch_index) for touch in touches
    ]
    np.testing.assert_array_equal(data[7][0].numpy().transpose(1, 2, 0), touches[7].image)


def test_a_plain_loader_says_which_class_makes_tensors(single_folder: Path) -> None:
    rounds = realtouch.load(single_folder, "train")
    stream = realtouch.load(single_folder, "train", streaming=True)
    for data in (rounds, rounds.touches(), stream):
        with pytest.raises(
            TypeError, match=r"give the DataLoader realtouch\.touch_tensors\.TouchTensors\(data\)"
        ):
            next(iter(torch.utils.data.DataLoader(data, batch_size=2)))
    of_labels = torch.utils.data.DataLoader(
        rounds, batch_size=2, collate_fn=lambda records: [record.label for record in records]
    )
    assert next(iter(of_labels)) == rounds.labels[:2].tolist()


def identity(touch: realtouch.Touch) -> tuple[int, int]:
    return touch.label, touch.touch_index


def test_without_torch_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "realtouch.touch_tensors", raising=False)
    with pytest.raises(MissingExtraError, match=r"the extra `torch`"):
        __import__("realtouch.touch_tensors")
