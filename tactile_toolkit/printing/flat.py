"""Objects as tables for other libraries: a row for each, with its mesh as a file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.flat import MESH, SIZES, flat_table
from tactile_toolkit.printing.checked import existing, holds, prepare, refuse_others, remove, settle
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.run.processes import runner_for
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet, open_checked
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.records import SolidRecord

__all__ = ["FlatFile", "export_flat", "forecast_flat"]

Choices: TypeAlias = "Iterable[tuple[str, RecordDataset[SolidRecord], NDArray[Any]]]"

_ROWS_PER_FILE = 1000
_SAMPLED = 32
# 100 digits are 12 MB unpacked. Level 9 makes their files 8 % smaller and takes three times as long.
_STYLE = ParquetStyle(100, compression_level=3, encodings=((f"{MESH}.bytes", "PLAIN"),))


@dataclass(frozen=True, slots=True)
class FlatFile:
    """A table that is there; ``state`` is ``"written"``, or ``"kept"`` where it was there already."""

    file: str
    rows: int
    bytes: int
    state: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class _Write:
    """Picklable: make one table; refuse another one in its place, but with ``overwrite``."""

    folder: str
    overwrite: bool

    def __call__(self, task: tuple[ShardName, RecordDataset[SolidRecord]]) -> FlatFile:
        shard, rows = task
        table = flat_table(rows)
        content, path = encode_parquet(table, _STYLE), Path(self.folder) / shard.data_path
        if path.exists() and not (self.overwrite or holds(path, content)):
            refuse_others(self.folder, [shard.data_path])

        def require_same(found: Path) -> None:
            if not open_checked(str(found)).read().equals(table):
                message = "it holds other rows than were written"
                raise InputError(message)

        return FlatFile(shard.data_path, len(table), len(content), settle(path, content, require_same))


def export_flat(
    choices: Choices,
    out: str,
    *,
    overwrite: bool = False,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> tuple[FlatFile, ...]:
    """Write chosen rows of splits as Parquet that other libraries read, named as they look for splits.

    A table that is there with the very same bytes is kept. Raises InputError where other files are in the way
    (with ``overwrite``, tables of an earlier export are replaced or removed), and StorageError where the
    folder cannot be written; finished tables stay.
    """
    tasks, others = _planned(choices, out, overwrite)
    folder, total = prepare(f"{out}/{DATA_FOLDER}").parent, sum(len(rows) for _, rows in tasks)
    made: list[FlatFile] = []
    for each in runner_for(workers).run(_Write(str(folder), overwrite), tasks):
        made.append(each)
        on_progress(sum(file.rows for file in made), total)
    remove(folder / name for name in others)
    return tuple(sorted(made, key=lambda file: file.file))


def forecast_flat(choices: Choices, out: str, *, overwrite: bool = False) -> tuple[FlatFile, ...]:
    """Say what :func:`export_flat` would write, with sizes guessed from a few rows; raises InputError."""
    tasks, _ = _planned(choices, out, overwrite)
    sample = tasks[0][1][:_SAMPLED]
    row_bytes = len(encode_parquet(flat_table(sample), _STYLE)) / len(sample)
    return tuple(
        FlatFile(shard.data_path, len(rows), round(row_bytes * len(rows)), "forecast")
        for shard, rows in tasks
    )


def _planned(
    choices: Choices, out: str, overwrite: bool
) -> tuple[list[tuple[ShardName, RecordDataset[SolidRecord]]], set[str]]:
    """Return the rows of each table, and the tables of an earlier export that are to go."""
    tables = []
    for split, rows, chosen in choices:
        starts = range(0, len(chosen), _ROWS_PER_FILE)
        for index, start in enumerate(starts):
            shard = ShardName(split, index, len(starts))
            tables.append((shard, rows[chosen[start : start + _ROWS_PER_FILE]]))
    others = _of_earlier_exports(out) - {shard.data_path for shard, _ in tables}
    if not overwrite:
        refuse_others(out, sorted(others))
    return tables, others


def _of_earlier_exports(out: str) -> set[str]:
    """Return the tables that are there; InputError where one is not of :func:`export_flat`."""
    from pyarrow import ArrowException

    folder = existing(out)
    there = [] if folder is None else sorted((folder / DATA_FOLDER).glob("[!.]*"))
    for path in there:
        try:
            is_ours = {MESH, *SIZES}.issubset(open_checked(str(path)).schema_arrow.names)
        except (ArrowException, OSError):
            is_ours = False
        if not is_ours:
            message = (
                f"{out!r} holds {DATA_FOLDER}/{path.name}, which is not of an export as tables; nothing was "
                "written; next: another --out"
            )
            raise InputError(message)
    return {f"{DATA_FOLDER}/{path.name}" for path in there}
