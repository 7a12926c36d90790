"""How fast touches become the formats of others, and images of others touches; in processor time of one core.

The way by hand, which most public code goes, is measured in the same run: `datasets` row by row, each image
decoded and encoded again as a file of its own.

    python benchmarks/exchange.py [--rounds 100]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
TOUCHES = 256
BY_HAND_ROUNDS = 4
TARGET = 10_000


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
    """Write each image of some rounds as a file, as scripts do."""
    import datasets

    datasets.disable_progress_bars()
    rounds = datasets.load_dataset(str(source), split="train", streaming=True)
    for record in rounds.take(BY_HAND_ROUNDS):
        for touch, image in enumerate(record["sensor_image"]):
            image.save(out / f"{record['id']}_{touch}.jpg", quality=95)


def main() -> None:
    import realtouch
    from benchmarks.real_touches import make_sets

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=100)
    options = parser.parse_args()
    print(f"{'set':16}{'what':22}{'touches/s':>10}{'of by hand':>12}")
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        make_sets(home / "sets", options.rounds)
        for name in ("single-64x64", "single-320x240"):
            source, touches = home / "sets" / name, options.rounds * TOUCHES
            hand = per_second(lambda out: by_hand(source, out), BY_HAND_ROUNDS * TOUCHES, home)  # noqa: B023
            work: dict[str, Callable[[Path], Any]] = {
                layout: lambda out, layout=layout: realtouch.export(source, out / "set", layout)  # noqa: B023
                for layout in ("flat", "webdataset", "lerobot")
            }
            tars = home / f"tars-{name}"
            realtouch.export(source, tars, "webdataset")
            columns = realtouch.ImportColumns(round="round_id", object_id="object_id")
            work["import webdataset"] = lambda out: realtouch.import_images(
                tars / "webdataset",  # noqa: B023
                out / "set",
                "webdataset",
                columns,  # noqa: B023
            )
            for what, job in work.items():
                rate = per_second(job, touches, home)
                note = "" if rate >= TARGET else f"  below {TARGET:,}"
                print(f"{name:16}{what:22}{rate:10,.0f}{rate / hand:12.1f}{note}", flush=True)


if __name__ == "__main__":
    main()
