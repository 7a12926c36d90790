"""Training on shards in an object store."""

from __future__ import annotations

from dataclasses import replace

import pytest

import starstruck_gen
from tactile_toolkit.store import open_folder
from tests.tactile_toolkit.toy import folder_bytes

pytestmark = [pytest.mark.s3, pytest.mark.torch]
torch = pytest.importorskip("torch", reason="torch (extra `torch`) is not installed")
pytest.importorskip("s3fs")
pytest.importorskip("moto")

from starstruck_gen.scene_dataset import SceneGenerator  # noqa: E402
from tactile_toolkit.mesh import SolidTensors  # noqa: E402
from tactile_toolkit.read import TrainingBatches  # noqa: E402


def test_training_from_a_store_is_training_from_a_folder(s3, bucket, tmp_path, monkeypatch):
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    layout = SceneGenerator.layout
    monkeypatch.setattr(SceneGenerator, "layout", lambda self: replace(layout(self), largest=8))
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 60), ("test", 1)))
    starstruck_gen.generate(spec, tmp_path / "scenes")
    place = open_folder(f"s3://{bucket}/scenes")
    for path in folder_bytes(tmp_path / "scenes"):
        place.upload(path, tmp_path / "scenes" / path)
    assert len(place.names("data")) == 9

    def batches_of(name):
        data = SolidTensors(starstruck_gen.load(name, "train"))
        return TrainingBatches(data, 7, window=3, rank=1, world_size=2, collate_fn=list)

    here, there = batches_of(str(tmp_path / "scenes")), batches_of(place.root)
    for epoch in range(2):
        s3.traffic.reset()
        mine = [item for batch in there for item in batch]
        assert (s3.traffic.sent_bytes == 0) == (epoch > 0)  # it is unpacked on this machine by then
        other = [item for batch in here for item in batch]
        assert len(mine) == len(other) == 30
        for (points, label), (expected, expected_label) in zip(mine, other, strict=True):
            assert torch.equal(points, expected)
            assert label == expected_label
