"""Names of the Hub, and the splits to which files of a repository belong."""

from __future__ import annotations

import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.hub import HubRepository, hub_name
from tactile_toolkit.hub.repository import HubName
from tactile_toolkit.places import open_place
from tactile_toolkit.places.split_files import splits_by_name


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a/b", ("a/b", None, "")),
        ("a/b@main", ("a/b", "main", "")),
        ("hf://datasets/a/b", ("a/b", None, "")),
        ("hf://datasets/a/b/", ("a/b", None, "")),
        ("hf://datasets/a/b@v1.0", ("a/b", "v1.0", "")),
        ("hf://datasets/a/b/data/x-0.parquet", ("a/b", None, "data/x-0.parquet")),
        ("hf://datasets/a/b@x%2Fy/data/", ("a/b", "x/y", "data")),
        ("hf://datasets/a/b@refs/pr/3/x.parquet", ("a/b", "refs/pr/3", "x.parquet")),
        (
            "hf://datasets/a/b@refs/convert/parquet/default/train/0000.parquet",
            ("a/b", "refs/convert/parquet", "default/train/0000.parquet"),
        ),
    ],
)
def test_parts_of_a_name(name, expected):
    assert hub_name(name) == HubName(*expected)


@pytest.mark.parametrize(
    "name",
    ["a", "a/b/c", "/a/b", "./a/b", "../a", "~a/b", "a/b@", "hf://a/b", "hf://datasets/a", "s3://a/b", ""],
)
def test_other_names_are_not_repositories(name):
    assert hub_name(name) is None


def test_a_revision_is_given_once():
    assert hub_name("a/b", "dev") == HubName("a/b", "dev", "")
    assert hub_name("a/b@dev", "dev") == HubName("a/b", "dev", "")
    with pytest.raises(
        InputError, match="'a/b@main' names the revision 'main', and 'dev' is given next to it"
    ):
        hub_name("a/b@main", "dev")


def test_a_part_of_a_repository_is_not_a_repository():
    with pytest.raises(InputError, match="leave 'data' out"):
        HubRepository.named("hf://datasets/a/b/data")


def test_numbered_files_belong_to_the_split_of_their_folder():
    paths = ["test/0000.parquet", "default/train/0001.parquet", "default/train/0000.parquet"]
    assert splits_by_name(paths, "here") == {
        "test": ("test/0000.parquet",),
        "train": ("default/train/0000.parquet", "default/train/0001.parquet"),
    }
    assert splits_by_name([*paths, "data/dev-00000-of-00001.parquet"], "here") == {
        "dev": ("data/dev-00000-of-00001.parquet",)
    }, "shards in data decide"


@pytest.mark.parametrize("name", ["~nobody-of-that-name/x", "x" * 5000, "a\0b", "nowhere"])
def test_names_that_no_place_can_have_are_refused(name):
    for names in (name, [name]):
        with pytest.raises(InputError, match="does not exist; expected a folder, a Parquet file") as caught:
            open_place(names)
        assert len(str(caught.value)) < 500
