"""Learned rendering on a domain whose truth is known (extras torch, oracle, sim): figures for README.md here.

No real touch is involved: pictures of the published generator, with sensor noise, stand for real touches. The
depth of each of them is known, though no training sees it. A small CycleGAN is trained on them, without
pairs, on one core. Then it is compared with Taxim and with weights that were never trained, and what both
generators make is compared with the truth. The published inverse reads pictures of the published generator in
their own size, 256 pixels. After an interruption, the same command continues.

    python benchmarks/cyclegan.py WORK [--steps N]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch
from learned_measures import add_noise_per_object, depth_from, print_measures, two_sample_test
from numpy.typing import NDArray
from PIL import Image

import realtouch
from tactile_sim import center_view
from tactile_sim.learned.generators import (
    PUBLISHED_SIZE_PX,
    CycleganOptics,
    GeneratorNetwork,
    GeneratorWeights,
    initialise,
    make_generator,
    published_weights,
    read_weights,
    weights_of,
    write_weights,
)
from tactile_sim.learned.training import DEPTH_WEIGHTS, TOUCH_WEIGHTS, train
from tactile_sim.optics.rendering import scaled
from tactile_sim.optics.sensor_noise import SensorNoise
from tactile_sim.optics.taxim import TaximOptics
from tactile_sim.sets.pairs import Pairs
from tactile_sim.sets.set_options import TrainConfig, TrainRun
from tactile_toolkit.store import open_folder

SIZE = (64, 64)
# In fewer pixels the published network shows hardly any relief; what it makes here is scaled down.
RENDERED = (128, 128)
CONTACT_M = 0.006
RELIEF_LEVELS = 4
SMALL = {
    "filters": 12,
    "blocks": 3,
    "discriminator_filters": 32,
    "batch": 2,
    "crop": 1.0,
    # Pairs by simulation first: pictures that are not paired do not say where in them relief belongs.
    "pretrain_steps": 2500,
    # Without these three, depth hides in faint dots, and touches are read as empty.
    "depth_cycle_weight": 10.0,
    "touch_cycle_weight": 40.0,
    "noise": 0.06,
    # Touches of the sensor differ by noise from all that is made without it; at first fine detail does, too.
    "sensor_noise": SensorNoise.calibrated(),
    "discriminator_noise": 0.06,
    "identity_weight": 0.0,
    "learning_rate": 3e-4,
}
STEPS = 7_000
# Split, objects, touches of each, pictures of each kind.
SETS = (("train", 400, 12, 2300), ("test", 160, 12, 960))
WITHOUT_CONTACT = 0.25
# Objects whose touches the published networks make and read in their own size, at seconds for each touch.
PEER_OBJECTS = 24


def run(module: str, *arguments: object) -> None:
    """Run a command of the toolkit."""
    subprocess.run([sys.executable, "-m", module, *map(str, arguments), "-w", "1", "-q"], check=True)


def make(work: Path, split: str, objects: int, touches: int, count: int) -> None:
    """Make objects, depth of touches, the same touches as a sensor shows them, and pairs."""
    made = work / f"digits-{split}"
    run("mnist3d", "generate", "--source", "synthetic", "--split", split, "--limit", objects, "--out", made)
    touch(work, split, "--touches", touches, "--size", "64x64", weights=("--weights", work / "published.npz"))
    run(
        "tactile_sim", "pairs", made, "--real", work / f"noisy-{split}", "--split", split, "--size", "64x64",
        "--count", count, "--without-contact", WITHOUT_CONTACT, "--window", "center",
        "--min-height-mm", 1e3 * CONTACT_M, "--out", work / f"pairs-{split}",
    )  # fmt: skip


def touch(work: Path, split: str, *options: object, own: str = "", weights: tuple[object, ...] = ()) -> None:
    """Make touches by the published generator, with and without noise, and their depth."""
    learned = ("--optics", "cyclegan", *weights)
    renderings = {
        "truth": ("--optics", "depth"),
        "noisy": (*learned, "--sensor-noise", "calibrated"),
        "clean": learned,
    }
    for name, rendering in renderings.items():
        if (name, split) != ("clean", "train"):
            run(
                "tactile_sim", "generate", work / f"digits-{split}", "--split", split, "--rounds", 1,
                "--seed", 11, "--image-format", "png", *options, *rendering,
                "--out", work / f"{own}{name}-{split}",
            )  # fmt: skip


class Known:
    """Touches with contact of the test split: those with noise, the same without, and their depth."""

    def __init__(self, work: Path, own: str = "") -> None:
        touches = {
            name: realtouch.load(work / f"{own}{name}-test", "test").touches()
            for name in ("noisy", "clean", "truth")
        }
        met = np.flatnonzero(touches["noisy"].heights_m() >= CONTACT_M)
        self.noisy, self.clean, depth = (touches[name].images()[met] for name in ("noisy", "clean", "truth"))
        self.depth = depth[..., 0].astype(np.float32) / 255
        self.objects = touches["noisy"].object_ids[met]


def moved(depth: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """Return depth images that lie somewhere else; what comes in is like the border."""
    reach = max(abs(down), abs(right))
    wide = np.pad(depth, ((0, 0), (reach, reach), (reach, reach)), mode="edge")
    width, height = SIZE
    return wide[:, reach - down : reach - down + height, reach - right : reach - right + width]


def depth_again(weights: Path, pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the depth images that a file of weights reads from pictures, whatever size it was trained in."""
    read = read_weights(weights)
    in_trained_size = scaled(pictures, read.size_px)
    depths = depth_from(make_generator(read), in_trained_size)
    return np.stack([resized_depth(depth, SIZE) for depth in depths])


def resized_depth(depth: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Scale a depth image."""
    return np.asarray(Image.fromarray(depth).resize(size, Image.Resampling.BICUBIC))


def depth_errors(known: Known, work: Path) -> tuple[int, int]:
    """Print how far depth that is read from touches with noise is from the truth; return its best move."""
    trained = depth_again(work / "weights" / DEPTH_WEIGHTS, known.noisy)
    # Nothing in pictures that are not paired says that depth and relief lie at the same place.
    reach = range(-10, 11)
    even, odd = slice(0, None, 2), slice(1, None, 2)
    moves = [(down, right) for down in reach for right in reach]
    offs = [np.abs(moved(trained[even], *move) - known.depth[even]).mean() for move in moves]
    best = moves[int(np.argmin(offs))]
    for name, estimate, truth in (
        ("trained", trained, known.depth),
        (f"trained, moved by {best} pixels", moved(trained[odd], *best), known.depth[odd]),
        ("untrained", depth_again(work / "untrained.npz", known.noisy), known.depth),
        ("no contact anywhere", np.ones_like(known.depth), known.depth),
    ):
        print_depth_error(name, estimate, truth)
    return best


def peer_errors(work: Path) -> None:
    """Print the same of the published inverse, at its best: in the size that it was trained in."""
    known = Known(work, "own-")
    inverse = make_generator(read_weights(published_weights("depth")))
    for name, pictures in (("with noise", known.noisy), ("without noise", known.clean)):
        estimate = depth_from(inverse, pictures)
        print_depth_error(f"published inverse, 256 pixels, {name}", estimate, known.depth)


def print_depth_error(name: str, estimate: NDArray[np.float32], truth: NDArray[np.float32]) -> None:
    """Print the mean distance of depth images from the truth, its standard error, and their correlation."""
    sensor = center_view(*SIZE)
    off_um = 1e6 * (sensor.gel_m - sensor.press_m) * np.abs(estimate - truth).mean(axis=(1, 2))
    error = off_um.std() / np.sqrt(len(off_um))
    alike = np.corrcoef(estimate.ravel(), truth.ravel())[0, 1] if np.ptp(estimate) else 0.0
    print(
        f"depth of {len(truth)} touches, {name}: {off_um.mean():.0f} ± {error:.0f} um, "
        f"correlation {alike:.2f}"
    )


def picture_errors(known: Known, work: Path, move: tuple[int, int]) -> None:
    """Print how far pictures of true depth are from those of the published network."""
    sensor = center_view(*SIZE)
    back = moved(known.depth, -move[0], -move[1])
    depth_m, back_m = (
        sensor.press_m + depth.astype(np.float64) * (sensor.gel_m - sensor.press_m)
        for depth in (known.depth, back)
    )
    trained = CycleganOptics(work / "weights" / TOUCH_WEIGHTS)
    pairs = Pairs.open(str(work / "pairs-train"))
    usual = np.median(pairs.real.images(np.flatnonzero(pairs.real.contact)), axis=0)
    # Where the gel is far from level; most of a picture is background.
    relief = np.abs(known.clean - np.median(known.clean, axis=0)).mean(axis=-1) > RELIEF_LEVELS
    for name, shown in (
        ("trained", trained.render(depth_m, sensor, SIZE)),
        ("trained, of depth moved back", trained.render(back_m, sensor, SIZE)),
        ("taxim", TaximOptics().render(depth_m, sensor, SIZE)),
        ("untrained", CycleganOptics(work / "untrained.npz").render(depth_m, sensor, SIZE)),
        ("median touch", usual[None]),
        ("the published network", known.clean),
    ):
        off = np.abs(shown.astype(np.float64) - known.clean).mean(axis=-1)
        noisy = np.abs(shown.astype(np.float64) - known.noisy).mean()
        print(
            f"pictures of true depth, {name}: {off.mean():.2f} levels, {off[relief].mean():.1f} on relief "
            f"({100 * relief.mean():.0f} % of pixels), {noisy:.2f} against pictures with noise"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("work", type=Path)
    parser.add_argument("--steps", type=int, default=STEPS)
    options = parser.parse_args()
    work: Path = options.work
    work.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    arrays = read_weights(published_weights("touch")).arrays
    write_weights(open_folder(str(work)), "published.npz", GeneratorWeights(arrays, RENDERED))
    for split, *counts in SETS:
        if not (work / f"pairs-{split}" / "README.md").exists():
            make(work, split, *counts)
    size = "{}x{}".format(*PUBLISHED_SIZE_PX)
    touch(work, "test", "--limit", PEER_OBJECTS, "--touches", SETS[1][2], "--size", size, own="own-")
    peer_errors(work)
    config = TrainConfig(**SMALL, steps=options.steps, checkpoint_every=500)
    started = time.perf_counter(), time.process_time()
    done = train(str(work / "pairs-train"), work / "weights", config, TrainRun("cpu", deterministic=True))
    taken_s, computed_s = time.perf_counter() - started[0], time.process_time() - started[1]
    print(f"{done.taken} steps: {taken_s:.0f} s, {computed_s:.0f} s of processor time; {done.losses}")
    for name, noise in (("calibrated", SensorNoise.calibrated()), ("no", None)):
        print(f"generated images with {name} noise:")
        print_measures(work / "weights", str(work / "pairs-test"), noise)
    untrained = GeneratorNetwork(config.filters, config.blocks)
    initialise(untrained, 0)
    write_weights(open_folder(str(work)), "untrained.npz", weights_of(untrained, SIZE))
    known = Known(work)
    picture_errors(known, work, depth_errors(known, work))
    # What a generator without any fault would reach.
    other = add_noise_per_object(known.clean, known.objects, SensorNoise.calibrated(), 0)
    share, error = two_sample_test((known.noisy, known.objects), (other, known.objects), 0)
    print(f"two-sample test under other noise: {100 * share:.1f} ± {100 * error:.1f} %")


if __name__ == "__main__":
    main()
