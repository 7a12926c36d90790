"""The mark of LeRobotDatasets of this toolkit, and the names of their columns on import."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from realtouch import importing, touch_options
from realtouch.formats import episodes, zarr_recordings
from realtouch.touches.rounds import touch_id

_VECTORS = {episodes.STATE: touch_options.POSE_COLUMNS, episodes.ACTION: touch_options.POSITION_COLUMNS}
_OF_EPISODE = ("label", "label_name", "object_id")


class Mark(msgspec.Struct, frozen=True):
    """Mark of an export of this toolkit.

    ``clips``: an episode is a clip, not a round. ``extra``: the stored name of the further column in each
    feature: ``extra.NAME`` with an entry for each touch, or ``extra_seq.NAME`` for each frame.
    """

    class_names: tuple[str, ...]
    clips: bool
    extra: Mapping[str, str] = {}

    def own_name(self, feature: str) -> str:
        """Return the name of a further column in the data set; the name of another feature is unchanged."""
        return self.extra.get(feature, feature).removeprefix("extra_seq.").removeprefix("extra.")

    @property
    def per_touch(self) -> list[str]:
        """Names in the data set of the further columns with an entry for each touch."""
        return [self.own_name(name) for name, stored in self.extra.items() if stored.startswith("extra.")]


def as_ours(found: importing.Recording, mark: Mark) -> importing.Recording:
    """Return an episode that this toolkit wrote, with its columns named as in its tables."""
    every = found.per_frame
    columns = {name: column for name, column in every.items() if name not in mark.extra}
    values, time_s = dict(found.values), found.time_s
    if episodes.TIME in columns:
        time_s = columns.pop(episodes.TIME).to_numpy(zero_copy_only=False)
    values.pop("task", None)  # it is the label
    name = round_id = str(values.pop("round_id", found.name))
    touch, of_episode, cut = values.pop("touch", None), list(_OF_EPISODE), "frames"
    if mark.clips:
        name, cut = found.name, "whole"
        if isinstance(touch, int):
            name = touch_id(round_id, touch)
        of_episode += [*touch_options.POSITION_COLUMNS, *mark.per_touch]
    found = replace(found, name=name, round=round_id, cut=cut, time_s=time_s, per_frame=columns)
    found = zarr_recordings.with_contact(found)
    ours = zarr_recordings.name_ours(found, _VECTORS, mark.class_names).per_frame
    # Further columns are added last: one may have the name of a column of ours, which is kept then.
    per_frame = {**{mark.own_name(name): every[name] for name in mark.extra if name in every}, **ours}
    values |= {each: per_frame.pop(each)[0].as_py() for each in of_episode if each in per_frame}
    return replace(found, values=values, per_frame=per_frame)
