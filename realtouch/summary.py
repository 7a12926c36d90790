"""What a data set of touches holds, in numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from realtouch.columns.per_frame import clip_length
from realtouch.dataset import TouchDataset
from realtouch.touches import Touches
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch.schema import POSE_COLUMN


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
    contact_rule : str or None
        Height above the plate from which a touch counted, and where the height of the plate is from.
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
    contact_rule: str | None
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

    Parameters
    ----------
    dataset : TouchDataset
        One split, or a part of it.

    Returns
    -------
    Summary

    Raises
    ------
    InputError
        The data set is empty.
    IntegrityError
        What is read is damaged.
    """
    touches = dataset.touches()
    if not len(touches):
        raise InputError("an empty data set has no summary", next="choose other filters")
    counts = np.bincount(touches.round_positions, minlength=len(dataset))
    first = touches[0]
    has_poses = dataset.has_column(f"{POSE_COLUMN[dataset.kind]}.position")
    gels: Counter[str] = Counter()
    if dataset.has_column("info.gel_id"):
        # Through all rounds, without their pictures: the gel is not a plain column.
        gels.update(str(record.info["gel_id"]) for _, record in dataset.rounds_without_media())
    by_label = dataset.by_label() if dataset.has_column("label") else {}
    return Summary(
        kind=dataset.kind,
        rounds=len(dataset),
        touches=int(counts.sum()),
        objects=len(np.unique(dataset.int_column("object_id"))) if dataset.has_column("object_id") else 0,
        touches_per_round=(int(counts.min()), int(counts.max())),
        contact_share=float(touches.in_contact().mean()) if has_poses else None,
        contact_rule="; or ".join(map(str, dict.fromkeys(dataset.contact_rules()))) if has_poses else None,
        labels={name: len(rows) for name, rows in by_label.items()},
        image_size=first.round._picture_size(first.touch_index),
        clip_frames=_clip_frames(touches),
        fps=first.clip.fps if dataset.kind == "seq" else None,
        gel_ids=dict(sorted(gels.items())),
    )


def _clip_frames(touches: Touches[Any]) -> tuple[int, int, int] | None:
    dataset = touches.dataset
    if dataset.kind == "single" or not dataset.has_column("video_length_frames"):
        return None
    shown: dict[int, list[int]] = {}
    rows = dataset.row_numbers[touches.round_positions].tolist()
    for row, touch in zip(rows, touches.touch_indices.tolist(), strict=True):
        shown.setdefault(row, []).append(touch)
    lengths = [
        clip_length(record._row, touch)
        for row, record in dataset.rounds_without_media()
        for touch in shown.get(row, ())
    ]
    known = [length for length in lengths if length is not None]
    return min(known), int(np.median(known)), max(known)
