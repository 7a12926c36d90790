"""The report of a data set: rows of all its shards in one file, written and read a row group at a time."""

from __future__ import annotations

import contextlib
import io
from collections import Counter
from collections.abc import Collection, Generator, Iterator, Sequence
from pathlib import PurePosixPath
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    file_sha256,
    named_damage,
    open_checked,
    sha256_hex,
    stream_parquet,
)
from tactile_toolkit.store.shards import ShardName, ShardRecord

_READ_AHEAD = 16
"""Pending reports that are held at a time; a store is asked for all of them at once."""


@contextlib.contextmanager
def _opened(folder: DataFolder, path: str) -> Iterator[Any]:
    """Open a report; IntegrityError where it is missing or damaged, also when it is read."""
    with contextlib.ExitStack() as stack, named_damage(folder.address(path)):
        source = folder.address(path) if folder.is_local else stack.enter_context(folder.open(path))
        yield stack.enter_context(open_checked(source))


def report_columns(folder: DataFolder, path: str) -> list[str]:
    """Return the names of the columns of a report; IntegrityError where it is missing or damaged."""
    with _opened(folder, path) as parquet:
        return list(parquet.schema_arrow.names)


def report_pieces(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> Iterator[Any]:
    """Yield a report, or some of its columns, as Arrow tables, one for each row group.

    Raises IntegrityError when the file is missing or damaged.
    """
    with _opened(folder, path) as parquet:
        for group in range(parquet.num_row_groups):
            # Arrow's threads are not started, see open_checked.
            yield parquet.read_row_group(group, columns=columns, use_threads=False)


def read_report(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> Any:
    """Read a report, or some of its columns, as one Arrow table; raises as :func:`report_pieces`."""
    import pyarrow as pa

    return pa.concat_tables(report_pieces(folder, path, columns))


def report_shards(folder: DataFolder, path: str, *, reads_all: bool = True) -> dict[str, int]:
    """Count the rows of each shard in a report; raises as :func:`report_pieces`.

    With ``reads_all``, rows count where all of their columns can be read.
    """
    rows: Counter[str] = Counter()
    for piece in report_pieces(folder, path, None if reads_all else ["shard"]):
        rows.update({entry["values"]: entry["counts"] for entry in piece["shard"].value_counts().to_pylist()})
    return dict(rows)


def merge_reports(folder: DataFolder, path: str, manifest: Manifest) -> str | None:
    """Write one report over all shards of the manifest and return its checksum; None where none has rows.

    Rows of shards finished in an earlier run come from the report that run wrote; the order is always that
    of the manifest, so the bytes do not depend on the order of the work. Where that report is of the same
    shards it stays as it is. Raises IntegrityError where rows are nowhere.
    """
    records = [record for record in manifest.shards if record.report_sha256]
    if not records:
        return None
    there = set(folder.names(PENDING_FOLDER))
    pending = {record.shard for record in records if PurePosixPath(record.shard.report_path).name in there}
    known = (manifest.files or {}).get(path)
    if known and not pending and folder.exists(path) and file_sha256(folder, path) == known:
        return known
    try:
        # What is read is let go before the new file takes its place.
        with folder.writing(path) as stream, contextlib.closing(_stored_rows(folder, path)) as stored:
            return stream_parquet(stream, _tables(folder, records, pending, stored), REPORT_STYLE)
    except IntegrityError as error:
        raise IntegrityError(
            f"{error}; nothing was changed", next="run the same command again with --check"
        ) from error


def _tables(
    folder: DataFolder,
    records: Sequence[ShardRecord],
    pending: Collection[ShardName],
    stored: Iterator[tuple[str, Any]],
) -> Iterator[Any]:
    """Yield the report rows of each of these shards, in their order, which is that of the stored ones."""
    for start in range(0, len(records), _READ_AHEAD):
        some = records[start : start + _READ_AHEAD]
        paths = [record.shard.report_path for record in some if record.shard in pending]
        contents = dict(zip(paths, folder.read_many(paths), strict=True))
        for record in some:
            # It goes where another run of the same ends at this moment; then that one has merged it.
            table = _pending_rows(contents.get(record.shard.report_path), record)
            if table is None and record.rows:
                table = next((rows for name, rows in stored if name == str(record.shard)), None)
                found = 0 if table is None else len(table)
                if found != record.rows:
                    raise IntegrityError(
                        f"the report holds {found:,} rows of shard {record.shard}, expected {record.rows:,}"
                    )
            if table is not None:
                yield table


def _pending_rows(content: bytes | None, record: ShardRecord) -> Any:
    """Return the rows of a pending report; None without one, and for one that is damaged."""
    if content is not None and sha256_hex(content) == record.report_sha256:
        with contextlib.suppress(IntegrityError), named_damage(PENDING_FOLDER):
            return open_checked(io.BytesIO(content)).read(use_threads=False)
    return None


def _stored_rows(folder: DataFolder, path: str) -> Generator[tuple[str, Any], None, None]:
    """Yield the shards of a report that a run has merged, each with its rows, which stand together."""
    import pyarrow as pa
    import pyarrow.compute as pc

    last = ""
    held: list[Any] = []
    for piece in report_pieces(folder, path):
        runs, start = pc.run_end_encode(piece["shard"].combine_chunks()), 0
        for name, end in zip(runs.values.to_pylist(), runs.run_ends.to_pylist(), strict=True):
            if name != last and held:
                yield last, pa.concat_tables(held)
                held = []
            held.append(piece.slice(start, end - start))
            last, start = name, end
    if held:
        yield last, pa.concat_tables(held)
