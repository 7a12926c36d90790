"""How places of data are read: local paths, and addresses in stores."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.store.address import is_remote, place_of_data
from tactile_toolkit.store.folder import DataFolder
from tests.processes import printed_by


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
    assert place_of_data(given) == place
    assert place_of_data(place) == place
    assert is_remote(given) == is_remote(place) == (place.partition("://")[0] in ("s3", "gs", "hf"))


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("s3://", "'s3://' names no bucket; next: write it as s3://BUCKET/FOLDER"),
        ("s3:///set", "names no bucket"),
        ("file://set", "expected file:///FOLDER; next: write it so, or as a path"),
        ("s3://a/../b", "'s3://a/../b' has '.' or '..' in it, which lead nowhere in a store"),
        ("s3://a/./b", "next: write the folder in full"),
        ("s3://../b", "which lead nowhere in a store"),
        ("s3://a/b\0", "holds a line break or another control character"),
        ("s3://KEY:SECRET@bucket/set", "'s3://...@bucket/set' holds a user, a key or a signature"),
        ("s3://bucket/set?X-Amz-Signature=SECRET", "'s3://bucket/set?...' holds a user"),
        ("https://KEY:SECRET@host/set", "'https://...@host/set' is an address of the web"),
        ("s3:/bucket/set", "'s3:/bucket/set' is an address of which a slash was lost"),
        ("http://host/set?X-Amz-Signature=SECRET", "give a folder, s3://BUCKET/FOLDER"),
    ],
)
def test_what_is_no_address_of_data_is_refused_without_repeating_secrets(address, words):
    with pytest.raises(InputError, match=rf"{re.escape(words)}") as told:
        DataFolder(address)
    assert "; next: " in str(told.value)
    assert "SECRET" not in str(told.value)
    assert "KEY" not in str(told.value)


@pytest.mark.parametrize(
    "act",
    [
        lambda folder: folder.require_folder(),
        lambda folder: folder.write_bytes("data/a", b"1"),
        lambda folder: folder.create_bytes("data/a", b"1"),
        lambda folder: folder.copy_in("data/a", Path(__file__)),
        lambda folder: folder.remove("data/a"),
    ],
)
def test_nothing_is_written_to_the_hub_file_by_file(act):
    """Said before anything is asked there: no server is reached."""
    with pytest.raises(InputError, match=r"'hf://datasets/a/b.*' cannot be written to: .* command `upload`"):
        act(DataFolder("hf://datasets/a/b"))


def test_an_address_of_this_machine_is_a_local_folder(tmp_path):
    folder = DataFolder(f"file://{tmp_path}/set")
    assert folder.is_local
    folder.write_bytes("data/a", b"1")
    assert (tmp_path / "set/data/a").read_bytes() == b"1"
    assert folder.sizes("data") == {"a": 1}
    assert folder.sizes("none") == folder.sizes("data/a") == {}
    assert folder.sizes() == {}


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("s3://bucket/set", "needs the package 's3fs', .*; next: pip install .*extra `s3`"),
        ("gs://bucket/set", "needs the package 'gcsfs', which is not installed; next: pip install gcsfs"),
        ("nowhere://bucket/set", "no store is known by 'nowhere://'"),
    ],
)
def test_a_store_whose_package_is_missing(address, words):
    program = f"""
import sys
sys.modules.update(s3fs=None, gcsfs=None)
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder
try:
    DataFolder({address!r}).names()
except InputError as error:
    print(error)
"""
    said = printed_by(program)
    assert re.search(words, said), said
    assert not Path("s3:").exists()
