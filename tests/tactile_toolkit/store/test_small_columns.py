"""Files of small columns: what they hold, when they are asked, and that nothing wrong with them is served."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tactile_toolkit.errors import StorageError
from tactile_toolkit.places import open_place
from tactile_toolkit.read import RecordDataset, Shard, ShardedTable
from tactile_toolkit.run import ProcessRunner
from tactile_toolkit.store import DataFolder, Manifest, build, parquet, verify
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, toy_plan

FILES = [f"reports/columns-train-{number:05d}-of-00002.parquet" for number in range(2)]


@pytest.fixture(autouse=True)
def two_shards_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "_SHARDS_TOGETHER", 3)


def make(folder: Path, **options: object) -> Manifest:
    return build(DataFolder(str(folder)), toy_plan(), **options)


def opened(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], list[int], set[str]]:
    """Read labels and ids of a split, and return them with the names of the files that were opened."""
    seen: set[str] = set()
    whole = Shard._opened

    def noted(self: Shard, metadata: object = None) -> object:
        seen.add(Path(self.path).name)
        return whole(self, metadata)

    with monkeypatch.context() as patch:
        patch.setattr(Shard, "_opened", noted)
        dataset = RecordDataset(ShardedTable(open_place(str(folder)).shards("train")), label_names="abc")
        return dataset.labels.tolist(), dataset.ids.tolist(), seen


IDS = [number for number in range(20) if number % 10 != 9]


def test_labels_come_from_few_files_and_are_those_of_the_shards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = make(tmp_path / "set")
    assert sorted(manifest.files or ()) == [*FILES, "reports/toy.parquet"]
    labels, ids, seen = opened(tmp_path / "set", monkeypatch)
    assert (ids, labels) == (IDS, [number % 3 for number in IDS])
    assert seen == {Path(path).name for path in FILES}
    assert pq.read_schema(tmp_path / "set" / FILES[0]).names == ["id", "label"], "no lists"
    table = ShardedTable(open_place(str(tmp_path / "set")).shards("train"))
    assert pickle.loads(pickle.dumps(table)).column("id").tolist() == IDS
    assert verify(DataFolder(str(tmp_path / "set")), SCHEMA).ok


def test_a_file_that_is_wrong_costs_speed_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(tmp_path / "set")
    first, second = (tmp_path / "set" / path for path in FILES)
    content = first.read_bytes()
    changed = bytearray(content)
    changed[40] ^= 1
    other = pq.read_table(first).replace_schema_metadata({parquet.SOURCE_DIGEST: b"others"})
    damages = [bytes(changed), content[:-20], b"", second.read_bytes(), None]
    for damage in [*damages, other]:
        first.unlink(missing_ok=True)
        if isinstance(damage, bytes):
            first.write_bytes(damage)
        elif damage is not None:
            pq.write_table(damage, first)
        labels, ids, _ = opened(tmp_path / "set", monkeypatch)
        assert (ids, labels) == (IDS, [number % 3 for number in IDS])
        problems = verify(DataFolder(str(tmp_path / "set")), SCHEMA).findings
        assert [finding.file for finding in problems] == [FILES[0]]
        make(tmp_path / "set")
        assert first.read_bytes() == content, "made again"


@pytest.mark.thorough
def test_bytes_do_not_depend_on_how_a_set_was_made(tmp_path: Path) -> None:
    make(tmp_path / "one")
    plan = toy_plan()
    broken = replace(plan.tasks[2], error=StorageError("stop"))
    with pytest.raises(StorageError):
        build(
            DataFolder(str(tmp_path / "two")),
            replace(plan, tasks=(*plan.tasks[:2], broken)),
            workers=ProcessRunner(2),
        )
    build(DataFolder(str(tmp_path / "two")), toy_plan(("test",)))
    make(tmp_path / "two")
    make(tmp_path / "two")
    assert folder_bytes(tmp_path / "two") == folder_bytes(tmp_path / "one")
