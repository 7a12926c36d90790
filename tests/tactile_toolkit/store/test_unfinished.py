from __future__ import annotations

from dataclasses import replace

import pytest

from mnist3d.kind import KIND
from tactile_toolkit.catalog import shards_to_check
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store import DataFolder, build, read_manifest, write_manifest
from tactile_toolkit.store.job import write_record
from tests.tactile_toolkit.toy import toy_plan


@pytest.fixture
def folder(tmp_path):
    place = DataFolder(str(tmp_path / "set"))
    build(place, replace(toy_plan(), kind=KIND.name))
    return place


def _interrupted(folder, kept):
    """Leave the folder as a run leaves it that was killed: `kept` records are in the manifest."""
    manifest = read_manifest(folder)
    for record in manifest.shards:
        if not kept(record):
            write_record(folder, record, manifest.identity)
    records = tuple(record for record in manifest.shards if kept(record))
    write_manifest(folder, replace(manifest, shards=records, complete=False))


@pytest.mark.parametrize("finished", [(), ("test",)])
def test_interrupted_run_is_refused_though_another_split_is_finished(folder, finished):
    _interrupted(folder, lambda record: record.shard.split in finished)
    with pytest.raises(IntegrityError, match="is not finished"):
        shards_to_check(folder.url, None, KIND)


def test_folder_without_a_data_set_is_refused(tmp_path):
    with pytest.raises(InputError, match="is empty; expected a data set"):
        shards_to_check(str(tmp_path), None, KIND)
