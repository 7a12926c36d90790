"""Touches, not only rounds: the flat view with random access, and its filters."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator
from itertools import groupby
from operator import itemgetter
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_touch import entries_of, touch_total
from realtouch.columns.poses import touch_contact_z_m
from realtouch.contact import contact_heights_m
from realtouch.damage import missing_column
from realtouch.media.images import SensorImages
from realtouch.rounds import TouchRound, TouchSingleRound
from realtouch.touch import Touch, touch_id
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset, Row
from tactile_toolkit.read.order import StoredParts
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.read.sequence import LazySequence, nearest, positions
from tactile_toolkit.touch.contact import ContactHeight
from tactile_toolkit.touch.jpeg import Pixels, room_for
from tactile_toolkit.touch.rows import flat_row
from tactile_toolkit.touch.schema import Kind, is_per_touch
from tactile_toolkit.wording import counted, is_whole, plain_number

__all__ = ["Touches", "with_empties"]


_INDEX = "touch_index"
_POSITION = ("x_m", "y_m")

R = TypeVar("R", bound=TouchRound)


class Rounds(RecordDataset[R]):
    """Rounds, with what a view of their touches asks of them; see :class:`realtouch.TouchDataset`."""

    kind: Kind

    @property
    @abstractmethod
    def touch_counts(self) -> NDArray[np.int64]:
        """T of each round."""

    @property
    @abstractmethod
    def row_numbers(self) -> NDArray[np.int64]:
        """Number of each round in the stored tables."""

    @abstractmethod
    def has_column(self, name: str) -> bool:
        """Tell whether there is a column."""

    @abstractmethod
    def known_contact_z_m(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Heights of all stored touches, NaN where unknown, and where those of each stored row begin."""

    @abstractmethod
    def plates_z_m(self) -> NDArray[np.float64]:
        """Height of the plate of every stored row, NaN where unknown."""

    @abstractmethod
    def contact_rules(self) -> list[ContactHeight]:
        """Rule by which touches of each round count as contact."""

    @abstractmethod
    def known_positions_m(self) -> NDArray[np.float64]:
        """Intended position of every touch of these rounds, shape (touches, 2), NaN where unknown."""

    @abstractmethod
    def rounds_without_media(self) -> Iterator[tuple[int, R]]:
        """Yield stored row number and round, without opening images or clips until asked for."""


class Touches(LazySequence[Touch], Generic[R]):
    """All touches of some rounds, or a selection of them; a view that copies nothing.

    ``touches[i]`` gives a :class:`Touch`; a slice, ints or a boolean mask give a view. Filters give views too
    and read only the columns that they need. :meth:`split` divides touches, so that parts share rounds and
    objects: divide the rounds, or by :attr:`object_ids`, where they must not.

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

    def __iter__(self) -> Iterator[Touch]:
        last, current = -1, None
        for index in range(len(self)):
            position, touch = self.locate(index)
            # Neighbours share a round, whose columns are then resolved once.
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
        # In place: `checked_index` would cost a tenth of all that `touches[i]` does.
        if not -length <= index < length:
            message = f"index {index} is out of range for {length} touches"
            raise IndexError(message)
        flat = index % length if self._chosen is None else int(self._chosen[index])
        if self._per_round:
            return divmod(flat, self._per_round)
        place = int(np.searchsorted(self._starts, flat, side="right")) - 1
        return place, flat - int(self._starts[place])

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
    def labels(self) -> NDArray[np.int64]:
        """Label of each touch, shape (len,), int64; reads the label column only."""
        return self.dataset.labels[self.round_positions]

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class, in order of the label."""
        return self.dataset.label_names

    @property
    def column_names(self) -> tuple[str, ...]:
        """Stored columns of the rounds, and ``touch_index``: those of :meth:`to_hf`."""
        return (*self.dataset.column_names, _INDEX)

    @property
    def _plain_columns(self) -> tuple[str, ...]:
        where = _POSITION if self.dataset.has_column("pos_in_cell") else ()
        return (*self.dataset._plain_columns, _INDEX, *where)

    def column(self, name: str) -> NDArray[Any]:
        """Read one plain column, shape (len,): one of the rounds, ``touch_index``, or ``x_m`` or ``y_m``.

        The last two are the intended position, metres, cell frame, NaN where none can be read.

        Raises
        ------
        InputError
            There is no such column.
        """
        if name == _INDEX:
            return self.touch_indices
        if name in _POSITION:
            values: NDArray[Any] = self.dataset.known_positions_m()[self._flat, _POSITION.index(name)]
            return values
        return self.dataset.column(name)[self.round_positions]

    def to_hf(self) -> Any:
        """Return the touches as a data set of the library `datasets`, one row each, with their features.

        Columns with one entry per touch give that entry, all others are repeated, and ``touch_index`` is
        added. Pictures and clips are not copied where the cache can be written; they stay as they are stored.

        Returns
        -------
        datasets.Dataset

        Raises
        ------
        IntegrityError
            A file is damaged, or a column has not one entry per touch.
        """
        import pyarrow as pa
        from datasets import Dataset, DatasetInfo, Features

        places = self.round_positions
        # Of no touches, the first round tells the columns.
        rounds = np.unique(places).tolist() or list(range(min(1, len(self.dataset))))
        if not rounds:
            return Dataset.from_dict({})
        rows = [self.dataset[place]._row for place in rounds]
        first, total = flat_row(rows[0]), touch_total(rows[0])
        names = [
            each.name
            for each in first.schema
            if is_per_touch(each.name, each.type) and len(first.column(each.name).chunk(0).flatten()) == total
        ]
        parts = [_row_of_each_touch(row, names) for row in rows]
        features = Features.from_arrow_schema(parts[0].schema)
        for name, feature in Features.from_arrow_schema(rows[0].group.table.schema).flatten().items():
            features[name] = feature.feature if name in names else feature
        # Its own fingerprint would be that of all bytes.
        told = repr([self.dataset.identity, rounds, places.tobytes(), self._flat.tobytes()])
        whole = Dataset(
            pa.concat_tables(parts),
            info=DatasetInfo(features=features),
            fingerprint=hashlib.sha256(told.encode()).hexdigest()[:16],
        )
        starts = np.cumsum([0, *map(len, parts)])
        return whole.select(starts[np.searchsorted(rounds, places)] + self.touch_indices)

    def _places_of_id(self, id: Any) -> NDArray[np.int64]:
        name, _, touch = str(id).rpartition("_")
        wanted = int(touch) if touch.isdecimal() else -1
        return np.flatnonzero((self.column("id") == name) & (self.touch_indices == wanted))

    def _near_ids(self, id: Any) -> list[str]:
        ids, name = self.column("id").tolist(), str(id).rpartition("_")[0]
        rounds = {name} & set(ids) or nearest(ids, name)
        numbered = zip(ids, self.touch_indices.tolist(), strict=True)
        return nearest((touch_id(each, touch) for each, touch in numbered if each in rounds), str(id))

    @property
    def object_ids(self) -> NDArray[np.int64]:
        """Object of each touch, shape (len,), int64; reads that column only."""
        return self.dataset.int_column("object_id")[self.round_positions]

    def heights_m(self, recalibrate_z: bool = True) -> NDArray[np.float64]:
        """Return how high above the plate the gel stopped in each touch, shape (len,), metres.

        Reads the poses only. See :func:`realtouch.contact.contact_heights_m`; all touches of a round take
        part in finding its plate, whatever was selected here; where `realtouch select` took touches out of
        the files, the plate that it stored is taken. Of touches that `tactile-sim generate` made, the height
        of the plate is known and always taken.

        Raises
        ------
        IntegrityError
            The height of a touch of this view cannot be read; names file, row and touch.
        """
        z_m, starts = self.dataset.known_contact_z_m()
        plates_m = self.dataset.plates_z_m()
        rules = self.dataset.contact_rules()
        heights = np.full(int(self._starts[-1]), np.nan)
        for position, row in enumerate(self.dataset.row_numbers):
            touched_m = z_m[starts[row] : starts[row + 1]]
            of_round = heights[self._starts[position] : self._starts[position + 1]]
            known = ~np.isnan(touched_m)
            above_plate = recalibrate_z or rules[position].plate == "known"
            of_round[known] = contact_heights_m(touched_m[known], above_plate, plates_m[row])
        chosen = heights[self._flat]
        unknown = np.isnan(chosen)
        if unknown.any():
            position, touch = self.locate(int(np.argmax(unknown)))
            touch_contact_z_m(self.dataset[position]._row, self.dataset.kind, touch)  # says what is wrong
        return chosen

    def with_contact(self, min_height_m: float | None = None, recalibrate_z: bool = True) -> Touches[R]:
        """Return the touches in which the gel stopped on an object; see :meth:`in_contact`."""
        return self[self.in_contact(min_height_m, recalibrate_z)]

    def in_contact(self, min_height_m: float | None = None, recalibrate_z: bool = True) -> NDArray[np.bool_]:
        """Return of each touch whether the gel stopped on an object, shape (len,).

        Parameters
        ----------
        min_height_m : float, optional
            Height above the plate from which a touch counts, metres. By default that of the publisher's own
            viewer, 6 mm; of touches that `tactile-sim generate` made, any height above the plate.
        recalibrate_z : bool
            Take the deepest touch of each round as the plate, where its height is not known: the zero of z
            drifts by up to 3 mm.

        Raises
        ------
        IntegrityError
            As :meth:`heights_m`.
        """
        heights_m = self.heights_m(recalibrate_z)
        if min_height_m is not None:
            return heights_m >= min_height_m
        least_m = np.array([rule.min_height_m for rule in self.dataset.contact_rules()])
        return np.asarray(heights_m >= least_m[self.round_positions])

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

    def sample(
        self,
        n: int | None = None,
        seed: int = 0,
        *,
        empties: float | None = None,
        contact: NDArray[np.bool_] | None = None,
    ) -> Self:
        """Return touches drawn at random without repetition, or those with contact and a share of the rest.

        Parameters
        ----------
        n : int, optional
            How many; with ``empties`` all that there are by default.
        seed : int
            From 0.
        empties : float, optional
            Share of touches without contact in what is returned, 0 to below 1, as far as there are any. Which
            ones follows from the seed, the id of the round and the touch's number alone, whatever else is
            selected and in whatever order. They stay where they are among the others.
        contact : ndarray of bool, shape (len,), optional
            Which touches have contact; by default those that :meth:`with_contact` keeps. See also
            :func:`realtouch.find_contacts`.

        Raises
        ------
        InputError
            There are fewer touches, or a number, share or mask is none.
        """
        if empties is None:
            return super().sample(len(self) if n is None else n, seed)
        mask = self.in_contact() if contact is None else contact
        chosen = self._some(with_empties(self, mask, empties, seed))
        return chosen if n is None else super(Touches, chosen).sample(n, seed)

    def without(self, lost: Iterable[tuple[int, int | None]]) -> Touches[R]:
        """Return the touches but some, given as stored row and number in the round."""
        rows = self.dataset.row_numbers[self.round_positions].tolist()
        # By stored row: places in a view change with each filter.
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
        wanted = [self.locate(each) for each in positions(index, len(self)).tolist()]
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

    def _item(self, position: int) -> Touch:
        place, touch = self.locate(position)
        return Touch(self.dataset[place], touch)

    def _some(self, chosen: slice | NDArray[np.int64]) -> Self:
        wanted = positions(chosen, len(self)) if isinstance(chosen, slice) else chosen
        return type(self)(self.dataset, wanted if self._chosen is None else self._chosen[wanted])

    def _joined(self, other: Self) -> Self:
        if self.dataset is other.dataset:
            return type(self)(self.dataset, np.concatenate([self._flat, other._flat]))
        moved = other._flat + self._starts[-1]
        return type(self)(self.dataset + other.dataset, np.concatenate([self._flat, moved]))

    def _like(self, item: Any) -> Iterable[int]:
        if not isinstance(item, Touch):
            return ()
        rounds = list(self.dataset._like(item.round))
        places = np.isin(self.round_positions, rounds) & (self.touch_indices == item.touch_index)
        return np.flatnonzero(places).tolist()

    def _same_rows(self, other: Self) -> bool:
        return self.dataset._same_rows(other.dataset) and np.array_equal(self._flat, other._flat)

    def _each(self) -> Iterator[tuple[int, Touch]]:
        touches = self.touch_indices.tolist()
        by_round: dict[int, list[int]] = {}
        for index, place in enumerate(self.round_positions.tolist()):
            by_round.setdefault(place, []).append(index)
        for place, record in self.dataset._each():
            for index in by_round.get(place, ()):
                yield index, Touch(record, touches[index])

    def _stored_parts(self) -> StoredParts:
        rounds = self.dataset._stored_parts()
        if rounds.order is None and self._chosen is None:
            return StoredParts.of(self._starts[rounds.starts])
        turn = np.arange(len(self.dataset))  # of each round, among all as they are stored
        if rounds.order is not None:
            turn[rounds.order] = np.arange(len(turn))
        turns = turn[self.round_positions]
        order = np.lexsort((self.touch_indices, turns))
        return StoredParts.of(np.searchsorted(turns[order], rounds.starts), order)

    def _row_groups(self, chosen: NDArray[np.int64]) -> list[tuple[Shard, int]]:
        flat = chosen if self._chosen is None else self._chosen[chosen]
        return self.dataset._row_groups(np.unique(np.searchsorted(self._starts, flat, side="right") - 1))

    def _words(self) -> list[str]:
        of_rounds, *further = self.dataset._words()
        return [f"{counted(len(self), 'touches')} of {of_rounds}", *further]


def with_empties(
    touches: Touches[Any], contact: NDArray[np.bool_], share: float, seed: int
) -> NDArray[np.int64]:
    """Return the places of all touches with contact, and of so many without that they are a share of both.

    Raises InputError for a share, a seed or a mask that is none.
    """
    wanted, number, mask = plain_number(share, float), plain_number(seed), np.asarray(contact)
    for problem, found, expected in (
        (not isinstance(wanted, float) or not 0 <= wanted < 1, f"empties is {share!r}", "0 to below 1"),
        (not is_whole(number) or number < 0, f"the seed is {seed!r}", "a whole number from 0"),
        (
            mask.dtype != bool or mask.shape != (len(touches),),
            f"contact is {mask.dtype} of shape {mask.shape}",
            f"bool of shape ({len(touches)},)",
        ),
    ):
        if problem:
            message = f"{found}; expected {expected}"
            raise InputError(message)
    (empty,) = np.nonzero(~mask)
    count = min(len(empty), round((len(touches) - len(empty)) * wanted / (1 - wanted)))
    if not count:
        return np.flatnonzero(mask)
    ids = touches.dataset.column("id")[touches.round_positions[empty]].tolist()
    texts = zip(ids, touches.touch_indices[empty].tolist(), strict=True)
    drawn = [
        hashlib.blake2b(f"{number} {name} {touch}".encode(), digest_size=16).digest() for name, touch in texts
    ]
    order = sorted(range(len(drawn)), key=drawn.__getitem__)[:count]
    return np.sort(np.concatenate([np.flatnonzero(mask), empty[order]]))


def _row_of_each_touch(row: Row, per_touch: Collection[str]) -> Any:
    """Return a table with a row for each touch of a round; columns without one entry each are repeated."""
    import pyarrow as pa

    table, count = flat_row(row), touch_total(row)
    columns = {}
    for name in table.column_names:
        array = table.column(name).chunk(0)
        if name in per_touch:
            entries_of(row, name)  # refuses a round with more or less of them
            columns[name] = array.flatten()
        else:
            columns[name] = array.take(pa.array(np.zeros(count, np.int64)))
    return pa.table({**columns, _INDEX: np.arange(count)})


def _listed(wanted: Iterable[Any], types: tuple[type, ...], expected: str) -> list[Any]:
    """Lay values and sequences of them in one list; InputError where one has another type."""
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
