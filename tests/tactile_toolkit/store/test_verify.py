"""Findings of `verify` for each kind of fault, and that it checks all files."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.store import build, open_folder, verify
from tactile_toolkit.store.verification import DownloadRecord, HubFile, write_download_record
from tests.sealed import edit
from tests.tactile_toolkit.toy import SCHEMA, STYLE, toy_plan


@pytest.fixture
def folder(tmp_path):
    made = open_folder(str(tmp_path / "set"))
    build(made, toy_plan())
    return made


def edited(folder, change):
    edit(Path(folder.address("manifest.json")), change)


def problems(folder):
    return [(finding.file, finding.problem) for finding in verify(folder, SCHEMA).findings]


def test_all_files_are_counted(folder):
    found = verify(folder, SCHEMA)
    assert found.ok
    assert found.files == 7, "six shards and the report"
    assert found.rows == 27
    assert found.bytes == sum(folder.sizes("data").values())


def test_shards_that_a_manifest_lacks_are_named(folder):
    edited(folder, lambda values: values["shards"].pop(2))
    folder.remove("data/train-00002-of-00004.parquet")
    assert problems(folder) == [("manifest.json", "split 'train' has no shards [2]")]


def test_strange_files_of_an_unfinished_set_are_not_named(folder):
    folder.write_bytes("data/strange.bin", b"x")
    edited(folder, lambda values: values.update(complete=False))
    interrupted = ("manifest.json", "not finished: 6 of 6 shards; the same command continues")
    assert problems(folder) == [interrupted], "they may be shards that a run is about to record"


def rewritten(folder, path, change):
    """Replace a shard by another table, whose checksum is in the manifest."""
    table = change(pq.read_table(folder.address(path)))
    folder.write_bytes(path, STYLE.encode(table))

    def vouch(values):
        (record,) = (each for each in values["shards"] if each["file"] == path)
        record |= {"bytes": folder.size_bytes(path), "sha256": folder.sha256(path)}

    edited(folder, vouch)


def with_ids(ids):
    return lambda table: table.set_column(0, "id", [ids])


NO_ID = "holds no column 'id' of one value for each row"


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda table: table.slice(1), ["has 4 rows, expected 5"]),
        (with_ids(pa.array([10, 11, 12, 13, 11])), ["id 11 is not unique, it is also in {} (1 such id)"]),
        (with_ids(pa.array([0, 11, 4, 12, 1])), ["id 0 is not unique, it is also in {first} (3 such ids)"]),
        (
            with_ids(pa.array([[1]] * 5)),
            [NO_ID, "schema differs: ['id: list<element: int64>'] there, ['id: int64'] expected"],
        ),
        (lambda table: table.drop_columns("id"), [NO_ID, "schema differs: [] there, ['id: int64'] expected"]),
        (
            lambda table: table.rename_columns(["id", "class", "points"]),
            ["schema differs: ['class: int64'] there, ['label: int64'] expected"],
        ),
        (lambda table: table.select(["label", "id", "points"]), ["schema differs: the order of columns"]),
    ],
)
def test_shards_that_are_as_recorded_and_not_as_they_should_be(folder, change, found):
    """Their checksums are right, because a user made them so."""
    first, path = (f"data/train-0000{index}-of-00004.parquet" for index in (0, 2))
    rewritten(folder, path, change)
    told = problems(folder)
    assert {file for file, _ in told} == {path}
    expected = [each.format(path, first=first) for each in found]
    assert [problem[: len(each)] for (_, problem), each in zip(told, expected, strict=True)] == expected


def copy_of(tmp_path, **files):
    """Return a downloaded folder, whose record states the right digests of its files or wrong ones."""
    folder = open_folder(str(tmp_path / "copy"))
    for name, (content, _, _) in files.items():
        if content is not None:
            folder.write_bytes(f"images/{name}", content)
    listed = {f"images/{name}": HubFile(f"images/{name}", *said) for name, (_, *said) in files.items()}
    write_download_record(folder, DownloadRecord("a/b", "0" * 40, None, listed, (), ()))
    return folder


def test_a_copy_is_compared_with_all_digests_of_the_hub(tmp_path):
    digest = hashlib.sha256(b"content").hexdigest()
    in_git = hashlib.sha1(b"blob 7\0content").hexdigest()
    folder = copy_of(
        tmp_path,
        whole=(b"content", 7, digest),
        in_git=(b"content", 7, in_git),
        unnamed=(b"content", 7, None),
        cut=(b"cont", 7, None),
        flipped=(b"c0ntent", 7, digest),
        gone=(None, 7, digest),
    )
    folder.write_bytes("data/strange.bin", b"x")
    found = verify(folder)
    assert found.files == 6
    assert found.bytes == 42
    assert found.reference == "a/b at 000000000000"
    flipped = hashlib.sha256(b"c0ntent").hexdigest()
    assert {finding.file: finding.problem for finding in found.findings} == {
        "images/cut": "has 4 bytes, expected 7",
        "images/flipped": f"sha256 is {flipped}, expected {digest}",
        "images/gone": "is missing",
        "data/strange.bin": "is not listed in .download.json; next: move it to another folder",
    }


def test_folders_without_any_digest_cannot_be_verified(tmp_path):
    with pytest.raises(InputError, match=r"no manifest\.json and no record of a download"):
        verify(open_folder(str(tmp_path)))
