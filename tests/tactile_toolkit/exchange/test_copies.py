"""Copies take the rows that their source had when they were planned, or none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pyarrow.parquet as pq
import pytest

import realtouch
import starstruck_gen
import tactile_sim
from starstruck_gen.kind import KIND as SCENES
from tactile_toolkit.catalog import RowFilter
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.exchange import merge_sets, plan_tables
from tactile_toolkit.exchange.copies import divide, write_part
from tactile_toolkit.places import open_place
from tactile_toolkit.store import Progress, build, open_folder
from tests.realtouch import factories


def scenes(folder: Path, seed: int) -> str:
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 3),), seed=seed), folder)
    return str(folder)


def touches(folder: Path, seed: int) -> str:
    rounds = [factories.make_round(seed + index, 2, (24, 32), (4, 5)) for index in range(2)]
    factories.write_set(folder, {"train": factories.single_rows(rounds)}, "single")
    return str(folder)


def merged(source: str, out: str, **run: Any) -> None:
    merge_sets(SCENES, [source], out, **run)


def divided(source: str, out: str, **run: Any) -> None:
    write_part(SCENES, source, {"train": np.array([0, 2])}, {}, out, **run)


def flat(source: str, out: str, **run: Any) -> None:
    build(open_folder(out), plan_tables(SCENES, open_place(source), RowFilter(), out), **run)


def resized(source: str, out: str, **run: Any) -> None:
    realtouch.resize(source, out, 16, 12, **run)


def flat_touches(source: str, out: str, **run: Any) -> None:
    realtouch.export(source, out, "flat", **run)


def pressed(source: str, out: str, **run: Any) -> None:
    plan = tactile_sim.TouchPlan(rounds=1, touches=1)
    tactile_sim.generate(source, tactile_sim.TouchSetSpec(plan=plan, optics="depth"), out, **run)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("make", "copy"),
    [
        (scenes, merged),
        (scenes, divided),
        (scenes, flat),
        (scenes, pressed),
        (touches, resized),
        (touches, flat_touches),
    ],
)
def test_a_source_that_is_replaced_between_planning_and_copying_is_refused(make, copy, tmp_path):
    source, other = make(tmp_path / "source", 1), make(tmp_path / "other", 20)
    out = tmp_path / "out"

    def exchange(_progress: Progress) -> None:
        (tmp_path / "source" / "data").rename(tmp_path / "former")
        (Path(other) / "data").rename(tmp_path / "source" / "data")

    with pytest.raises(IntegrityError, match="was replaced or changed"):
        copy(source, str(out), on_progress=exchange)
    assert not out.exists()


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("copy", [merged, divided, flat])
def test_so_is_one_in_a_store(copy: Callable[..., None], tmp_path: Path) -> None:
    made, store = scenes(tmp_path / "made", 1), fsspec.filesystem("memory")
    source = f"memory://{copy.__name__}"
    for file in filter(Path.is_file, Path(made).rglob("*")):
        store.pipe_file(f"/{copy.__name__}/{file.relative_to(made)}", file.read_bytes())
    path = f"/{copy.__name__}/data/train-00000-of-00001.parquet"

    def replace(_progress: Progress) -> None:
        store.pipe_file(path, store.cat_file(path))  # as new, even if its content is the same

    with pytest.raises(IntegrityError, match="was replaced or changed"):
        copy(source, str(tmp_path / "out"), on_progress=replace)


def test_a_set_whose_first_shard_is_empty_is_divided(tmp_path: Path) -> None:
    whole = Path(scenes(tmp_path / "whole", 1)) / "data" / "train-00000-of-00001.parquet"
    table = pq.read_table(whole)
    source = tmp_path / "source" / "data"
    source.mkdir(parents=True)
    for index, part in enumerate((table[:0], table[:1], table[:0], table[1:])):
        pq.write_table(part, source / f"train-{index:05d}-of-00004.parquet")
    parts, _ = divide(SCENES, str(source.parent), (0.5, 0.5), 7)
    found: list[int] = []
    for number, rows in enumerate(parts):
        out = str(tmp_path / f"part-{number}")
        write_part(SCENES, str(source.parent), rows, {"part": number}, out)
        found += starstruck_gen.load(out).ids.tolist()
    assert sorted(found) == sorted(table["id"].to_pylist())
    merge_sets(SCENES, [str(source.parent)], str(tmp_path / "merged"))
    assert starstruck_gen.load(str(tmp_path / "merged")).ids.tolist() == table["id"].to_pylist()
