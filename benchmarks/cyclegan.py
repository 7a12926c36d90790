"""Learned rendering on a domain whose truth is known (extras torch, env, sim): figures for README.md here.

The published generator's pictures, with sensor noise, stand for real touches: what depth belongs to each of
them is known, though no training sees it. A small CycleGAN is trained on them, without pairs, on one core;
then ``tactile-sim evaluate`` compares it with Taxim and with weights that were never trained, and what both
generators make is compared with the truth. Stopped, the same command goes on.

    python benchmarks/cyclegan.py WORK [--steps 3600]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch

import realtouch
from tactile_sim import as_environment
from tactile_sim.learned.checkpoints import DEPTH_WEIGHTS, TOUCH_WEIGHTS
from tactile_sim.learned.config import TrainConfig
from tactile_sim.learned.networks import Generator, initialise, weights_of
from tactile_sim.learned.training import train
from tactile_sim.learned.weights import GeneratorWeights, published_weights, read_weights, write_weights
from tactile_sim.optics.cyclegan import CycleganDepth, CycleganOptics
from tactile_sim.optics.taxim import TaximOptics
from tactile_sim.pairs.reading import Pairs
from tactile_toolkit.store.folder import DataFolder

SIZE = (64, 64)
# In fewer pixels the published network shows hardly any relief; what it makes here is scaled down.
RENDERED = (128, 128)
CONTACT_M = 0.006
SMALL = {
    "filters": 12,
    "blocks": 3,
    "judge_filters": 32,
    "batch": 4,
    "crop": 1.0,
    # Without these three, depth hides in faint dots, and real touches are said to be empty.
    "depth_cycle_weight": 6.0,
    "touch_cycle_weight": 40.0,
    "noise": 0.08,
    "identity_weight": 0.0,
    "learning_rate": 3e-4,
}
SETS = (("train", 64, 12, 280, 0.1), ("test", 60, 12, 360, 0.3))


def run(module: str, *arguments: object) -> None:
    """Run a command of the toolkit."""
    subprocess.run([sys.executable, "-m", module, *map(str, arguments), "-w", "1", "-q"], check=True)


def make(work: Path, split: str, objects: int, touches: int, count: int, empty: float) -> None:
    """Make objects, depth of touches, the same touches as a sensor shows them, and pairs."""
    made = work / f"digits-{split}"
    run("mnist3d", "generate", "--source", "synthetic", "--split", split, "--limit", objects, "--out", made)
    where = ("--split", split, "--rounds", 1, "--touches", touches, "--seed", 11, "--format", "png")
    learned = ("64x64", "--optics", "cyclegan", "--weights", work / "published.npz", "--noise", "calibrated")
    for name, how in (("truth", ("64x64", "--optics", "depth")), ("real", learned)):
        run("tactile_sim", "generate", made, *where, "--out", work / f"{name}-{split}", "--size", *how)
    run(
        "tactile_sim", "pairs", made, "--real", work / f"real-{split}", "--split", split, "--size", "64x64",
        "--count", count, "--without-contact", empty, "--like", "environment",
        "--out", work / f"pairs-{split}",
    )  # fmt: skip


def truth(work: Path) -> None:
    """Print how far both directions are from the truth on touches with contact of the test split."""
    touches, depths = (realtouch.load(work / f"{name}-test", "test").touches() for name in ("real", "truth"))
    met = np.flatnonzero(touches.heights_m() >= CONTACT_M)
    pictures = touches.images()[met]
    depth = depths.images()[met][..., 0].astype(np.float32) / 255
    untrained = Generator(SMALL["filters"], SMALL["blocks"])
    initialise(untrained, 0)
    write_weights(DataFolder(str(work)), "untrained.npz", weights_of(untrained, SIZE))
    sensor = as_environment(*SIZE)
    depth_m = sensor.press_m + depth.astype(np.float64) * (sensor.gel_m - sensor.press_m)
    weights = work / "weights"
    seen = Pairs.open(str(work / "pairs-train"))
    usual_touch = np.median(seen.real.images(np.flatnonzero(seen.real.contact)), axis=0)
    for name, found in (
        ("trained", CycleganDepth(weights / DEPTH_WEIGHTS).images(pictures, SIZE)),
        ("untrained", CycleganDepth(work / "untrained.npz").images(pictures, SIZE)),
        ("no contact anywhere", np.ones_like(depth)),
    ):
        off_um = 1e6 * (sensor.gel_m - sensor.press_m) * np.abs(found - depth).mean(axis=(1, 2))
        error = off_um.std() / np.sqrt(len(off_um))
        alike = np.corrcoef(found.ravel(), depth.ravel())[0, 1] if np.ptp(found) else 0.0
        print(f"depth of real touches, {name}: {off_um.mean():.0f} ± {error:.0f} um, correlation {alike:.2f}")
    for name, shown in (
        ("trained", CycleganOptics(weights / TOUCH_WEIGHTS).render(depth_m, sensor, SIZE)),
        ("taxim", TaximOptics().render(depth_m, sensor, SIZE)),
        ("untrained", CycleganOptics(work / "untrained.npz").render(depth_m, sensor, SIZE)),
        ("median touch", usual_touch[None]),
    ):
        off = np.abs(shown.astype(np.float64) - pictures).mean()
        print(f"pictures of true depth, {name}: {off:.1f} levels")


def main() -> None:
    asked = argparse.ArgumentParser()
    asked.add_argument("work", type=Path)
    asked.add_argument("--steps", type=int, default=3600)
    options = asked.parse_args()
    work: Path = options.work
    work.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    published = read_weights(published_weights("touch"))
    write_weights(DataFolder(str(work)), "published.npz", GeneratorWeights(published.arrays, RENDERED))
    for split, *each in SETS:
        if not (work / f"pairs-{split}" / "README.md").exists():
            make(work, split, *each)
    started = time.perf_counter(), time.process_time()
    done = train(
        str(work / "pairs-train"),
        work / "weights",
        TrainConfig(**SMALL, steps=options.steps, checkpoint_every=200),
        device="cpu",
        deterministic=True,
    )
    taken_s, computed_s = time.perf_counter() - started[0], time.process_time() - started[1]
    print(f"{done.taken} steps: {taken_s:.0f} s, {computed_s:.0f} s of processor time; {done.losses}")
    evaluation = [work / "weights", "--pairs", work / "pairs-test", "--out", work / "evaluation"]
    subprocess.run([sys.executable, "-m", "tactile_sim", "evaluate", *map(str, evaluation)], check=True)
    truth(work)


if __name__ == "__main__":
    main()
