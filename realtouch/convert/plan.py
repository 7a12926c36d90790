"""What all conversions share: the rows, the tasks, and the finished folder.

A conversion is planned from footers and small columns alone; each task reads its own rows, block by block,
and makes one shard. See :mod:`tactile_toolkit.store.build` for resuming and byte-identical results.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Protocol

from realtouch.kind import KIND
from realtouch.names import repository_of
from realtouch.opening import open_shards
from tactile_toolkit.catalog.locate import splits_of
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.plan import BuildPlan, ShardContent
from tactile_toolkit.store.shards import ShardName, ShardRecord, Skipped
from tactile_toolkit.touch.rows import with_features
from tactile_toolkit.touch.schema import Kind, class_names, kind_of, require_types

__all__ = ["Conversion", "RowChoice", "Source", "Step", "convert", "plan_conversion", "refuse_source"]


@dataclass(frozen=True)
class Source:
    """A data set to convert.

    Attributes
    ----------
    name : str
        Folder, file, short name or Hub repository, as the user gave it.
    shards : mapping of str to tuple of Shard
        Shards of each split.
    kind : "seq" or "single"
        What it holds.
    """

    name: str
    shards: Mapping[str, tuple[Shard, ...]]
    kind: Kind

    @classmethod
    def open(cls, name: str | PathLike[str], revision: str | None = None, split: str | None = None) -> Source:
        """Find the splits of a data set, fetching them first where they are on the Hub; read their footers.

        Parameters
        ----------
        name : str or path
            Folder, file, short name or Hub repository.
        revision : str, optional
            Branch, tag or commit of a Hub repository.
        split : str, optional
            Only this split, of which alone files are fetched; all by default.

        Raises
        ------
        InputError, IntegrityError, HubError
            As :func:`realtouch.load`.
        """
        name = fspath(name)
        splits = (split,) if split is not None else splits_of(repository_of(name), revision=revision)
        shards = {each: open_shards(name, each, revision=revision) for each in splits}
        for shard in (shard for found in shards.values() for shard in found):
            require_types(shard.schema, shard.path)
        return cls(name, shards, kind_of(shards[splits[0]][0].schema, name))

    @property
    def schema(self) -> Any:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return class_names(self.schema)

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set."""
        shards = [shard for found in self.shards.values() for shard in found]
        groups = [
            shard.metadata.row_group(index)
            for shard in shards
            for index in range(shard.metadata.num_row_groups)
        ]
        rows = sum(group.num_rows for group in groups)
        return int(sum(group.total_byte_size for group in groups) // max(rows, 1))

    def fingerprint(self) -> dict[str, list[dict[str, Any]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files."""
        return {split: [_file_fingerprint(shard) for shard in found] for split, found in self.shards.items()}


def _file_fingerprint(shard: Shard) -> dict[str, Any]:
    # The footer holds place and size of every column chunk: other content gives another footer, and reading
    # 28 GB to plan a conversion would cost minutes.
    with Path(shard.path).open("rb") as stream:
        stream.seek(-8, 2)
        footer_bytes = int.from_bytes(stream.read(4), "little")
        stream.seek(-8 - footer_bytes, 2)
        footer = stream.read(footer_bytes)
    size = Path(shard.path).stat().st_size
    return {
        "file": Path(shard.path).name,
        "rows": len(shard),
        "bytes": size,
        "footer_sha256": hashlib.sha256(footer).hexdigest(),
    }


def refuse_source(folder: DataFolder, source: Source) -> None:
    """Refuse to write where the source is read, be it by another name or through a link.

    Raises
    ------
    InputError
        The folder holds a file of the source, or lies in its folder.
    """
    if not folder.is_local:
        return
    out = Path(folder.address()).resolve()
    home = Path(source.name).expanduser().resolve()
    files = [Path(shard.path).absolute() for shards in source.shards.values() for shard in shards]
    real = [file.resolve() for file in files]
    if _any_below(out, real):
        found = "holds the source"
    elif home.is_dir() and out.is_relative_to(home) and _any_below(home, [*real, *files]):
        found = "lies in the source"
    else:
        return
    message = (
        f"{folder.address()!r}, the folder to write, {found} {source.name!r}; nothing was changed; next: "
        "choose a folder outside it"
    )
    raise InputError(message)


def _any_below(folder: Path, files: Sequence[Path]) -> bool:
    return any(file.is_relative_to(folder) for file in files)


_SHARD_BYTES = 256 << 20
_GROUP_BYTES = 32 << 20
_MOST_ROWS_PER_SHARD = 64


@dataclass(frozen=True, slots=True)
class RowChoice:
    """A row that a conversion takes: its number in the split, and which touches (None: all)."""

    row: int
    touches: tuple[int, ...] | None = None


class Step(Protocol):
    """What a conversion does to one row; small and picklable."""

    def schema(self, source: Any) -> Any:
        """Return the flat schema that it writes, for the flat schema that it reads."""
        ...

    def apply(self, row: Row, choice: RowChoice, split: str) -> Any:
        """Return the new rows as a table of that schema.

        Raises
        ------
        IntegrityError, ItemError
            The row cannot be used; it is left out and listed.
        """
        ...


@dataclass(frozen=True)
class Conversion:
    """A conversion, decided down to its rows.

    Attributes
    ----------
    source : Source
        What is read.
    operation : str
        Its name.
    options : mapping
        Its options as JSON values.
    step : Step
        What is done to a row.
    choices : mapping of str to sequence of RowChoice
        Rows of each split, in order.
    rows_per_shard, rows_per_group : int or None
        Layout; by the size of the source's rows where None.
    extra_dirs : tuple of str
        What the step writes beside the rows; see :class:`tactile_toolkit.store.plan.BuildPlan`.
    extras_intact : callable
        Tells whether what the step wrote there for a finished shard is still whole.
    """

    source: Source
    operation: str
    options: Mapping[str, Any]
    step: Step
    choices: Mapping[str, Sequence[RowChoice]]
    rows_per_shard: int | None = None
    rows_per_group: int | None = None
    extra_dirs: tuple[str, ...] = ()
    extras_intact: Callable[[ShardRecord], bool] = field(default=lambda _: True, repr=False)


@dataclass(frozen=True)
class _ConvertShard:
    """Picklable: make one shard of a conversion."""

    shard: ShardName
    paths: tuple[str, ...] = field(repr=False)
    choices: tuple[RowChoice, ...] = field(repr=False)
    step: Step = field(repr=False)
    schema: Any = field(repr=False)

    @property
    def size(self) -> int:
        """How many rows it works on."""
        return len(self.choices)

    def make(self) -> ShardContent:
        """Convert the rows; damaged ones are left out and listed."""
        import pyarrow as pa

        tables, skipped = [self.schema.empty_table()], []
        for choice, row in _chosen_rows(self.paths, self.choices):
            try:
                tables.append(self.step.apply(row, choice, self.shard.split).cast(self.schema))
            except IntegrityError as error:
                skipped.append(Skipped(choice.row, "damaged", str(error)))
            except ItemError as error:
                skipped.append(Skipped(choice.row, error.reason, error.message))
        return ShardContent(pa.concat_tables(tables).combine_chunks(), tuple(skipped))


def _chosen_rows(paths: Sequence[str], choices: Sequence[RowChoice]) -> Iterator[tuple[RowChoice, Row]]:
    """Read the blocks that hold chosen rows, one at a time, in order."""
    wanted = {choice.row: choice for choice in choices}
    first, last = min(wanted), max(wanted)
    start = 0
    for shard in map(Shard, paths):
        for index, group_start in enumerate(shard.group_starts[:-1]):
            begin, end = start + group_start, start + shard.group_starts[index + 1]
            if end <= first or begin > last:
                continue
            for group in shard.blocks(index):
                for place in range(len(group.table)):
                    number = start + group.first_row + place
                    if number in wanted:
                        yield wanted[number], Row(group, place)
        start += len(shard)


def plan_conversion(conversion: Conversion) -> BuildPlan:
    """Decide which shards hold which rows; pure, reads nothing.

    Raises
    ------
    InputError
        Nothing is left to convert.
    """
    from tactile_toolkit.touch.rows import flat_schema

    source = conversion.source
    schema = with_features(conversion.step.schema(flat_schema(source.schema)), source.label_names)
    row_bytes = max(source.row_bytes(), 1)
    per_shard = conversion.rows_per_shard or max(1, min(_MOST_ROWS_PER_SHARD, _SHARD_BYTES // row_bytes))
    per_group = conversion.rows_per_group or max(1, min(per_shard, _GROUP_BYTES // row_bytes))
    tasks = [
        task
        for split, choices in conversion.choices.items()
        for task in _split_tasks(conversion, split, choices, per_shard, schema)
    ]
    if not tasks:
        message = (
            f"nothing is left of {source.name!r} after {conversion.operation!r}; next: choose fewer filters"
        )
        raise InputError(message)
    spec = {
        "operation": conversion.operation,
        "options": dict(conversion.options),
        "rows_per_shard": per_shard,
        "source": source.fingerprint(),
    }
    style = ParquetStyle(per_group, compression_level=3, encodings=_plain_media(schema))
    return BuildPlan(
        KIND.name,
        spec,
        tuple(source.shards),
        tuple(tasks),
        style,
        extra_dirs=conversion.extra_dirs,
        extras_intact=conversion.extras_intact,
        needs_rows=True,
    )


def _plain_media(schema: Any) -> tuple[tuple[str, str], ...]:
    # JPEG does not compress again, and a dictionary or statistics of pictures would only take space.
    media = [name for name in ("sensor_image", "sensor_video") if schema.get_field_index(name) >= 0]
    return tuple((f"{name}.list.element.bytes", "PLAIN") for name in media)


def _split_tasks(
    conversion: Conversion, split: str, choices: Sequence[RowChoice], per_shard: int, schema: Any
) -> list[_ConvertShard]:
    paths = tuple(shard.path for shard in conversion.source.shards[split])
    chunks = [tuple(choices[start : start + per_shard]) for start in range(0, len(choices), per_shard)]
    return [
        _ConvertShard(ShardName(split, index, len(chunks)), paths, chunk, conversion.step, schema)
        for index, chunk in enumerate(chunks)
    ]


def convert(
    conversion: Conversion,
    out: str | PathLike[str],
    *,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Write a conversion as a data set folder; an interrupted one goes on where it stopped.

    Raises
    ------
    InputError
        The folder to write holds the source, or lies in it; nothing was touched.
    IntegrityError
        Every round is damaged; nothing is left behind.
    SpecMismatchError
        The folder holds something made by another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    folder = DataFolder(fspath(out))
    refuse_source(folder, conversion.source)
    runner = runner_for(workers)
    return build(folder, plan_conversion(conversion), runner, overwrite=overwrite, on_progress=on_progress)
