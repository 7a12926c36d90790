"""Numbers of episodes and frames through all shards, which are known before any frame is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from realtouch.convert.conversion import RowChoice, Source
from realtouch.exchange.episodes import Episodes
from realtouch.touch_dataset import dataset_of
from tactile_toolkit import store
from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import InputError, IntegrityError


@dataclass(frozen=True)
class EpisodeNumbers:
    """Numbers of the first episode and frame of each shard, and of one more."""

    starts: Sequence[Sequence[int]] = field(repr=False)

    @classmethod
    def of(
        cls, source: Source, step: Episodes, chosen: Sequence[RowChoice], rows_per_shard: int
    ) -> EpisodeNumbers:
        """Read the lengths of all rows; InputError for clips whose lengths are not stated."""
        counts = _episode_lengths(source, step)[[each.row for each in chosen]]
        ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
        return cls(ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist())

    def of_shard(
        self, shard: store.ShardName, found: Sequence[int], skipped: Sequence[store.Skipped]
    ) -> Sequence[int]:
        """Return the numbers of the first episode and frame of a shard, given how many there are.

        Raises IntegrityError for a shard that lacks rounds, or has other counts than were planned.
        """
        if skipped:
            raise IntegrityError(
                f"{skipped[0].message}; episodes are numbered without gaps, so that none can be left out; "
                "nothing of this file was written",
                next="leave the round out first (`realtouch select`)",
            )
        start, end = self.starts[shard.index : shard.index + 2]
        if np.subtract(end, start).tolist() != found:
            episodes, frames = found
            raise IntegrityError(
                f"{shard}: {episodes:,} episodes of {frames:,} frames in all, other than "
                "'video_length_frames' stated when the export was planned; nothing of this file was written",
                next="run `realtouch verify` on the source",
            )
        return start


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
