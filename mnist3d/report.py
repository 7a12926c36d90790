"""``reports/printability.parquet``: what was found about each mesh, one row per digit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mnist3d.rows import MeshRow
from tactile_toolkit.mesh.printability import REPORT_COLUMNS, PrintReport

__all__ = ["REPORT_FILE", "report_table"]

REPORT_FILE = "reports/printability.parquet"


def report_table(shard: str, split: str, rows: Sequence[MeshRow], reports: Sequence[PrintReport]) -> Any:
    """Pack the reports of one shard into an Arrow table.

    Parameters
    ----------
    shard, split : str
        Where the rows are written.
    rows : sequence of MeshRow
        The rows.
    reports : sequence of PrintReport
        One per row.
    """
    import pyarrow as pa

    values = [
        {"id": row.id, "label": row.label, "split": split, "shard": shard, **_report_row(report)}
        for row, report in zip(rows, reports, strict=True)
    ]
    return pa.Table.from_pylist(values, schema=_schema())


def _report_row(report: PrintReport) -> dict[str, Any]:
    return {**report.to_row(), "warnings": list(report.warnings)}


def _schema() -> Any:
    import pyarrow as pa

    arrow = {bool: pa.bool_(), str: pa.string(), int: pa.int64(), float: pa.float64()}
    # Rows are only of meshes that are solids: what says why a mesh is none has no place here.
    measured = {name: kind for name, kind in REPORT_COLUMNS.items() if name not in ("problem", "detail")}
    return pa.schema(
        [
            ("id", pa.int64()),
            ("label", pa.int64()),
            ("split", pa.string()),
            ("shard", pa.string()),
            *((name, arrow[kind]) for name, kind in measured.items() if name != "warnings"),
            ("warnings", pa.list_(pa.string())),
        ]
    )
