"""``merge`` and ``split``: every row occurs once and unchanged, in data sets of the same kind."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tactile_toolkit.catalog import RowFilter
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange.copies import drawn_parts
from tactile_toolkit.store import open_folder, read_manifest
from tests.command_line import call
from tests.processes import start_held
from tests.realtouch import factories

ALONE = ("--workers", 1, "-q")


def _made(kind: str, folder: Path) -> Path:
    if kind == "realtouch":
        rounds = [factories.make_round(index, 3, (32, 24), (4, 5)) for index in range(6)]
        return factories.write_set(folder, {"train": factories.single_rows(rounds)}, "single")
    words = {
        "mnist3d": ("generate", "--split", "test", "--per-class", 1, "--vertices", 2_000, *ALONE),
        "starstruck": ("generate", "--scenes", "train=8,test=4", *ALONE),
    }[kind]
    assert call(kind, *words, "--out", folder) == 0
    return folder


def with_source(row: dict[str, object], source: str, kind: str) -> dict[str, object]:
    """Return a row as it is stored in a merged set."""
    licence = "cc-by-2.0" if kind == "realtouch" else "mit"
    name = "source_set" if kind == "mnist3d" else "source"
    return {**row, name: source, "source_id": str(row["id"]), "licence": licence}


def _rows(*folders: Path) -> dict[str, list[dict[str, object]]]:
    """Return the rows of data sets by split, in order of their ids."""
    rows: dict[str, list[dict[str, object]]] = {}
    for folder in folders:
        for file in sorted((folder / "data").glob("*.parquet")):
            rows.setdefault(file.name.split("-")[0], []).extend(pq.read_table(file).to_pylist())
    return {split: sorted(each, key=lambda row: row["id"]) for split, each in rows.items()}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("kind", ["realtouch", "mnist3d", "starstruck"])
def test_parts_are_data_sets_and_together_the_whole(kind, tmp_path, capsys):
    folder = _made(kind, tmp_path / "all")
    parts = tmp_path / "parts"
    assert call("tactile", "split", folder, "--fractions", "0.75,0.25", "--out", parts, *ALONE) == 0
    one, two = parts / "part-1", parts / "part-2"
    back = tmp_path / "back"
    again = tmp_path / "again"
    assert call("tactile", "merge", two, one, "--out", back, *ALONE) == 0
    for made in (one, two, back):
        assert call("tactile", "verify", made, "-q") == 0
        assert call("tactile", "card", made, "-q") == 0
        assert call("tactile", "info", made) == 0
    assert _rows(one, two) == _rows(folder)
    assert _rows(back) == {
        split: [with_source(row, "part-1" if row in _rows(one)[split] else "part-2", kind) for row in rows]
        for split, rows in _rows(folder).items()
    }
    assert {len(each) for each in _rows(two).values()} <= {1, 2, 3}
    package = {"starstruck": "starstruck_gen"}.get(kind, kind)
    split = next(iter(_rows(back)))
    assert len(import_module(package).load(str(back), split)) == len(_rows(back)[split])
    # The same parts from the same seed.
    assert call("tactile", "split", folder, "--fractions", "0.75,0.25", "--out", again, *ALONE) == 0
    for file in one.rglob("*.parquet"):
        assert (again / file.relative_to(parts)).read_bytes() == file.read_bytes()
    capsys.readouterr()
    assert call("tactile", "merge", one, folder, "--out", tmp_path / "twice", "--workers", 1) == 0
    assert f"{sum(map(len, _rows(one).values()))} ids occurred again and are new" in capsys.readouterr().out
    assert call("tactile", "verify", tmp_path / "twice", "-q") == 0


@pytest.mark.thorough
def test_objects_are_taken_out_by_id(tmp_path, capsys):
    folder = _made("mnist3d", tmp_path / "all")
    ids = [row["id"] for row in _rows(folder)["test"]]
    words = ("split", folder, "--ids", f"{ids[0]},{ids[3]}", "--out", tmp_path / "parts", *ALONE)
    assert call("tactile", *words) == 0
    assert [row["id"] for row in _rows(tmp_path / "parts/part-1")["test"]] == [ids[0], ids[3]]
    assert len(_rows(tmp_path / "parts/part-2")["test"]) == len(ids) - 2
    assert call("tactile", "split", folder, "--out", tmp_path / "none", *ALONE) == 2
    assert "expected --fractions, or filters" in capsys.readouterr().err
    both = ("--fractions", "0.8,0.2", "--ids", f"{ids[0]}")
    assert call("tactile", "split", folder, *both, "--out", tmp_path / "none") == 2
    assert "next: leave out --fractions, or the filters" in capsys.readouterr().err
    for wrong in ("0.8,0.3", "0", "a", "nan"):
        assert call("tactile", "split", folder, "--fractions", wrong, "--out", tmp_path / "none") == 2
        assert f"--fractions is '{wrong}'" in capsys.readouterr().err
    scenes = _made("starstruck", tmp_path / "scenes")
    assert call("tactile", "merge", folder, scenes, "--out", tmp_path / "none", *ALONE) == 2
    assert (
        f"holds digits and {str(scenes)!r} holds scenes; expected data sets of one kind"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "none").exists()


def test_rounds_are_taken_by_their_ids(tmp_path, capsys):
    folder = _made("realtouch", tmp_path / "all")
    split, rows = next(iter(_rows(folder).items()))
    ids = [row["id"] for row in rows]
    words = ("--split", split, "--ids", ids[1])
    assert call("tactile", "split", folder, *words, "--out", tmp_path / "parts", *ALONE) == 0
    assert [row["id"] for row in _rows(tmp_path / "parts/part-1")[split]] == ids[1:2]
    assert [row["id"] for row in _rows(tmp_path / "parts/part-2")[split]] == [ids[0], *ids[2:]]
    assert call("tactile", "gallery", folder, *words, "--out", tmp_path / "page", *ALONE) == 0
    capsys.readouterr()
    for wrong in ("3", "3-5", ids[1][:-1]):
        words = ("--split", split, "--ids", wrong, "--out", tmp_path / "none")
        for command in ("split", "gallery"):
            assert call("tactile", command, folder, *words, *ALONE) == 2
            assert "no object with " in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


@pytest.mark.thorough
def test_a_killed_merge_continues_and_damage_is_not_copied(tmp_path, capsys):
    folder = _made("mnist3d", tmp_path / "all")
    assert call("tactile", "split", folder, "--fractions", "0.5,0.5", "--out", tmp_path, *ALONE) == 0
    one, two, out = tmp_path / "part-1", tmp_path / "part-2", tmp_path / "out"
    process = start_held("tactile", 1, tmp_path / "marker", "merge", one, two, "--out", out, "--workers", 1)
    process.kill()
    process.communicate()
    assert call("tactile", "merge", one, two, "--out", out, "--workers", 1) == 0
    assert "made 5 digits in " in capsys.readouterr().out
    assert call("tactile", "verify", out, "-q") == 0
    manifest = read_manifest(open_folder(str(one)))
    assert manifest is not None
    file = one / manifest.shards[0].shard.data_path
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 1
    file.write_bytes(content)
    assert call("tactile", "merge", one, two, "--out", tmp_path / "bad", *ALONE) == 3
    assert file.name in capsys.readouterr().err


def test_an_unknown_split_and_an_empty_choice_are_named(tmp_path, capsys):
    folder = _made("starstruck", tmp_path / "all")
    out = tmp_path / "parts"
    capsys.readouterr()
    for further in ((), ("--ids", 0)):
        assert call("tactile", "split", folder, "--split", "tset", *further, "--out", out, *ALONE) == 2
        error = capsys.readouterr().err
        assert "no split 'tset'" in error
        assert "did you mean 'test'?" in error
    assert not out.exists()
    scenes = [("train", import_module("starstruck_gen").load(str(folder), "train"))]
    with pytest.raises(InputError, match="no object is chosen"):
        RowFilter(ids=[]).choose(scenes)


def _objects(folder: Path) -> set[int]:
    return {row["object_id"] for rows in _rows(folder).values() for row in rows}


def test_all_touches_of_an_object_are_in_one_part(tmp_path, capsys):
    """Also of objects in several splits; dividing them is refused unless it is asked for."""
    rounds = [
        replace(factories.make_round(index, 2, (16, 12), (3, 4)), object_id=index % 4) for index in range(12)
    ]
    splits = {"train": factories.single_rows(rounds[:8]), "test": factories.single_rows(rounds[8:11])}
    folder = factories.write_set(tmp_path / "all", splits, "single")
    parts = tmp_path / "parts"
    assert call("tactile", "split", folder, "--fractions", "0.8,0.2", "--out", parts, *ALONE) == 0
    one, two = parts / "part-1", parts / "part-2"
    assert (len(_objects(one)), len(_objects(two))) == (3, 1)
    assert not _objects(one) & _objects(two)
    assert read_manifest(open_folder(str(two))).spec["options"]["objects"] == "whole"
    for choice in ("--limit 1", f"--ids {rounds[0].id}"):
        words = ("split", folder, "--split", "train", *choice.split(), "--out", tmp_path / "limit", *ALONE)
        assert call("tactile", *words) == 2
        assert "both parts would have rounds of 1 object, the first with id 0" in capsys.readouterr().err
        assert not (tmp_path / "limit").exists()
    words = ("--fractions", "0.5,0.5", "--same-objects", "--out", tmp_path / "rows")
    assert call("tactile", "split", folder, *words, *ALONE) == 0
    divided = [tmp_path / "rows" / part for part in ("part-1", "part-2")]
    assert _objects(divided[0]) & _objects(divided[1])
    assert read_manifest(open_folder(str(divided[0]))).spec["options"]["objects"] == "divided"


def test_unknown_objects_are_stated(tmp_path, capsys):
    rounds = [factories.make_round(index, 2, (16, 12), (3, 4)) for index in range(4)]
    layout = factories.Layout(leave_out=("object_id",))
    rows = {"train": factories.single_rows(rounds)}
    folder = factories.write_set(tmp_path / "all", rows, "single", layout)
    parts = tmp_path / "parts"
    assert call("tactile", "split", folder, "--fractions", "0.5,0.5", "--out", parts, "-w", 1) == 0
    assert "the objects of some rounds are not known (no object_id)" in capsys.readouterr().err
    assert [len(_rows(part)["train"]) for part in sorted(parts.iterdir())] == [2, 2]


def test_each_part_has_an_object_if_there_are_enough():
    for count, fractions, sizes in (
        (2, (0.8, 0.2), [1, 1]),
        (4, (0.8, 0.2), [3, 1]),
        (10, (0.5, 0.3), [5, 3]),
        (5, (0.01, 0.01, 0.98), [1, 1, 3]),
        (4, (0.97, 0.01, 0.02), [2, 1, 1]),
        (1, (0.8, 0.2), [1, 0]),
    ):
        parts = list(drawn_parts(dict.fromkeys(range(count), 7), fractions, 0).values())
        assert [parts.count(part) for part in range(len(fractions))] == sizes
