"""Data sets and streams of rounds, and their touches as one sequence."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Self, TypeAlias, TypeVar

import numpy as np
import pyarrow as pa

from realtouch.touches import media, rounds, schema, stored_round, stored_values
from tactile_toolkit import checked_fields, errors, kind, read, run, touch, wording
from tactile_toolkit.value_types import AnyArray, Bool, Float64, Int64, UInt8

if TYPE_CHECKING:
    from datasets import Dataset


_POSITION = ("x_m", "y_m")

# Imported on use: they take touches.
_contacts_by_image = kind.lazy("realtouch.touches.image_contacts:contacts_by_image")
_with_no_contact = kind.lazy("realtouch.touches.image_contacts:with_no_contact")
R = TypeVar("R", bound=rounds.TouchRound)


class TouchDataset(read.RecordDataset[R]):
    """A lazy sequence of rounds; see :class:`tactile_toolkit.read.RecordDataset`.

    Parameters
    ----------
    table, rows, label_names
        As for :class:`tactile_toolkit.read.RecordDataset`.
    """

    things = "rounds"
    kind: schema.Kind | Literal["mixed"]

    def touches(self) -> Touches[R]:
        """Return the flat view: every touch of every round, in order, with random access."""
        return Touches(self)

    @property
    def labels(self) -> Int64:
        """Label of each round, shape (len,), int64, -1 without labels; reads the label column only."""
        return self._integers("label", lambda: np.full(len(self), -1), lambda record: record.label)

    def _row_at(self, number: int) -> stored_round.StoredRound:
        return stored_round.StoredRound(*self.table.locate(number))

    @property
    def object_ids(self) -> Int64:
        """Id of the touched object of each round, shape (len,), int64, -1 without one."""
        return self._integers(
            "object_id",
            lambda: np.full(len(self), -1),
            lambda record: record.object_id if record.row.has("object_id") else -1,
        )

    @property
    def touch_counts(self) -> Int64:
        """T of each round, shape (len,), int64; reads one small column, or none if its type fixes T."""
        return np.diff(stored_values.starts(self.table))[self.row_numbers]

    def contact_sources(self) -> list[schema.ContactSource]:
        """Return how contact of each round is known; joined sets may differ."""
        sources = [
            (schema.ContactSource.of(read.column_types(shard.schema)), len(shard))
            for shard in self.table.shards
        ]
        of_rows = [source for source, count in sources for _ in range(count)]
        return [of_rows[row] for row in self.row_numbers.tolist()]

    def rounds_without_media(self) -> Iterator[tuple[int, R]]:
        """Yield stored row number and round, row by row, and open images or clips only on access."""
        number = 0
        # In stored order, so that each block is read once, whatever the order of the view.
        chosen = set(self.row_numbers.tolist())
        for source in self.table.shards:
            columns = [name for name in source.schema.names if name not in schema.MEDIA_COLUMN.values()]
            start = number
            for block in read.ShardedTable((source,)).blocks(columns):
                rows = _RowsWithoutMedia(block, source, number - start)
                for row in range(len(block.table)):
                    if number + row in chosen:
                        yield number + row, self.record_class(stored_round.StoredRound(rows, row))
                number += len(block.table)

    def each_record(self) -> Iterator[tuple[int, R]]:
        """Yield position and round, in the fastest order; images and clips are not read."""
        positions: dict[int, list[int]] = {}
        for position, row in enumerate(self.row_numbers.tolist()):
            positions.setdefault(row, []).append(position)
        # A view may hold a round several times, at several positions.
        for row, record in self.rounds_without_media():
            for position in positions[row]:
                yield position, record


class TouchSingleDataset(TouchDataset[rounds.TouchSingleRound]):
    """Rounds with one image per touch."""

    record_class: ClassVar[type[Any]] = rounds.TouchSingleRound
    kind = "single"


class TouchSeqDataset(TouchDataset[rounds.TouchSeqRound]):
    """Rounds with one clip per touch."""

    record_class: ClassVar[type[Any]] = rounds.TouchSeqRound
    kind = "seq"


def _round_of(row: stored_round.StoredRound) -> rounds.TouchSeqRound | rounds.TouchSingleRound:
    return _DATASETS[row.kind].record_class(row)  # type: ignore[no-any-return]


class TouchMixedDataset(TouchDataset[rounds.TouchSeqRound | rounds.TouchSingleRound]):
    """Rounds with clips and rounds with images, such as `tactile merge` makes of sets of both."""

    record_class: ClassVar[Any] = staticmethod(_round_of)
    kind = "mixed"


AnyDataset = TouchDataset[Any]
"""Rounds of any kind."""


LoadedDataset: TypeAlias = TouchSeqDataset | TouchSingleDataset | TouchMixedDataset


def dataset_of(shards: Sequence[read.RowSource]) -> LoadedDataset:
    """Return the data set of some shards."""
    table = read.ShardedTable(tuple(shards))
    kinds = {schema.media_kind(stored, shards[0].path) for stored in table.schemas}
    dataset = _DATASETS["mixed" if len(kinds) > 1 else kinds.pop()]
    return dataset(table, None, schema.class_names_of(shards))


_DATASETS: dict[str, type[LoadedDataset]] = {
    "seq": TouchSeqDataset,
    "single": TouchSingleDataset,
    "mixed": TouchMixedDataset,
}


class TouchStream(read.RowStream[read.Shard]):
    """Rounds one after another; see :class:`tactile_toolkit.read.RowStream`.

    Parameters
    ----------
    shards : tuple of Shard
        Shards to read in turn.
    """

    @property
    def kind(self) -> str:
        """Media of the rounds: seq, single, or mixed in merged sets."""
        return dataset_of(self.shards).kind

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return schema.class_names_of(self.shards)

    def touches(self) -> AnyTouches:
        """Return the flat view: every touch of every round, in order, with random access.

        A row group is read from its address when one of its rows is first accessed, and kept in the cache.
        """
        return dataset_of(self.shards).touches()

    def __iter__(self) -> Iterator[rounds.TouchRound]:
        """Yield rounds; a bounded block of rows is in memory at a time."""
        blocks = (block for shard, index in self.row_groups() for block in shard.blocks(index))
        return map(_round_of, stored_round.rows_of(blocks))

    def __repr__(self) -> str:
        return self._described(self.kind)


class Touches(read.RecordDataset[rounds.Touch], Generic[R]):
    """All touches of some rounds, or a selection of them; a view that copies nothing.

    ``touches[i]`` gives a :class:`Touch`; a slice, ints or a boolean mask give a view. Filters give views too
    and read only the columns that they need. :meth:`split` divides touches, so parts share rounds and
    objects; to avoid that, divide the rounds, or use :attr:`object_ids`.

    Parameters
    ----------
    dataset : TouchDataset
        The rounds.
    chosen : ndarray of int64, optional
        Which touches, counted through all rounds of the data set; all by default.
    """

    things = "touches"

    def __init__(self, dataset: TouchDataset[R], chosen: Int64 | None = None) -> None:
        self.dataset = dataset
        counts = dataset.touch_counts
        self._starts = np.concatenate([[0], np.cumsum(counts)])
        rows: range | Int64 = chosen if chosen is not None else range(int(self._starts[-1]))
        super().__init__(dataset.table, rows, dataset.label_names)
        # Rounds of one length, the common case, are found by a division.
        self._per_round = 0
        if len(set(counts.tolist())) == 1:
            self._per_round = int(counts[0])

    def __iter__(self) -> Iterator[rounds.Touch]:
        last, current = -1, None
        for flat in self._rows:
            position, touch = self._located(int(flat))
            # Neighbours share a round, whose columns are then resolved once.
            if position != last or current is None:
                last = position
                current = self.dataset[position]
            yield rounds.Touch(current, touch)

    def locate(self, index: int) -> tuple[int, int]:
        """Return the number of a touch's round in the data set, and its own in the round.

        Raises
        ------
        IndexError
            The data set has no touch of that index.
        """
        return self._located(self._row_number(index))

    def _located(self, flat: int) -> tuple[int, int]:
        if self._per_round:
            return divmod(flat, self._per_round)
        position = int(np.searchsorted(self._starts, flat, side="right")) - 1
        return position, flat - int(self._starts[position])

    @property
    def round_positions(self) -> Int64:
        """Number of the round of each touch in the data set, shape (len,), int64."""
        return np.searchsorted(self._starts, self.row_numbers, side="right") - 1

    @property
    def touch_indices(self) -> Int64:
        """Number of each touch in its round, shape (len,), int64."""
        indices: Int64 = self.row_numbers - self._starts[self.round_positions]
        return indices

    @property
    def _stored_numbers(self) -> Int64:
        rows = self.dataset.row_numbers[self.round_positions]
        numbers: Int64 = stored_values.starts(self.table)[rows] + self.touch_indices
        return numbers

    @property
    def _stored_starts(self) -> Int64:
        return stored_values.starts(self.table)[self.table.part_starts]

    @property
    def labels(self) -> Int64:
        """Label of each touch, shape (len,), int64, -1 without labels; reads the label column only."""
        return self.dataset.labels[self.round_positions]

    def int_column(self, name: str) -> Int64:
        """Read one column of integers of the rounds, shape (len,), int64."""
        return self.dataset.int_column(name)[self.round_positions]

    @property
    def ids(self) -> AnyArray:
        """Id of each touch, as :attr:`Touch.id`, shape (len,); reads the ids of the rounds only."""
        pairs = zip(self.dataset.ids[self.round_positions].tolist(), self.touch_indices.tolist(), strict=True)
        return np.array([rounds.touch_id(*pair) for pair in pairs], object)

    @property
    def column_names(self) -> tuple[str, ...]:
        """Stored columns of the rounds, and ``touch_index``: those of :meth:`to_hf`."""
        return (*self.dataset.column_names, rounds.INDEX)

    @property
    def plain_columns(self) -> tuple[str, ...]:
        """Columns of numbers and texts: those of the rounds, the place in the round, and positions."""
        names = (*self.dataset.plain_columns, rounds.INDEX)
        if self.dataset.has_column("pos_in_cell"):
            names += _POSITION
        return names

    def column(self, name: str) -> AnyArray:
        """Read one plain column, shape (len,): one of the rounds, ``touch_index``, or ``x_m`` or ``y_m``.

        The last two are the intended position, metres, cell frame, NaN where none can be read.

        Raises
        ------
        InputError
            The data set has no column of that name.
        """
        if name == rounds.INDEX:
            return self.touch_indices
        if name in _POSITION:
            of_view: AnyArray = stored_values.positions_m(self.table)[self._stored_numbers]
            return of_view[:, _POSITION.index(name)]
        return self.dataset.column(name)[self.round_positions]

    def to_hf(self) -> Dataset:
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
        positions = self.round_positions
        # Without touches, the first round defines the columns.
        chosen = np.unique(positions).tolist() or list(range(min(1, len(self.dataset))))
        rows = [self.dataset[position].row for position in chosen]
        # The library's own fingerprint would be that of all bytes.
        content = repr([self.dataset.identity, chosen, positions.tobytes(), self.row_numbers.tobytes()])
        return rounds.hf_touches(rows, np.searchsorted(chosen, positions), self.touch_indices, content)

    @property
    def object_ids(self) -> Int64:
        """Object of each touch, shape (len,), int64; reads that column only."""
        return self.int_column("object_id")

    def heights_m(self, recalibrate_z: bool = True) -> Float64:
        """Return the height above the plate at which the gel stopped in each touch, shape (len,), metres.

        Reads the poses only; see :func:`realtouch.contact.contact_heights_m`. All touches of a round take
        part in finding its plate, whatever was selected here. Where `tactile select` took touches out of
        the files, the stored height of the plate is taken. The plate of touches made by `tactile-sim
        generate` is known and always taken.

        Raises
        ------
        IntegrityError
            The height of a touch of this view cannot be read; names file, row and touch.
        """
        heights_m = stored_values.heights_m(self.table, recalibrate_z)
        return self._chosen_values(heights_m, stored_round.StoredRound.contact_z_m)

    def _chosen_values(
        self, values: Float64, reread: Callable[[stored_round.StoredRound, int], AnyArray]
    ) -> Float64:
        """Return the values of these touches, given those of all; one that is NaN is read again."""
        chosen: Float64 = values[self._stored_numbers]
        unknown = np.isnan(chosen)
        if unknown.any():
            position, touch = self.locate(int(np.argmax(unknown)))
            reread(self.dataset[position].row, touch)  # states what is wrong
        return chosen

    def with_contact(self, min_height_m: float | None = None, recalibrate_z: bool = True) -> Touches[R]:
        """Return the touches with contact; see :meth:`in_contact`."""
        return self[self.in_contact(min_height_m, recalibrate_z)]

    def in_contact(self, min_height_m: float | None = None, recalibrate_z: bool = True) -> Bool:
        """Return whether the sensor met an object in each touch, shape (len,).

        How this is known depends on the set. Of published touches, the gel stopped at least 6 mm above the
        plate, as in the publisher's own viewer; of touches that `tactile-sim generate` made, at any height
        above it. An imported set may have a column ``in_contact``. Of all others the pictures decide, by the
        rule of :func:`realtouch.contacts_by_image`, which decodes all of them.

        Parameters
        ----------
        min_height_m : float, optional
            Height above the plate from which a touch counts, metres; then heights decide in any set that has
            poses.
        recalibrate_z : bool
            Take the deepest touch of each round as the plate, where its height is not known: the zero of z
            drifts by up to 3 mm in the published sets.

        Raises
        ------
        InputError
            The height is not a finite number, the set has no poses for it, or ``recalibrate_z=False`` is
            given where heights do not decide.
        IntegrityError
            As :meth:`heights_m`.
        """
        if min_height_m is not None:
            least_m = touch.HeightRule.checked_m(min_height_m)
            stored_schemas = self.dataset.table.schemas
            if not all(schema.has_poses(read.column_types(stored)) for stored in stored_schemas):
                raise errors.InputError(
                    f"{', '.join(self.dataset.description())}: no column {schema.POSITION_COLUMNS[0]!r} in "
                    "all of its files, which has the heights of the gel",
                    next="leave out the height",
                )
            return self.heights_m(recalibrate_z) >= least_m
        sources = self.dataset.contact_sources()
        if not recalibrate_z and not all(source.heights for source in sources):
            raise errors.InputError(
                f"{', '.join(self.dataset.description())}: heights do not decide about contact; a touch has "
                f"it if {'; or '.join(map(str, dict.fromkeys(sources)))}",
                next="leave out recalibrate_z, or give a height if there are poses",
            )
        positions = self.round_positions
        contact = np.zeros(len(self), bool)
        for source in dict.fromkeys(sources):
            is_of_source = np.array([source == of_round for of_round in sources], bool)[positions]
            contact[is_of_source] = self[is_of_source]._contact_by(source, recalibrate_z)
        return contact

    def _contact_by(self, source: schema.ContactSource, recalibrate_z: bool) -> Bool:
        """Return whether there is contact in each touch, shape (len,), all of sets that state it this way."""
        if source.has_column:
            stated = stored_values.stated_contact(self.table)
            return self._chosen_values(stated, stored_round.StoredRound.stated_contact) > 0
        if source.heights is not None:
            return np.asarray(self.heights_m(recalibrate_z) >= source.heights.min_height_m)
        by_pictures: Bool = _contacts_by_image(self, threads=run.usable_cores()).contact
        return by_pictures

    def objects(self, *object_ids: int | Iterable[int]) -> Touches[R]:
        """Return the touches of some objects, by ``object_id``, given as numbers or as sequences of them.

        Raises
        ------
        InputError
            Something else than integers is given.
        """
        numbers = list(map(checked_fields.to_builtin, self._flattened(object_ids)))
        if not checked_fields.is_integer(*numbers):
            raise errors.InputError(f"{object_ids!r} was given; expected object ids as integers")
        ids = self.object_ids
        return self[np.isin(ids, sorted(set(numbers) & set(ids.tolist())))]

    def sample(
        self,
        n: int | None = None,
        seed: int = 0,
        *,
        no_contact_fraction: float | None = None,
        contact: Bool | None = None,
    ) -> Self:
        """Return touches drawn at random without repetition, or those with contact and a share of the rest.

        Parameters
        ----------
        n : int, optional
            How many; with ``no_contact_fraction`` all that there are by default.
        seed : int
            From 0.
        no_contact_fraction : float, optional
            Fraction of touches without contact in the result, 0 to below 1; less if there are too few. Which
            ones follows from the seed, the id of the round and the touch's number alone, whatever else is
            selected and in whatever order. They stay where they are among the others.
        contact : ndarray of bool, shape (len,), optional
            Which touches have contact; by default those that :meth:`with_contact` keeps. See also
            :func:`realtouch.contacts_by_image`.

        Raises
        ------
        InputError
            There are fewer touches, or a number, fraction or mask is invalid.
        """
        chosen = self
        if no_contact_fraction is not None:
            if contact is None:
                contact = self.in_contact()
            chosen = self._select(_with_no_contact(self, contact, no_contact_fraction, seed))
            if n is None:
                return chosen
        if n is None:
            n = len(self)
        return super(Touches, chosen).sample(n, seed)

    def images(self, index: object = slice(None), *, threads: int = 1, out: UInt8 | None = None) -> UInt8:
        """Decode the images of several touches of a ``single`` set into one array.

        Parameters
        ----------
        index : slice, sequence of int, or boolean mask
            Which touches, in any order.
        threads : int
            Number of images to decode at a time.
        out : ndarray, shape (n, H, W, 3), uint8, optional
            Array to write to.

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
        located = [self._located(int(flat)) for flat in self._chosen(index)._rows]
        size = (0, 0)
        if located or (len(self.dataset) and self.dataset[0].touch_count):
            first, number = [*located, (0, 0)][0]
            size = self._images_of(first).size(number)
        if out is None:
            out = np.empty((len(located), *size, 3), np.uint8)
        else:
            out = media.images_array(len(located), size, out)
        start = 0
        for position, of_round in groupby(located, key=lambda pair: pair[0]):
            touches = [touch for _, touch in of_round]
            stop = start + len(touches)
            self._images_of(position).decode_into(out[start:stop], touches, threads=threads)
            start = stop
        return out

    def _images_of(self, position: int) -> media.SensorImages:
        record = self.dataset[position]
        if not isinstance(record, rounds.TouchSingleRound):
            raise record.row.missing_column("sensor_image")
        return record.sensor_image

    def _stored(self, row: int) -> rounds.Touch:
        position, touch = self._located(row)
        return rounds.Touch(self.dataset[position], touch)

    def _concat(self, other: Self) -> Self:
        if self.dataset is other.dataset:
            return self._view(np.concatenate([self.row_numbers, other.row_numbers]))
        moved = other.row_numbers + self._starts[-1]
        return type(self)(self.dataset + other.dataset, np.concatenate([self.row_numbers, moved]))

    @property
    def identity(self) -> str:
        """Identifies these touches; differs if the files change."""
        row_digest = hashlib.sha256(self.dataset.row_numbers.tobytes()).hexdigest()
        return f"{self.dataset.identity} {row_digest}"

    def each_record(self) -> Iterator[tuple[int, rounds.Touch]]:
        """Yield position and touch, in the fastest order; images and clips are not read."""
        touches = self.touch_indices.tolist()
        by_round: dict[int, list[int]] = {}
        for index, position in enumerate(self.round_positions.tolist()):
            by_round.setdefault(position, []).append(index)
        for position, record in self.dataset.each_record():
            for index in by_round.get(position, ()):
                yield index, rounds.Touch(record, touches[index])

    def row_groups(self, chosen: Int64) -> list[tuple[read.RowSource, int]]:
        """Return the row groups of touches at positions (n,), each once."""
        return self.dataset.row_groups(np.unique(self.round_positions[chosen]))

    def description(self) -> list[str]:
        """Return a description of the data set and its origin."""
        of_rounds, *further = self.dataset.description()
        return [f"{wording.with_count(len(self), self.things)} of {of_rounds}", *further]


AnyTouches = Touches[Any]
"""Touches of rounds of either kind."""


class _RowsWithoutMedia(read.RowGroup):
    """A block of rows without images or clips, which are read on first use.

    ``number`` is the number of the first row in the source.
    """

    def __init__(self, block: read.RowGroup, source: read.RowSource, number: int) -> None:
        super().__init__(path=block.path, first_row=block.first_row)
        self._block = block
        self._source = source
        self._number = number

    @cached_property
    def table(self) -> pa.Table:
        """The rows with all columns; reads the whole block."""
        return self._source.locate(self._number)[0].table

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name, including those not read yet."""
        return read.column_names(self._source.schema)

    def arrow(self, name: str) -> pa.Array:
        """Return a column; reads the complete rows if it was left out."""
        try:
            return self._block.arrow(name)
        except KeyError:
            return super().arrow(name)
