"""Kinds of data sets: found by their entry points, and what each says of itself is there."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

import data_cards
from env_assets.wrench.kind import KIND as WRENCH
from mnist3d.kind import KIND as DIGITS
from realtouch.kind import KIND as TOUCHES
from starstruck_gen.kind import KIND as SCENES
from tactile_sim.kind import KIND as SIMULATED
from tactile_toolkit.catalog.kinds import kind_of_meshes
from tactile_toolkit.catalog.published import kind_that_published, published_set
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, kinds
from tests.processes import printed_by

ALL = (DIGITS, TOUCHES, SCENES, SIMULATED, WRENCH)


def test_all_kinds_are_found_by_their_entry_points():
    assert kinds() == ALL


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)
def test_what_a_kind_names_is_there(kind: DatasetKind) -> None:
    paths: list[str] = []
    for value in vars(kind).values():
        if getattr(value, "__qualname__", "") == "lazy.<locals>.call":
            module, name = (cell.cell_contents for cell in value.__closure__)
            paths.append(f"{module}:{name}")
    assert paths
    for path in paths:
        module, _, name = path.partition(":")
        assert callable(getattr(import_module(module), name)), path
    folder = Path(data_cards.__path__[0])
    assert list(folder.glob(kind.card_template.replace("{}", "*")))


@pytest.mark.parametrize("kind", [DIGITS, SCENES, WRENCH], ids=lambda kind: kind.name)
def test_columns_of_a_kind_are_in_its_schema_and_in_no_other(kind: DatasetKind) -> None:
    assert kind.schema is not None
    schema = kind.schema()
    assert set(kind.columns) < set(schema.names)
    assert kind_of_meshes(schema) is kind
    plain = schema.remove(schema.get_field_index(kind.columns[0]))
    # Without our columns, as the published data sets are, the names of the classes tell.
    assert kind_of_meshes(plain) is (kind if kind.published else None)
    assert kind_of_meshes(plain.remove_metadata()) is None


def test_data_of_another_kind_is_refused():
    manifest = SimpleNamespace(kind="starstruck")
    SCENES.refuse_other(manifest, "here")
    DIGITS.refuse_other(None, "here")
    with pytest.raises(
        InputError, match="'here' holds a data set of kind 'starstruck'; expected one of 'mnist3d'"
    ):
        DIGITS.refuse_other(manifest, "here")


def test_lines_that_open_a_data_set():
    assert SCENES.loading_lines(None, 'a "b"', "train") == (
        "import starstruck_gen",
        r'starstruck_gen.load("a \"b\"", split="train")',
    )
    plain = SimpleNamespace(kind="realtouch", spec={"operation": "frames"})
    assert TOUCHES.loading_lines(plain, "me/touches", "test", "v1") == (
        "import datasets",
        'datasets.load_dataset("me/touches", split="test", revision="v1")',
    )
    tables = SimpleNamespace(kind="starstruck", spec={"operation": "export"})
    for kind in (SCENES, TOUCHES):
        assert kind.loading_lines(tables, "x", "test")[1] == 'datasets.load_dataset("x", split="test")'
    assert SCENES.schema_of(tables) is None
    assert TOUCHES.loading_lines(None, "x", "test")[1] == 'realtouch.load("x", split="test")'


def test_published_sets_know_their_kind():
    entry = published_set("real-single")
    assert entry is not None
    assert entry is published_set("real-single-320x240")
    assert published_set(entry.repo_id) is entry
    assert kind_that_published(entry.name) is kind_that_published(entry.repo_id) is TOUCHES
    assert kind_that_published("nobody/nothing") is None


@pytest.mark.parametrize("kind", [DIGITS, SCENES, WRENCH], ids=lambda kind: kind.name)
def test_recipes_come_back_from_what_a_manifest_keeps(kind: DatasetKind) -> None:
    stored = json.loads(json.dumps(kind.recipe(3, 2).making.manifest()))
    settings = kind.recipe_settings(stored)
    assert settings == (None if kind is WRENCH else (3, 2))


def test_looking_at_kinds_imports_nothing_heavy():
    code = (
        "import sys; from tactile_toolkit.kind import kinds; kinds();"
        "print(*{'numpy', 'pyarrow', 'trimesh', 'datasets', 'PIL'} & set(sys.modules))"
    )
    assert printed_by(code).strip() == ""
