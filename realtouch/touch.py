"""One touch of a round."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from realtouch.clip import TouchClip
from realtouch.jpeg import Pixels
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

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
        position: NDArray[np.floating] = self.round.pos_in_cell_m[self._place]
        return position

    @property
    def gel_pose(self) -> RigidTransform:
        """Pose of the gel at contact, metres, cell frame; of a clip, that of the last frame of contact."""
        if isinstance(self.round, TouchSingleRound):
            return self.round.gel_pose_cell_frame[self._place]
        clip = self.clip
        return clip.poses[clip.contact_index("contact_end")]

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
        return f"Touch(round_id={self.round_id!r}, touch_index={self.touch_index}, label={self.label})"

    def _repr_html_(self) -> str:
        """Show the picture of the contact in a notebook."""
        from realtouch.pictures import touch_html

        return touch_html(self)
