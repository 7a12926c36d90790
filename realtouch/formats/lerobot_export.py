"""Touches as a LeRobotDataset v3.0 with images: an episode is a clip, or a round of single images.

Facts of the format: frames are in ``data/chunk-000/file-000.parquet``, 1,000 files in a chunk, and are
numbered over all episodes; ``meta`` has the start of each episode, the features, and their statistics. Depth
maps are lossless TIFF of float32 in metres, as LeRobot 0.6 stores depth. A feature of maps has one channel,
and ``info`` with ``is_depth_map`` and ``depth_unit``, which is ``m`` or ``mm``. Statistics are in that unit,
while those of colours are scaled to 1.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch import contact, convert
from realtouch.formats import lerobot_metadata, lerobot_statistics
from realtouch.formats.episodes import DEPTH, EpisodeNumbers, Episodes
from realtouch.touches import datasets, media, stored_round
from tactile_toolkit import store, touch
from tactile_toolkit.array_types import Float32, Int64
from tactile_toolkit.touch import MEDIA_TYPE

_GROUP_BYTES = 16 << 20
_INDEX_COLUMNS = ("round_id", "touch", "label", "object_id")
_META_COLUMNS = ("round_id", "touch")

_NUMBER_BYTES = 4  # of float32


def plan_lerobot(
    source: convert.Source,
    choices: convert.Choices,
    method: contact.ContactMethod,
    options: Mapping[str, object],
) -> convert.Conversion:
    """Plan a LeRobotDataset; reads footers, lengths and the header of one image.

    Raises InputError for several splits.
    """
    rows_per_shard = max(1, lerobot_metadata.FILE_BYTES // source.row_bytes())
    step = Episodes.of(source, choices, "LeRobotDataset", pa.float32())
    step = replace(step, depth_of=_depth_of)
    numbers = EpisodeNumbers.of(source, step, choices[step.split], rows_per_shard)
    tasks = tuple(f"touch an object of class {name}" for name in step.names)
    if (datasets.dataset_of(source.shards[step.split]).labels < 0).any():
        tasks += ("touch an object",)  # the last, as -1 counts from the end
    frame_bytes = source.image_bytes()
    if DEPTH in step.schema(source.schema).names:
        frame_bytes += _NUMBER_BYTES * math.prod(step.size)
    return convert.Conversion(
        source,
        "export",
        {**options, "fps": step.fps, "image_size": [step.size[1], step.size[0]]},
        step,
        choices,
        rows_per_shard=rows_per_shard,
        rows_per_group=1 << 12,
        extra_dirs=(lerobot_metadata.FOLDER,),
        write_files=lerobot_metadata.WriteMeta(step, tasks),
        pack=_PackEpisodes(numbers, tasks, max(1, _GROUP_BYTES // frame_bytes)),
    )


@dataclass(frozen=True)
class _PackEpisodes:
    """Packs the frames of a shard and the table of its episodes; keeps an index of episodes."""

    numbers: EpisodeNumbers
    tasks: tuple[str, ...]
    rows_per_group: int

    def __call__(
        self, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]
    ) -> convert.Made:
        """Return the frames and episodes of a shard, numbered over the whole data set.

        Raises IntegrityError if a round was left out, or if lengths differ from those that were stated.
        """
        rows = rows.combine_chunks()
        firsts = np.flatnonzero(rows["frame_index"].to_numpy() == 0)
        episode, frame = self.numbers.of_shard(shard, [len(firsts), len(rows)], skipped)
        episodes = episode + np.arange(len(firsts))
        lengths = np.diff([*firsts, len(rows)])
        frames = self._frames(rows, np.repeat(episodes, lengths), frame)
        chunk, number = divmod(shard.index, lerobot_metadata.FILES_PER_CHUNK)
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
            **{name: rows[name].take(firsts) for name in _META_COLUMNS if name in rows.schema.names},
            **lerobot_statistics.columns_of_episodes(frames, firsts.tolist(), lengths.tolist()),
        }
        pictures = [each.name for each in rows.schema if each.type == touch.MEDIA_TYPE]
        encodings = tuple((f"{name}.bytes", "PLAIN") for name in pictures)
        style = store.ParquetStyle(self.rows_per_group, compression_level=3, encodings=encodings)
        index = {"id": episodes, "first_frame": frame + firsts, "frames": lengths}
        index |= {name: rows[name].take(firsts) for name in _INDEX_COLUMNS if name in rows.schema.names}
        return convert.with_files(
            pa.table(index),
            {
                f"{lerobot_metadata.FOLDER}/data/{place}": store.encode_parquet(frames, style),
                f"{lerobot_metadata.FOLDER}/meta/episodes/{place}": store.encode_parquet(
                    pa.table(meta), lerobot_metadata.META_STYLE
                ),
            },
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
        # Types of the columns for `datasets`; a class is a number here.
        return frames.cast(touch.with_features(frames.schema, None))


def _depth_of(row: stored_round.StoredRound, size: tuple[int, int]) -> pa.Array:
    """Return the encoded depth maps of a round; IntegrityError for a map of another size."""
    files = []
    for number, depth_m in enumerate(media.DepthMaps(row, media.DEPTH)):
        if depth_m.shape != size:
            raise row.damaged(media.DEPTH, f"a map {depth_m.shape}; expected {size} as the images", number)
        files.append({"bytes": _tiff(depth_m), "path": f"{row.name()}_{number:03d}.tiff"})
    return pa.array(files, MEDIA_TYPE)


def _tiff(depth_m: Float32) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(depth_m).save(stream, "TIFF")
    return stream.getvalue()
