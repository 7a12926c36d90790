"""Reports: one row per item beside the data, merged from the shards of a run."""

from __future__ import annotations

import io
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.shards import ParquetStyle, encode_parquet, file_sha256, sha256_hex

__all__ = ["merge_reports", "read_report", "report_rows_per_shard"]

_STYLE = ParquetStyle(rows_per_group=1 << 16)


def read_report(folder: DataFolder, path: str) -> Any:
    """Read a report as an Arrow table.

    Raises
    ------
    IntegrityError
        When the file is missing or no Parquet.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        # Neither pq.read_table nor buffering ahead: threads of Arrow's can abort the process at its end.
        return pq.ParquetFile(io.BytesIO(folder.read_bytes(path)), pre_buffer=False).read(use_threads=False)
    except pa.ArrowInvalid as error:
        message = f"{folder.address(path)!r} is not a whole Parquet file: {error}"
        raise IntegrityError(message) from error


def merge_reports(folder: DataFolder, path: str, manifest: Manifest) -> str:
    """Write one report over all shards of the manifest and return its checksum.

    Rows of shards finished in an earlier run come from the report that run wrote; the order is always that
    of the manifest, so the bytes do not depend on the order of the work.
    """
    import pyarrow as pa

    earlier = _report_if_whole(folder, path)
    tables = []
    for receipt in manifest.receipts:
        part = receipt.shard.report_path
        if folder.exists(part):
            tables.append(read_report(folder, part))
        elif earlier is not None:
            tables.append(_rows_of_shard(earlier, str(receipt.shard)))
    if not tables:
        return ""
    content = encode_parquet(pa.concat_tables(tables), _STYLE)
    checksum = sha256_hex(content)
    if not folder.exists(path) or file_sha256(folder, path) != checksum:
        folder.write_bytes(path, content)
    return checksum


def report_rows_per_shard(folder: DataFolder, path: str) -> dict[str, int]:
    """Count the rows of each shard in a merged report; a missing or damaged report counts as empty."""
    report = _report_if_whole(folder, path)
    if report is None:
        return {}
    counts = report["shard"].value_counts()
    return {entry["values"]: entry["counts"] for entry in counts.to_pylist()}


def _report_if_whole(folder: DataFolder, path: str) -> Any:
    if not folder.exists(path):
        return None
    try:
        return read_report(folder, path)
    except IntegrityError:
        return None


def _rows_of_shard(report: Any, shard: str) -> Any:
    import pyarrow.compute as pc

    return report.filter(pc.equal(report["shard"], shard))
