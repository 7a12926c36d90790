"""The list files of AnyTouch 2 as touches: a line is an image."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from realtouch.convert.conversion import id_of_stem
from realtouch.exchange.anytouch import FRAMES, IMAGES, LEFT_OUT, LIST_END
from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import (
    FoundTouch,
    found_file,
    open_source,
    path_of,
    source_of,
    visible_files,
)
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError


def find_anytouch(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each line of the lists, or of one list; a missing file is the touch's problem."""
    lists = [(home, name) for name in visible_files(home, LIST_END)]
    if table is not None:
        lists = [source_of(table)]
    if not lists:
        raise InputError(f"{home.address()!r} holds no lists (*{LIST_END})")
    sizes = cache(home.sizes)
    for place, each in lists:
        split = each.removesuffix(LIST_END)
        with open_source(place, each) as stream:
            content = stream.read().decode(errors="replace")
        for line in content.splitlines():
            image, label, *_ = f"{line},".split(",")
            folder, _, base = path_of(image).rpartition("/")
            round_id = id_of_stem(folder.removeprefix(f"{split}-"))
            values = {"label": label.strip(), "round_id": round_id, "split": split}
            name = f"{IMAGES}/{folder}/{FRAMES}/{base}"
            if values["label"] == LEFT_OUT:
                problem = ItemError("label", "the list leaves it out: its label is -1")
                yield FoundTouch(name, home.address(), name, 0, 0, values, problem)
            else:
                yield found_file(home, name, values, sizes)
