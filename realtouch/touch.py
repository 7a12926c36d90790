"""One touch of a round: a typed, frozen record."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from realtouch import depth_maps, extras, rounds, touch_clips
from tactile_toolkit import pictures
from tactile_toolkit.array_types import Float32, Floating, UInt8
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from realtouch.pose import Pose


def touch_id(round_id: str, touch_index: int) -> str:
    """Return the id of a touch."""
    return f"{round_id}_{touch_index:03d}"


class Touch(pictures.Drawn):
    """One touch of a round; frozen, fields are read on access.

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

    __slots__ = ("_index_in_row", "round", "touch_index")
    round: rounds.TouchRound
    touch_index: int
    _index_in_row: int

    def __init__(self, round: rounds.TouchRound, touch_index: int, index_in_row: int | None = None) -> None:
        object.__setattr__(self, "round", round)
        object.__setattr__(self, "touch_index", touch_index)
        if index_in_row is None:
            index_in_row = touch_index
        object.__setattr__(self, "_index_in_row", index_in_row)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"Touch is frozen; {name!r} cannot be set")

    @property
    def id(self) -> str:
        """Id of the round and number of the touch, as exports name it: ``2023-09-28_15-50-43_7-0_012``."""
        return touch_id(self.round_id, self.touch_index)

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
    def pos_in_cell_m(self) -> Floating:
        """Intended position, shape (2,), metres, cell frame."""
        position: Floating = self.round.row.intended_positions(self._index_in_row)[0]
        return position

    @property
    def extra(self) -> extras.Extras:
        """Further columns by their own names: a value, a vector, or an array with an entry per frame.

        See :attr:`realtouch.TouchRound.extra`.
        """
        return extras.Extras(tuple(self.round.extra), self._extra)

    def _extra(self, name: str) -> object:
        return self.round.extra[name][self._index_in_row]

    @property
    def gel_pose(self) -> Pose:
        """Pose of the gel at contact, metres, cell frame; of a clip, that of the last frame of contact.

        Reads this touch only, and opens no clip where the times of its frames are stored.
        """
        row, touch = self.round.row, self._index_in_row
        if isinstance(self.round, rounds.TouchSingleRound):
            return row.poses(touch)[0]
        (frame,) = touch_clips.contact_frames_of(row, "contact_end", touch)
        return row.pose_sequences(touch)[0][frame]

    @property
    def image(self) -> UInt8:
        """Picture of the contact, shape (H, W, 3), uint8; of a clip, its last frame of contact."""
        return self.round.contact_image(self._index_in_row)

    @property
    def depth_m(self) -> Float32:
        """How far each point of the gel is pressed in, shape (H, W), metres; 0 where nothing touches it.

        Raises
        ------
        InputError
            `realtouch depth` did not write the data set.
        """
        return self._map(depth_maps.DEPTH)

    @property
    def depth_error_m(self) -> Float32:
        """Expected error of each pixel of :attr:`depth_m`, shape (H, W), metres."""
        return self._map(depth_maps.DEPTH_ERROR)

    def _map(self, column: str) -> Float32:
        return depth_maps.DepthMaps(self.round.row, column)[self._index_in_row]

    @property
    def clip(self) -> touch_clips.TouchClip:
        """The clip of a touch of a ``seq`` set.

        Raises
        ------
        InputError
            The data set holds images.
        """
        if not isinstance(self.round, rounds.TouchSeqRound):
            raise self.round.row.missing_column("sensor_video")
        return self.round.sensor_video[self._index_in_row]

    def _alone(self) -> Touch:
        """Return the touch with a copy of its own bytes only."""
        return Touch(self.round.with_touches([self._index_in_row]), self.touch_index, 0)

    def __eq__(self, other: object) -> bool:
        """Return whether the other is the same touch of an equal round."""
        if not isinstance(other, Touch):
            return NotImplemented
        if hash(self) != hash(other):  # the number in the round, and the round's id
            return False
        mine, theirs = self.round.row, other.round.row
        if mine.group is theirs.group and mine.index == theirs.index:
            return self._index_in_row == other._index_in_row
        return self._alone().round == other._alone().round

    def __hash__(self) -> int:
        return hash((self.touch_index, self.round))

    def __reduce__(self) -> tuple[object, ...]:
        # A round of clips takes about 50 MB; a touch is pickled with its own bytes only.
        alone = self._alone()
        return (Touch, (alone.round, alone.touch_index, 0))

    def __repr__(self) -> str:
        shown = {
            "round_id": self.round.describe_field("id"),
            "touch_index": f"{self.touch_index}",
            "label": self.round.describe_field("label"),
        }
        words = [f"{name}={value}" for name, value in shown.items() if value is not None]
        return f"Touch({', '.join(words)})"

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the label, the number and the position of the touch, as far as they are known."""
        words = [*self.round.label_words(), f"touch {self.touch_index}"]
        with suppress(InputError):  # without positions
            x_mm, y_mm = (1000.0 * float(value) for value in self.pos_in_cell_m)
            words.append(f"x {x_mm:.1f} mm, y {y_mm:.1f} mm")
        return ", ".join(words)

    def picture(self, width_px: float) -> UInt8:
        """Return the picture of the contact at another width."""
        return pictures.fitted(self.image, width_px)
