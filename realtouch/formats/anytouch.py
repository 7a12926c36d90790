"""List files of AnyTouch 2, with the lines of Touch and Go: ``FOLDER/0000000012.jpg,LABEL,BACKGROUND``.

Facts of the format: images are in ``touch_and_go/FOLDER/gelsight_frame``, and their numbers have ten digits;
``train_bg.txt`` and ``test_bg.txt`` have a line for each image, and the label -1 leaves an image out.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import groupby
from operator import itemgetter

import pyarrow as pa

from realtouch import convert, importing
from realtouch.formats.exports import NamedImage, TouchFormat
from realtouch.touches import media
from tactile_toolkit import errors, read, store
from tactile_toolkit.columns import column_types

_FOLDER, IMAGES, FRAMES = "anytouch", "touch_and_go", "gelsight_frame"
_BACKGROUND = "background.jpg"
LIST_END = "_bg.txt"
LEFT_OUT = "-1"


def _pack(shard: store.ShardName, index: pa.Table, images: Iterator[NamedImage]) -> convert.Made:
    """Return the touches of each round as numbered images, and their median as the background."""
    if (index["label"].to_numpy() < 0).any():
        raise errors.InputError(
            "touches without a class; in this format the label -1 leaves an image out",
            next="choose those of known classes with `realtouch select --labels`, or another format",
        )
    files: dict[str, bytes] = {}
    paths: list[str] = []
    backgrounds: list[str] = []
    stored = zip(index["round_id"].to_pylist(), index["touch"].to_pylist(), images, strict=True)
    for name, touches in groupby(stored, key=itemgetter(0)):
        home = f"{_FOLDER}/{IMAGES}/{shard.split}-{convert.stem_of_id(name)}/{FRAMES}"
        found = {f"{home}/{touch:010d}.jpg": media.as_jpeg(image) for _, touch, (_, image) in touches}
        background = f"{home}/{_BACKGROUND}"
        files |= {**found, background: media.background_of(list(found.values()), list(found))}
        paths += found
        backgrounds += [background] * len(found)
    return convert.with_files(index, files, [paths, backgrounds])


def _write_lists(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write a list for each split; return the checksum of each by its path."""
    lines: dict[str, list[str]] = {}
    for record in manifest.shards:
        table = read.Shard(folder.address(record.shard.data_path)).read(columns=["file", "label"])
        path = f"{_FOLDER}/{record.shard.split}{LIST_END}"
        for image, label in zip(*(column.to_pylist() for column in table.columns), strict=True):
            _, _, name, _, base = image.split("/")
            lines.setdefault(path, []).append(f"{name}/{base},{label},{_BACKGROUND}\n")
    # The index has the checksums of the images; in the manifest they would take too much space.
    return convert.write_changed(folder, {path: "".join(each).encode() for path, each in lines.items()})


plan_anytouch = TouchFormat(_FOLDER, _pack, _write_lists).plan


def find_anytouch(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.FoundTouches]:
    """Yield the lines of each list, or of one list, as touches; the touch of a missing file has a problem."""
    named = home if table is None else store.open_folder(table)
    find = partial(importing.visible_files, endings=LIST_END)
    place, lists = importing.files_to_read(named, f"lists (*{LIST_END})", find)
    for each in lists:
        split = each.removesuffix(LIST_END)
        with importing.open_source(place, each) as stream:
            lines = stream.read().decode(errors="replace").splitlines()
        paths, labels, rounds = list[str](), list[str](), list[str]()
        for line in lines:
            image, label, *_ = f"{line},".split(",")
            folder, _, base = importing.path_of(image).rpartition("/")
            paths.append(f"{IMAGES}/{folder}/{FRAMES}/{base}")
            labels.append(label.strip())
            rounds.append(convert.id_of_stem(folder.removeprefix(f"{split}-")))
        problem = errors.ItemError("label", "the list leaves it out: its label is -1")
        left_out = [number for number, label in enumerate(labels) if label == LEFT_OUT]
        said = {
            "label": pa.array(labels, pa.string()),
            "round_id": pa.array(rounds, pa.string()),
            "split": column_types.repeated(split, len(paths)),
        }
        yield importing.image_files(home, paths, said, dict.fromkeys(left_out, problem))
