"""Tables that are read a few rows at a time, compared with their content."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.columns import tables
from tactile_toolkit.columns.tables import Table
from tactile_toolkit.errors import InputError


def table(content: bytes | str, ending: str = ".csv") -> Table:
    data = content.encode() if isinstance(content, str) else content
    return Table(f"home/table{ending}", lambda: io.BytesIO(data))


def read(found: Table, *numbers: int) -> dict[str, list[Any]]:
    rows, _, _ = found.scan()
    result: dict[str, list[Any]] = pa.table(found.rows(np.array(numbers or range(rows)))).to_pydict()
    return result


@pytest.mark.parametrize(
    "text",
    [
        "n,x,ok,note\n1,0.5,true,a\n2,3,FALSE,b c\n-3,,true,7\n",
        "sep=;\r\nn;x;ok;note\r\n1;0,5;true;a\r\n2;3;FALSE;b c\r\n-3;NA;true;7\r\n",
        '"n"\t"x"\t"ok"\t"note"\n1\t0.5\ttrue\ta\n2\t 3\tFALSE\t"b c"\n-3\tnan\ttrue\t7',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("block_bytes", [24, 1 << 20])
def test_types_follow_from_all_rows(text, encoding, block_bytes, monkeypatch):
    monkeypatch.setattr(tables, "_BLOCK_BYTES", block_bytes)
    expected = {"n": [1, 2, -3], "x": [0.5, 3.0, None], "ok": [True, False, True], "note": ["a", "b c", "7"]}
    assert read(table(text.encode(encoding))) == expected
    assert read(table(text.encode(encoding)), 0, 2) == {name: each[::2] for name, each in expected.items()}


def test_quoted_lines_empty_names_and_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "_BLOCK_BYTES", 32)
    found = read(table(',note,code\n0,"two\nlines, a comma",007\n1,NA,1e3\n2,,x\n'))
    assert found["column_1"] == [0, 1, 2]
    assert found["note"] == ["two\nlines, a comma", "NA", None]
    assert found["code"] == ["007", "1e3", "x"]


EXACT = {
    "code": ["007", "8"],
    "hexadecimal": ["0x1F", "1"],
    "long": ["9007199254740993", "0.5"],
    "large": ["1e400", "1"],
    "switch": ["true", "1"],
}


def test_text_that_a_number_would_not_reproduce_stays_text() -> None:
    rows = [",".join(EXACT), *(",".join(row) for row in zip(*EXACT.values(), strict=True))]
    assert read(table("\n".join(rows))) == EXACT
    _, _, times = table("t\n007\n008\n").scan(lambda _: "t")
    assert times.to_pylist() == [7, 8]  # fixed width, as loggers write it


def test_a_column_without_a_value_has_none() -> None:
    assert read(table("n,empty,words\n1,,NA\n2,,nan\n")) == {
        "n": [1, 2],
        "empty": [None] * 2,
        "words": [None] * 2,
    }


@pytest.mark.parametrize("block_bytes", [50, 1 << 20])
def test_json_lines(block_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "_BLOCK_BYTES", block_bytes)
    lines = [{"t": number, "x": 1 if number % 2 else 0.5, "pose": [0.0, number]} for number in range(20)]
    lines[3] |= {"note": 'a "quote\nb'}
    text = "".join(f"{json.dumps(line)}\n" for line in lines)
    found = read(table(text, ".jsonl"))
    assert found["t"] == list(range(20))
    assert found["x"] == [0.5, 1.0] * 10
    assert found["pose"] == [[0.0, number] for number in range(20)]
    assert found["note"] == [None] * 3 + ['a "quote\nb'] + [None] * 16


def test_parquet(tmp_path: Path) -> None:
    stored = pa.table(
        {"t": np.arange(70_000) / 1000, "word": ["a", "b"] * 35_000, "v": [[1.0, 2.0]] * 70_000}
    )
    pq.write_table(stored, tmp_path / "table.parquet", row_group_size=20_000)
    found = table((tmp_path / "table.parquet").read_bytes(), ".parquet")
    rows, _, times = found.scan(lambda _: "t")
    assert rows == 70_000
    assert times.to_pylist() == stored["t"].to_pylist()
    numbers = np.array([0, 32_767, 32_768, 69_999])
    assert pa.table(found.rows(numbers)).to_pydict() == stored.take(numbers).to_pydict()


@pytest.mark.parametrize(
    ("content", "ending", "words"),
    [
        ("a,a\n1,2\n", ".csv", "two columns 'a'"),
        ("Fx\tt\t Fx\n1\t2\t3\n", ".tsv", "two columns 'Fx'"),
        ("a,b\n1,2,3\n", ".csv", "row 2, with the header as row 1, has 3 values; expected 2"),
        ("a,b\n\n1\n", ".csv", "row 2, with the header as row 1, has 1 value; expected 2"),
        (b"a\n\xff\xfe\n", ".csv", "is not text; next: save it as UTF-8 text"),
        (b"a,b\n1,2\n\xff\n", ".csv", "is not text; next: save it as UTF-8 text"),
        ('a,b\n"1,2\n3,4\n', ".csv", "cannot be read as a table"),
        ("", ".csv", "is empty; next: write a line"),
        ("sep=;\n\n", ".csv", "is empty; next: write a line"),
        (",".join(map(str, range(2000))) + "\n", ".csv", "2,000 columns"),
        ('{"a": 1}\n{"a": \n', ".jsonl", "cannot be read as a table"),
        ('{"a": 1}\n{"a": "b"}\n', ".jsonl", "cannot be read as a table"),
        ('"text"', ".jsonl", "cannot be read as a table"),
        ("[" * 100_000, ".jsonl", "more than 32 brackets inside each other"),
        ('{"a": ' + "[" * 10_000 + "]" * 10_000 + "}", ".jsonl", "more than 32 brackets inside each other"),
        ('{"]": "]]", "a": ' + '{"a": [' * 20 + "]}" * 20 + "}", ".jsonl", "more than 32 brackets"),
        (b"PAR1 and more", ".parquet", "cannot be read as a table"),
    ],
)
def test_other_files_are_refused(content: bytes | str, ending: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(table(content, ending))


def test_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "MAX_ROWS", 3)
    with pytest.raises(InputError, match="more than 3 rows"):
        table("a\n" + "1\n" * 4).scan()
    monkeypatch.setattr(tables, "MAX_HELD_ROWS", 2)
    with pytest.raises(InputError, match="more than 2 rows"):
        table("a\n" + "1\n" * 3).whole()
    monkeypatch.setattr(tables, "_BLOCK_BYTES", 16)
    for ending, line in ((".csv", "1" * 100), (".jsonl", f'{{"a": {"1" * 100}}}')):
        with pytest.raises(InputError, match="cannot be read as a table"):
            table(f"a\n{line}\n", ending).scan()
    assert table("", ".jsonl").names == []


def test_types_that_differ_between_blocks_of_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "_BLOCK_BYTES", 8)
    with pytest.raises(InputError, match="Field a has incompatible types: int64 vs string"):
        table('{"a": 1}\n{"a": "b"}\n', ".jsonl").scan()


def test_switches_after_numbers_are_text(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block ends between them; each block alone would have another type."""
    monkeypatch.setattr(tables, "_BLOCK_BYTES", 8)
    values = ["1"] * 7 + ["true"] * 8
    assert read(table("\n".join(["a", *values]) + "\n")) == {"a": values}
    empty = ["NA"] * 8 + ["true"] * 8
    assert read(table("\n".join(["a", *empty]) + "\n")) == {"a": [None] * 8 + [True] * 8}


def test_brackets_in_texts_are_not_nested_and_deep_vectors_stay_text() -> None:
    lines = ['{"a": ":-[ \\\\"}', '{"a": "{ \\" ["}'] * 100
    assert read(table("\n".join(lines), ".jsonl"))["a"] == [":-[ \\", '{ " ['] * 100
    deep = "[" * 5_000 + "]" * 5_000
    assert table(f"a,b\n1,{deep}\n").whole()["b"].to_pylist() == [deep]


def test_a_field_holds_thousands_of_numbers() -> None:
    """The maps of a touch are a field of a megabyte."""
    field = " ".join(["0.123456"] * 100_000)
    assert table(f"file,map\n0.png,{field}\n").whole()["map"].to_pylist() == [field]


def test_a_whole_table_keeps_chosen_texts_and_reads_vectors() -> None:
    found = table('label;x;v;bad\n007; 0,5;"[1, 2.5]";1,5\n 7 ;1,5;[];NA\n8;2;[3];high\n')
    columns = found.whole(["label"], ["x", "bad"])
    assert columns["label"].to_pylist() == ["007", " 7 ", "8"]
    assert columns["x"].to_pylist() == [0.5, 1.5, 2.0]
    assert columns["v"].to_pylist() == [[1.0, 2.5], [], [3.0]]
    assert columns["bad"].to_pylist() == ["1.5", None, "high"]
    assert {name: len(column) for name, column in table("a,b\n").whole().items()} == {"a": 0, "b": 0}
