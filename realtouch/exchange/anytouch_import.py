"""The list files of AnyTouch 2 as touches: a line is an image."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa

from realtouch.convert.conversion import id_of_stem
from realtouch.exchange.anytouch import FRAMES, IMAGES, LEFT_OUT, LIST_END
from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import FoundTouches
from realtouch.importing.source_files import image_files, open_source, path_of, source_of, visible_files
from tactile_toolkit import column_types, store
from tactile_toolkit.errors import InputError, ItemError


def find_anytouch(
    home: store.DataFolder, columns: ImportColumns, table: str | None
) -> Iterator[FoundTouches]:
    """Yield the lines of each list, or of one list, as touches; a missing file is the touch's problem."""
    lists = [(home, name) for name in visible_files(home, LIST_END)]
    if table is not None:
        lists = [source_of(table)]
    if not lists:
        raise InputError(f"{home.address()!r} holds no lists (*{LIST_END})")
    for place, each in lists:
        split = each.removesuffix(LIST_END)
        with open_source(place, each) as stream:
            lines = stream.read().decode(errors="replace").splitlines()
        paths, labels, rounds = list[str](), list[str](), list[str]()
        for line in lines:
            image, label, *_ = f"{line},".split(",")
            folder, _, base = path_of(image).rpartition("/")
            paths.append(f"{IMAGES}/{folder}/{FRAMES}/{base}")
            labels.append(label.strip())
            rounds.append(id_of_stem(folder.removeprefix(f"{split}-")))
        problem = ItemError("label", "the list leaves it out: its label is -1")
        left_out = [number for number, label in enumerate(labels) if label == LEFT_OUT]
        said = {
            "label": pa.array(labels, pa.string()),
            "round_id": pa.array(rounds, pa.string()),
            "split": column_types.repeated(split, len(paths)),
        }
        yield image_files(home, paths, said, dict.fromkeys(left_out, problem))
