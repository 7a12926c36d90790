"""Speed of exports to other formats and of imports from them, in processor time of one core.

A plain script is measured in the same run, in turn. For an export, it reads rows with pyarrow and writes each
image as a file, as it is stored. For an import, it verifies each image with Pillow, reads its values from a
table or JSON, and writes all with pyarrow as one Parquet file.

    python benchmarks/exchange.py [--rounds 100]
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import statistics
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from figures import tell

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
TOUCHES = 256
BY_HAND_ROUNDS = 4
TURNS = 3

Job = tuple[Callable[[Path], Any], int]
"""A function that is measured, and the number of its touches."""


def per_second(jobs: Iterable[Job], home: Path) -> list[float]:
    """Return touches per second of processor time, the median of three runs in turn."""
    rates: list[list[float]] = [[] for _ in jobs]
    for _ in range(TURNS):
        for (run, touches), job_rates in zip(jobs, rates, strict=True):
            with tempfile.TemporaryDirectory(dir=home) as folder:
                start_s = time.process_time()
                run(Path(folder))
                job_rates.append(touches / (time.process_time() - start_s))
    return list(map(statistics.median, rates))


def export_by_hand(source: Path, out: Path) -> None:
    """Write each image of some rounds as a file, as a script would."""
    import pyarrow.parquet as pq

    batches = (
        batch
        for file in sorted((source / "data").glob("*.parquet"))
        for batch in pq.ParquetFile(file).iter_batches(1, columns=["id", "sensor_image"])
    )
    for batch in islice(batches, BY_HAND_ROUNDS):
        for record in batch.to_pylist():
            for touch, image in enumerate(record["sensor_image"]):
                (out / f"{record['id']}_{touch}.jpg").write_bytes(image["bytes"])


def in_table(source: Path) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """Yield the images of a folder, each with its row of the table."""
    with (source / "index.csv").open(newline="") as stream:
        for line in csv.DictReader(stream):
            yield (source / line["file"]).read_bytes(), line


def in_tars(source: Path) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """Yield the images of tars, each with its JSON."""
    image = b""
    for name in sorted(source.glob("*.tar")):
        with tarfile.open(name) as tar:
            for member in tar:
                content = tar.extractfile(member).read()
                if not member.name.endswith(".json"):
                    image = content
                else:
                    yield image, json.loads(content)


def import_by_hand(samples: Callable[[], Iterator[tuple[bytes, dict[str, Any]]]], out: Path) -> None:
    """Verify each image and write it with its label and pose, as a script would."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from PIL import Image

    from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS

    numbers = (*POSITION_COLUMNS, *POSE_COLUMNS)
    rows: dict[str, list[Any]] = {
        name: [] for name in ("round", "label", "object_id", "width", "height", "image", *numbers)
    }
    for content, fields in samples():
        with Image.open(io.BytesIO(content)) as image:
            width, height = image.size
            image.verify()
        rows["round"].append(fields["round_id"])
        rows["label"].append(int(fields["label"]))
        rows["object_id"].append(int(fields["object_id"]))
        rows["width"].append(width)
        rows["height"].append(height)
        rows["image"].append(content)
        for name in numbers:
            rows[name].append(float(fields[name]))
    pq.write_table(pa.table(rows), out / "touches.parquet", compression="zstd")


def make_set(folder: Path, size: tuple[int, int], rounds: int) -> Path:
    """Write single images like the published ones: 256 per round, with the noise of a sensor."""
    from benchmarks.real_touches import repeated
    from tests.realtouch import factories as f

    truths = [f.make_round(index, 8, size, (4, 5), noise=1.5) for index in range(rounds)]
    encode = partial(f.encode_jpeg, quality=75 if size == (64, 64) else 90)
    rows = [repeated(row, TOUCHES) for row in f.single_rows(truths, encode)]
    return f.write_set(folder, {"train": rows}, "single", f.Layout(group_rows=10))


COMMANDS = {
    "flat": "--format flat",
    "webdataset": "--format webdataset",
    "lerobot": "--format lerobot",
    "import_folder": "realtouch import --format folder",
    "import": "realtouch import --format webdataset",
}


def jobs_of(source: Path, exported: Path, touches: int) -> dict[str, tuple[Job, Job]]:
    """Return jobs by name, each with that of the plain script."""
    import realtouch

    realtouch.export(source, exported, "webdataset")
    realtouch.frames(source, exported / "images", "jpeg")
    tars, images = exported / "webdataset", exported / "images"

    def exporting(layout: Any) -> tuple[Job, Job]:
        by_hand = partial(export_by_hand, source), BY_HAND_ROUNDS * TOUCHES
        return (lambda out: realtouch.export(source, out / "set", layout), touches), by_hand

    def importing(layout: Any, folder: Path, samples: Any) -> tuple[Job, Job]:
        by_hand = partial(import_by_hand, partial(samples, folder)), touches
        return (
            lambda out: realtouch.import_touches(folder, out / "set", realtouch.ImportSpec(layout)),
            touches,
        ), by_hand

    return {
        **{layout: exporting(layout) for layout in ("flat", "webdataset", "lerobot")},
        "import_folder": importing("folder", images, in_table),
        "import": importing("webdataset", tars, in_tars),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--only", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for size in ((64, 64), (320, 240)):
            name = f"{size[0]}x{size[1]}"
            source, touches = make_set(home / name, size, options.rounds), options.rounds * TOUCHES
            for what, jobs in jobs_of(source, home / f"exported-{name}", touches).items():
                if what not in options.only:
                    continue
                rate, rate_by_hand = per_second(jobs, home)
                tell(
                    f"{what}_{size[0]}", f"a touch, `{COMMANDS[what]}`, {name}; by hand", 1 / rate, "s",
                    other=1 / rate_by_hand,
                )  # fmt: skip


if __name__ == "__main__":
    main()
