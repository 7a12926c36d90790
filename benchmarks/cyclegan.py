"""Learned rendering on a domain whose truth is known (extras torch, env, sim): figures for README.md here.

The published generator's pictures, with sensor noise, stand for real touches: what depth belongs to each of
them is known, though no training sees it. A small CycleGAN is trained on them, without pairs, on one core;
then ``tactile-sim evaluate`` compares it with Taxim and with weights that were never trained.

    python benchmarks/cyclegan.py WORK [--steps 6000]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tactile_sim.learned.weights import GeneratorWeights, published_weights, read_weights, write_weights
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.touch.jpeg import decode_image, encode_image

# tactile-mnist 0.13.0, SensorNoiseConfig: frame noise, and gain and offset of a round.
FRAME_STD, GAIN_STD, OFFSET_STD = 0.0038, 0.047, 0.0094
SIZE = (64, 64)
SMALL = {
    "filters": 12,
    "blocks": 2,
    "judge_filters": 12,
    "crop": 0.75,
    "identity_weight": 0.0,
    "learning_rate": 4e-4,
}


def tactile_sim(*arguments: object) -> None:
    """Run a command of the toolkit."""
    subprocess.run([sys.executable, "-m", "tactile_sim", *map(str, arguments)], check=True)


def digits(work: Path, split: str, count: int) -> None:
    """Make the objects, where they are not there yet."""
    command = [sys.executable, "-m", "mnist3d", "generate", "--source", "synthetic", "--split", split]
    command += ["--limit", str(count), "--out", str(work / f"digits-{split}"), "-w", "1", "-q"]
    subprocess.run(command, check=True)


def real(work: Path, split: str, touches: int, weights: Path) -> None:
    """Render with the published network, and add what a sensor adds."""
    clean = work / f"clean-{split}"
    tactile_sim(
        "generate", work / f"digits-{split}", "--split", split, "--rounds", 1, "--touches", touches,
        "--size", "64x64",
        "--optics", "cyclegan", "--weights", weights, "--format", "png", "--seed", 11, "--out", clean,
        "-w", 1,
    )  # fmt: skip
    out = work / f"real-{split}" / "data" / f"{split}-00000-of-00001.parquet"
    out.parent.mkdir(parents=True, exist_ok=True)
    table = pq.read_table(clean / "data" / f"{split}-00000-of-00001.parquet")
    rng = np.random.default_rng(5)
    rows = []
    for images in table.column("sensor_image").to_pylist():
        gain, offset = 1 + GAIN_STD * rng.normal(), OFFSET_STD * rng.normal()
        rows.append([{**each, "bytes": noisy(each["bytes"], gain, offset, rng)} for each in images])
    field = table.schema.get_field_index("sensor_image")
    pq.write_table(
        table.set_column(field, table.schema.field(field), pa.array(rows, table.schema.field(field).type)),
        out,
    )


def noisy(data: bytes, gain: float, offset: float, rng: np.random.Generator) -> bytes:
    shades = decode_image(data) / 255
    mean = shades.mean()
    seen = mean + (shades - mean) * gain + offset + FRAME_STD * rng.normal(size=shades.shape)
    return encode_image(np.rint(255 * seen.clip(0, 1)).astype(np.uint8), "png")


def main() -> None:
    asked = argparse.ArgumentParser()
    asked.add_argument("work", type=Path)
    asked.add_argument("--steps", type=int, default=6000)
    options = asked.parse_args()
    work: Path = options.work
    work.mkdir(parents=True, exist_ok=True)
    weights = work / "published-64.npz"
    published = read_weights(published_weights("touch"))
    write_weights(DataFolder(str(work)), weights.name, GeneratorWeights(published.arrays, SIZE))
    for split, objects, touches, count, empty in (("train", 60, 12, 300, 0.3), ("test", 40, 5, 80, 0.4)):
        digits(work, split, objects)
        if not (work / f"pairs-{split}" / "README.md").exists():
            real(work, split, touches, weights)
            tactile_sim(
                "pairs", work / f"digits-{split}", "--real", work / f"real-{split}", "--split", split,
                "--size", "64x64", "--count", count, "--without-contact", empty, "--like", "environment",
                "--out", work / f"pairs-{split}", "-w", 1,
            )  # fmt: skip
    started = time.perf_counter()
    small = [f"--{name.replace('_', '-')}={value}" for name, value in SMALL.items()]
    steps = options.steps
    tactile_sim(
        "train", work / "pairs-train", "--out", work / "weights", "--steps", steps, *small,
        "--checkpoint-every", 100, "--device", "cpu", "--deterministic",
    )  # fmt: skip
    tactile_sim("evaluate", work / "weights", "--pairs", work / "pairs-test", "--out", work / "evaluation")
    print(f"trained {steps} steps in {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
