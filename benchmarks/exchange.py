"""How fast touches become the formats of others, and images of others touches; in processor time of one core.

The plain way is measured in the same run: rows read with pyarrow, each image written as a file of its own as
it is stored.

    python benchmarks/exchange.py [--rounds 100]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from figures import tell

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
TOUCHES = 256
BY_HAND_ROUNDS = 4


def per_second(work: Callable[[Path], Any], touches: int, home: Path) -> float:
    """Return touches per second of processor time, the median of three runs."""
    rates = []
    for _ in range(3):
        with tempfile.TemporaryDirectory(dir=home) as folder:
            start_s = time.process_time()
            work(Path(folder))
            rates.append(touches / (time.process_time() - start_s))
    return statistics.median(rates)


def by_hand(source: Path, out: Path) -> None:
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


def make_set(folder: Path, size: tuple[int, int], rounds: int) -> Path:
    """Write single images as the published ones: 256 a round, with the noise of a sensor."""
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
    "import": "realtouch import --format webdataset",
}


def jobs(source: Path, tars: Path) -> dict[str, Callable[[Path], Any]]:
    import realtouch

    realtouch.export(source, tars, "webdataset")
    columns = realtouch.ImportColumns(round="round_id", object_id="object_id")
    return {
        "flat": lambda out: realtouch.export(source, out / "set", "flat"),
        "webdataset": lambda out: realtouch.export(source, out / "set", "webdataset"),
        "lerobot": lambda out: realtouch.export(source, out / "set", "lerobot"),
        "import": lambda out: realtouch.import_touches(
            tars / "webdataset", out / "set", "webdataset", columns
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=100)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for size in ((64, 64), (320, 240)):
            name = f"{size[0]}x{size[1]}"
            source, touches = make_set(home / name, size, options.rounds), options.rounds * TOUCHES
            hand = per_second(partial(by_hand, source), BY_HAND_ROUNDS * TOUCHES, home)
            for what, job in jobs(source, home / f"tars-{name}").items():
                rate = per_second(job, touches, home)
                tell(
                    f"{what}_{size[0]}", f"a touch, `{COMMANDS[what]}`, {name}; by hand", 1 / rate, "s",
                    other=1 / hand,
                )  # fmt: skip


if __name__ == "__main__":
    main()
