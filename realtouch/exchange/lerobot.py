"""LeRobotDataset v3.0 with images: one clip an episode, or one round of single images.

Facts of the format: frames lie in ``data/chunk-000/file-000.parquet``, 1,000 files a chunk, numbered over all
episodes; ``meta`` says where each episode begins, what the features are, and their statistics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import Choices, Conversion, Made, Source, with_files
from realtouch.exchange import lerobot_depth
from realtouch.exchange.episodes import DEPTH, Episodes
from realtouch.exchange.lerobot_info import FILE_BYTES, FILES_PER_CHUNK, FOLDER, META_STYLE, WriteMeta
from realtouch.exchange.lerobot_statistics import columns_of_episodes
from realtouch.touch_dataset import dataset_of
from tactile_toolkit import store
from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import MEDIA_TYPE, with_features

_GROUP_BYTES = 16 << 20
_OF_EPISODE = ("round_id", "touch", "label", "object_id")
_OF_READERS = ("round_id", "touch")


def plan_lerobot(
    source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
) -> Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and one header. InputError for several splits."""
    rows_per_shard = max(1, FILE_BYTES // source.row_bytes())
    step = Episodes.of(source, choices, "LeRobotDataset", pa.float32())
    step = replace(step, depth_of=lerobot_depth.depth_of)
    chosen = choices[step.split]
    counts = _episode_lengths(source, step)[[each.row for each in chosen]]
    ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    # Numbers of the first episode and frame of each shard, and of one more.
    starts = ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist()
    tasks = tuple(f"touch an object of class {name}" for name in step.names)
    if (dataset_of(source.shards[step.split]).labels < 0).any():
        tasks += ("touch an object",)  # the last, as -1 counts from the end
    frame_bytes = source.image_bytes()
    if DEPTH in step.schema(source.schema).names:
        frame_bytes += lerobot_depth.NUMBER_BYTES * math.prod(step.size)
    return Conversion(
        source,
        "export",
        {**options, "fps": step.fps, "image_size": [step.size[1], step.size[0]]},
        step,
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(FOLDER,),
        write_files=WriteMeta(step, tasks),
        pack=_PackEpisodes(starts, tasks, max(1, _GROUP_BYTES // frame_bytes)),
    )


def _episode_lengths(source: Source, step: Episodes) -> Int64:
    """Return the number of episodes and of frames of each row, shape (n, 2)."""
    if not step.are_clips:
        counts = dataset_of(source.shards[step.split]).touch_counts
        return np.column_stack([counts > 0, counts]).astype(np.int64)
    found = []
    for shard in source.shards[step.split]:
        if "video_length_frames" not in shard.types:
            raise InputError(f"{shard.path!r} has no column 'video_length_frames'")
        lengths = shard.read(columns=["video_length_frames"]).column(0).to_pylist()
        found += [(len(each), sum(each)) for each in lengths]
    return np.array(found, np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and the table of its episodes; keeps an index of episodes."""

    starts: Sequence[Sequence[int]] = field(repr=False)
    tasks: tuple[str, ...]
    rows_per_group: int

    def __call__(self, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]) -> Made:
        """Return the frames and episodes of a shard, numbered over the whole data set.

        Raises IntegrityError if a round was left out, or lengths were not as stated.
        """
        rows = rows.combine_chunks()
        firsts = np.flatnonzero(rows["frame_index"].to_numpy() == 0)
        self._require_all(shard, [len(firsts), len(rows)], skipped)
        episode, frame = self.starts[shard.index]
        episodes, lengths = episode + np.arange(len(firsts)), np.diff([*firsts, len(rows)])
        frames = self._frames(rows, np.repeat(episodes, lengths), frame)
        chunk, number = divmod(shard.index, FILES_PER_CHUNK)
        place = f"chunk-{chunk:03d}/file-{number:03d}.parquet"
        chunks, files = np.full(len(firsts), chunk), np.full(len(firsts), number)
        labels = rows["label"].to_numpy()[firsts]
        meta = {
            "episode_index": episodes,
            "tasks": pa.array([[self.tasks[label]] for label in labels], pa.list_(pa.string())),
            "length": lengths,
            "data/chunk_index": chunks,
            "data/file_index": files,
            "dataset_from_index": frame + firsts,
            "dataset_to_index": frame + firsts + lengths,
            "meta/episodes/chunk_index": chunks,
            "meta/episodes/file_index": files,
            **{name: rows[name].take(firsts) for name in _OF_READERS if name in rows.schema.names},
            **columns_of_episodes(frames, firsts.tolist(), lengths.tolist()),
        }
        pictures = [each.name for each in rows.schema if each.type == MEDIA_TYPE]
        encodings = tuple((f"{name}.bytes", "PLAIN") for name in pictures)
        style = store.ParquetStyle(self.rows_per_group, compression_level=3, encodings=encodings)
        index = {"id": episodes, "first_frame": frame + firsts, "frames": lengths}
        index |= {name: rows[name].take(firsts) for name in _OF_EPISODE if name in rows.schema.names}
        return with_files(
            pa.table(index),
            {
                f"{FOLDER}/data/{place}": store.encode_parquet(frames, style),
                f"{FOLDER}/meta/episodes/{place}": store.encode_parquet(pa.table(meta), META_STYLE),
            },
        )

    def _require_all(
        self, shard: store.ShardName, counts: Sequence[int], skipped: Sequence[store.Skipped]
    ) -> None:
        """Refuse a shard that lacks rounds, or has other counts than were planned (IntegrityError)."""
        if skipped:
            raise IntegrityError(
                f"{skipped[0].message}; episodes are numbered without gaps, so that none can be left out; "
                "nothing of this file was written",
                next="leave the round out first (`realtouch select`)",
            )
        planned = np.subtract(self.starts[shard.index + 1], self.starts[shard.index]).tolist()
        if planned != counts:
            episodes, frames = counts
            raise IntegrityError(
                f"{shard}: {episodes:,} episodes of {frames:,} frames in all, other than "
                "'video_length_frames' stated when the export was planned; nothing of this file was written",
                next="run `realtouch verify` on the source",
            )

    def _frames(self, rows: pa.Table, episodes: Int64, first: int) -> pa.Table:
        """Return the frames of a shard with their numbers, the first of which is ``first``."""
        known = {"id", "round_id", "touch"}.intersection(rows.schema.names)
        frames = rows.drop_columns(sorted(known))
        for name, values in (
            ("episode_index", episodes),
            ("index", first + np.arange(len(rows))),
            ("task_index", rows["label"].to_numpy() % len(self.tasks)),
        ):
            frames = frames.append_column(name, pa.array(values, pa.int64()))
        # What `datasets` makes of the columns; a class is a number here.
        return frames.cast(with_features(frames.schema, None))
