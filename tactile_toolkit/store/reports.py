"""Reports: a table with a row of facts for each row of the shards, merged into one file."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Collection, Generator, Iterator, Sequence
from typing import IO

import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    named_damage,
    open_checked,
    sha256_hex,
    stream_parquet,
)
from tactile_toolkit.store.shards import ShardName, ShardRecord


def report_pieces(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """Yield a report, or some of its columns, as Arrow tables, one for each row group.

    Raises IntegrityError when the file is missing or damaged.
    """
    with contextlib.ExitStack() as stack, named_damage(folder.address(path)):
        source = folder.address(path) if folder.is_local else stack.enter_context(folder.open(path))
        parquet = stack.enter_context(open_checked(source))
        for group in range(parquet.num_row_groups):
            # Arrow's threads are not started, see open_checked.
            yield parquet.read_row_group(group, columns=columns, use_threads=False)


def read_report(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a report, or some of its columns, as one Arrow table; raises as :func:`report_pieces`."""
    return pa.concat_tables(report_pieces(folder, path, columns))


def merge_reports(folder: DataFolder, path: str, manifest: Manifest) -> str | None:
    """Write one report over all shards of the manifest and return its checksum; None if no shard has one.

    Rows of shards from an earlier run are copied from its report. The order is that of the manifest, so the
    bytes do not depend on the order of the work. A report of the same shards is not rewritten. Raises
    IntegrityError if rows are missing.
    """
    records = [record for record in manifest.shards if record.report_sha256]
    if not records:
        return None
    stored = {f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)}
    pending = {record.shard for record in records if record.shard.report_path in stored}
    known = manifest.files.get(path)
    if known and not pending and folder.has_sha256(path, known):
        return known

    def write(stream: IO[bytes]) -> str:
        # The old file is closed before the new one replaces it.
        with contextlib.closing(_stored_rows(folder, path)) as stored:
            return stream_parquet(stream, _tables(folder, records, pending, stored), REPORT_STYLE)

    try:
        return folder.write(path, write)
    except IntegrityError as error:
        raise IntegrityError(
            f"{error.what}; nothing was changed", next="run the same command again with --check"
        ) from error


def _tables(
    folder: DataFolder,
    records: Sequence[ShardRecord],
    pending: Collection[ShardName],
    stored: Iterator[tuple[str, pa.Table]],
) -> Iterator[pa.Table]:
    """Yield the report rows of each of these shards, in order."""
    contents = folder.read_many([each.shard.report_path for each in records if each.shard in pending])
    for record in records:
        content = next(contents) if record.shard in pending else None
        table = None
        # The content may be missing, if another run of the same job has just merged it.
        if content is not None and sha256_hex(content) == record.report_sha256:
            with contextlib.suppress(IntegrityError), named_damage(record.shard.report_path):
                table = open_checked(io.BytesIO(content)).read(use_threads=False)
        if table is None and record.rows:
            table = next((rows for name, rows in stored if name == str(record.shard)), None)
            found = len(table or ())
            if found != record.rows:
                raise IntegrityError(
                    f"the report holds {found:,} rows of shard {record.shard}, expected {record.rows:,}"
                )
        if table is not None:
            yield table


def _stored_rows(folder: DataFolder, path: str) -> Generator[tuple[str, pa.Table], None, None]:
    """Yield the name of each shard in a merged report with its rows, which are contiguous."""
    last = ""
    held: list[pa.Table] = []
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
