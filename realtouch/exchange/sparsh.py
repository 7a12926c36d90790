"""The layout of Sparsh: pickled lists of encoded images, and the picture of a gel at rest.

Facts of the format: ``DATASET.pkl`` is a list of the bytes of image files, in order; the background is
``bgs/bg_gs.jpg``. The format has no place for labels: they are in a CSV table of the same name.
"""

from __future__ import annotations

import io
import json
import pickle
import pickletools
from collections.abc import Iterator
from functools import partial
from typing import IO

import pyarrow as pa
from pyarrow import csv as arrow_csv

from realtouch import convert, importing
from realtouch.exchange.touch_rows import NamedImage, TouchFormat
from realtouch.touches import stored_images
from tactile_toolkit import column_types, errors, store

# No image is smaller; a million empty ones would take long to check.
_MIN_IMAGE_BYTES = 24
# Number of bytes of an opcode before its content.
_HEADER_BYTES = {"SHORT_BINBYTES": 2, "BINBYTES": 5, "BINBYTES8": 9}
_OF_LISTS = frozenset(
    ["PROTO", "FRAME", "EMPTY_LIST", "MARK", "MEMOIZE", "BINPUT", "LONG_BINPUT", "APPEND", "APPENDS", "STOP"]
)


_FOLDER = "sparsh"
_BACKGROUND = "bgs/bg_gs.jpg"
_PROTOCOL = 4
_MAX_IN_MEDIAN = 256


def places_of_images(stream: IO[bytes], name: str) -> Iterator[tuple[int, int]]:
    """Yield offset and size of each image in a pickled list, without executing the pickle."""
    lists = 0
    try:
        for opcode, content, position in pickletools.genops(stream):
            lists += opcode.name == "EMPTY_LIST"
            if opcode.name in _HEADER_BYTES and content is not None and position is not None:
                if len(content) < _MIN_IMAGE_BYTES:
                    raise errors.InputError(
                        f"{name!r} holds {len(content)} bytes at {position:,}; expected an encoded image"
                    )
                yield position + _HEADER_BYTES[opcode.name], len(content)
            elif opcode.name not in _OF_LISTS or lists > 1:
                raise errors.InputError(
                    f"{name!r} does not hold one list of encoded images ({opcode.name})",
                    next="write one list of `bytes` with pickle protocol 3 or higher",
                )
    except (ValueError, OverflowError, MemoryError) as error:
        raise errors.InputError(f"{name!r} is not an intact pickle", next="fetch it again") from error
    if stream.read(1):
        raise errors.InputError(f"{name!r} holds more than one pickle; expected one list of encoded images")


def find_sparsh(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.FoundTouches]:
    """Yield the images of each pickle of one split as touches, with the fields of the table next to it."""
    split = home.address().rstrip("/").rpartition("/")[2]
    home, names = importing.files_to_read(
        home, "pickles (*.pkl)", partial(importing.visible_files, endings=".pkl")
    )
    files = home.sizes()
    for name in names:
        stem = name.rpartition(".")[0]
        folder, beside = (home, f"{stem}.csv") if table is None else importing.source_of(table)
        with importing.open_source(home, name) as stream:
            places = list(places_of_images(stream, name))
        said = {"split": column_types.repeated(split, len(places))}
        if table is not None or beside in files:
            lines = importing.read_table(folder, beside, columns)
            if lines.rows != len(places):  # rows might belong to other images
                raise errors.InputError(
                    f"{beside!r} has {lines.rows:,} rows; expected {len(places):,}, one for each image of "
                    f"{name!r}"
                )
            said |= lines.columns
        touch_names = [f"{stem}_{count:06d}" for count in range(len(places))]
        starts, sizes = [place[0] for place in places], [place[1] for place in places]
        yield importing.FoundTouches.of(touch_names, home.address(), name, said, start=starts, size=sizes)


def _pack(shard: store.ShardName, index: pa.Table, images: Iterator[NamedImage]) -> convert.Made:
    """Return the stored images of a shard as a list, with a table."""
    stream = io.BytesIO()
    arrow_csv.write_csv(_with_texts(index), stream)
    path = f"{_FOLDER}/{shard.split}/dataset_{shard.index:05d}"
    stored = pickle.dumps([bytes(image) for _, image in images], _PROTOCOL)
    return convert.with_files(index, {f"{path}.pkl": stored, f"{path}.csv": stream.getvalue()})


def _with_texts(index: pa.Table) -> pa.Table:
    """Return a table with vectors as JSON texts, as CSV has no lists."""
    for place, field in enumerate(index.schema):
        if pa.types.is_nested(field.type):
            values = index[field.name].to_pylist()
            texts = [None if value is None else json.dumps(value) for value in values]
            index = index.set_column(place, field.name, pa.array(texts, pa.string()))
    return index


def _write_backgrounds(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the median of the first images of each split; return the checksum of each file by its path."""
    files = convert.checksums(folder, manifest)
    found: dict[str, bytes] = {}
    for split in dict.fromkeys(record.shard.split for record in manifest.shards if record.rows):
        of_split = f"{_FOLDER}/{split}/"
        first = next(path for path in files if path.startswith(of_split) and path.endswith(".pkl"))
        with folder.open(first) as stream:
            places = list(places_of_images(stream, first))[:_MAX_IN_MEDIAN]
            names = [f"{first}, image {number}" for number in range(len(places))]
            images = []
            for start, size in places:
                stream.seek(start)
                images.append(stream.read(size))
        found[f"{of_split}{_BACKGROUND}"] = stored_images.background_of(images, names)
    return files | convert.write_changed(folder, found)


plan_sparsh = TouchFormat(_FOLDER, _pack, _write_backgrounds).plan
