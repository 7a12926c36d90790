"""Rounds, typed records of all touches of one object, and single touches."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch import contact
from realtouch.touches import media, poses, schema, stored_round
from tactile_toolkit import errors, pictures, read, run, wording
from tactile_toolkit.value_types import Float32, Floating, Int64, JsonDict, UInt8

if TYPE_CHECKING:
    from datasets import Dataset

    from realtouch.touches.pose import Pose


_MAX_THREADS = 4
_MAX_TILES = 32  # touches that a notebook shows of a round

_TENSORS = "realtouch.touch_tensors.TouchTensors"
INDEX = "touch_index"
"""Column of the number of a touch in its round, in tables of touches."""


class TouchRound(pictures.Drawn, read.Record):
    """T touches of one object; fields are loaded on first use.

    Poses and positions are metres in the cell frame: origin at the cell centre, x right of the robot, y away
    from it, z up. Iterate :meth:`realtouch.TouchDataset.touches` for single touches.
    """

    __slots__ = ()
    TENSORS = _TENSORS
    row: stored_round.StoredRound

    @property
    def id(self) -> str:
        """Name of the round, such as ``2023-09-28_15-50-43_7-0``."""
        return self.row.name()

    @property
    def label(self) -> int:
        """Class of the object, such as the digit, 0 to 9, in the MNIST sets; -1 if it is not known."""
        return self._once("label", self.row.label_value)

    @property
    def object_id(self) -> int:
        """Id of the touched mesh in its data set of meshes."""
        return self._once("object_id", lambda: self.row.integer("object_id"))

    @property
    def info(self) -> JsonDict:
        """Metadata such as ``gel_id`` and notes, nested, with poses; a new dict, which may be changed."""
        return dict(self._once("info", lambda: self.row.read_info()))

    @property
    def extra(self) -> schema.Extras:
        """Further columns by their own names, such as ``extra["force_n"]``; each is read on first use.

        A column with an entry per touch is an array of shape (T,), or (T, k) of vectors; one with an entry
        per frame is a tuple of T arrays, shapes (N_i,) or (N_i, k). Missing values are NaN, or None for texts
        and booleans; integers with missing values are floats.
        """
        return schema.Extras(tuple(schema.extra_columns(self.row.group.names)), self._extra)

    def _extra(self, name: str) -> object:
        return self._once(f"extra {name}", lambda: self.row.extra_values(name))

    @property
    def pos_in_cell_m(self) -> Floating:
        """Intended positions, shape (T, 2), metres, cell frame; a read-only view."""
        return self.row.intended_positions()

    @property
    def pos_in_cell(self) -> Floating:
        """The published name of :attr:`pos_in_cell_m`."""
        return self.pos_in_cell_m

    @property
    def touch_count(self) -> int:
        """T, the number of touches."""
        return self.row.touch_total()

    def with_touches(self, touches: Sequence[int]) -> Self:
        """Return a round of some of the touches, in the order given; a copy of their stored bytes."""
        row = self.row
        table = schema.flat_row(row)
        chosen = schema.take_touches(table, touches, self.touch_count)
        return type(self)(stored_round.StoredRound(read.RowGroup(chosen, row.path, row.number), 0))

    def describe_field(self, name: str, in_words: Callable[[Any], str] = repr) -> str | None:
        """Return a field as text; None if the column does not exist or the class is not known."""
        try:
            value = getattr(self, name)
            return None if name == "label" and value == -1 else in_words(value)
        except errors.InputError:
            return None
        except (errors.ToolkitError, ValueError, OSError):
            return "unreadable"

    def __repr__(self) -> str:
        named = ((name, self.describe_field(name)) for name in ("id", "label"))
        words = [f"{name}={value}" for name, value in named if value is not None]
        words.append(f"{self.describe_field('touch_count')} touches")
        return f"{type(self).__name__}({', '.join(words)})"

    def _repr_html_(self) -> str:
        """Show touches in a notebook; missing columns and damaged pictures are left out."""
        words = self.label_words()
        words += filter(None, [self.describe_field("object_id", "object {}".format)])
        touches = media.evenly_spaced(self.touch_count, _MAX_TILES)
        images = [(f"{touch}", partial(self.contact_image, touch)) for touch in touches]
        title = self.describe_field("id", str) or "Round"
        return pictures.Drawn.grid_html(
            title, [*words, wording.with_count(self.touch_count, "touches")], images
        )

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the label, if there is one, and the number of touches."""
        return ", ".join([*self.label_words(), wording.with_count(self.touch_count, "touches")])

    def picture(self, width_px: float) -> UInt8:
        """Return the picture of the contact in the middle of the round; InputError if it has no touches."""
        if not self.touch_count:
            raise errors.InputError("the round has no touches, and no picture", next="choose another round")
        return pictures.fitted(self.contact_image(self.touch_count // 2), width_px)

    def label_words(self) -> list[str]:
        """Return the label as text; empty for a data set without labels."""
        label = self.describe_field("label", "label {}".format)
        return list(filter(None, [label]))

    def contact_image(self, touch: int) -> UInt8:
        """Return the picture of one contact, shape (H, W, 3), uint8; of a clip, its last frame of contact."""
        raise NotImplementedError

    def picture_size(self, touch: int) -> tuple[int, int]:
        """Return width and height of the picture, or of the frames, of one touch; decodes nothing."""
        raise NotImplementedError


class TouchSingleRound(TouchRound):
    """T touches of one object, one image each."""

    __slots__ = ()

    @property
    def gel_pose_cell_frame(self) -> poses.Poses:
        """Pose of the gel at contact, T poses; their arrays are views."""
        return self._once("gel_pose_cell_frame", lambda: self.row.poses())

    @property
    def sensor_image(self) -> media.SensorImages:
        """Images, T of them, decoded on demand: int -> (H, W, 3) uint8, else (n, H, W, 3)."""

        def images() -> media.SensorImages:
            self.row.entries_of("sensor_image")  # refuses a round with more or less than T images
            return media.SensorImages(self.row)

        return self._once("sensor_image", images)

    @property
    def depth_m(self) -> media.DepthMaps:
        """Maps of how far the gel is pressed in, T of them, metres, of sets from `tactile-sim depth`."""
        return self._once(media.DEPTH, lambda: media.DepthMaps(self.row, media.DEPTH))

    @property
    def depth_error_m(self) -> media.DepthMaps:
        """Maps of the expected error of :attr:`depth_m`, T of them, metres."""
        return self._once(media.DEPTH_ERROR, lambda: media.DepthMaps(self.row, media.DEPTH_ERROR))

    def contact_image(self, touch: int) -> UInt8:
        """As :meth:`TouchRound.contact_image`."""
        return self.sensor_image[touch]

    def picture_size(self, touch: int) -> tuple[int, int]:
        """As :meth:`TouchRound.picture_size`."""
        return self.sensor_image.size(touch)[::-1]


class TouchSeqRound(TouchRound):
    """T touches of one object, one clip each; touch i has N_i frames."""

    __slots__ = ()

    @property
    def video_length_frames(self) -> Int64:
        """Number of frames of each clip, shape (T,), int64."""
        return self.row.clip_lengths()

    @property
    def gel_pose_cell_frame_seq(self) -> poses.PoseSequences:
        """Pose of the gel in each frame: T sequences of N_i poses; their arrays are views."""
        return self._once("gel_pose_cell_frame_seq", lambda: self.row.pose_sequences())

    @property
    def time_stamp_rel_seq(self) -> tuple[NDArray[np.timedelta64], ...]:
        """Time stamp of each frame: T arrays of ``timedelta64``, shapes (N_i,)."""
        times = partial(self.row.cut, "time_stamp_rel_seq", 0)
        return self._once("time_stamp_rel_seq", lambda: tuple(map(schema.as_timedelta, times())))

    @property
    def touch_start_time_rel(self) -> NDArray[np.timedelta64]:
        """Time of first registered contact, shape (T,), ``timedelta64``."""
        return self.row.touch_durations("touch_start_time_rel")

    @property
    def touch_end_time_rel(self) -> NDArray[np.timedelta64]:
        """Time of last registered contact, shape (T,), ``timedelta64``."""
        return self.row.touch_durations("touch_end_time_rel")

    @property
    def sensor_video(self) -> media.SensorClips:
        """Clips, T of them, opened on demand."""
        return self._once("sensor_video", lambda: media.SensorClips(self.row))

    def contact_image(self, touch: int) -> UInt8:
        """As :meth:`TouchRound.contact_image`."""
        return self.sensor_video[touch].contact_frame("contact_end")

    def picture_size(self, touch: int) -> tuple[int, int]:
        """As :meth:`TouchRound.picture_size`."""
        return self.sensor_video[touch].size[::-1]

    def contact_frames(
        self, method: str = "contact_end", *, threads: int | None = None, out: UInt8 | None = None
    ) -> UInt8:
        """Decode the frame of each touch that shows the contact.

        Parameters
        ----------
        method : str
            See :meth:`realtouch.TouchClip.contact_index`.
        threads : int, optional
            Number of clips that are decoded at a time; by default the number of processor cores, at most 4.
        out : ndarray, shape (T, H, W, 3), uint8, optional
            Array to write them to.

        Returns
        -------
        ndarray, shape (T, H, W, 3), uint8
        """
        clips = self.sensor_video
        chosen = contact.require_method(method)
        pixels = clips.array_for(len(clips), out)
        cores = _cores(threads)
        if chosen == "best":  # by the pictures: each clip is decoded whole

            def decode(touch: int) -> None:
                clip = clips[touch]
                clip.decode_into(pixels[touch], clip.contact_index(chosen))

            media.in_parallel(decode, len(clips), cores)
        else:
            media.decode_frames(
                clips, range(len(clips)), media.contact_frames_of(self.row, chosen), pixels, cores
            )
        return pixels

    def contact_windows(
        self, touches: object = slice(None), *, threads: int | None = None
    ) -> tuple[UInt8, ...]:
        """Decode every frame of contact of several touches.

        Parameters
        ----------
        touches : slice, sequence of int, or boolean mask
            Touches to decode; all by default. At 320 x 240 pixels, a touch takes 1.6 MB.
        threads : int, optional
            Number of frames that are decoded at a time; by default the number of processor cores, at most 4.

        Returns
        -------
        tuple of ndarray, shapes (n_i, H, W, 3), uint8
            The frames of :attr:`realtouch.TouchClip.contact_window` of each touch; views of one array.
        """
        clips = self.sensor_video
        numbers = clips.checked_indices(touches)
        windows = [media.contact_windows(self.row, touch)[0] for touch in numbers]
        counts = [window.stop - window.start for window in windows]
        pixels = clips.array_for(sum(counts))
        frames = [frame for window in windows for frame in range(window.start, window.stop)]
        owners = np.repeat(numbers, counts).tolist()
        media.decode_frames(clips, owners, frames, pixels, _cores(threads))
        return tuple(np.split(pixels, np.cumsum(counts)))[: len(counts)]


def _cores(threads: int | None) -> int:
    return threads or min(run.usable_cores(), _MAX_THREADS)


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
    TENSORS = _TENSORS
    round: TouchRound
    touch_index: int
    _index_in_row: int

    def __init__(self, round: TouchRound, touch_index: int, index_in_row: int | None = None) -> None:
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
    def extra(self) -> schema.Extras:
        """Further columns by their own names: a value, a vector, or an array with an entry per frame.

        See :attr:`realtouch.TouchRound.extra`.
        """
        return schema.Extras(tuple(self.round.extra), self._extra)

    def _extra(self, name: str) -> object:
        return self.round.extra[name][self._index_in_row]

    @property
    def gel_pose(self) -> Pose:
        """Pose of the gel at contact, metres, cell frame; of a clip, that of the last frame of contact.

        Reads this touch only, and opens no clip where the times of its frames are stored.
        """
        row = self.round.row
        touch = self._index_in_row
        if isinstance(self.round, TouchSingleRound):
            return row.poses(touch)[0]
        (frame,) = media.contact_frames_of(row, "contact_end", touch)
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
            `tactile-sim depth` did not write the data set.
        """
        return self._map(media.DEPTH)

    @property
    def depth_error_m(self) -> Float32:
        """Expected error of each pixel of :attr:`depth_m`, shape (H, W), metres."""
        return self._map(media.DEPTH_ERROR)

    def _map(self, column: str) -> Float32:
        return media.DepthMaps(self.round.row, column)[self._index_in_row]

    @property
    def clip(self) -> media.TouchClip:
        """The clip of a touch of a ``seq`` set.

        Raises
        ------
        InputError
            The data set holds images.
        """
        if not isinstance(self.round, TouchSeqRound):
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
        with suppress(errors.InputError):  # without positions
            x_mm, y_mm = (1000.0 * float(value) for value in self.pos_in_cell_m)
            words.append(f"x {x_mm:.1f} mm, y {y_mm:.1f} mm")
        return ", ".join(words)

    def picture(self, width_px: float) -> UInt8:
        """Return the picture of the contact at another width."""
        return pictures.fitted(self.image, width_px)


def hf_touches(
    rows: Sequence[stored_round.StoredRound], positions: Int64, touches: Int64, content: str
) -> Dataset:
    """Return touches as a data set of the library `datasets`; see :meth:`realtouch.Touches.to_hf`.

    ``rows`` are the rounds, ``positions`` and ``touches``, shape (n,), the round of each touch and its number
    in it; ``content`` identifies all of them. Columns that a merged round lacks are null.
    """
    from datasets import Dataset, DatasetInfo, Features  # an extra

    if not rows:
        return Dataset.from_dict({})
    first_with = {name: row for row in reversed(rows) for name in row.group.names}
    names = [
        field.name
        for field in schema.flat_row(rows[0]).schema
        if field.name in first_with
        and schema.is_per_touch(field.name, field.type)
        and _count_in(first_with[field.name], field.name) == first_with[field.name].touch_total()
    ]
    parts = [_row_of_each_touch(row, names) for row in rows]
    features = Features.from_arrow_schema(parts[0].schema)
    for name, feature in Features.from_arrow_schema(rows[0].group.table.schema).flatten().items():
        features[name] = feature.feature if name in names else feature
    whole = Dataset(
        pa.concat_tables(parts),
        info=DatasetInfo(features=features),
        fingerprint=hashlib.sha256(content.encode()).hexdigest()[:16],
    )
    starts = np.cumsum([0, *map(len, parts)])
    return whole.select(starts[positions] + touches)


def _count_in(row: stored_round.StoredRound, name: str) -> int:
    return len(schema.flat_row(row).column(name).chunk(0).flatten())


def _row_of_each_touch(row: stored_round.StoredRound, per_touch: Collection[str]) -> pa.Table:
    """Return a table with a row for each touch of a round; other columns repeat the value of the round."""
    table = schema.flat_row(row)
    count = row.touch_total()
    columns = {}
    for name in table.column_names:
        array = table.column(name).chunk(0)
        if name in per_touch and not row.has(name):
            columns[name] = pa.nulls(count, array.type.value_type)
        elif name in per_touch:
            row.entries_of(name)  # refuses a round with more or less of them
            columns[name] = array.flatten()
        else:
            columns[name] = array.take(pa.array(np.zeros(count, np.int64)))
    return pa.table({**columns, INDEX: np.arange(count)})
