"""Speed of exports to other formats and of imports from them, in processor time of one core.

A plain script is measured in the same run, in turn. For an export, it reads rounds with pyarrow, and writes
a row for each touch with image, label, position and pose: as Parquet, or as tars by `webdataset`. For an
import, it verifies each image with Pillow, reads its values from a table or JSON, and writes all with pyarrow
as one Parquet file. The limit is reading alone.

    python benchmarks/exchange.py [--rounds 40]
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
from itertools import chain
from pathlib import Path
from typing import Any

from figures import tell
from plain_ways import touch_rows

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
TOUCHES = 256
ROUNDS_AT_ONCE = 4
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


def rounds_of(source: Path) -> Iterator[Any]:
    """Yield what an export needs of some rounds at a time."""
    import pyarrow.parquet as pq

    poses = [f"gel_pose_cell_frame.{name}" for name in ("position", "quaternion")]
    columns = ["id", "label", "object_id", "pos_in_cell", *poses, "sensor_image"]
    for file in sorted((source / "data").glob("*.parquet")):
        yield from pq.ParquetFile(file).iter_batches(ROUNDS_AT_ONCE, columns=columns)


def read_alone(source: Path, _: Path) -> None:
    for _batch in rounds_of(source):
        pass


def to_parquet(source: Path, out: Path) -> None:
    """Write a row for each touch as Parquet, as a script would."""
    import pyarrow.parquet as pq

    tables = map(touch_rows, rounds_of(source))
    first = next(tables)
    with pq.ParquetWriter(
        out / "touches.parquet", first.schema, compression="zstd", use_dictionary=False
    ) as file:
        for table in chain([first], tables):
            file.write_table(table)


def to_tars(source: Path, out: Path) -> None:
    """Write image and JSON of each touch to a tar, as a script would."""
    import webdataset

    with webdataset.TarWriter(str(out / "touches.tar")) as tar:
        for table in map(touch_rows, rounds_of(source)):
            for row in table.to_pylist():
                image, key = row.pop("image"), f"{row['id']}_{row['touch']}"
                tar.write({"__key__": key, "jpg": image["bytes"], "json": row})


def files_alone(source: Path, _: Path) -> None:
    for path in source.rglob("*"):
        if path.is_file():
            path.read_bytes()


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


def jobs_of(source: Path, exported: Path, touches: int) -> dict[str, tuple[str, list[Job]]]:
    """Return jobs by name: what the plain script uses; the export or import, the script, and the limit."""
    import realtouch

    realtouch.export(source, exported, "webdataset")
    realtouch.export(source, exported / "images", "jpeg")
    tars, images = exported / "webdataset", exported / "images"

    def exporting(layout: Any, way: str, plain: Callable[[Path, Path], None]) -> tuple[str, list[Job]]:
        runs = (
            lambda out: realtouch.export(source, out / "set", layout),
            partial(plain, source),
            partial(read_alone, source),
        )
        return way, [(run, touches) for run in runs]

    def importing(layout: Any, folder: Path, samples: Any) -> tuple[str, list[Job]]:
        runs = (
            lambda out: realtouch.import_touches(folder, out / "set", realtouch.ImportSpec(layout)),
            partial(import_by_hand, partial(samples, folder)),
            partial(files_alone, folder),
        )
        return "Pillow and `pyarrow`", [(run, touches) for run in runs]

    return {
        "flat": exporting("flat", "`pyarrow`", to_parquet),
        "webdataset": exporting("webdataset", "`pyarrow` and `webdataset`", to_tars),
        "lerobot": exporting("lerobot", "`pyarrow`, rows without statistics", to_parquet),
        "import_folder": importing("folder", images, in_table),
        "import": importing("webdataset", tars, in_tars),
    }


def tell_further(size: tuple[int, int], source: Path, rounds: int, home: Path) -> None:
    """Tell what a touch costs without the card, its pictures and the other files that a set has once."""
    import realtouch

    half = make_set(home / f"half-{size[0]}", size, rounds // 2)
    touches = (rounds * TOUCHES, rounds // 2 * TOUCHES)

    def exporting(chosen: Path) -> Callable[[Path], object]:
        return lambda out: realtouch.export(chosen, out / "set", "flat")

    jobs = list(zip(map(exporting, (source, half)), touches, strict=True))
    whole_s, half_s = (count / rate for count, rate in zip(touches, per_second(jobs, home), strict=True))
    what = f"each further touch, `{COMMANDS['flat']}`, {size[0]}x{size[1]}"
    tell(
        f"flat_further_{size[0]}",
        what,
        (whole_s - half_s) / (touches[0] - touches[1]),
        "s",
        statistic=f"median of {TURNS}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--only", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for size in ((64, 64), (320, 240)):
            name = f"{size[0]}x{size[1]}"
            source, touches = make_set(home / name, size, options.rounds), options.rounds * TOUCHES
            for what, (way, jobs) in jobs_of(source, home / f"exported-{name}", touches).items():
                if what not in options.only:
                    continue
                ours_s, plain_s, read_s = (1 / rate for rate in per_second(jobs, home))
                if what == "flat":
                    tell_further(size, source, options.rounds, home)
                tell(
                    f"{what}_{size[0]}", f"a touch of {touches:,}, `{COMMANDS[what]}`, {name}", ours_s, "s",
                    statistic=f"median of {TURNS}", plain=(plain_s, way), limit=(read_s, "reading alone"),
                )  # fmt: skip


if __name__ == "__main__":
    main()
