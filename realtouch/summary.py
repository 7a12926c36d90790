"""What a data set of touches holds, in numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dataset_store.errors import InputError
from realtouch.dataset import TouchDataset
from realtouch.rounds import TouchSeqRound, TouchSingleRound
from realtouch.schema import column_type

__all__ = ["Summary", "summarise"]


@dataclass(frozen=True, slots=True)
class Summary:
    """Figures of one split.

    Attributes
    ----------
    kind : str
        ``"seq"`` or ``"single"``.
    rounds, touches, objects : int
        How many.
    touches_per_round : tuple of int
        Least and most.
    contact_share : float or None
        Share of touches in which the gel stopped on an object; None without poses.
    labels : dict of str to int
        Rounds of each class.
    image_size : tuple of int
        Width and height of the first image or frame, pixels.
    clip_frames : tuple of int, or None
        Least, median and most frames of a clip; None for images.
    fps : float or None
        Frames per second of the first clip.
    gel_ids : dict of str to int
        Rounds of each gel; empty where the set does not say.
    """

    kind: str
    rounds: int
    touches: int
    objects: int
    touches_per_round: tuple[int, int]
    contact_share: float | None
    labels: dict[str, int]
    image_size: tuple[int, int]
    clip_frames: tuple[int, int, int] | None
    fps: float | None
    gel_ids: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def summarise(dataset: TouchDataset[Any]) -> Summary:
    """Count what a data set holds; reads small columns and one image or clip.

    Raises
    ------
    InputError
        The data set is empty.
    IntegrityError
        What is read is damaged.
    """
    if not len(dataset):
        message = "an empty data set has no summary; next: choose other filters"
        raise InputError(message)
    counts = dataset.touch_counts
    height, width, fps = _picture(dataset[0])
    return Summary(
        kind=dataset.kind,
        rounds=len(dataset),
        touches=int(counts.sum()),
        objects=len(np.unique(dataset.column("object_id"))) if _has(dataset, "object_id") else 0,
        touches_per_round=(int(counts.min()), int(counts.max())),
        contact_share=_contact_share(dataset),
        labels={name: len(rows) for name, rows in dataset.by_label().items()},
        image_size=(width, height),
        clip_frames=_clip_frames(dataset),
        fps=fps,
        gel_ids=_gel_ids(dataset),
    )


def _has(dataset: TouchDataset[Any], name: str) -> bool:
    return column_type(dataset._tables[0].schema, name) is not None


def _picture(record: Any) -> tuple[int, int, float | None]:
    if isinstance(record, TouchSingleRound):
        return (*record.sensor_image.size(0), None)
    clip = record.sensor_video[0]
    return (*clip.size, clip.fps)


def _contact_share(dataset: TouchDataset[Any]) -> float | None:
    suffix = "" if dataset.kind == "single" else "_seq"
    if not _has(dataset, f"gel_pose_cell_frame{suffix}.position"):
        return None
    touches = dataset.touches()
    return len(touches.with_contact()) / max(len(touches), 1)


def _clip_frames(dataset: TouchDataset[Any]) -> tuple[int, int, int] | None:
    if dataset.kind == "single" or not _has(dataset, "video_length_frames"):
        return None
    lengths = np.concatenate([_lengths(record) for _, record in dataset.light_rounds()])
    return int(lengths.min()), int(np.median(lengths)), int(lengths.max())


def _lengths(record: TouchSeqRound) -> Any:
    return record.video_length_frames


def _gel_ids(dataset: TouchDataset[Any]) -> dict[str, int]:
    if not _has(dataset, "info.gel_id"):
        return {}
    ids = Counter(str(record.info["gel_id"]) for _, record in dataset.light_rounds())
    return dict(sorted(ids.items()))
