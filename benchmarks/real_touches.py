"""How fast real touches load: ours against the published loader and plain `datasets`, in one run.

Sets in the published schema (256 touches per round) are made in a temporary folder, with noise in all frames
so that decoding costs what it costs on a real sensor. Reported are medians. What lies in the cache of the
toolkit was unpacked before. The plain way has a column in memory, and decodes by Pillow or torchcodec; the
limit is the decoder alone, into the same memory.

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
import simplejpeg
from figures import Peer, in_words, tell
from plain_ways import IN_MEMORY, medians_in_turn_s, pixels, stored_media

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
TOUCHES = 256
TIMES = ("time_stamp_rel_seq", "touch_start_time_rel", "touch_end_time_rel")
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


def decode(image: Any, out: np.ndarray) -> np.ndarray:
    """Decode a JPEG into the same memory each time, which any reader does at least."""
    return simplejpeg.decode_jpeg(image, "RGB", buffer=out)


def median_s(work: Callable[[], Any], repeats: int) -> float:
    """Return the median time of one call, after one call that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def line(
    what: str,
    ours_s: float,
    published_s: float,
    least: float = 0,
    *,
    plain: Peer | None = None,
    limit: Peer | None = None,
    datasets_s: float = 0.0,
) -> None:
    """Tell a median next to those of its peers; ``least`` is how many times as fast ours is to be."""
    tell(
        re.sub(r"\W+", "_", what), what, ours_s, "s", statistic="median", published=published_s, plain=plain,
        limit=limit, target=f"at least {least:g}" if least else "",
        note=f"`datasets` alone {in_words(datasets_s, 's')}" if datasets_s else "",
    )  # fmt: skip


def draw(*sizes: int) -> list[int]:
    """Draw an index below each size."""
    return [int(ORDER.integers(size)) for size in sizes]


def bench_images(folder: Path, size: str, pass_least: float) -> None:
    """Random touches and a full pass over images."""
    import tactile_mnist
    from datasets import load_dataset

    import realtouch

    plain = load_dataset(str(folder / f"single-{size}"), split="train")
    column = stored_media(folder / f"single-{size}", "sensor_image")
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

    encoded = [column[index].as_py() for index in range(256)]
    space = np.empty_like(pixels(column, 0))
    assert np.array_equal(pixels(column, 5), touches[5].image)
    decoding = median_s(lambda: [decode(image, space) for image in encoded], 9) / 256, "decoder alone"
    by_pillow = f"{IN_MEMORY}, Pillow"
    line(
        f"random touch {size}",
        median_s(lambda: touches[draw(len(touches))[0]].image, 2000),
        median_s(their_touch, 9),
        300,
        plain=(median_s(lambda: pixels(column, draw(len(column))[0]), 2000), by_pillow),
        limit=decoding,
        datasets_s=median_s(plain_touch, 9),
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
    peers = {
        "plain": (median_s(lambda: [pixels(column, row) for row in range(count)], 3) / count, by_pillow),
        "limit": decoding,
        "datasets_s": median_s(plain_pass, 3) / count,
    }
    theirs = median_s(their_pass, 3) / count
    line(f"full pass {size}, per image", median_s(our_pass, 5) / count, theirs, pass_least, **peers)
    batched = median_s(our_batched_pass, 5) / count
    least = 4 if size == "64x64" else pass_least
    line(f"full pass {size}, into one batch", batched, theirs, least, **peers)
    if size != "64x64":
        one, two = (thread_s(folder / f"single-{size}", threads) / TOUCHES for threads in (1, 2))
        line(f"two threads, {size}", two, 0, 1.7, plain=(one, "one thread"))


def bench_clips(folder: Path) -> None:
    """Random frames, whole clips, contact frames and poses."""
    import tactile_mnist
    from datasets import load_dataset

    import realtouch

    plain = load_dataset(str(folder / "seq"), split="train")
    published = tactile_mnist.TouchSeqDataset(plain)
    column = stored_media(folder / "seq", "sensor_video")
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

    def memory_frame() -> Any:
        clip = decoder_of(column, draw(len(column))[0])
        return clip[draw(len(clip))[0]]

    encoded = [touches[0].clip.encoded(frame) for frame in range(len(touches[0].clip))]
    space = np.empty_like(touches[0].clip[0])
    decoding_s = median_s(lambda: [decode(image, space) for image in encoded], 15) / len(encoded)
    by_decoder = f"{IN_MEMORY}, `torchcodec`"
    line(
        "random frame of a random clip",
        median_s(our_frame, 2000),
        median_s(their_frame, 9),
        300,
        plain=(median_s(memory_frame, 200), by_decoder),
        limit=(decoding_s, "decoder alone"),
        datasets_s=median_s(plain_frame, 5),
    )

    def our_clip() -> Any:
        return touches[draw(len(touches))[0]].clip.frames()

    def their_clip() -> Any:
        row, touch = draw(len(ours), TOUCHES)
        return published[row].sensor_video[touch][:]

    peers = {
        "plain": (median_s(lambda: decoder_of(column, draw(len(column))[0])[:], 25), by_decoder),
        "limit": (decoding_s * len(encoded), "decoder alone"),
    }
    line("whole clip, one thread", median_s(our_clip, 50), median_s(their_clip, 9), 8, **peers)
    line(
        "whole clip, two threads",
        median_s(lambda: touches[draw(len(touches))[0]].clip.frames(threads=2), 50),
        median_s(their_clip, 9),
        8,
        **peers,
    )

    bench_contact(ours, published, column, decoding_s)
    bench_poses(ours, published, folder / "seq")


def decoder_of(column: Any, touch: int) -> Any:
    """Return the decoder of a clip in memory, as `datasets` makes it, with one thread."""
    from torchcodec.decoders import VideoDecoder

    return VideoDecoder(column[touch].as_py(), num_ffmpeg_threads=1)


def bench_contact(ours: Any, published: Any, column: Any, decoding_s: float) -> None:
    """Contact frames of one round: one of each touch, and all of each touch."""

    def their_frames() -> Any:
        return [decoder[window[-1]] for decoder, window in _windows(published[0])]

    def their_windows() -> Any:
        return [decoder[window[0] : window[-1] + 1] for decoder, window in _windows(published[0])]

    def windows_in_memory() -> Any:
        row = ours[0].row
        stored = zip(*(row.value(name) for name in TIMES), strict=True)
        for touch, (stamps, start, end) in enumerate(stored):
            times = np.asarray(stamps)
            yield decoder_of(column, touch), np.flatnonzero((times >= start) & (times <= end)).tolist()

    def memory_frames() -> Any:
        return [decoder[window[-1]] for decoder, window in windows_in_memory()]

    def memory_windows() -> Any:
        return [decoder[window[0] : window[-1] + 1] for decoder, window in windows_in_memory()]

    def our_frames(threads: int | None, out: Any = None) -> Callable[[], Any]:
        return lambda: ours[0].contact_frames("contact_end", threads=threads, out=out)

    def our_windows(threads: int | None) -> Callable[[], Any]:
        return lambda: ours[0].contact_windows(threads=threads)

    batch = our_frames(1)()
    frames = {
        "contact frames of a round (default threads)": our_frames(None),
        "contact frames of a round, one thread": our_frames(1),
        "contact frames of a round, one thread, into one batch": our_frames(1, batch),
    }
    windows = {
        "all 7 frames of each contact (default)": our_windows(None),
        "all 7 frames of each contact, one thread": our_windows(1),
    }
    count = TOUCHES
    for theirs, in_memory, works, repeats, least in (
        (their_frames, memory_frames, frames, 15, 5),
        (their_windows, memory_windows, windows, 5, 0),
    ):
        theirs_s, plain_s, *ours_s = medians_in_turn_s([theirs, in_memory, *works.values()], repeats)
        peers = {
            "plain": (plain_s, f"{IN_MEMORY}, `torchcodec`"),
            "limit": (decoding_s * count, "decoder alone, one thread"),
        }
        for what, taken_s in zip(works, ours_s, strict=True):
            line(what, taken_s, theirs_s, least, **peers)
        count *= 7


def bench_poses(ours: Any, published: Any, folder: Path) -> None:
    """All poses of one round."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ["gel_pose_cell_frame_seq.position", "gel_pose_cell_frame_seq.quaternion"]
    files = sorted((folder / "data").glob("*.parquet"))
    table = pa.concat_tables([pq.read_table(file, columns=names) for file in files]).combine_chunks()

    def memory_poses() -> Any:
        return [
            column.chunk(0).slice(0, 1).flatten().flatten().flatten().to_numpy().copy()
            for column in table.columns
        ]

    def our_poses() -> Any:
        poses = ours[0].gel_pose_cell_frame_seq
        return poses.position_m, poses.quaternion

    line(
        "all poses of a round as arrays",
        median_s(our_poses, 100),
        median_s(lambda: published[0].gel_pose_cell_frame_seq, 3),
        300,
        plain=(median_s(memory_poses, 100), "columns of pyarrow in memory, unchecked"),
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
