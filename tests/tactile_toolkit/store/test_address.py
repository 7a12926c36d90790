"""Parsing of places of data: local paths, and addresses in stores."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store import open_folder, scheme_of
from tactile_toolkit.store.addresses import normalize_uri
from tests.forked import run_forked


@pytest.mark.parametrize(
    ("given", "place"),
    [
        ("data", "data"),
        ("./s3://bucket/set", "./s3://bucket/set"),
        ("file:///tmp/set/", "/tmp/set"),
        ("local:///tmp/set", "/tmp/set"),
        ("FILE:///", "/"),
        ("s3://bucket/set/", "s3://bucket/set"),
        ("S3://bucket", "s3://bucket"),
        ("s3a://bucket/set", "s3://bucket/set"),
        ("gcs://bucket/set", "gs://bucket/set"),
        ("hf://datasets/a/b@main/data", "hf://datasets/a/b@main/data"),
    ],
)
def test_one_form_of_each_place(given, place):
    assert normalize_uri(given) == place
    assert normalize_uri(place) == place
    scheme = place.partition("://")[0]
    assert scheme_of(given) == scheme_of(place) == (scheme if scheme in ("s3", "gs", "hf") else "")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("s3://", "'s3://' is not the address of a data set; expected a folder, file:///FOLDER, s3://"),
        ("s3:///set", "is not the address of a data set"),
        ("file://set", "expected a folder, file:///FOLDER, s3://"),
        ("s3://a/../b", "'s3://a/../b' is not the address of a data set"),
        ("s3://a/./b", "of names without '.', '..' and control characters"),
        ("s3://a/b\0", "is not the address of a data set"),
        *((f"s3://a/b{mark}c", "and control characters") for mark in "\n\r\x1b"),
        ("s3://KEY:SECRET@bucket/set", "the address 's3://...' may hold a user, a key or a signature"),
        ("https://KEY:SECRET@host/set", "the address 'https://...' may hold"),
        ("s3:/bucket/set", "'s3:/bucket/set' is not the address of a data set"),
        ("http://host/set", "and not of the web"),
    ],
)
def test_invalid_addresses_are_refused_without_repeating_secrets(address, words):
    with pytest.raises(InputError, match=rf"{re.escape(words)}") as told:
        open_folder(address)
    assert "; next: " in str(told.value)
    assert str(told.value).isprintable()
    assert "SECRET" not in str(told.value)
    assert "KEY" not in str(told.value)


@pytest.mark.parametrize(
    "act",
    [
        lambda folder: folder.require_folder(),
        lambda folder: folder.write_bytes("data/a", b"1"),
        lambda folder: folder.create_bytes("data/a", b"1"),
        lambda folder: folder.upload("data/a", Path(__file__)),
        lambda folder: folder.remove("data/a"),
    ],
)
def test_nothing_is_written_to_the_hub_file_by_file(act):
    """The error is raised before any request."""
    with pytest.raises(InputError, match=r"'hf://datasets/a/b.*' cannot be written to: .* command `upload`"):
        act(open_folder("hf://datasets/a/b"))


def test_an_address_of_this_machine_is_a_local_folder(tmp_path):
    folder = open_folder(f"file://{tmp_path}/set")
    assert folder.is_local
    folder.write_bytes("data/a", b"1")
    assert (tmp_path / "set/data/a").read_bytes() == b"1"
    assert folder.sizes("data") == {"a": 1}
    assert folder.sizes("none") == folder.sizes("data/a") == {}
    assert folder.sizes() == {}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("s3://bucket/set", "needs the package 's3fs', .*; next: pip install .*extra `s3`"),
        ("gs://bucket/set", "needs the package 'gcsfs', which is not installed; next: pip install gcsfs"),
        ("sftp://host/set", "client for 'sftp://' is not installed .*paramiko.*; next: install that package"),
        ("nowhere://bucket/set", "no store is known by 'nowhere://'"),
    ],
)
def test_a_store_whose_package_is_missing(address, words):
    program = f"""
import sys
sys.modules.update(s3fs=None, gcsfs=None, paramiko=None)
from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder
try:
    open_folder({address!r}).names()
except InputError as error:
    print(error)
"""
    message = run_forked(program)
    assert re.search(words, message), message
    assert not Path("s3:").exists()


def test_unreadable_files_are_named_with_the_reason_of_the_system(tmp_path):
    """Without the error number, and without a second mention of the path."""
    folder = open_folder(str(tmp_path))
    (tmp_path / "folder").mkdir()
    for path, words in (("absent", "No such file or directory"), ("folder", "Is a directory")):
        with pytest.raises(IntegrityError) as caught:
            folder.read_bytes(path)
        assert str(caught.value) == f"cannot read {str(tmp_path / path)!r}: {words}"
