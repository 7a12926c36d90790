"""A changed byte of a manifest or record is noticed by every reader."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.run import Part
from tactile_toolkit.store import MANIFEST_FILE, Manifest, build, open_folder, read_manifest
from tactile_toolkit.store.job import pending_records
from tactile_toolkit.store.manifest import require_seal, seal
from tactile_toolkit.store.verification import (
    RECORD_FILE,
    DownloadRecord,
    HubFile,
    read_download_record,
    write_download_record,
)
from tests.sealed import edit
from tests.tactile_toolkit.toy import folder_bytes, toy_plan


def changed(content: bytes) -> Iterator[bytes]:
    """Yield a document with one byte changed: each byte, by a bit and to a space."""
    for place, byte in enumerate(content):
        for other in {byte ^ 1, 32} - {byte}:
            yield content[:place] + bytes([other]) + content[place + 1 :]


def test_any_byte_of_a_manifest(tmp_path: Path) -> None:
    build(open_folder(str(tmp_path)), toy_plan(("test",)))
    content = (tmp_path / MANIFEST_FILE).read_bytes()
    assert Manifest.from_json(content, "m").complete
    for damaged in changed(content):
        with pytest.raises(IntegrityError, match="'m' "):
            Manifest.from_json(damaged, "m")


def test_any_byte_of_a_record_of_a_download(tmp_path: Path) -> None:
    folder = open_folder(str(tmp_path))
    file = HubFile("data/train.parquet", 3, "0" * 40)
    write_download_record(folder, DownloadRecord("a/b", "0" * 40, None, {file.path: file}, ("train",), ()))
    content = (tmp_path / RECORD_FILE).read_bytes()
    assert read_download_record(folder) is not None
    for damaged in changed(content):
        (tmp_path / RECORD_FILE).write_bytes(damaged)
        with pytest.raises(IntegrityError):
            read_download_record(folder)


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """A folder with all shards that is not finished."""
    build(open_folder(str(tmp_path / "set")), toy_plan(), part=Part(0, 1))
    return tmp_path / "set"


@pytest.mark.thorough
def test_any_byte_of_a_pending_record(parts: Path) -> None:
    folder = open_folder(str(parts))
    manifest = read_manifest(folder)
    assert manifest is not None
    record = parts / ".pending" / "train-00001-of-00004.json"
    content = record.read_bytes()
    assert len(pending_records(folder, manifest.identity)) == 6
    for damaged in changed(content):
        record.write_bytes(damaged)
        assert len(pending_records(folder, manifest.identity)) == 5, damaged


@pytest.mark.parametrize("name", ["rows", "bytes", "sha256", "skipped"])
def test_a_changed_record_is_not_finished_but_made_again(parts: Path, tmp_path: Path, name: str) -> None:
    record = parts / ".pending" / "train-00001-of-00004.json"
    text = record.read_text()
    number = re.search(rf'"{name}": [^0-9]*', text)
    assert number is not None
    digit = text[number.end()]
    record.write_text(f"{text[: number.end()]}{(int(digit) + 1) % 10}{text[number.end() + 1 :]}")
    with pytest.raises(IntegrityError, match=r"1 of 6 shards of .* are not finished"):
        build(open_folder(str(parts)), toy_plan(), finish=True)
    build(open_folder(str(parts)), toy_plan())
    build(open_folder(str(tmp_path / "whole")), toy_plan())
    assert folder_bytes(parts) == folder_bytes(tmp_path / "whole")


def test_changed_line_ends_are_not_damage() -> None:
    text = seal('{\n "a": "x\\r\\ny"\n}\n')
    for same in (text, text.removesuffix("\n"), text.replace("\n", "\r\n"), text.encode()):
        require_seal(same, "here")


@pytest.mark.parametrize("version", [1, 2, 4])
def test_another_schema_version_is_refused(tmp_path: Path, version: int) -> None:
    build(open_folder(str(tmp_path)), toy_plan())
    edit(tmp_path / MANIFEST_FILE, lambda values: values.update(schema_version=version))
    with pytest.raises(IntegrityError, match=f"has schema version {version}, expected 3; next: install"):
        build(open_folder(str(tmp_path)), toy_plan())
