"""How fast real touches load: ours against the published loader and plain `datasets`, in one run.

Sets in the published schema (256 touches per round) are made in a temporary folder, with noise in all frames
so that decoding costs what it costs on a real sensor. Reported are medians.

    python benchmarks/real_touches.py [--folder KEPT] [--rounds 6]
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from figures import in_words, tell

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
TOUCHES = 256
DISTINCT_CLIPS = 24
CLIP_NOISE = 0.8
ORDER = np.random.default_rng(0)


def make_sets(folder: Path, rounds: int) -> None:
    """Write the three published sets: images of two sizes, and clips (two rounds)."""
    from tests.realtouch import factories as f

    layout = f.Layout(group_rows=100)
    for name, size in (("single-64x64", (64, 64)), ("single-320x240", (320, 240))):
        truths = [f.make_round(index, 32, size, (4, 5), noise=1.5) for index in range(rounds)]
        # Quality 75 gives the 864 bytes per image of the published 64x64 set.
        quality = 75 if size == (64, 64) else 90
        encode = partial(f.encode_jpeg, quality=quality)
        rows = [repeated(row, TOUCHES) for row in f.single_rows(truths, encode)]
        f.write_set(folder / name, {"train": rows}, "single", layout)
    # So much noise gives the 180 kB per clip of the published set (28 GB for 153,600 of them).
    truth = f.make_round(0, DISTINCT_CLIPS, (320, 240), noise=CLIP_NOISE)
    rows = [repeated(row, TOUCHES) for row in f.seq_rows([truth])]
    f.write_set(folder / "seq", {"train": rows * 2}, "seq", f.Layout(group_rows=1))


def repeated(row: dict[str, Any], touches: int) -> dict[str, Any]:
    """Fill a round up to ``touches`` with the touches that it has."""
    longer = {}
    for name, values in row.items():
        per_touch = isinstance(values, (list, np.ndarray)) and not name.startswith("info.")
        longer[name] = [values[index % len(values)] for index in range(touches)] if per_touch else values
    longer["pos_in_cell"] = np.asarray(longer["pos_in_cell"])
    return longer


def median_s(work: Callable[[], Any], repeats: int) -> float:
    """Return the median time of one call, after one call that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def in_turn(works: list[Callable[[], Any]], repeats: int) -> list[float]:
    """Return the median time of one call of each; they take turns, so that other work weighs on all alike."""
    times: list[list[float]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, taken in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            if turn:  # the first is not counted
                taken.append(time.perf_counter() - start)
    return [statistics.median(taken) for taken in times]


def line(what: str, ours_s: float, published_s: float, plain_s: float | None, wanted: float = 0) -> None:
    """Tell a figure next to the published package's and that of `datasets` alone."""
    note = f"`datasets` alone {in_words(plain_s, 's')}" if plain_s else ""
    target = f"at least {wanted:g}" if wanted else ""
    tell(re.sub(r"\W+", "_", what), what, ours_s, "s", other=published_s, target=target, note=note)


def draw(*sizes: int) -> list[int]:
    """Draw an index below each size."""
    return [int(ORDER.integers(size)) for size in sizes]


def bench_images(folder: Path, size: str, pass_wanted: float) -> None:
    """Random touches and a full pass over images."""
    import tactile_mnist
    from datasets import load_dataset

    import realtouch

    plain = load_dataset(str(folder / f"single-{size}"), split="train")
    published = tactile_mnist.TouchSingleDataset(plain)
    ours = realtouch.load(folder / f"single-{size}")
    touches = ours.touches()
    rounds = len(ours)

    def their_touch() -> Any:
        row, touch = draw(rounds, TOUCHES)
        return published[row].sensor_image[touch]

    def plain_touch() -> Any:
        row, touch = draw(rounds, TOUCHES)
        return np.asarray(plain[row]["sensor_image"][touch])

    line(
        f"random touch {size}",
        median_s(lambda: touches[draw(len(touches))[0]].image, 2000),
        median_s(their_touch, 9),
        median_s(plain_touch, 9),
        300,
    )

    def their_pass() -> None:
        for point in published:
            images = point.sensor_image
            for touch in range(TOUCHES):
                images[touch]

    def plain_pass() -> None:
        for row in plain.select_columns("sensor_image"):
            for image in row["sensor_image"]:
                np.asarray(image)

    def our_pass() -> None:
        for record in ours:
            for _ in record.sensor_image:
                pass

    out = np.empty((TOUCHES, *ours[0].sensor_image.size(0), 3), np.uint8)

    def our_batched_pass() -> None:
        for record in ours:
            record.sensor_image.batch(out=out)

    count = len(touches)
    theirs, plains = median_s(their_pass, 3) / count, median_s(plain_pass, 3) / count
    line(f"full pass {size}, per image", median_s(our_pass, 5) / count, theirs, plains, pass_wanted)
    batched = median_s(our_batched_pass, 5) / count
    line(f"full pass {size}, into one batch", batched, theirs, plains, 4 if size == "64x64" else pass_wanted)
    if size != "64x64":
        one, two = (thread_s(folder / f"single-{size}", threads) / TOUCHES for threads in (1, 2))
        line(f"two threads, {size}; ours, one thread", two, one, None, 1.7)


def bench_clips(folder: Path) -> None:
    """Random frames, whole clips, contact frames and poses."""
    import tactile_mnist
    from datasets import load_dataset

    import realtouch

    plain = load_dataset(str(folder / "seq"), split="train")
    published = tactile_mnist.TouchSeqDataset(plain)
    ours = realtouch.load(folder / "seq")
    touches = ours.touches()

    def our_frame() -> Any:
        clip = touches[draw(len(touches))[0]].clip
        return clip[draw(len(clip))[0]]

    def their_frame() -> Any:
        row, touch = draw(len(ours), TOUCHES)
        decoder = published[row].sensor_video[touch]
        return decoder[draw(len(decoder))[0]]

    def plain_frame() -> Any:
        row, touch = draw(len(ours), TOUCHES)
        decoder = plain[row]["sensor_video"][touch]
        return decoder[draw(len(decoder))[0]]

    line(
        "random frame of a random clip",
        median_s(our_frame, 2000),
        median_s(their_frame, 9),
        median_s(plain_frame, 5),
        300,
    )

    def our_clip() -> Any:
        return touches[draw(len(touches))[0]].clip.frames()

    def their_clip() -> Any:
        row, touch = draw(len(ours), TOUCHES)
        return published[row].sensor_video[touch][:]

    line("whole clip, one thread", median_s(our_clip, 50), median_s(their_clip, 9), None, 8)
    line(
        "whole clip, two threads",
        median_s(lambda: touches[draw(len(touches))[0]].clip.frames(threads=2), 50),
        median_s(their_clip, 9),
        None,
        8,
    )

    bench_contact(ours, published)
    bench_poses(ours, published)


def bench_contact(ours: Any, published: Any) -> None:
    """Contact frames of one round: one of each touch, and all of each touch."""

    def their_frames() -> Any:
        return [decoder[window[-1]] for decoder, window in _windows(published[0])]

    def their_windows() -> Any:
        return [decoder[window[0] : window[-1] + 1] for decoder, window in _windows(published[0])]

    def our_frames(threads: int | None, out: Any = None) -> Callable[[], Any]:
        return lambda: ours[0].contact_frames("contact_end", threads=threads, out=out)

    def our_windows(threads: int | None) -> Callable[[], Any]:
        return lambda: ours[0].contact_windows(threads=threads)

    batch = our_frames(1)()
    frames = {
        "contact frames of a round (default threads)": our_frames(None),
        "the same, one thread": our_frames(1),
        "the same, one thread, into one batch": our_frames(1, batch),
    }
    windows = {
        "all 7 frames of each contact (default)": our_windows(None),
        "the same, one thread": our_windows(1),
    }
    for theirs, works, repeats, wanted in ((their_frames, frames, 15, 5), (their_windows, windows, 5, 0)):
        theirs_s, *ours_s = in_turn([theirs, *works.values()], repeats)
        for what, taken_s in zip(works, ours_s, strict=True):
            line(what, taken_s, theirs_s, None, wanted)


def bench_poses(ours: Any, published: Any) -> None:
    """All poses of one round."""

    def our_poses() -> Any:
        poses = ours[0].gel_pose_cell_frame_seq
        return poses.position_m, poses.quaternion

    line(
        "all poses of a round as arrays",
        median_s(our_poses, 100),
        median_s(lambda: published[0].gel_pose_cell_frame_seq, 3),
        None,
        300,
    )


def _windows(point: Any) -> Any:
    """Yield decoder and contact frames of each clip of a published data point."""
    times, starts, ends = point.time_stamp_rel_seq, point.touch_start_time_rel, point.touch_end_time_rel
    for decoder, stamps, start, end in zip(point.sensor_video, times, starts, ends, strict=True):
        yield decoder, [frame for frame, stamp in enumerate(stamps) if start <= stamp <= end]


_MEMORY = """
import json, sys, warnings
warnings.simplefilter("ignore")
import numpy as np
def private_mb():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024
folder, who, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
random = np.random.default_rng(0)
if who == "ours":
    import realtouch
    data = realtouch.load(folder).touches()
    take = lambda: data[int(random.integers(len(data)))].image
else:
    import tactile_mnist
    from datasets import load_dataset
    data = tactile_mnist.TouchSingleDataset(load_dataset(folder, split="train"))
    take = lambda: data[int(random.integers(len(data)))].sensor_image[int(random.integers(256))]
take()
before = private_mb()
for _ in range(count):
    take()
print(json.dumps(private_mb() - before))
"""


_THREADS = """
import sys, time, statistics
import numpy as np
import realtouch
images = realtouch.load(sys.argv[1])[0].sensor_image
out = np.empty((len(images), *images.size(0), 3), np.uint8)
times = []
for _ in range(25):
    start = time.perf_counter()
    images.batch(out=out, threads=int(sys.argv[2]))
    times.append(time.perf_counter() - start)
print(statistics.median(times))
"""


def thread_s(folder: Path, threads: int) -> float:
    """Return the median time to decode a round in a fresh process, where no other library keeps threads."""
    command = [sys.executable, "-c", _THREADS, str(folder), str(threads)]
    return float(subprocess.run(command, capture_output=True, check=True).stdout)


def memory_mb(folder: Path, who: str, count: int) -> float:
    """Return by how much random touches raise the private memory of a fresh process."""
    command = [sys.executable, "-W", "ignore", "-c", _MEMORY, str(folder), who, str(count)]
    return float(json.loads(subprocess.run(command, capture_output=True, check=True).stdout.splitlines()[-1]))


def import_s(module: str) -> float:
    """Return the median time in which a fresh interpreter imports a module."""
    code = f"import time; s = time.perf_counter(); import {module}; print(time.perf_counter() - s)"
    command = [sys.executable, "-W", "ignore", "-c", code]
    runs = [
        subprocess.run(command, capture_output=True, check=True).stdout.splitlines()[-1] for _ in range(3)
    ]
    return statistics.median(map(float, runs))


def main() -> None:
    """Run everything."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--rounds", type=int, default=6)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    import datasets

    datasets.disable_progress_bars()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        if not (folder / "seq").is_dir():
            make_sets(folder, options.rounds)
        bench_images(folder, "64x64", 3)
        bench_images(folder, "320x240", 1.8)
        bench_clips(folder)
        note = f"`import tactile_mnist` {import_s('tactile_mnist'):.1f} s"
        tell("import", "`import realtouch`", import_s("realtouch"), "s", target="at most 0.5", note=note)
        ours, theirs = (
            memory_mb(folder / "single-320x240", *what) for what in (("ours", 1000), ("theirs", 60))
        )
        what = "memory that 1,000 random touches at 320x240 add"
        note = f"published, 60 of them: {theirs:,.0f} MB"
        tell("memory", what, max(ours, 0.0), "MB", target="at most 50", note=note)


if __name__ == "__main__":
    main()
