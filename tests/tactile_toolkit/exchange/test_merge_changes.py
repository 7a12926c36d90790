"""Merging: duplicate ids get new ones, and a column names the data set of each row."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
import starstruck_gen
from realtouch.kind import KIND as TOUCHES
from starstruck_gen.kind import KIND as SCENES
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange import merge_sets
from tactile_toolkit.exchange.copies import divide, schema_difference, source_names, write_part
from tactile_toolkit.read.schemas import feature_metadata, label_feature
from tests.command_line import call
from tests.realtouch import factories


def scenes(folder: Path, seed: int) -> Path:
    starstruck_gen.generate(
        starstruck_gen.SceneSetSpec(scenes=(("train", 3), ("test", 2)), seed=seed), folder
    )
    return folder


def touches(folder: Path, seed: int) -> Path:
    rounds = [factories.make_round(index, 2, (24, 32), (4, 5)) for index in range(3 + seed % 2)]
    return factories.write_set(folder, {"train": factories.single_rows(rounds)}, "single")


def rows_of(folder: Path) -> list[dict[str, Any]]:
    return [row for file in sorted((folder / "data").iterdir()) for row in pq.read_table(file).to_pylist()]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("program", "make", "load"),
    [("starstruck", scenes, starstruck_gen.load), ("realtouch", touches, realtouch.load)],
)
def test_rows_get_new_ids_and_a_source_and_are_otherwise_unchanged(program, make, load, tmp_path, capsys):
    one, other = make(tmp_path / "a" / "set", 1), make(tmp_path / "b" / "set", 2)
    words = ("--out", tmp_path / "out", "-w", 1)
    assert call("tactile", "merge", one, other, *words, "--source-column", "origin") == 0
    said = capsys.readouterr().out
    spec = json.loads((tmp_path / "out" / "manifest.json").read_text())["spec"]["options"]
    assert (spec["source_column"], spec["sources"]) == ("origin", ["a/set", "b/set"])
    ((renumbered),) = spec["renumbered"]
    old, new = zip(*renumbered["ids"], strict=True)
    assert f"set: {len(old)} ids changed, the first from {old[0]} to {new[0]}" in said
    before = {"a/set": rows_of(one), "b/set": rows_of(other)}
    known = [row["id"] for rows in before.values() for row in rows]
    assert not set(new) & set(known)
    back = dict(zip(new, old, strict=True))
    merged: dict[str, dict[Any, Any]] = {name: {} for name in before}
    for row in rows_of(tmp_path / "out"):
        name, number = row.pop("origin"), row.pop("id")
        # The first data set keeps its ids.
        assert name == "b/set" or number not in back
        merged[name][back.get(number, number)] = row
    assert merged == {name: {row.pop("id"): row for row in rows} for name, rows in before.items()}
    out = tmp_path / "out"
    for command in ("verify", "info", "card"):
        assert call("tactile", command, out, "-q") == 0
    assert "name of the merged data set that the row is from" in (out / "README.md").read_text()
    counts = [len(load(name, split="train")) for name in (one, other)]
    origins = ["a/set"] * counts[0] + ["b/set"] * counts[1]
    assert load(out, split="train").column("origin").tolist() == origins
    import datasets

    read = datasets.load_dataset("parquet", data_files=[str(file) for file in (out / "data").glob("train*")])
    assert read["train"].features["origin"].dtype == "string"
    # Parts of it are data sets, too.
    assert call("tactile", "split", out, "--fractions", "0.5,0.5", "--out", tmp_path / "parts", "-w", 1) == 0
    assert call("tactile", "verify", tmp_path / "parts" / "part-1", "-q") == 0
    # The same bytes with two workers.
    kind = {"starstruck": SCENES, "realtouch": TOUCHES}[program]
    again = tmp_path / "again"
    merge_sets(kind, [one, other], str(again), source_column="origin", workers=2)
    for file in (out / "data").iterdir():
        assert file.read_bytes() == (again / "data" / file.name).read_bytes()


def test_shards_without_changes_are_copied_byte_for_byte(tmp_path: Path) -> None:
    whole = scenes(tmp_path / "whole", 1)
    for number, rows in enumerate(divide(SCENES, whole, (0.5, 0.5), 7, {})[0]):
        write_part(SCENES, whole, rows, {"part": number}, str(tmp_path / f"part-{number}"))
    parts = [tmp_path / "part-0", tmp_path / "part-1"]
    merged = merge_sets(SCENES, parts, str(tmp_path / "merged"))
    copied = {file.read_bytes() for part in parts for file in (part / "data").iterdir()}
    assert {file.read_bytes() for file in (tmp_path / "merged" / "data").iterdir()} == copied
    assert merged.spec["options"] == {}


def test_impossible_merges_are_refused(tmp_path: Path) -> None:
    one, other = scenes(tmp_path / "one", 1), scenes(tmp_path / "other", 2)
    for name in ("id", "mesh", "a.b", "", " ", "a\nb"):
        with pytest.raises(InputError, match=r"source_column is .*expected the name of a new column"):
            merge_sets(SCENES, [one, other], str(tmp_path / "out"), source_column=name)
    link = tmp_path / "link"
    link.symlink_to(one)
    part = next((Path(one) / "data").iterdir())
    for again in (one, f"{one}/../{Path(one).name}", link, part):
        with pytest.raises(InputError, match=r"a data set is given twice: .* have a file in common"):
            merge_sets(SCENES, [one, other, again], str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_new_ids_are_new_in_all_sources(tmp_path: Path) -> None:
    """Also if the first choice of a new id exists already, or an id occurs twice in one source."""
    folders = []
    for number, ids in enumerate((["a", "a_2", "b"], ["a", "a", "b_2"], ["a", "a_3"])):
        rounds = [factories.make_round(index, 2, (24, 32), (4, 5)) for index in range(len(ids))]
        rows = factories.single_rows(rounds)
        table = pq.read_table(
            next((factories.write_set(tmp_path / f"x{number}", {"train": rows}, "single") / "data").iterdir())
        )
        place = tmp_path / f"set-{number}" / "data"
        place.mkdir(parents=True)
        column = table.schema.get_field_index("id")
        pq.write_table(
            table.set_column(column, table.schema.field("id"), pa.array(ids)),
            place / "train-00000-of-00001.parquet",
        )
        folders.append(place.parent)
    merged = merge_sets(TOUCHES, folders, str(tmp_path / "out"))
    found = [row["id"] for row in rows_of(tmp_path / "out")]
    assert found == ["a", "a_2", "b", "a_4", "a_5", "b_2", "a_6", "a_3"]
    pairs = {each["source"]: each["ids"] for each in merged.spec["options"]["renumbered"]}
    assert pairs == {"set-1": [["a", "a_4"], ["a", "a_5"]], "set-2": [["a", "a_6"]]}


def test_messages_name_what_differs() -> None:
    def schema(classes: list[str], more: dict[str, Any] | None = None, **types: pa.DataType) -> pa.Schema:
        features = {"label": label_feature(classes), **(more or {})}
        return pa.schema({"id": pa.int64(), "label": pa.int64(), **types}).with_metadata(
            feature_metadata(features)
        )

    base = schema(["nut", "bolt"], x=pa.float32())
    for other, words in (
        (schema(["nut", "bolt"], x=pa.float64()), "the column 'x' is float in A and double in B"),
        (schema(["nut", "bolt"]), "A has the column 'x', which B lacks"),
        (schema(["nut", "bolt"], x=pa.float32(), y=pa.int8()), "B has the column 'y', which A lacks"),
        (schema(["nut", "star"], x=pa.float32()), "class 1 is 'bolt' in A and 'star' in B"),
        (schema(["nut"], x=pa.float32()), "class 1 is 'bolt' in A and missing in B"),
        (schema(["nut", "bolt"], {"x": {"_type": "Image"}}, x=pa.float32()), "the column 'x' has other meta"),
        (base.with_metadata({**(base.metadata or {}), b"k": b"v"}), "the metadata of A are not those of B"),
        (pa.schema(reversed(list(base)), base.metadata), "the columns of A are in another order"),
        (base, ""),
    ):
        found = schema_difference(base, other, ("A", "B"))
        assert found.startswith(words)
        assert bool(found) == bool(words)


def test_names_of_sources_are_as_short_as_they_differ(tmp_path: Path) -> None:
    assert source_names(["x/touches", "y/other"]) == ["touches", "other"]
    assert source_names(["x/set", "y/set"]) == ["x/set", "y/set"]
    assert source_names(["s3://bucket/a/set", "hub/name@main"]) == ["set", "name@main"]
