"""A changed byte or a value of another type is noticed by every reader of a manifest or record."""

from __future__ import annotations

import contextlib
import copy
import functools
import json
import operator
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.places import open_place
from tactile_toolkit.run import Part
from tactile_toolkit.store import MANIFEST_FILE, Manifest, build, open_folder, read_manifest, verify
from tactile_toolkit.store.manifest import pending_records, require_seal, seal
from tactile_toolkit.store.verification import (
    RECORD_FILE,
    DownloadRecord,
    HubFile,
    read_download_record,
    write_download_record,
)
from tests.sealed import edit, sealed
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


DEEP = json.loads("[" * 400 + "]" * 400)
STRANGE: list[Any] = ["10", -5, 10**15, 10**400, True, 1.5, None, [], [[]], {}, {"a": DEEP}, float("nan"), ""]


@pytest.fixture(scope="module")
def toy_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("typed") / "set"
    build(open_folder(str(path)), toy_plan())
    return path


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, each in inner for place in places(each, (*path, key)))]


def with_value(values: Any, place: tuple[Any, ...], other: Any) -> str:
    values = copy.deepcopy(values)
    if not place:
        return sealed(other)
    inside = values
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = other
    return sealed(values)


@pytest.mark.thorough
def test_every_value_is_of_its_kind_or_named(toy_set: Path) -> None:
    """Valid values are written back as the same text; any other value raises one kind of error."""
    values = json.loads((toy_set / MANIFEST_FILE).read_text())
    counts = {"classes": [1, 2], "sizes": {"all": 3}}
    values["shards"][0]["statistics"] = counts
    whole, _ = outcome(sealed(values))
    assert whole is not None
    named = 0
    for place in places(values):
        for other in STRANGE:
            read, story = outcome(with_value(values, place, other))
            if read is None:
                assert "set/manifest.json" in story
                assert len(story) < 1000
                named += 1
                continue
            # Values that do not affect rows may be any of their type.
            harmless = ("spec", "toolkit_version", "skipped", "statistics", "trees", "kind", "libraries")
            assert place[0] in (*harmless, "shards") or read == whole or other == {}, (place, other)
            read.to_json()
    assert named > 100


def outcome(text: str) -> tuple[Manifest | None, str]:
    try:
        return Manifest.from_json(text, "set/manifest.json"), ""
    except IntegrityError as error:
        return None, str(error)


def test_a_manifest_that_agrees_with_itself_and_not_with_the_files(toy_set: Path, tmp_path: Path) -> None:
    """State one row less than there is."""
    values = json.loads((toy_set / MANIFEST_FILE).read_text())
    values["shards"][0]["rows"] -= 1
    (tmp_path / "data").symlink_to(toy_set / "data")
    (tmp_path / MANIFEST_FILE).write_text(sealed(values))
    shards = open_place(str(tmp_path)).shards("train")
    with pytest.raises(IntegrityError, match=r"rows; expected \d by the manifest"):
        _ = shards[0].metadata


def test_a_shard_that_the_manifest_lacks_is_named(toy_set: Path, tmp_path: Path) -> None:
    manifest = read_manifest(open_folder(str(toy_set)))
    assert manifest is not None
    fewer = replace(manifest, shards=(manifest.shards[0], *manifest.shards[2:]))
    (tmp_path / "data").symlink_to(toy_set / "data")
    (tmp_path / MANIFEST_FILE).write_text(fewer.to_json())
    with pytest.raises(IntegrityError, match=r"manifest\.json of .* lists 3 of 4 shards"):
        open_place(str(tmp_path)).shards("train")


@pytest.mark.parametrize(
    "text", ["[" * 200_000, "[" * 200_000 + "]" * 200_000, "1" * 5_000, "\ud800", "[]", ""]
)
def test_text_that_is_no_manifest(text: str) -> None:
    with pytest.raises(IntegrityError, match="here' is damaged"):
        Manifest.from_json(text, "here")


def test_every_value_of_a_record_of_a_download(tmp_path: Path) -> None:
    file = {"bytes": 3, "digest": "0" * 40}
    values = {
        "repository": "a/b", "commit": "0" * 40, "revision": None, "finished": True, "splits": ["train"],
        "labels": ["README.md"], "files": {"data/train.parquet": file},
    }  # fmt: skip
    folder = open_folder(str(tmp_path))
    (tmp_path / RECORD_FILE).write_text(sealed(values))
    assert read_download_record(folder) is not None
    for place in places(values):
        stored = functools.reduce(operator.getitem, place, values)
        for other in STRANGE:
            (tmp_path / RECORD_FILE).write_text(with_value(values, place, other))
            with contextlib.suppress(IntegrityError):
                read_download_record(folder)
                # What is read has the type of what it replaces.
                assert type(other) is type(stored) or None in (other, stored), (place, other)


@pytest.mark.skipif(
    not hasattr(os, "seteuid") or os.geteuid() != 0, reason="only root can become another user"
)
def test_a_folder_that_this_user_may_not_read(toy_set: Path, tmp_path: Path) -> None:
    import shutil
    import tempfile

    base = Path(tempfile.mkdtemp())
    base.chmod(0o755)
    shutil.copytree(toy_set, base / "set")
    (base / "set").chmod(0o700)
    os.seteuid(65534)
    try:
        for ask in (
            lambda: open_place(str(base / "set")).shards("train"),
            lambda: verify(open_folder(str(base / "set"))),
        ):
            with pytest.raises(InputError, match=r"set.* cannot be read: permission denied"):
                ask()
    finally:
        os.seteuid(0)
        shutil.rmtree(base)
