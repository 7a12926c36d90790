"""Import of Parquet tables of images, made by this toolkit or by others."""

from __future__ import annotations

import datetime
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.formats.flat_parquet import find_flat
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.source_files import Ledger
from realtouch.importing.source_touches import SourceTouches
from tactile_toolkit import read, store
from tactile_toolkit.errors import InputError, ToolkitError
from tests.realtouch.found import each_of, require_pictures_or_messages
from tests.realtouch.images_of_others import picture

JPEGS = [picture(level) for level in range(0, 240, 20)]


def found(home: Path, **columns: Any) -> SourceTouches:
    parts = find_flat(store.open_folder(str(home)), realtouch.ImportColumns(**columns), None, Ledger())
    return SourceTouches.joined(list(parts))


def write(
    home: Path, name: str = "data/train-00000-of-00001.parquet", rows_per_group: int = 5, **columns: Any
) -> Path:
    path = home / name
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path, row_group_size=rows_per_group)
    return path


def images(names: list[str | None] | None = None) -> pa.Array:
    paths = names or [None] * len(JPEGS)
    return pa.array([{"bytes": jpeg, "path": path} for jpeg, path in zip(JPEGS, paths, strict=True)])


@pytest.mark.parametrize("form", ["struct", "binary", "large"])
def test_rows_of_others_are_touches(form: str, tmp_path: Path) -> None:
    """Other columns keep their names; pictures may be in any order."""
    names: list[str | None] = [f"/home/me/{number}.jpg" for number in range(len(JPEGS))]
    names[3] = None
    kinds = {"struct": images(names), "binary": pa.array(JPEGS), "large": pa.array(JPEGS, pa.large_binary())}
    force = np.random.default_rng(1).normal(size=(len(JPEGS), 3))
    others = {"force": force.tolist(), "label": ["mug", None] * 6, "when": [datetime.date(2026, 1, 1)] * 12}
    write(tmp_path, tactile=kinds[form], **others)
    write(tmp_path, "more/part.parquet", tactile=kinds[form], **others)
    touches = found(tmp_path)
    assert len(touches) == 24
    for number, touch in enumerate(each_of(touches)):
        row = number % 12
        split = {"split": "train"} if number < 12 else {}
        values = {name: column[row] for name, column in others.items() if column[row] is not None}
        assert touch.values == {**split, **values}
        assert touch.problem is None
    stem = "data/train-00000-of-00001"
    expected = [f"{stem}_{row:06d}" if form != "struct" or row == 3 else f"{row}.jpg" for row in range(12)]
    assert touches.listing["name"].to_pylist()[:12] == expected
    assert list(IMPORTS["flat"].contents(touches)) == JPEGS * 2
    order = np.random.default_rng(2).permutation(24).tolist()
    assert list(IMPORTS["flat"].contents(touches.take(np.array(order)))) == [
        JPEGS[each % 12] for each in order
    ]
    (tmp_path / "more" / "part.parquet").rename(tmp_path / "only.parquet")
    assert len(found(tmp_path / "only.parquet")) == 12


def test_a_table_with_only_pictures(tmp_path: Path) -> None:
    write(tmp_path, picture=pa.array(JPEGS))
    assert [touch.values for touch in each_of(found(tmp_path))] == [{"split": "train"}] * 12


def test_folders_of_hive_state_columns(tmp_path: Path) -> None:
    write(tmp_path, "label=/split=/part-0.parquet", tactile=images())
    write(tmp_path, "label=3/object%20name=blue%20cup/part-0.parquet", tactile=images())
    write(tmp_path, "label=4/split=test/code=007/part-0.parquet", tactile=images(), split=["own"] * 12)
    values = [touch.values for touch in each_of(found(tmp_path))][::12]
    assert values == [
        {},
        {"label": 3, "object name": "blue cup"},
        {"label": 4, "split": "own", "code": "007"},
    ]


def test_one_of_several_columns_of_pictures_is_chosen(tmp_path: Path) -> None:
    write(tmp_path, left=images(), right=pa.array(JPEGS[::-1]), label=["a"] * 12)
    with pytest.raises(
        InputError, match="has the columns of pictures left, right; expected one; next: choose one"
    ):
        found(tmp_path)
    with pytest.raises(InputError, match="left, right; expected 'rigt'; did you mean 'right'"):
        found(tmp_path, image="rigt")
    touches = found(tmp_path, image="right")
    assert list(IMPORTS["flat"].contents(touches)) == JPEGS[::-1]
    assert each_of(touches)[0].values == {"label": "a", "split": "train"}
    write(tmp_path, label=["a"])
    with pytest.raises(InputError, match="no columns of pictures, but label; expected pictures"):
        found(tmp_path)


@pytest.mark.parametrize("kind", ["single", "seq"])
def test_a_set_of_touches_needs_no_import(kind: str, request: pytest.FixtureRequest) -> None:
    folder = request.getfixturevalue(f"{kind}_folder")
    with pytest.raises(InputError, match=r"'sensor_(image|video)' of a data set of touches, which needs no"):
        found(folder)


def test_invalid_pictures_and_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no Parquet files"):
        found(tmp_path)
    home, secret = tmp_path / "home", tmp_path / "secret.parquet"
    write(tmp_path, "secret.parquet", image=images())
    stored = [
        {"bytes": None, "path": "/etc/passwd"},
        None,
        {"bytes": b"", "path": "a"},
        {"bytes": JPEGS[0], "path": 3},
    ]
    write(home, image=pa.array([{**each, "path": str(each["path"])} if each else None for each in stored]))
    contents = list(IMPORTS["flat"].contents(found(home)))
    problems = [f"row {row} of 'image' holds no bytes; expected a picture" for row in range(3)]
    assert [str(each) for each in contents[:3]] == problems
    assert contents[3] == JPEGS[0]
    (home / "data" / "link.parquet").symlink_to(secret)
    with pytest.raises(InputError, match=r"link\.parquet': a link leads out of the folder"):
        found(home)
    (home / "data" / "link.parquet").unlink()
    (home / "data" / "z.parquet").write_bytes(secret.read_bytes()[:-30])
    with pytest.raises(ToolkitError, match=r"z\.parquet' is damaged"):
        found(home)
    names = ["a", "a"]
    pq.write_table(
        pa.Table.from_arrays([pa.array(JPEGS), pa.array(JPEGS)], names), home / "data" / "z.parquet"
    )
    with pytest.raises(InputError, match="two columns of one name"):
        found(home)


def test_tables_that_unpack_to_huge_sizes_are_refused(tmp_path, monkeypatch):
    """A text that is stored once for many rows, and numbers that compress to almost no space."""
    monkeypatch.setenv("TACTILE_TOOLKIT_UNPACKED_MIB", "4")
    count = 10_000
    image = pa.DictionaryArray.from_arrays(pa.array([0] * count, pa.int32()), pa.array([JPEGS[0]])).cast(
        pa.binary()
    )
    force = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(80 * count)), 80)
    write(tmp_path, rows_per_group=count, image=image, force=force)
    with pytest.raises(InputError, match=r"unpacks to .* nothing was unpacked"):
        found(tmp_path)
    note = pa.DictionaryArray.from_arrays(pa.array([0] * count, pa.int32()), pa.array(["x" * 5000]))
    write(tmp_path, rows_per_group=count, image=image, note=note.cast(pa.string()))
    with pytest.raises(InputError, match=r"unpacks to .* nothing was unpacked"):
        found(tmp_path)


@pytest.mark.thorough
def test_any_damage_gives_a_result_or_a_message(tmp_path: Path) -> None:
    force = np.random.default_rng(1).normal(size=(12, 3))
    path = write(tmp_path, image=images(), force=force.tolist(), label=["mug", None] * 6, count=[1, None] * 6)
    require_pictures_or_messages(path, "flat", "image")


def with_wrong_histogram(content: bytes) -> list[bytes]:
    """Return files whose footer states one more count for a column than its type has levels."""
    start = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    footer, found = content[start:-8], []
    for at in (place.start() for place in re.finditer(b"\x36", footer)):  # three integers
        longer = b"".join((footer[:at], b"\x46", footer[at + 1 : at + 4], b"\0", footer[at + 4 :]))
        found.append(content[:start] + longer + len(longer).to_bytes(4, "little") + b"PAR1")
    return found


def test_a_footer_that_contradicts_itself_does_not_end_the_process(tmp_path: Path) -> None:
    """Arrow aborts the process when such a column is read from the footer."""
    path = write(tmp_path, image=images())
    problems = set()
    for content in with_wrong_histogram(path.read_bytes()):
        path.write_bytes(content)
        for look in (lambda: found(tmp_path), read.Shard(str(path)).read):
            try:
                look()
            except ToolkitError as error:
                problems.add((look.__name__, "histogram size mismatch, size: 4" in error.what))
    assert problems >= {("<lambda>", True), ("read", True)}


def test_a_page_that_states_more_than_it_can_hold_is_damage(tmp_path: Path) -> None:
    """Arrow allocates memory for a page before it reads the page."""
    path = write(tmp_path, image=pa.array(JPEGS), force=np.arange(12.0))
    content = path.read_bytes()
    start = pq.read_metadata(path).row_group(0).column(1).data_page_offset
    for stated, words in (
        (b"\x15\xfe\xff\xff\xff\x0f\x15\x02", "2,147,483,647 bytes"),
        (b"\x15\x02\x15\xfe\xff\xff\xff\x0f", "stored"),
    ):
        header = b"".join((b"\x15\0", stated, b"\0"))
        path.write_bytes(content[:start] + header + content[start + len(header) :])
        with pytest.raises(ToolkitError, match=f"a page of .*{words}"):
            found(tmp_path)
