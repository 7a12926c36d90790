"""Touches, not only rounds: the flat view with random access, and its filters."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_frame import clip_times, touch_times
from realtouch.columns.per_touch import intended_position
from realtouch.columns.poses import clip_poses, touch_contact_z_m, touch_pose
from realtouch.contact import MIN_CONTACT_HEIGHT_M, contact_heights_m, contact_window
from realtouch.damage import missing_column
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages, positions_of
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch.jpeg import Pixels, room_for
from tactile_toolkit.touch.schema import Kind

if TYPE_CHECKING:
    from realtouch.pose import Pose

__all__ = ["Touch", "Touches"]


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

    __slots__ = ("_index_in_row", "round", "touch_index")
    round: TouchRound
    touch_index: int
    _index_in_row: int

    def __init__(self, round: TouchRound, touch_index: int, index_in_row: int | None = None) -> None:
        object.__setattr__(self, "round", round)
        object.__setattr__(self, "touch_index", touch_index)
        object.__setattr__(self, "_index_in_row", touch_index if index_in_row is None else index_in_row)

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
        return intended_position(self.round._row, self._index_in_row)

    @property
    def gel_pose(self) -> Pose:
        """Pose of the gel at contact, metres, cell frame; of a clip, that of the last frame of contact.

        Reads this touch only, and opens no clip where the times of its frames are stored.
        """
        row, touch = self.round._row, self._index_in_row
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
        return self.round._contact_image(self._index_in_row)

    @property
    def clip(self) -> TouchClip:
        """The clip of a touch of a ``seq`` set.

        Raises
        ------
        InputError
            The data set holds images.
        """
        if not isinstance(self.round, TouchSeqRound):
            raise missing_column(self.round._row, "sensor_video")
        return self.round.sensor_video[self._index_in_row]

    def alone(self) -> Touch:
        """Return the touch with a copy of its own bytes, which keeps no other touch in memory."""
        return Touch(self.round.with_touches([self._index_in_row]), self.touch_index, 0)

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
        from realtouch.media.sheets import touch_html

        label = self.round.shown("label", str)
        words = [*([] if label is None else [f"label {label}"]), f"touch {self.touch_index}"]
        with suppress(InputError):  # without positions
            x_mm, y_mm = (1000.0 * float(value) for value in self.pos_in_cell_m)
            words.append(f"x {x_mm:.1f} mm, y {y_mm:.1f} mm")
        return touch_html(self.image, ", ".join(words))


R = TypeVar("R", bound=TouchRound)
R_co = TypeVar("R_co", bound=TouchRound, covariant=True)


class Rounds(Protocol[R_co]):
    """What a view of touches must know of its rounds; :class:`realtouch.TouchDataset` is one."""

    kind: Kind

    @property
    def touch_counts(self) -> NDArray[np.int64]:
        """T of each round."""

    @property
    def row_numbers(self) -> NDArray[np.int64]:
        """Number of each round in the stored tables."""

    @property
    def labels(self) -> NDArray[np.int64]:
        """Label of each round."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> R_co: ...

    def has_column(self, name: str) -> bool:
        """Tell whether there is a column."""

    def int_column(self, name: str) -> NDArray[np.int64]:
        """Read one column of integers."""

    def filter_labels(self, labels: Iterable[int | str]) -> Rounds[R_co]:
        """Return the rounds of some classes."""

    def known_contact_z_m(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Heights of all stored touches, NaN where unknown, and where those of each stored row begin."""

    def plates_z_m(self) -> NDArray[np.float64]:
        """Height of the plate of every stored row, NaN where unknown."""

    def rounds_without_media(self) -> Iterator[tuple[int, R_co]]:
        """Yield stored row number and round, without opening images or clips until asked for."""


class Touches(Sequence[Touch], Generic[R]):
    """All touches of some rounds, or a selection of them; a view that copies nothing.

    ``touches[i]`` gives a :class:`Touch`; a slice, ints or a boolean mask give a view. Filters give views too
    and read only the columns that they need.

    Parameters
    ----------
    dataset : TouchDataset
        The rounds.
    chosen : ndarray of int64, optional
        Which touches, counted through all rounds of the data set; all by default.
    """

    def __init__(self, dataset: Rounds[R], chosen: NDArray[np.int64] | None = None) -> None:
        self.dataset = dataset
        counts = dataset.touch_counts
        self._starts = np.concatenate([[0], np.cumsum(counts)])
        self._chosen = chosen
        self._length = int(self._starts[-1]) if chosen is None else len(chosen)
        # Rounds of one length, the common case, are found by a division.
        self._per_round = int(counts[0]) if len(counts) and (counts == counts[0]).all() else 0

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> Touch: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[Any]) -> Touches[R]: ...
    def __getitem__(self, index: Any) -> Touch | Touches[R]:
        """Return a touch (int) or a view (slice, ints, boolean mask)."""
        if isinstance(index, (slice, list, tuple, np.ndarray)):
            wanted = np.asarray(positions_of(index, len(self)), np.int64)
            return Touches(self.dataset, wanted if self._chosen is None else self._chosen[wanted])
        position, touch = self.locate(operator.index(index))
        return Touch(self.dataset[position], touch)

    def __iter__(self) -> Iterator[Touch]:
        last, current = -1, None
        for index in range(len(self)):
            position, touch = self.locate(index)
            if position != last or current is None:
                last, current = position, self.dataset[position]
            yield Touch(current, touch)

    def locate(self, index: int) -> tuple[int, int]:
        """Return the number of a touch's round in the data set, and its own in the round.

        Raises
        ------
        IndexError
            There is no such touch.
        """
        length = self._length
        if not -length <= index < length:
            message = f"index {index} is out of range for {length} touches"
            raise IndexError(message)
        flat = index % length if self._chosen is None else int(self._chosen[index])
        if self._per_round:
            return divmod(flat, self._per_round)
        position = int(np.searchsorted(self._starts, flat, side="right")) - 1
        return position, flat - int(self._starts[position])

    @property
    def round_positions(self) -> NDArray[np.int64]:
        """Number of the round of each touch in the data set, shape (len,), int64."""
        return np.searchsorted(self._starts, self._flat, side="right") - 1

    @property
    def touch_indices(self) -> NDArray[np.int64]:
        """Number of each touch in its round, shape (len,), int64."""
        indices: NDArray[np.int64] = self._flat - self._starts[self.round_positions]
        return indices

    @property
    def label_array(self) -> NDArray[np.int64]:
        """Label of each touch, shape (len,), int64; reads the label column only."""
        return self.dataset.labels[self.round_positions]

    @property
    def object_ids(self) -> NDArray[np.int64]:
        """Object of each touch, shape (len,), int64; reads that column only."""
        return self.dataset.int_column("object_id")[self.round_positions]

    def heights_m(self, recalibrate_z: bool = True) -> NDArray[np.float64]:
        """Return how high above the plate the gel stopped in each touch, shape (len,), metres.

        Reads the poses only. See :func:`realtouch.contact.contact_heights_m`; all touches of a round take
        part in finding its plate, whatever was selected here; where `realtouch select` took touches out of
        the files, the plate that it stored is taken.

        Raises
        ------
        IntegrityError
            The height of a touch of this view cannot be read; names file, row and touch.
        """
        z_m, starts = self.dataset.known_contact_z_m()
        plates_m = self.dataset.plates_z_m()
        heights = np.full(int(self._starts[-1]), np.nan)
        for position, row in enumerate(self.dataset.row_numbers):
            touched_m = z_m[starts[row] : starts[row + 1]]
            of_round = heights[self._starts[position] : self._starts[position + 1]]
            known = ~np.isnan(touched_m)
            of_round[known] = contact_heights_m(touched_m[known], recalibrate_z, plates_m[row])
        chosen = heights[self._flat]
        unknown = np.isnan(chosen)
        if unknown.any():
            position, touch = self.locate(int(np.argmax(unknown)))
            touch_contact_z_m(self.dataset[position]._row, self.dataset.kind, touch)  # says what is wrong
        return chosen

    def with_contact(
        self, min_height_m: float = MIN_CONTACT_HEIGHT_M, recalibrate_z: bool = True
    ) -> Touches[R]:
        """Return the touches in which the gel stopped on an object.

        Parameters
        ----------
        min_height_m : float
            Height above the plate from which a touch counts, metres.
        recalibrate_z : bool
            Take the deepest touch of each round as the plate; the zero of z drifts by up to 3 mm.
        """
        return self[self.heights_m(recalibrate_z) >= min_height_m]

    def labels(self, *wanted: int | str | Iterable[int | str]) -> Touches[R]:
        """Return the touches of some classes, given as numbers or names, or as sequences of them.

        Raises
        ------
        InputError
            There is no such class, or something else than numbers and names is given.
        """
        classes = _listed(wanted, (int, np.integer, str), "classes as whole numbers or names")
        kept = self.dataset.filter_labels(classes).row_numbers
        return self[np.isin(self.dataset.row_numbers[self.round_positions], kept)]

    def objects(self, *wanted: int | Iterable[int]) -> Touches[R]:
        """Return the touches of some objects, by ``object_id``, given as numbers or as sequences of them.

        Raises
        ------
        InputError
            Something else than whole numbers is given.
        """
        numbers = {int(each) for each in _listed(wanted, (int, np.integer), "object ids as whole numbers")}
        known = {int(each) for each in np.unique(self.object_ids)}
        return self[np.isin(self.object_ids, sorted(numbers & known))]

    def where(self, predicate: Callable[[Touch], bool]) -> Touches[R]:
        """Return the touches for which a function is true.

        Images and clips are read only when the function asks for them.
        """
        keep = np.zeros(len(self), bool)
        touches = self.touch_indices
        by_row: dict[int, list[int]] = {}
        for index, row in enumerate(self.dataset.row_numbers[self.round_positions].tolist()):
            by_row.setdefault(row, []).append(index)
        for row, record in self.dataset.rounds_without_media():
            for index in by_row.get(row, ()):
                keep[index] = bool(predicate(Touch(record, int(touches[index]))))
        return self[keep]

    def without(self, lost: Iterable[tuple[int, int | None]]) -> Touches[R]:
        """Return the touches but some, given as stored row and number in the round."""
        rows = self.dataset.row_numbers[self.round_positions].tolist()
        gone = set(lost)
        pairs = zip(rows, self.touch_indices.tolist(), strict=True)
        return self[np.array([pair not in gone for pair in pairs], bool)]

    def images(self, index: Any = slice(None), *, threads: int = 1, out: Pixels | None = None) -> Pixels:
        """Decode the images of several touches of a ``single`` set into one array.

        Parameters
        ----------
        index : slice, sequence of int, or boolean mask
            Which touches, in any order.
        threads : int
            How many images to decode at a time.
        out : ndarray, shape (n, H, W, 3), uint8, optional
            Where to put them.

        Returns
        -------
        ndarray, shape (n, H, W, 3), uint8

        Raises
        ------
        InputError
            ``out`` is not a writable array of that shape and dtype, each image C-contiguous.
        IntegrityError
            An image is damaged or of another size; names file, row and touch.
        """
        wanted = [self.locate(each) for each in positions_of(index, len(self))]
        if not wanted:
            has_any = len(self.dataset) and self.dataset[0].touch_count
            size = self._images_of(0).size() if has_any else (0, 0)
            return room_for(0, size) if out is None else out
        size = self._images_of(wanted[0][0]).size(wanted[0][1])
        out = np.empty((len(wanted), *size, 3), np.uint8) if out is None else out
        room_for(len(wanted), size, out)
        start = 0
        for position, of_round in groupby(wanted, key=itemgetter(0)):
            touches = [touch for _, touch in of_round]
            stop = start + len(touches)
            self._images_of(position).decode_into(out[start:stop], touches, threads=threads)
            start = stop
        return out

    def _images_of(self, position: int) -> SensorImages:
        record = self.dataset[position]
        if not isinstance(record, TouchSingleRound):
            raise missing_column(record._row, "sensor_image")
        return record.sensor_image

    @property
    def _flat(self) -> NDArray[np.int64]:
        return np.arange(len(self)) if self._chosen is None else self._chosen

    def __repr__(self) -> str:
        return f"Touches({len(self):,} of {len(self.dataset):,} rounds)"


def _listed(wanted: Iterable[Any], types: tuple[type, ...], expected: str) -> list[Any]:
    """Lay values and sequences of them in one list; InputError where one is of none of the types."""
    values: list[Any] = []
    for item in wanted:
        if isinstance(item, np.ndarray):
            values += item.reshape(-1).tolist()
        elif isinstance(item, Iterable) and not isinstance(item, (str, bytes)):
            values += item
        else:
            values.append(item)
    for value in values:
        if not isinstance(value, types) or isinstance(value, bool):
            message = f"{value!r} ({type(value).__name__}) was given; expected {expected}"
            raise InputError(message)
    return values
