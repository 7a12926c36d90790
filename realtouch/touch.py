"""One touch of a round."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from realtouch.clip import TouchClip
from realtouch.contact import contact_window
from realtouch.fields import clip_poses, clip_times, touch_pose, touch_times
from realtouch.jpeg import Pixels
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.touch_columns import intended_position

if TYPE_CHECKING:
    from realtouch.pose import Pose

__all__ = ["Touch"]


class Touch:
    """One touch of a round; frozen, fields are read when asked for.

    Attributes
    ----------
    round : TouchRound
        The round it belongs to.
    touch_index : int
        Its number in the round, from 0.

    Notes
    -----
    Pickles with its own image or clip only: the ``round`` of a touch that came back from another process
    holds this one touch.
    """

    __slots__ = ("_place", "round", "touch_index")
    round: TouchRound
    touch_index: int
    _place: int

    def __init__(self, round: TouchRound, touch_index: int, place: int | None = None) -> None:
        object.__setattr__(self, "round", round)
        object.__setattr__(self, "touch_index", touch_index)
        object.__setattr__(self, "_place", touch_index if place is None else place)

    def __setattr__(self, name: str, value: object) -> None:
        message = f"Touch is frozen; {name!r} cannot be set"
        raise AttributeError(message)

    @property
    def round_id(self) -> str:
        """Id of the round."""
        return self.round.id

    @property
    def label(self) -> int:
        """Class of the object."""
        return self.round.label

    @property
    def object_id(self) -> int:
        """Id of the touched mesh."""
        return self.round.object_id

    @property
    def pos_in_cell_m(self) -> NDArray[np.floating]:
        """Intended position, shape (2,), metres, cell frame."""
        return intended_position(self.round._row, self._place)

    @property
    def gel_pose(self) -> Pose:
        """Pose of the gel at contact, metres, cell frame; of a clip, that of the last frame of contact.

        Reads this touch only, and opens no clip where the times of its frames are stored.
        """
        row, touch = self.round._row, self._place
        if isinstance(self.round, TouchSingleRound):
            return touch_pose(row, touch)
        if not (row.has("time_stamp_rel_seq") and row.has("video_length_frames")):
            return self.clip.poses[self.clip.contact_index("contact_end")]
        times = clip_times(row, touch)
        window = contact_window(np.empty(0) if times is None else times, *touch_times(row, touch))
        return clip_poses(row, touch)[int(window.stop) - 1]

    @property
    def image(self) -> Pixels:
        """Picture of the contact, shape (H, W, 3), uint8; of a clip, its last frame of contact."""
        if isinstance(self.round, TouchSingleRound):
            return self.round.sensor_image[self._place]
        return self.clip.contact_frame("contact_end")

    @property
    def clip(self) -> TouchClip:
        """The clip of a touch of a ``seq`` set.

        Raises
        ------
        InputError
            The data set holds images.
        """
        if not isinstance(self.round, TouchSeqRound):
            from realtouch.damage import missing_column

            raise missing_column(self.round._row, "sensor_video")
        return self.round.sensor_video[self._place]

    def alone(self) -> Touch:
        """Return the touch with a copy of its own bytes, which keeps no other touch in memory."""
        return Touch(self.round.with_touches([self._place]), self.touch_index, 0)

    def __reduce__(self) -> tuple[Any, ...]:
        alone = self.alone()
        return (Touch, (alone.round, alone.touch_index, 0))

    def __repr__(self) -> str:
        shown = {
            "round_id": self.round.shown("id"),
            "touch_index": f"{self.touch_index}",
            "label": self.round.shown("label"),
        }
        words = [f"{name}={value}" for name, value in shown.items() if value is not None]
        return f"Touch({', '.join(words)})"

    def _repr_html_(self) -> str:
        """Show the picture of the contact in a notebook."""
        from realtouch.pictures import touch_html

        return touch_html(self)
