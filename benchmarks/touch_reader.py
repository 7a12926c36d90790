"""Whether touches of ours teach a reader of digits as much as the environment's own.

Usage: python benchmarks/touch_reader.py [WORK]

Depth touches of the same training digits, 16 places on each, turned and shifted as in the environments, drawn
with other seeds: rendered by the renderer of the environments with OpenGL, and as a set that
``tactile_sim.generate`` wrote. One network and the same seeds learn from each in the same way, and are tested
on touches of held-back digits by the renderer of the environments: one touch alone, and the 16 of a digit
together (sums of log probabilities). WORK keeps the data sets between runs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("LP_NUM_THREADS", "0")

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mnist3d
import realtouch
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.sets.round_plan import plan_round
from tests.tactile_sim.oracle import GEL_M, PRESS_M, Oracle

TOUCHES, TEST_EVERY, EPOCHS, SEEDS = 16, 2, 5, range(3)


def published(digits: Path, split: str, seed: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Levels (digits, TOUCHES, 64, 64), uint8, as the environments render them, and labels."""
    oracle, plan = Oracle(64, 64), tactile_sim.TouchPlan(1, TOUCHES, "object", seed=seed)
    images, labels = [], []
    for record in mnist3d.load(str(digits), split)[::every]:
        solid, mesh = tactile_sim.Pressable.of(record, check=False), record.mesh
        drawn = plan_round(plan, solid, split, record.id, 0)
        for pose, place in zip(drawn.object_poses, drawn.positions_m, strict=False):
            depth_m, _ = oracle.depth_m(mesh, pose, tactile_sim.pose(*place))
            images.append(np.rint(255 * (depth_m.clip(PRESS_M, GEL_M) - PRESS_M) / (GEL_M - PRESS_M)))
        labels.append(record.label)
    return np.array(images, np.uint8).reshape(-1, TOUCHES, 64, 64), np.array(labels)


def kept(file: Path, make: Callable[[], tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Make a data set, or take it from an earlier run."""
    if not file.exists():
        images, labels = make()
        np.savez(file, images=images, labels=labels)
    with np.load(file) as stored:
        return stored["images"], stored["labels"]


def written(digits: Path, out: Path, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Give the same of a set that was written."""
    plan = tactile_sim.TouchPlan(1, TOUCHES, "object", seed=seed)
    spec = tactile_sim.TouchSetSpec((64, 64), "depth", plan=plan)
    tactile_sim.generate(str(digits), spec, str(out), ["train"])
    found = realtouch.load(str(out), split="train")
    return np.stack([each.sensor_image[:][..., 0] for each in found]), np.array(
        [each.label for each in found]
    )


def reader(seed: int) -> nn.Module:
    torch.manual_seed(seed)
    layers: list[nn.Module] = [nn.AvgPool2d(2)]
    for before, after in ((1, 16), (16, 32), (32, 64)):
        layers += [nn.Conv2d(before, after, 5, stride=2, padding=2), nn.BatchNorm2d(after), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten(), nn.Dropout(0.3), nn.Linear(1024, 10))


def learn(images: np.ndarray, labels: np.ndarray, seed: int) -> nn.Module:
    net = reader(seed)
    x = torch.from_numpy(images.reshape(-1, 1, 64, 64) / np.float32(255))
    y = torch.from_numpy(np.repeat(labels, images.shape[1]))
    steps = EPOCHS * (len(x) // 128)
    optimiser = torch.optim.AdamW(net.parameters(), 2e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)
    generator = torch.Generator().manual_seed(seed)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(x), generator=generator).split(128)[: len(x) // 128]:
            optimiser.zero_grad()
            nn.functional.cross_entropy(net(x[batch]), y[batch]).backward()
            optimiser.step()
            schedule.step()
    return net.eval()


@torch.no_grad()
def accuracies(net: nn.Module, images: np.ndarray, labels: np.ndarray) -> tuple[float, float]:
    """Percent of single touches, and of digits, that are read rightly."""
    x = torch.from_numpy(images.reshape(-1, 1, 64, 64) / np.float32(255))
    said = torch.cat([net(part).log_softmax(1) for part in x.split(512)]).reshape(*images.shape[:2], 10)
    y = torch.from_numpy(labels)
    single = (said.argmax(2) == y[:, None]).float().mean()
    return 100 * float(single), 100 * float((said.sum(1).argmax(1) == y).float().mean())


def main() -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(sys.argv[1] if len(sys.argv) > 1 else folder)
        digits = work / "digits"
        mnist3d.generate(mnist3d.DigitSetSpec(SyntheticSource(), per_class=100), digits, ["train", "test"])
        test = kept(work / "test.npz", lambda: published(digits, "test", 100, TEST_EVERY))
        sources = {
            "the environments' renderer": kept(work / "train.npz", lambda: published(digits, "train", 1)),
            "a written set": written(digits, work / "touches", 2),
        }
        print(f"tested on {test[0].shape[0] * TOUCHES:,} touches of {len(test[1])} digits", flush=True)
        for name, (images, labels) in sources.items():
            start_s, found = time.process_time(), []
            for seed in SEEDS:
                found.append(accuracies(learn(images, labels, seed), *test))
            single, together = np.array(found).T
            print(
                f"{name}: {images.shape[0] * images.shape[1]:,} touches learned; single touch "
                f"{single.mean():.1f} +- {single.std(ddof=1):.1f} %, digit {together.mean():.1f} +- "
                f"{together.std(ddof=1):.1f} % ({time.process_time() - start_s:.0f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
