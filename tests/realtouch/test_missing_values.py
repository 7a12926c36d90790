"""Values that are missing or do not fit are errors that name row and touch; none is replaced."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from tactile_toolkit.errors import IntegrityError
from tests.realtouch import factories
from tests.realtouch.factories import Layout


def no_start(row: dict[str, Any]) -> None:
    row["touch_start_time_rel"] = [*row["touch_start_time_rel"][:3], None, row["touch_start_time_rel"][4]]


def damaged(folder: Path, rows: list[dict], kind: str, edit: Any) -> Path:
    layout = Layout(edit=lambda row, index: edit(row) if index == 1 else None)
    return factories.write_set(folder, {"train": rows}, kind, layout)


@pytest.mark.parametrize("seconds", [False, True])
def test_missing_times(seconds: bool, truth: list, tmp_path: Path) -> None:
    layout = Layout(seconds=seconds, edit=lambda row, index: no_start(row) if index == 1 else None)
    factories.write_set(tmp_path, {"train": factories.seq_rows(truth, layout)}, "seq", layout)
    record = realtouch.load(tmp_path)[1]
    for ask, problem in (
        (lambda: record.touch_start_time_rel, "no time is stored"),
        (lambda: record.sensor_video[3].contact_window, "contact from nan s"),
        (record.contact_frames, "contact from nan s"),
    ):
        with pytest.raises(IntegrityError, match=f"touch 3, field 'touch_start_time_rel': {problem}"):
            ask()
    assert record.sensor_video[2].contact_window.start == truth[1].touches[2].contact_start
    assert len(record.touch_end_time_rel) == 5
    findings = realtouch.verify(str(tmp_path)).findings
    assert {(finding.row, finding.touch, finding.field) for finding in findings} == {
        (1, 3, "touch_start_time_rel")
    }


def with_object_ids(folder: Path, rows: list[dict], ids: pa.Array) -> Path:
    factories.write_set(folder, {"train": rows}, "single")
    place = folder / "data" / "train-00000-of-00001.parquet"
    table = pq.ParquetFile(place).read()
    pq.write_table(table.set_column(table.column_names.index("object_id"), "object_id", ids), place)
    return folder


def test_object_ids_that_do_not_fit(single_rows: list[dict], tmp_path: Path) -> None:
    ids = pa.array([4000, 2**64 - 1, 2**63 - 1], pa.uint64())
    dataset = realtouch.load(with_object_ids(tmp_path, single_rows, ids))
    named = f"row 1, field 'object_id': the value is {2**64 - 1}; expected an integer"
    touches = dataset.touches()
    for ask in (lambda: dataset[1].object_id, lambda: touches.object_ids, lambda: touches.objects(4000)):
        with pytest.raises(IntegrityError, match=named):
            ask()
    assert dataset[2].object_id == 2**63 - 1
    assert dataset[[0, 2]].touches().object_ids.tolist() == [4000] * 5 + [2**63 - 1] * 5
    assert [(finding.row, finding.field) for finding in realtouch.verify(str(tmp_path)).findings] == [
        (1, "object_id")
    ]


def test_missing_labels_and_objects(single_rows: list[dict], tmp_path: Path) -> None:
    def forget(row: dict[str, Any]) -> None:
        row["label"] = row["object_id"] = None

    dataset = realtouch.load(damaged(tmp_path, single_rows, "single", forget))
    touches = dataset.touches()
    for field, ask in (
        ("label", lambda: dataset.labels),
        ("label", lambda: touches.labels),
        ("label", lambda: touches.filter_labels(0)),
        ("object_id", lambda: touches.object_ids),
    ):
        with pytest.raises(IntegrityError, match=f"row 1, field '{field}': no value is stored"):
            ask()
