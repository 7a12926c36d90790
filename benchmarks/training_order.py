"""The order of training beside the plain pass over the same shards of touches, beside `datasets`, and beside
what an expert would write for a set that fits into memory.

::

    python benchmarks/training_order.py [--folder SET] [--shards 20] [--rounds 2]

Everything runs on one thread of one process, in turn, and is given in processor time per touch: a batch of
images and labels as tensors. Reported are medians of the turns; next to them what decoding alone takes, the
least possible. What lies in the cache was unpacked before, as in every epoch but the first, which is a
line of its own.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from figures import tell
from plain_ways import IN_MEMORY, pixels, stored_media

BATCH = 64
TOUCHES = 256
BUFFER_ROUNDS = 64
"""What `datasets` mixes: as many rounds as a window of ours holds, all of them decoded."""


def make_set(folder: Path, shards: int, rounds: int) -> None:
    """Write shards of rounds in the published schema, 64x64, in row groups of two rounds."""
    from tests.realtouch import factories as f

    layout = f.Layout(shards=shards, group_rows=2)
    truths = [f.make_round(index, 16, (64, 64), (4, 5), noise=1.5) for index in range(shards * rounds)]
    rows = f.single_rows(truths, partial(f.encode_jpeg, quality=75))
    f.write_set(folder, {"train": [_repeated(row) for row in rows]}, "single", layout)


def _repeated(row: dict[str, Any]) -> dict[str, Any]:
    longer = {}
    for name, values in row.items():
        per_touch = isinstance(values, (list, np.ndarray)) and not name.startswith("info.")
        longer[name] = [values[index % len(values)] for index in range(TOUCHES)] if per_touch else values
    longer["pos_in_cell"] = np.asarray(longer["pos_in_cell"])
    return longer


def touches_given(batches: Iterator[Any]) -> int:
    """Take all batches; return how many touches they held."""
    return sum(len(labels) for _, labels in batches)


def streamed(folder: Path) -> Iterator[Any]:
    """Batches of `datasets` streaming: rounds of this rank, shuffled by its buffer, then touch by touch."""
    import torch
    from datasets import load_dataset
    from datasets.distributed import split_dataset_by_node

    rounds = load_dataset(str(folder), split="train", streaming=True)
    rounds = split_dataset_by_node(rounds.shuffle(seed=0, buffer_size=BUFFER_ROUNDS), rank=0, world_size=1)
    rounds = rounds.select_columns(["sensor_image", "label"])
    items: list[Any] = []
    for row in rounds:
        for image in row["sensor_image"]:
            items.append((torch.from_numpy(np.asarray(image)).permute(2, 0, 1), row["label"]))
            if len(items) == BATCH:
                yield torch.utils.data.default_collate(items)
                items = []
    if items:
        yield torch.utils.data.default_collate(items)


def in_memory(folder: Path) -> Iterator[Any]:
    """Batches of a column in memory in random order, decoded by Pillow."""
    import torch

    images = stored_media(folder, "sensor_image")
    labels = torch.zeros(len(images), dtype=torch.int64)
    order = np.random.default_rng(0).permutation(len(images))
    for start in range(0, len(order), BATCH):
        rows = order[start : start + BATCH].tolist()
        batch = np.stack([pixels(images, row) for row in rows])
        yield torch.from_numpy(batch).permute(0, 3, 1, 2).contiguous(), labels[rows]


def decoded(folder: Path) -> Iterator[Any]:
    """What any way to read these JPEGs does at least: each is decoded, into the same memory."""
    import realtouch
    from realtouch.touches.media import images_array
    from tactile_toolkit.touch import decode_image

    space = images_array(1, (64, 64))[0]
    for record in realtouch.load(folder, "train"):
        for touch in range(TOUCHES):
            decode_image(record.sensor_image.encoded(touch), space)
        yield space, range(TOUCHES)


def passes(folder: Path) -> dict[str, Callable[[], Iterator[Any]]]:
    """Return what is compared, by name."""
    import torch

    import realtouch
    from realtouch.touch_tensors import TouchTensors, TrainingBatches

    tensors = TouchTensors(realtouch.load(folder, "train"))
    channels_last = TouchTensors(tensors.touches, channels_last=True)
    return {
        "plain": lambda: iter(torch.utils.data.DataLoader(tensors, batch_size=BATCH)),
        "training": lambda: iter(TrainingBatches(tensors, BATCH)),
        "channels_last": lambda: iter(TrainingBatches(channels_last, BATCH)),
        "random": lambda: iter(torch.utils.data.DataLoader(tensors, batch_size=BATCH, shuffle=True)),
        "datasets": lambda: streamed(folder),
        "memory": lambda: in_memory(folder),
        "decoding": lambda: decoded(folder),
    }


def processor_s(work: Callable[[], Iterator[Any]]) -> float:
    """Return processor time per touch of one pass, all threads of this process together."""
    start = time.process_time()
    given = touches_given(work())
    return (time.process_time() - start) / given


def resume_s(folder: Path) -> tuple[float, float]:
    """Return the time to the first batch from the beginning of an epoch, and from near its end."""
    import realtouch
    from realtouch.touch_tensors import TouchTensors, TrainingBatches

    times = []
    for share in (0.0, 0.9):
        batches = TrainingBatches(TouchTensors(realtouch.load(folder, "train")), BATCH)
        state = batches.state_dict()
        batches.load_state_dict(state | {"batches": int(share * len(batches))})
        start = time.perf_counter()
        next(iter(batches))
        times.append(time.perf_counter() - start)
    return times[0], times[1]


def main() -> None:
    """Run everything."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--shards", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as temporary:
        os.environ["TACTILE_TOOLKIT_CACHE"] = str(Path(temporary) / "cache")
        os.environ["HF_DATASETS_CACHE"] = str(Path(temporary) / "hf")
        import torch

        torch.set_num_threads(1)
        folder = options.folder or Path(temporary) / "set"
        if not folder.is_dir():
            make_set(folder, options.shards, options.rounds)
        compared = passes(folder)
        touches_given(islice(compared["random"](), 1))  # imports what making tensors takes
        first_s = processor_s(compared["training"])
        turns = [{name: processor_s(work) for name, work in compared.items()} for _ in range(options.turns)]
        tell_turns(turns)
        tell("first_epoch", "the first epoch, which unpacks row groups meanwhile, a touch", first_s, "s")
        begun_s, resumed_s = resume_s(folder)
        tell("begun", "first batch of an epoch", begun_s, "s")
        tell("resumed", "first batch, resumed at nine tenths of an epoch", resumed_s, "s")


def tell_turns(turns: list[dict[str, float]]) -> None:
    """Tell medians, and how ratios differ from turn to turn."""
    medians = {name: statistics.median(turn[name] for turn in turns) for name in turns[0]}
    ways = {
        "datasets": "`datasets` streaming, its shuffle buffer",
        "memory": f"{IN_MEMORY}, Pillow",
        "plain": "here, in stored order",
        "random": "here, any touch at random",
    }
    for name, beside, what, target in (
        ("training", "datasets", "the order of training", 5),
        ("channels_last", "datasets", "the same in torch's `channels_last`", 5),
        ("training", "memory", "the order of training", 0),
        ("training", "plain", "the order of training", 0.8),
        ("training", "random", "the order of training", 0),
    ):
        ratios = [turn[beside] / turn[name] for turn in turns]
        tell(
            f"{name}_{beside}", f"a touch in {what}, batches of 64", medians[name], "s",
            statistic=f"median of {len(turns)}", plain=(medians[beside], ways[beside]),
            limit=(medians["decoding"], "decoder alone"), target=f"at least {target}" if target else "",
            note=f"{min(ratios):.1f} to {max(ratios):.1f} in {len(turns)} turns",
        )  # fmt: skip


if __name__ == "__main__":
    main()
