"""Kinds of data sets: they are found by their entry points, and everything they name exists."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

import data_cards
from env_assets.wrench.kind import KIND as WRENCH
from mnist3d.kind import KIND as DIGITS
from realtouch.kind import KIND as TOUCHES
from starstruck_gen.kind import KIND as SCENES
from tactile_envs.episodes.kind import KIND as EPISODES
from tactile_sim.kind import KIND as SIMULATED
from tactile_toolkit.kind import DatasetKind

ALL = (EPISODES, DIGITS, TOUCHES, SCENES, SIMULATED, WRENCH)


def test_all_kinds_are_found_by_their_entry_points():
    assert DatasetKind.installed() == ALL


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)
def test_everything_that_a_kind_names_exists(kind: DatasetKind) -> None:
    paths: list[str] = [kind.preview_spec]
    for value in vars(kind).values():
        if getattr(value, "__qualname__", "") == "lazy.<locals>.call":
            (path,) = (cell.cell_contents for cell in value.__closure__)
            paths.append(path)
    assert len(paths) > 1
    for path in paths:
        module, _, name = path.partition(":")
        assert callable(getattr(import_module(module), name)), path
    folder = Path(data_cards.__path__[0])
    assert list(folder.glob(kind.card_template.replace("{}", "*")))
