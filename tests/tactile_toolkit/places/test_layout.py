"""Splits of folders: as `datasets.load_dataset` finds them, or refused if it would guess."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.places import Place, open_place
from tactile_toolkit.places.split_files import splits_by_card, splits_by_name
from tactile_toolkit.store import build, open_folder
from tests.tactile_toolkit.toy import toy_plan


def folder_of(root: Path, files: dict[str, int], card: str = "") -> Path:
    """Write Parquet files with given numbers of rows, unique ids, and a data card."""
    first = 0
    for name, rows in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table({"id": range(first, first + rows)}), root / name)
        first += rows
    if card:
        (root / "README.md").write_text(card)
    return root


def ids_of(place: Place) -> dict[str, list[int]]:
    return {
        split: [row for shard in place.shards(split) for row in shard.column("id").to_pylist()]
        for split in place.splits
    }


def ids_in_datasets(folder: Path, cache: Path, config: str | None = None) -> dict[str, list[int]]:
    import datasets

    datasets.disable_progress_bars()
    loaded = datasets.load_dataset(str(folder), config, cache_dir=str(cache))
    return {split: sorted(rows["id"]) for split, rows in loaded.items()}


def card(*configs: str) -> str:
    return "---\nlicense: mit\nconfigs:\n" + "\n".join(configs) + "\n---\n# A card\n"


SPLITS_NAMED = card(
    "- config_name: default",
    "  data_files:",
    "  - {split: train, path: monday.parquet}",
    "  - {split: test, path: 'tues*.parquet'}",
)
TWO = (
    "- config_name: small\n  data_files: [{split: train, path: 'small/train-*'}]",
    "- config_name: large\n  data_files: [{split: train, path: 'large/train-*'}]",
)
TWO_FILES = {"small/train-00000-of-00001.parquet": 2, "large/train-00000-of-00001.parquet": 3}

ALIKE = {
    "splits by the card": ({"monday.parquet": 3, "tuesday.parquet": 2}, SPLITS_NAMED),
    "one folder by the card": (
        {"rounds/a.parquet": 3, "rounds/b.parquet": 2, "old/a.parquet": 1},
        card("- config_name: default\n  data_files: 'rounds/*.parquet'"),
    ),
    "any depth": (
        {"a/b/c/x.parquet": 3, "a/y.parquet": 2, "z.parquet": 1},
        card("- config_name: default\n  data_files: [{split: train, path: 'a/**/*.parquet'}]"),
    ),
    "a folder of data": (
        {"some/train.parquet": 3, "some/test.parquet": 2, "other/train.parquet": 1},
        card("- config_name: default\n  data_dir: some"),
    ),
    "the default of two": (TWO_FILES, card(TWO[0], TWO[1] + "\n  default: true")),
    "the one called default": (
        TWO_FILES,
        card(TWO[0], TWO[1].replace("config_name: large", "config_name: default")),
    ),
    "patterns in a list": (
        {"a.parquet": 3, "b.parquet": 2, "c.parquet": 1},
        card("- config_name: default\n  data_files: ['b.parquet', 'a.parquet']"),
    ),
    "shards in data": (
        {"data/train-00000-of-00002.parquet": 3, "data/train-00001-of-00002.parquet": 2, "old/x.parquet": 1},
        "",
    ),
    "any split in data": ({"data/monday-00000-of-00001.parquet": 3}, ""),
    "shards with a digest": (
        {"data/train-00000-of-00001-1a2b3c.parquet": 3, "data/test-00000-of-00001-4d5e6f.parquet": 2},
        "",
    ),
    "folders": ({"train/a.parquet": 3, "train/2024/b.parquet": 2, "testing/a.parquet": 1}, ""),
    "words in folders": ({"my train/a.parquet": 3, "dev-set/a.parquet": 2}, ""),
    "files": ({"training.parquet": 3, "val.parquet": 2, "eval-1.parquet": 1}, ""),
    "words in files": ({"touches-train.parquet": 3, "touches_test_0.parquet": 2}, ""),
    "numbered": ({"default/train/0000.parquet": 3, "default/train/0001.parquet": 2}, ""),
}


@pytest.mark.parametrize("situation", ALIKE)
def test_splits_are_those_of_load_dataset(situation, tmp_path):
    files, text = ALIKE[situation]
    folder = folder_of(tmp_path / "set", files, text)
    found = {split: sorted(rows) for split, rows in ids_of(open_place(folder)).items()}
    assert found == ids_in_datasets(folder, tmp_path / "cache")


def test_several_configurations_need_a_choice(tmp_path):
    folder = folder_of(tmp_path / "set", TWO_FILES, card(*TWO))
    with pytest.raises(
        InputError, match=r"has the configurations small, large; expected one of them; .*config="
    ) as e:
        open_place(folder)
    assert "--config-name small" in str(e.value)
    for config in ("small", "large"):
        assert ids_of(open_place(folder, config=config)) == ids_in_datasets(folder, tmp_path / config, config)
    with pytest.raises(InputError, match=r"no configuration 'smal' in .* did you mean 'small'"):
        open_place(folder, config="smal")
    (folder / "README.md").unlink()
    with pytest.raises(InputError, match="has files of split 'train' in 'large' and 'small'"):
        open_place(folder)
    assert ids_of(open_place(folder / "small")) == {"train": [0, 1]}
    with pytest.raises(InputError, match=r"has no configurations, 'small' was asked for|has files of split"):
        open_place(folder, config="small")


def test_a_configuration_is_refused_where_none_decides(tmp_path):
    """Otherwise other data than the requested ones would be opened."""
    plain = folder_of(tmp_path / "plain", {"train.parquet": 2})
    file = plain / "train.parquet"
    build(open_folder(str(tmp_path / "ours")), toy_plan())
    said = folder_of(tmp_path / "said", {"train.parquet": 2}, "---\ntags: [x]\n---\n")
    for name in (plain, file, [file], tmp_path / "ours", said):
        with pytest.raises(InputError, match="has no configurations, 'small' was asked for; next: leave it"):
            open_place(name, config="small")
        with pytest.raises(InputError, match="is not on the Hub and has no revisions; 'main' was asked for"):
            open_place(name, revision="main")
        assert open_place(name).splits


@pytest.mark.parametrize(
    "files",
    [
        ("train-00000-of-00001.parquet", "old/train-00000-of-00001.parquet"),
        ("train.parquet", "train/0000.parquet"),
        ("a/test/0000.parquet", "b/test/0000.parquet"),
        ("x/one.parquet", "y/two.parquet"),
    ],
)
def test_files_of_one_split_in_two_folders_are_refused(files):
    with pytest.raises(
        InputError, match=r"has files of split '(train|test)' in '[^']+' and '[^']+', and no README"
    ):
        splits_by_name(files, "here")


@pytest.mark.parametrize(
    "text",
    [
        *("# no head", "---\nconfigs: [\n---\n", "---\nlicense: mit\n---\nconfigs: below"),
        *("---\nconfigs: &a [*a, *a]\n--- no end", "---\nconfigs:\n---\n"),
    ],
)
def test_without_configurations_in_the_card_file_names_decide(text):
    assert splits_by_card(text.encode(), ["x.parquet"], None, "here") is None


@pytest.mark.parametrize(
    "data_files",
    [
        *("../x.parquet", "/etc/*", "https://evil/x.parquet", "hf://datasets/a/b/x.parquet"),
        *("data/../../x.parquet", "C:\\\\x.parquet", "[{split: '../train', path: x.parquet}]"),
        *("[{split: train, path: 3}]", "[{split: [], path: x.parquet}]", "{train: {a: b}}", "7"),
    ],
)
def test_links_out_of_the_folder_and_unreadable_files_are_refused(data_files):
    text = f"---\nconfigs:\n- config_name: default\n  data_files: {data_files}\n---\n"
    with pytest.raises(InputError, match=r"^README\.md of 'here'.*; next: "):
        splits_by_card(text.encode(), ["x.parquet"], None, "here")


def test_a_split_of_the_card_without_files_is_named(tmp_path):
    folder = folder_of(tmp_path, {"monday.parquet": 3}, SPLITS_NAMED)
    place = open_place(folder)
    assert place.splits == ("train",)
    with pytest.raises(IntegrityError, match="has 0 of 1 file of split 'test'; expected all"):
        place.shards("test")
    (tmp_path / "monday.parquet").unlink()
    said = "README.md of .* names the files of train, test; none of them is a Parquet file there"
    with pytest.raises(InputError, match=said):
        open_place(folder)


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.text(max_size=8)
        | st.sampled_from(["*", "**", "x.parquet"]),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["config_name", "data_files", "data_dir", "split", "path"]), inner
            )
        ),
        max_leaves=12,
    )
)
def test_a_card_of_any_content_gives_files_or_a_sentence(values):
    text = f"---\n{json.dumps({'configs': values})}\n---\n"
    paths = ["x.parquet", "data/y.parquet"]
    with suppress(InputError):  # any other error fails
        found = splits_by_card(text.encode(), paths, None, "here")
        assert found is None or {*sum(found.values(), ())} <= {*paths}


def test_a_pattern_of_many_stars_ends(tmp_path):
    text = f"---\nconfigs:\n- config_name: default\n  data_files: '{'*a' * 60}b'\n---\n"
    assert splits_by_card(text.encode(), ["a" * 140 + ".parquet"], None, "here") == {"train": ()}


def test_a_data_set_in_a_folder_is_not_of_that_folder(tmp_path):
    folder_of(tmp_path, {"train.parquet": 2, "copy/data/train-00000-of-00001.parquet": 2})
    (tmp_path / "copy" / "manifest.json").write_text("{}")
    assert ids_of(open_place(tmp_path)) == {"train": [0, 1]}
    shutil.rmtree(tmp_path / "copy")
    (tmp_path / ".hidden").mkdir()
    pq.write_table(pa.table({"id": [7]}), tmp_path / ".hidden" / "train.parquet")
    (tmp_path / "._train.parquet").write_bytes(b"of a Mac")
    assert ids_of(open_place(tmp_path)) == {"train": [0, 1]}


@pytest.mark.parametrize(
    ("text", "is_ours"), [('{"name": "x"}', False), ("[7]", False), ('{"shards": []}', True)]
)
def test_a_manifest_of_another_program_is_ignored(tmp_path, text, is_ours):
    """On this machine and on the Hub; a manifest of ours with changed bytes is damaged."""
    folder = folder_of(tmp_path, {"train.parquet": 2})
    (folder / "manifest.json").write_text(text)
    if is_ours:
        with pytest.raises(IntegrityError, match="is damaged"):
            open_place(folder)
    else:
        assert ids_of(open_place(folder)) == {"train": [0, 1]}
