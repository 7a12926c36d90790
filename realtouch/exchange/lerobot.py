"""LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.

Facts of the format: frames lie in ``data/chunk-000/file-000.parquet``, 1,000 files a chunk, numbered over all
episodes; ``meta`` says where each episode begins, what the features are, and their statistics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.plan import (
    Choices,
    Conversion,
    Made,
    Source,
    with_files,
)
from realtouch.exchange.episodes import IMAGE, Episodes, numbered_starts, numbers_of_shard, only_split
from realtouch.exchange.lerobot_meta import FILE_BYTES, FILES_PER_CHUNK, FOLDER, META_STYLE, WriteMeta
from realtouch.exchange.lerobot_statistics import columns_of_episodes
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.touch.schema import with_features

_GROUP_BYTES = 16 << 20
_OF_EPISODE = ("round_id", "touch", "label", "object_id")


def plan(source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, Any]) -> Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and one header. InputError for several splits."""
    rows_per_shard = max(1, FILE_BYTES // source.row_bytes())
    split = only_split(source, choices, "LeRobotDataset")
    starts = numbered_starts(source, split, choices[split], rows_per_shard)
    step = Episodes.of(source, split)
    tasks = tuple(f"touch an object of class {name}" for name in step.names)
    image_bytes = source.media_bytes() if source.kind == "single" else source.media_bytes() // 64 or 1
    return Conversion(
        source,
        "export",
        {**options, "fps": step.fps, "image_size": [step.size[1], step.size[0]]},
        step,
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(FOLDER,),
        write_files=WriteMeta(split, step.fps, step.size, tasks),
        pack=_PackEpisodes(starts, tasks, max(1, _GROUP_BYTES // image_bytes)),
    )


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and what is to be known of its episodes; keeps an index of those."""

    starts: Sequence[Sequence[int]] = field(repr=False)
    tasks: tuple[str, ...]
    rows_per_group: int

    def __call__(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> Made:
        """Return the frames and episodes of a shard, numbered over the whole data set."""
        rows = rows.combine_chunks()
        episodes, firsts, lengths = numbers_of_shard(self.starts, shard, rows, skipped)
        starts = firsts - firsts[:1]
        index = {"id": episodes, "first_frame": firsts, "frames": lengths}
        frames = rows.drop_columns(
            [name for name in ("id", "round_id", "touch") if name in rows.schema.names]
        )
        for name, values in (
            ("episode_index", np.repeat(episodes, lengths)),
            ("index", firsts[:1] + np.arange(len(rows))),
            ("task_index", rows["label"].to_numpy()),
        ):
            frames = frames.append_column(name, pa.array(values, pa.int64()))
        # What `datasets` makes of the columns; a class is a number here.
        frames = frames.cast(with_features(frames.schema, ()))
        labels = rows["label"].to_numpy()[starts]
        chunk, number = divmod(shard.index, FILES_PER_CHUNK)
        place = f"chunk-{chunk:03d}/file-{number:03d}.parquet"
        chunks, files = np.full(len(starts), chunk), np.full(len(starts), number)
        meta = {
            "episode_index": episodes,
            "tasks": pa.array([[self.tasks[label]] for label in labels], pa.list_(pa.string())),
            "length": lengths,
            "data/chunk_index": chunks,
            "data/file_index": files,
            "dataset_from_index": firsts,
            "dataset_to_index": firsts + lengths,
            "meta/episodes/chunk_index": chunks,
            "meta/episodes/file_index": files,
            **columns_of_episodes(frames, starts.tolist(), lengths.tolist()),
        }
        encodings = ((f"{IMAGE}.bytes", "PLAIN"),)
        style = ParquetStyle(self.rows_per_group, compression_level=3, encodings=encodings)
        index |= {name: rows[name].take(starts) for name in _OF_EPISODE if name in rows.schema.names}
        return with_files(
            pa.table(index),
            {
                f"{FOLDER}/data/{place}": encode_parquet(frames, style),
                f"{FOLDER}/meta/episodes/{place}": encode_parquet(pa.table(meta), META_STYLE),
            },
        )
