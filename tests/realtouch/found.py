"""Results of readers of sources, as objects that tests compare; readings of damaged sources."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.formats import ros_bags
from realtouch.importing.cuts import Cutter
from realtouch.importing.import_options import ImportColumns, ImportSpec
from realtouch.importing.import_sources import IMPORTS, find_source
from realtouch.importing.source_touches import PictureLocation, Recording, SourceTouches, one_chunk
from realtouch.touches.schema import array_with_gaps
from tactile_toolkit.columns import column_types
from tactile_toolkit.errors import ItemError, ToolkitError
from tests.mutations import mutated, with_other_numbers

_TEXTS = (".json", ".jsonl", ".zarray", ".zgroup")


@dataclass(frozen=True)
class Found:
    """A touch with its values; missing ones are left out."""

    name: str
    place: PictureLocation
    values: dict[str, Any]
    problem: str | None
    contact: tuple[int, int] | None
    time_s: np.ndarray | None

    @property
    def start(self) -> int:
        return self.place.start

    @property
    def frames(self) -> int:
        return self.place.frames


def each_of(touches: SourceTouches) -> list[Found]:
    """Return touches one by one."""
    columns = [column_types.values_of(one_chunk(column)) for column in touches.per_touch.columns]
    rows = list(zip(*columns, strict=True)) or [()] * len(touches)
    found = []
    for place, row, where in zip(touches, rows, touches.listing.to_pylist(), strict=True):
        said = dict(zip(touches.per_touch.column_names, row, strict=True))
        contact, time_s = where["contact"], where["time_s"]
        found.append(
            Found(
                where["name"],
                place,
                {name: value for name, value in said.items() if value is not None},
                where["problem"],
                None if contact is None else (contact[0], contact[1]),
                None if time_s is None else np.array(time_s),
            )
        )
    return found


def cut_by(cutter: Cutter, recordings: Iterable[Recording]) -> list[Found]:
    """Cut recordings, and add touches that a table lists."""
    parts = [cutter.cut(recording) for recording in recordings]
    return [touch for part in (*parts, *cutter.unused()) for touch in each_of(part)]


def per_frame(recording: Recording, name: str) -> np.ndarray:
    """Return the values of pictures: NaN for a missing number, None for other missing values."""
    return array_with_gaps(recording.per_frame[name])


def columns(given: dict[str, Any]) -> dict[str, pa.Array]:
    """Return the columns of arrays, or of any values."""
    return {name: column_types.column_of(each) for name, each in given.items()}


def require_pictures_or_messages(source: Path, layout: str, image: str = "file", count: int = 400) -> None:
    """Read many damaged copies of a source: each gives pictures, or an error of the toolkit.

    Bytes of any file are changed, and numbers in files of text.
    """
    files = sorted(path for path in source.rglob("*") if path.is_file()) if source.is_dir() else [source]
    whole = {path: path.read_bytes() for path in files}
    spec = ImportSpec(layout, ImportColumns(image=image))
    read = 0
    for seed in range(count):
        path = files[seed // 2 % len(files)]
        damage = with_other_numbers if path.name.endswith(_TEXTS) and seed % 2 else mutated
        path.write_bytes(damage(whole[path], seed))
        ros_bags._opened.cache_clear()
        with suppress(ToolkitError):
            touches = find_source(str(source), spec).touches
            usable = touches.take(np.flatnonzero(touches.is_usable))
            contents = list(IMPORTS[layout].contents(usable))
            assert len(contents) == sum(max(1, picture.frames) for picture in usable) < 10_000
            assert all(isinstance(content, (bytes, ItemError)) for content in contents)
            read += 1
        path.write_bytes(whole[path])
    assert read
