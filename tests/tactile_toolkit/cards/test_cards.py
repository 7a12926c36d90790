"""Cards agree with the data: `datasets` finds what they state, and contradictions are named."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import datasets
import pyarrow.parquet as pq
import pytest
import yaml
from huggingface_hub import DatasetCard, DatasetCardData
from hypothesis import given, strategies as st

from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.digit_options import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit import cards
from tactile_toolkit.cards import FolderSummary
from tactile_toolkit.cards.card import column_type_text, with_repo_name
from tactile_toolkit.cards.yaml_head import check_card, size_category, with_head
from tactile_toolkit.read.schemas import yaml_features
from tactile_toolkit.store import open_folder, verify


def edit_head(folder: Path, edit: Callable[[dict], None]) -> None:
    card = folder / "README.md"
    _, head, body = card.read_text().split("---\n", 2)
    values = yaml.safe_load(head)
    edit(values)
    card.write_text("---\n" + yaml.safe_dump(values, sort_keys=False) + "---\n" + body)


def problems(folder: Path) -> list[str]:
    return [f"{finding.file}: {finding.problem}" for finding in check_card(open_folder(str(folder)))]


def test_unpacked_bytes_are_those_that_datasets_counts(digits_set, tmp_path):
    bare = tmp_path / "bare"  # without a card, `datasets` counts the rows
    shutil.copytree(digits_set / "data", bare / "data")
    loaded = datasets.load_dataset(str(bare))
    facts = FolderSummary.of(open_folder(str(digits_set)))
    assert {split.split for split in facts.splits} == set(loaded)
    for split in facts.splits:
        counted = loaded[split.split].info.splits[split.split].num_bytes
        assert split.unpacked_bytes == pytest.approx(counted, rel=0.05)


def test_the_hubs_own_classes_read_the_card(digits_set):
    card = DatasetCard((digits_set / "README.md").read_text())
    assert isinstance(card.data, DatasetCardData)
    head = card.data
    assert (head.license, head.pretty_name, head.size_categories) == ("mit", "MNIST 3D", ["n<1K"])
    assert head.language is None
    assert head.configs == [
        {
            "config_name": "default",
            "data_files": [
                {"split": "test", "path": "data/test-*"},
                {"split": "holdout", "path": "data/holdout-*"},
            ],
        }
    ]
    assert head.task_ids
    assert head.tags


def test_a_true_card_has_no_findings(digits_set):
    assert problems(digits_set) == []
    assert cards.verify(open_folder(str(digits_set))).ok


def _drop_split(head: dict) -> None:
    head["configs"][0]["data_files"].pop()


def _wrong_pattern(head: dict) -> None:
    head["configs"][0]["data_files"][0]["path"] = "data/*"


def _more_rows(head: dict) -> None:
    head["dataset_info"]["splits"][0]["num_examples"] += 1


def _further_split(head: dict) -> None:
    head["dataset_info"]["splits"].append({"name": "train", "num_bytes": 1, "num_examples": 1})


def _wrong_column(head: dict) -> None:
    head["dataset_info"]["features"][0]["dtype"] = "string"


def _lost_column(head: dict) -> None:
    head["dataset_info"]["features"].pop()


def _wrong_class(head: dict) -> None:
    head["dataset_info"]["features"][1]["dtype"]["class_label"]["names"]["3"] = "three"


@pytest.mark.parametrize(
    ("lie", "words"),
    [
        (
            _drop_split,
            "files of split 'holdout' in configuration 'default' is missing, expected ['data/holdout-",
        ),
        (_wrong_pattern, "files of split 'test' in configuration 'default' is ['data/holdout-"),
        (_more_rows, "num_examples of split 'test' is 11, expected 10"),
        (_further_split, "num_examples of split 'train' is 1, expected missing"),
        (_wrong_column, "column 'id' is {'dtype': 'string'}, expected {'dtype': 'int64'}"),
        (_lost_column, "column 'source' is missing, expected {'dtype': 'string'}"),
        (_wrong_class, "column 'label' is {'dtype': {'class_label'"),
        (lambda head: head.pop("dataset_info"), "its YAML head cannot be read (KeyError: 'dataset_info')"),
        (lambda head: head.update(size_categories=["n>1T"]), "expected ['n<1K']"),
        (lambda head: head["dataset_info"].update(download_size=1), "download_size is 1, expected"),
    ],
)
def test_a_lie_in_the_head_is_named(folder, lie, words):
    edit_head(folder, lie)
    (found,) = [problem for problem in problems(folder) if words in problem]
    assert found.startswith("README.md: ")
    assert not cards.verify(open_folder(str(folder))).ok
    assert verify(open_folder(str(folder))).ok, "the rows are fine"


@pytest.mark.parametrize(
    ("card", "words"),
    [
        (None, "is missing; next: write it again with the command `card`"),
        ("# No head", "its YAML head cannot be read (ValueError"),
        ("---\na: [\n---\n", "its YAML head cannot be read (ValueError"),
    ],
)
def test_a_card_that_cannot_be_read_is_named(folder, card, words):
    (folder / "README.md").unlink()
    if card is not None:
        (folder / "README.md").write_text(card)
    (found,) = problems(folder)
    assert found.startswith(f"README.md: {words}")


def test_a_head_that_repeats_itself_is_shown_in_part(folder):
    lines = [f"x{level}: &x{level} [{', '.join([f'*x{level - 1}'] * 9)}]" for level in range(1, 12)]
    head = "\n".join(["x0: &x0 [a]", *lines])

    def repeat(text: str) -> str:
        return re.sub("download_size: [0-9]+", "download_size: *x11", text)

    card = folder / "README.md"
    card.write_text(repeat(card.read_text()).replace("---\n", f"---\n{head}\n", 1))
    (found,) = [problem for problem in problems(folder) if "download_size is" in problem]
    assert len(found) < 1000


@pytest.mark.parametrize("stored", ["{", "[]", '{"info": 5}', '{"info": {"features": [1]}}'])
def test_columns_that_are_described_wrongly_are_named(folder, stored):
    (path,) = (folder / "data").glob("test-*.parquet")
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata({"huggingface": stored}), path, write_page_checksum=True)
    assert any(f"{path.name!r}"[1:-1] in problem and "huggingface" in problem for problem in problems(folder))


def test_the_card_takes_another_name(digits_set):
    card = (digits_set / "README.md").read_text()
    named = with_repo_name(card, "someone/digits")
    assert card.count('"FOLDER"') == named.count('"someone/digits"') == 3
    assert '"FOLDER"' not in named
    assert with_repo_name(named, "other/name") == with_repo_name(card, "other/name")
    assert with_repo_name("no code here", "other/name") == "no code here"


@given(st.integers(0, 10**15))
def test_size_categories_are_the_hubs(rows):
    name = size_category(rows)
    bounds = {"K": 10**3, "M": 10**6, "B": 10**9, "T": 10**12}

    def number(text: str) -> int:
        return int(text[:-1]) * bounds[text[-1]]

    parts = name.split("n")
    low = number(parts[0].rstrip("<")) if parts[0] else (number(parts[1][1:]) if parts[1][0] == ">" else 0)
    high = number(parts[1][1:]) if parts[1].startswith("<") else 10**18
    assert low <= rows < high


FEATURES = {
    "plain": datasets.Value("int64"),
    "dotted.name": datasets.List(datasets.List(datasets.Value("float32"), length=3)),
    "fixed": datasets.List(datasets.List(datasets.Value("float64"), length=4), length=5),
    "text": datasets.List(datasets.Value("string")),
    "pictures": datasets.List(datasets.Image(), length=2),
    "clips": datasets.List(datasets.Video()),
    "objects": datasets.List({"shape": datasets.Value("string"), "x_m": datasets.Value("float64")}),
    "inside": {"a": datasets.Value("bool"), "b": {"c": datasets.ClassLabel(names=["x", "y"])}},
    "when": datasets.Value("duration[us]"),
}


@pytest.mark.parametrize("name", FEATURES)
def test_features_are_spelt_as_datasets_spells_them(name):
    features = datasets.Features({name: FEATURES[name]})
    assert yaml_features(features.arrow_schema) == features._to_yaml_list()
    assert datasets.Features._from_yaml_list(yaml_features(features.arrow_schema)) == features


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"dtype": "int64"}, "int64"),
        ({"list": {"list": "float32", "length": 3}}, "list of float32[3]"),
        ({"list": {"list": "float64", "length": 2}, "length": 5}, "float64[2][5]"),
        ({"list": {"list": {"list": "int8"}}, "length": 5}, "(list of list of int8)[5]"),
        ({"dtype": {"class_label": {"names": {"0": "a", "1": "b"}}}}, "ClassLabel: a, b"),
        ({"list": [{"name": "x"}, {"name": "y"}]}, "list of struct of x, y"),
    ],
)
def test_types_for_people(entry, text):
    assert column_type_text(entry) == text


@pytest.mark.thorough
def test_the_same_rows_give_the_same_picture_and_card(digits_set, tmp_path):
    again = tmp_path / "again"
    spec = DigitSetSpec(SyntheticSource(), SolidSpec(target_vertices=2_000), per_class=1)
    generate(spec, str(again), ("holdout",))
    generate(spec, str(again), ("test",))
    for path in ("README.md", "previews/digits.png"):
        assert (again / path).read_bytes() == (digits_set / path).read_bytes()


@pytest.mark.parametrize(
    "card", ["x\n---\na: 1\n---\nbody", "---\n[1]\n---\nbody", "---\na: [\n---\nbody", "body"]
)
def test_a_head_is_changed_only_where_there_is_one(card):
    assert with_head("---\na: 1\n---\nbody", lambda head: head.update(b=2)) == "---\na: 1\nb: 2\n---\nbody"
    with pytest.raises(ValueError, match=r"."):
        with_head(card, lambda head: head.update(b=2))
