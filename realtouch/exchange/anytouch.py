"""The list files of AnyTouch 2, as Touch and Go has them: ``FOLDER/0000000012.jpg,LABEL,BACKGROUND``.

Facts of the format: images lie in ``touch_and_go/FOLDER/gelsight_frame``, their numbers have ten digits;
``train_bg.txt`` and ``test_bg.txt`` have a line for each image, and the label -1 leaves one out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from itertools import groupby

import pyarrow as pa

from realtouch.convert.conversion import Made
from realtouch.convert.index_tables import file_stem, id_of_stem, with_files, write_changed
from realtouch.exchange.flat import IMAGE, plan as plan_rows
from realtouch.exchange.found_touches import FoundTouch, open_source, path_of, source_of
from realtouch.exchange.stored_images import as_jpeg, background_of
from realtouch.touch_options import ImportColumns
from tactile_toolkit import read, store
from tactile_toolkit.errors import InputError, ItemError

_FOLDER, _IMAGES, _FRAMES = "anytouch", "touch_and_go", "gelsight_frame"
_BACKGROUND = "background.jpg"
_LIST_END = "_bg.txt"
_LEFT_OUT = "-1"


def _pack(shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]) -> Made:
    """Return the touches of each round as numbered images, and their median as the background."""
    if (rows["label"].to_numpy() < 0).any():
        raise InputError("touches without a class; in this format the label -1 leaves an image out")
    files: dict[str, bytes] = {}
    paths: list[str] = []
    backgrounds: list[str] = []
    stored = zip(rows["round_id"].to_pylist(), rows["touch"].to_pylist(), rows[IMAGE], strict=True)
    for name, touches in groupby(stored, key=lambda each: each[0]):
        home = f"{_FOLDER}/{_IMAGES}/{shard.split}-{file_stem(name)}/{_FRAMES}"
        images = {f"{home}/{touch:010d}.jpg": as_jpeg(image.as_py()["bytes"]) for _, touch, image in touches}
        background = f"{home}/{_BACKGROUND}"
        files |= {**images, background: background_of(list(images.values()), list(images))}
        paths += images
        backgrounds += [background] * len(images)
    return with_files(rows.drop_columns([IMAGE]), files, [paths, backgrounds])


def _write_lists(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write a list for each split; return the checksum of each by its path."""
    lines: dict[str, list[str]] = {}
    for record in manifest.shards:
        table = read.Shard(folder.address(record.shard.data_path)).read(columns=["file", "label"])
        for path, label in zip(*(column.to_pylist() for column in table.columns), strict=True):
            _, _, name, _, image = path.split("/")
            lines.setdefault(record.shard.split, []).append(f"{name}/{image},{label},{_BACKGROUND}\n")
    paths = {f"{_FOLDER}/{split}{_LIST_END}": "".join(each).encode() for split, each in lines.items()}
    # The index holds the checksums of the images: as many checksums would make the manifest larger than it.
    return {path: write_changed(folder, path, content) for path, content in paths.items()}


plan = partial(plan_rows, folder=_FOLDER, pack=_pack, write_files=_write_lists)


def items(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each line of the lists (or one, by its name); of a file that is not there, why."""
    found = [(home, name) for name in home.sizes() if name.endswith(_LIST_END) and not store.is_hidden(name)]
    lists = found if table is None else [source_of(table)]
    if not lists:
        raise InputError(f"{home.address()!r} holds no lists (*{_LIST_END})")
    sizes = cache(home.sizes)
    for place, each in lists:
        with open_source(place, each) as stream:
            content = stream.read().decode(errors="replace")
        for line in content.splitlines():
            image, _, rest = line.partition(",")
            folder, _, base = path_of(image).rpartition("/")
            label = rest.partition(",")[0].strip()
            name = f"{_IMAGES}/{folder}/{_FRAMES}/{base}"
            problem, size, split = None, 0, each.removesuffix(_LIST_END)
            try:
                if label == _LEFT_OUT:
                    raise ItemError("label", "the list leaves it out: its label is -1")
                size = store.size_inside(home, name, sizes)
            except ItemError as error:
                problem = error
            round_id = id_of_stem(folder.removeprefix(f"{split}-"))
            values = {"label": label, "round_id": round_id, "split": split}
            yield FoundTouch(name, home.address(), name, 0, size, values, problem)
