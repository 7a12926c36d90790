"""The layout of Sparsh: pickled lists of encoded images, and the picture of a gel at rest.

Facts of the format: ``DATASET.pkl`` is a list of the bytes of image files, in their order; the background is
``bgs/bg_gs.jpg``. Labels, for which the format has no place, lie in a CSV table of the same name.
"""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Iterator

import pyarrow as pa
from pyarrow import csv as arrow_csv

from realtouch.convert.conversion import Made, checksums, with_files, write_changed
from realtouch.exchange.sparsh_import import places_of_images
from realtouch.exchange.touch_rows import NamedImage, TouchFormat
from realtouch.stored_images import background_of
from tactile_toolkit import store

_FOLDER = "sparsh"
_BACKGROUND = "bgs/bg_gs.jpg"
_PROTOCOL = 4
_MOST_IN_MEDIAN = 256


def _pack(shard: store.ShardName, index: pa.Table, images: Iterator[NamedImage]) -> Made:
    """Return the stored images of a shard as a list, with a table."""
    stream = io.BytesIO()
    arrow_csv.write_csv(_with_texts(index), stream)
    path = f"{_FOLDER}/{shard.split}/dataset_{shard.index:05d}"
    stored = pickle.dumps([bytes(image) for _, image in images], _PROTOCOL)
    return with_files(index, {f"{path}.pkl": stored, f"{path}.csv": stream.getvalue()})


def _with_texts(index: pa.Table) -> pa.Table:
    """Return a table whose vectors are JSON texts; CSV has no lists."""
    for place, field in enumerate(index.schema):
        if pa.types.is_nested(field.type):
            texts = [value and json.dumps(value) for value in index[field.name].to_pylist()]
            index = index.set_column(place, field.name, pa.array(texts, pa.string()))
    return index


def _write_backgrounds(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the median of the first images of each split; return the checksum of each file by its path."""
    files = checksums(folder, manifest)
    found: dict[str, bytes] = {}
    for split in dict.fromkeys(record.shard.split for record in manifest.shards if record.rows):
        of_split = f"{_FOLDER}/{split}/"
        first = next(path for path in files if path.startswith(of_split) and path.endswith(".pkl"))
        with folder.open(first) as stream:
            places = list(places_of_images(stream, first))[:_MOST_IN_MEDIAN]
            names = [f"{first}, image {number}" for number in range(len(places))]
            images = []
            for start, size in places:
                stream.seek(start)
                images.append(stream.read(size))
        found[f"{of_split}{_BACKGROUND}"] = background_of(images, names)
    return files | write_changed(folder, found)


plan_sparsh = TouchFormat(_FOLDER, _pack, _write_backgrounds).plan
