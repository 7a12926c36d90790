"""Data sets of touches by name: one split to read, the files of all splits, and figures of a split.

Figures are also compared with those of the Tactile MNIST paper.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import accumulate, chain, pairwise
from operator import itemgetter
from typing import Literal, overload

import numpy as np
import pyarrow as pa

from realtouch import contact, kind
from realtouch.touches import damage, datasets, schema
from realtouch.touches.schema import ContactSource
from tactile_toolkit import errors, places, read, run, store, wording
from tactile_toolkit.touch import CELL_M

_NAMES_SHOWN = 12
_READERS = 4  # threads that read footers
_IMAGES_PER_MEDIA: dict[schema.Kind, int] = {"seq": 64, "single": 1}  # by size: clips are a few dozen images

SHORT_NAMES = {
    name: entry.repo_id.partition("/")[2]
    for entry in kind.KIND.published
    for name in (entry.name, *entry.aliases)
}
"""Short name to the name of the published repository, without its owner."""
# Tactile MNIST paper, section on the real data set: 600 printed digits, 256 touches each, two gels.
_ROUNDS = {"train": 500, "test": 100}
_CLASSES = {"train": "10 of 50 rounds", "test": "10 of 10 rounds"}
_TOUCHES_OF_A_GEL = 76_800
_PICTURES = "320 x 240 or 64 x 64 pixels"
_SIZES = ((320, 240), (64, 64))


@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: Literal[False] = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> datasets.LoadedDataset: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    streaming: Literal[True],
    revision: str | None = None,
    config: str | None = None,
) -> datasets.TouchStream: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> datasets.LoadedDataset | datasets.TouchStream: ...
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> datasets.LoadedDataset | datasets.TouchStream:
    """Open a data set of real touches.

    Parameters
    ----------
    name : str, path, or sequence of them
        A short name (see :data:`realtouch.SHORT_NAMES`), any repository of the Hub
        (``USER/NAME[@REVISION]``, ``hf://datasets/USER/NAME[@REVISION]/PATH``), a local folder, a Parquet
        file, or several that belong together. Local data of the same name comes first.
    split : str, optional
        Split to open; only its shards are fetched. May be left out where there is only one.
    streaming : bool
        Return an iterable that reads one shard after another and stores nothing.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    config : str, optional
        Configuration, of a data set whose card has several.

    Returns
    -------
    TouchSeqDataset, TouchSingleDataset, TouchMixedDataset or TouchStream; rows are read on access

    Raises
    ------
    InputError
        No such folder or split, several splits and none named, or no data set of touches.
    IntegrityError
        A file is damaged, a column has a wrong type, or files hold clips and images, or other
        classes.
    HubError
        The repository cannot be reached or does not exist.
    """
    data_set = places.open_place(name, revision=revision, config=config)
    files = agreeing_files(data_set.shards(split, kind=kind.KIND, streaming=streaming), data_set.name)
    if streaming:
        return datasets.TouchStream(tuple(files))
    return datasets.dataset_of(files)


def agreeing_files(
    shards: Iterable[read.Shard], name: str, left_out: list[damage.Damage] | None = None
) -> list[read.Shard]:
    """Return the files of a data set that can be read and agree with the first of them.

    The damage of the other files is added to ``left_out``. Without such a list it is raised: InputError for a
    file without touches, IntegrityError for a file that is damaged or differs.
    """
    files: list[read.Shard] = []
    for shard in shards:
        try:
            if not files:
                schema.media_kind(shard.schema, name)
            schema.require_types(shard)
            if files:
                _require_agreement(shard, files)
            files.append(shard)
        except (errors.InputError, errors.IntegrityError) as error:
            if left_out is None or (isinstance(error, errors.InputError) and not files):
                raise
            left_out.append(damage.unreadable_file(shard.path, error))
    return files


def _require_agreement(shard: read.Shard, files: Sequence[read.Shard]) -> None:
    """Refuse a file of another kind, or with other classes, than those before it; IntegrityError.

    Merged files may be of both kinds.
    """
    first = schema.media_kind(files[0].schema, files[0].path)
    is_merged = shard.absent_columns is not None
    if schema.media_kind(shard.schema, shard.path) != first and not is_merged:
        raise errors.IntegrityError(
            f"{shard.path!r}, field {schema.MEDIA_COLUMN[first]!r}: the column is not there; expected it as "
            f"in {files[0].path!r}",
            next="open files of one data set together",
        )
    names = shard.class_names
    expected = schema.stated_class_names(files)
    if names is not None and expected is not None and names != expected:
        own_names, first_names = (", ".join(some[:_NAMES_SHOWN]) for some in (names, expected))
        raise errors.IntegrityError(
            f"{shard.path!r}, field 'label': the classes are named {own_names}; expected {first_names} "
            "as in the files before it",
            next="open them apart, or make them again",
        )


def parts_of(data_set: places.Place, split: str | None) -> tuple[str, ...]:
    """Return the named split, or all splits."""
    return data_set.splits if split is None else (split,)


@dataclass(frozen=True)
class Source:
    """A data set to convert, and the shards of each split."""

    place: places.Place
    shards: Mapping[str, tuple[read.Shard, ...]]

    @property
    def name(self) -> str:
        """Name of the data set, as the user gave it."""
        return self.place.name

    @classmethod
    def open(cls, name: places.Name | places.Place, split: str | None = None) -> Source:
        """Find the splits of a data set (or the one given), fetching them first where they are on the Hub.

        Reads footers. Raises as :func:`realtouch.load`.
        """
        data_set = places.open_place(name).require_complete(split)
        splits = parts_of(data_set, split)
        shards = {part: data_set.shards(part, kind=kind.KIND) for part in splits}
        for files in shards.values():
            deque(run.in_threads(schema.require_types, files, _READERS), maxlen=0)
        return cls(data_set, shards)

    @property
    def kind(self) -> schema.Kind:
        """Whether the touches have clips or images; InputError for both, as in a merged set."""
        kinds = {datasets.dataset_of(files).kind for files in self.shards.values()}
        media = kinds.pop()
        if kinds or media == "mixed":
            raise errors.InputError(
                f"{self.name!r} holds clips and images; expected only one of them",
                next="convert the data sets before they are merged",
            )
        return media

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    @property
    def flat_schema(self) -> pa.Schema:
        """The schema with the fields of structs as columns of their own."""
        return next(iter(self.shards.values()))[0].flat_schema

    @property
    def contact_sources(self) -> list[ContactSource]:
        """How contact of the touches is known; merged sets may differ."""
        return ContactSource.of_files(read.ShardedTable(tuple(self._files())).schemas)

    @property
    def class_names(self) -> tuple[str, ...]:
        """Name of each class; empty without labels."""
        return schema.class_names_of(self._files())

    def require_frame(self, method: contact.ContactMethod) -> None:
        """Raise InputError unless the frames of clips can be chosen by a method."""
        schema.require_poses_for(method, read.column_types(self.schema), self.name)

    def manifest(self) -> store.Manifest | None:
        """Return the manifest next to the shards, if any."""
        return next(iter(self.shards.values()))[0].manifest()

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set; at least 1."""
        chunks = chain.from_iterable(run.in_threads(read.Shard.column_chunks, self._files(), _READERS))
        size: int = sum(chunk.total_uncompressed_size for chunk in chunks)
        return max(size // max(sum(map(len, self._files())), 1), 1)

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        sizes = run.in_threads(
            partial(_media_bytes, tuple(f"{name}." for name in schema.MEDIA_COLUMN.values())),
            self._files(),
            _READERS,
        )
        count, size = map(sum, zip(*sizes, strict=True))
        return max(size // max(count, 1), 1)

    def image_bytes(self) -> int:
        """Return the approximate size of an image, or of a frame of a clip; at least 1."""
        return self.media_bytes() // _IMAGES_PER_MEDIA[self.kind] or 1

    def _files(self) -> Iterator[read.Shard]:
        return chain.from_iterable(self.shards.values())

    def fingerprint(self) -> dict[str, list[dict[str, str | int]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files.

        The footer holds offset and size of every column chunk: other content gives another footer, and
        reading 28 GB to plan a conversion would cost minutes.
        """
        return {
            split: list(run.in_threads(read.Shard.fingerprint, files, _READERS))
            for split, files in self.shards.items()
        }


def _media_bytes(columns: tuple[str, ...], shard: read.Shard) -> tuple[int, int]:
    """Return the number of values of columns of bytes, and their size unpacked."""
    chosen = [chunk for chunk in shard.column_chunks() if chunk.path_in_schema.startswith(columns)]
    values = sum(chunk.num_values for chunk in chosen if chunk.path_in_schema.endswith(".bytes"))
    return values, sum(chunk.total_uncompressed_size for chunk in chosen)


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Figures of one split.

    Attributes
    ----------
    kind : str
        ``"seq"`` or ``"single"``.
    rounds, touches, objects : int
        How many; 0 objects if they are unknown.
    touches_per_round : tuple of int
        Least and most.
    contact_share : float or None
        Fraction of touches with contact; None if their pictures decide, as all would have to be decoded.
    contact_rule : str
        By what a touch counts as contact: a height above the plate, a column, or its picture.
    labels : dict of str to int
        Rounds of each class.
    image_size : tuple of int
        Width and height of the first image or frame, pixels.
    clip_frames : tuple of int, or None
        Minimum, median and maximum number of frames of a clip; None for images.
    fps : float or None
        Frames per second of the first clip.
    gel_ids : dict of str to int
        Rounds of each gel; empty if it is unknown.
    extra : dict of str to str
        Type of each further column.
    """

    kind: str
    rounds: int
    touches: int
    objects: int = 0
    touches_per_round: tuple[int, int]
    contact_share: float | None = None
    contact_rule: str | None = None
    labels: dict[str, int] = field(default_factory=dict)
    image_size: tuple[int, int]
    clip_frames: tuple[int, int, int] | None = None
    fps: float | None = None
    gel_ids: dict[str, int] = field(default_factory=dict)
    extra: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Return JSON values."""
        return asdict(self)

    def table(self) -> list[tuple[str, str]]:
        """Return names and values for people."""
        width, height = self.image_size
        contact = f"not counted ({self.contact_rule})"
        if self.contact_share is not None:
            contact = f"{self.contact_share:.1%} ({self.contact_rule})"
        gels = ", ".join(f"{gel}: {wording.with_count(n, 'rounds')}" for gel, n in self.gel_ids.items())
        per_round = "-".join(map(str, dict.fromkeys(self.touches_per_round)))
        rows = [
            ("rounds", f"{self.rounds:,}"),
            ("touches", f"{self.touches:,} ({per_round} per round)"),
            ("objects", f"{self.objects:,}" if self.objects else "unknown"),
            ("with contact", contact),
            ("labels", ", ".join(f"{name}: {count}" for name, count in self.labels.items()) or "none"),
            ("picture", f"{width} x {height} pixels"),
            ("gels", gels or "unknown"),
            *((f"extra {name}", type_text) for name, type_text in self.extra.items()),
        ]
        if self.clip_frames is not None:
            least, median, most = self.clip_frames
            rows.append(("clips", f"{least} to {most} frames, median {median}, {self.fps:g} per second"))
        return rows


def summarise(dataset: datasets.AnyDataset) -> Summary:
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
        raise errors.InputError("an empty data set has no summary", next="choose other filters")
    counts = np.bincount(touches.round_positions, minlength=len(dataset))
    first = touches[0]
    summary = Summary(
        kind=dataset.kind,
        rounds=len(dataset),
        touches=int(counts.sum()),
        touches_per_round=(int(counts.min()), int(counts.max())),
        contact_rule="; or ".join(map(str, dict.fromkeys(dataset.contact_sources()))),
        extra=_extra_types(dataset),
        image_size=first.round.picture_size(first.touch_index),
    )
    if dataset.kind == "seq":
        summary = replace(summary, clip_frames=_clip_frames(touches), fps=first.clip.fps)
    if dataset.has_column("label"):
        summary = replace(summary, labels={name: len(rows) for name, rows in dataset.by_label().items()})
    if dataset.has_column("object_id"):
        summary = replace(summary, objects=len(np.unique(dataset.int_column("object_id"))))
    if all(source.is_stored for source in dataset.contact_sources()):
        summary = replace(summary, contact_share=float(touches.in_contact().mean()))
    if dataset.has_column("info.gel_id"):
        # Through all rounds, without their pictures: the gel is not a plain column.
        gels = Counter(str(record.info["gel_id"]) for _, record in dataset.rounds_without_media())
        summary = replace(summary, gel_ids=dict(sorted(gels.items())))
    return summary


def summarise_splits(name: places.Name | places.Place, split: str | None = None) -> dict[str, Summary]:
    """Return the figures of the named split, or of all splits; raises as :func:`summarise`."""
    source = Source.open(name, split)
    return {part: summarise(datasets.dataset_of(shards)) for part, shards in source.shards.items()}


def _extra_types(dataset: datasets.AnyDataset) -> dict[str, str]:
    types = read.column_types(dataset.table.schemas[0])
    columns = schema.extra_columns(dataset.column_names)
    return {name: schema.extra_type_text(stored, types[stored]) for name, stored in columns.items()}


def _clip_frames(touches: datasets.AnyTouches) -> tuple[int, int, int]:
    """Return the least, the median and the largest number of frames of a clip."""
    dataset = touches.dataset
    rows = dataset.row_numbers[touches.round_positions].tolist()
    shown = set(zip(rows, touches.touch_indices.tolist(), strict=True))
    lengths = [
        record.row.clip_length(touch)
        for row, record in dataset.rounds_without_media()
        for touch in range(record.touch_count)
        if (row, touch) in shown
    ]
    return min(lengths), int(np.median(lengths)), max(lengths)


@dataclass(frozen=True, slots=True)
class PaperNumber:
    """One statement of the paper, and the value in the data.

    Attributes
    ----------
    what : str
        Name of the quantity.
    paper, found : str
        As the paper states it, and as it is in the data.
    agrees : bool
        Whether they are the same.
    """

    what: str
    paper: str
    found: str
    agrees: bool

    def to_dict(self) -> dict[str, object]:
        """Return JSON values."""
        return asdict(self)


def paper_numbers(splits: Mapping[str, datasets.AnyDataset]) -> list[PaperNumber]:
    """Measure what the paper states about real touches; reads one picture only.

    Parameters
    ----------
    splits : mapping of str to TouchDataset
        The splits of one set.

    Returns
    -------
    list of PaperNumber
        In the order of the paper.

    Raises
    ------
    InputError
        The set is empty, or has no labels, objects or positions.
    IntegrityError
        What is read is damaged.
    """
    rounds = _rounds_in_order(splits)
    _, counts, gels, reaches_m = zip(*rounds, strict=True)
    objects = [set(data.int_column("object_id").tolist()) for data in splits.values()]
    different = len(set().union(*objects))
    labels: dict[str, list[int]] = {split: [] for split in _ROUNDS}
    labels |= {split: data.labels.tolist() for split, data in splits.items()}
    size = next(data[0] for data in splits.values() if len(data)).picture_size(0)
    replaced, ends = _gel_replacements(gels, counts)
    reach = f"at most {1e3 * max(reaches_m):.1f} mm from the middle"
    counted = [
        ("rounds", "600", f"{len(rounds):,}"),
        ("touches", "153,600", f"{sum(counts):,}"),
        ("touches of a round", "256", ", ".join(map(str, sorted(set(counts))))),
        *((f"rounds in {split}", f"{count}", f"{len(labels[split]):,}") for split, count in _ROUNDS.items()),
        *((f"classes in {split}", _CLASSES[split], _class_text(labels[split])) for split in _ROUNDS),
        ("objects", "600", f"{different:,}"),
        ("objects in two splits", "none", "some" if sum(map(len, objects)) > different else "none"),
    ]
    once = f"{_TOUCHES_OF_A_GEL:,} touches, once"
    return [
        *(PaperNumber(what, paper, found, paper == found) for what, paper, found in counted),
        PaperNumber("intended positions", "within 12 x 12 cm", reach, max(reaches_m) <= CELL_M[0] / 2),
        PaperNumber("gel replaced after", once, replaced, ends == [_TOUCHES_OF_A_GEL]),
        PaperNumber("picture", _PICTURES, f"{size[0]} x {size[1]} pixels", size in _SIZES),
    ]


def _rounds_in_order(
    splits: Mapping[str, datasets.AnyDataset],
) -> list[tuple[str, int, object, float]]:
    """Return id, touches, gel and greatest distance from the middle, metres, of each round.

    Ids begin with the time of recording, so that their order is that of the gels. InputError without rounds.
    """
    rounds = [
        (
            str(record.id),
            record.touch_count,
            dict(record.info).get("gel_id"),
            float(np.abs(record.pos_in_cell_m).max(initial=0.0)),
        )
        for data in splits.values()
        for _, record in data.rounds_without_media()
    ]
    if not rounds:
        raise errors.InputError(
            "the set holds no rounds", next="name one that does, such as real-single-64x64"
        )
    return sorted(rounds, key=itemgetter(0))


def _class_text(labels: Sequence[int]) -> str:
    counts = Counter(labels)
    return f"{len(counts)} of {' or '.join(map(str, sorted(set(counts.values())))) or 'no'} rounds"


def _gel_replacements(gels: Sequence[object], counts: Sequence[int]) -> tuple[str, list[int]]:
    """Return after how many touches the gel was replaced; rounds are in the order of recording."""
    if any(gel is None for gel in gels):
        return "not stated", []
    done = accumulate(counts)
    ends = [end for end, (before, after) in zip(done, pairwise(gels), strict=False) if before != after]
    return f"{' and '.join(f'{end:,}' for end in ends) or 'never'} of {sum(counts):,}", ends
