"""Images of other projects, with tables and tars of their values."""

from __future__ import annotations

import csv
import io
import tarfile
from pathlib import Path
from typing import Any

import numpy as np

import realtouch
from tests.realtouch import factories

POSE = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")


COLUMNS = realtouch.ImportColumns(
    round="round_id", object_id="object_id", position=("pos_in_cell_x_m", "pos_in_cell_y_m"), pose=POSE
)


def picture(level: int, size: tuple[int, int] = (24, 32)) -> bytes:
    return factories.encode_jpeg(np.full((*size, 3), level, np.uint8))


def write_table(home: Path, lines: list[dict[str, Any]], name: str = "index.csv") -> None:
    with (home / name).open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)


def line(name: str, label: str = "cat", pose: str = "0 0 0.1 0 0 0 1") -> dict[str, str]:
    return {"file": name, "label": label, "pose": pose}


def write_tar(path: Path, members: list[tuple[str, bytes]]) -> None:
    with tarfile.open(path, "w") as tar:
        for name, content in members:
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))
