"""Folders of the first schema version are opened, verified, continued and finished in its bytes."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.run.processes import Finish, InlineRunner, Part
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest, write_manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet
from tactile_toolkit.store.shards import ShardName
from tactile_toolkit.store.verify import verify
from tests.tactile_toolkit.toy import SCHEMA, STYLE, BuildPlan, ToyTask, folder_bytes, toy_plan


def new_plan() -> BuildPlan:
    """Two shards of ten ids instead of four of five, and pages of their own."""
    first = toy_plan(("train",))
    tasks = tuple(ToyTask(ShardName("train", i, 2), tuple(range(10 * i, 10 * i + 10))) for i in range(2))
    style = replace(STYLE, rows_per_group=5, chunks_by_content=True)
    return replace(first, tasks=tasks, style=style, former=first)


def begin_first(path: Path, plan: BuildPlan) -> DataFolder:
    """Put the manifest there with which a run of the first version began."""
    folder = DataFolder(str(path))
    folder.require_folder()
    write_manifest(folder, plan.in_version(1).new_manifest())
    return folder


def make(folder: DataFolder, runner=None, plan=None, **options):
    return build(folder, plan or new_plan(), runner or InlineRunner(), **options)


def test_new_folders_are_of_the_second_version(tmp_path):
    manifest = make(DataFolder(str(tmp_path)))
    assert (manifest.schema_version, len(manifest.shards)) == (2, 2)
    shard = pq.read_metadata(tmp_path / manifest.shards[0].file)
    assert shard.row_group(0).column(0).has_offset_index


def test_a_folder_is_continued_in_the_version_in_which_it_was_begun(tmp_path):
    folder = begin_first(tmp_path / "set", new_plan())
    make(folder, Part(1, 2))
    made = times(tmp_path / "set")
    assert len(made) == 2, "of four shards, not of two"
    manifest = make(folder)
    assert (manifest.schema_version, manifest.complete, len(manifest.shards)) == (1, True, 4)
    assert made.items() <= times(tmp_path / "set").items()
    assert not verify(folder, SCHEMA).findings
    whole = begin_first(tmp_path / "whole", new_plan())
    make(whole)
    assert folder_bytes(tmp_path / "whole") == folder_bytes(tmp_path / "set")
    make(folder, Finish())
    assert folder_bytes(tmp_path / "whole") == folder_bytes(tmp_path / "set"), "finished again: the same"


def times(folder: Path) -> dict[str, int]:
    return {file.name: file.stat().st_mtime_ns for file in (folder / "data").iterdir()}


def test_a_folder_that_is_replaced_is_of_the_second_version(tmp_path):
    folder = begin_first(tmp_path, new_plan())
    make(folder)
    manifest = make(folder, overwrite=True)
    assert (manifest.schema_version, len(manifest.shards)) == (2, 2)
    assert read_manifest(folder) == manifest


def test_records_of_one_version_do_not_count_for_another():
    plan = toy_plan()
    assert plan.new_manifest().identity != plan.in_version(1).new_manifest().identity


def test_later_versions_are_refused(tmp_path):
    folder = DataFolder(str(tmp_path))
    make(folder)
    file = tmp_path / "manifest.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"schema_version": 3}))
    with pytest.raises(IntegrityError, match="schema version 3, this toolkit reads up to 2; next: install"):
        make(folder)


def test_a_changed_row_leaves_the_pages_after_it_as_they_were():
    """Pages end with rows, whatever their bytes; in a page, zstd makes others of all that follow."""
    rng = np.random.default_rng(0)

    def image() -> bytes:
        return rng.integers(0, 4, int(rng.integers(9_000, 13_000)), np.uint8).tobytes()

    rows = [[image() for _ in range(4)] for _ in range(40)]
    others = [*rows[:5], [image()] * 4, *rows[6:]]
    style = ParquetStyle(40, encodings=(("images.list.element", "PLAIN"),), values_per_page=4)

    def stored(table: list, style: ParquetStyle) -> bytes:
        content = encode_parquet(pa.table({"images": pa.array(table, pa.list_(pa.binary()))}), style)
        assert pq.read_table(io.BytesIO(content))["images"].to_pylist() == table
        return content

    def is_shared(style: ParquetStyle) -> bool:
        first = stored(rows, style)
        return first[len(first) // 4 : len(first) * 9 // 10] in stored(others, style)

    assert is_shared(style)
    assert not is_shared(replace(style, values_per_page=None))
