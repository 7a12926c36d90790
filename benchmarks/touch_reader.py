"""Whether touches of ours teach a reader of digits as much as the environment's own.

Usage: python benchmarks/touch_reader.py [WORK]

Three sets of depth touches of the same training digits: random episodes of the registered environment as it
is, with OpenGL; the same with ``renderer="fast"``; and a set that ``tactile_sim.generate`` wrote with its
default plan. One network, one recipe and the same seeds learn from each, and are tested on the environment's
own touches of held-back digits: one touch alone, and the 16 of an episode together (sums of log
probabilities). WORK keeps the data sets between runs.
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
from typing import Any

import numpy as np
import torch
from torch import nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import env_assets
import mnist3d
import realtouch
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource

ENV_ID, STEPS, SIDE_BY_SIDE = "TactileMNIST-Depth-{}-v0", 16, 16
TRAIN_EPISODES, TEST_EPISODES, EPOCHS, SEEDS = 1024, 512, 4, range(3)


def episodes(
    provider: Any, split: str, renderer: str, count: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Images (episodes, STEPS, 64, 64) and labels of random episodes."""
    env = env_assets.make(ENV_ID.format(split), provider=provider, num_envs=SIDE_BY_SIDE, renderer=renderer)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    images, labels = [], []
    for _ in range(count // SIDE_BY_SIDE):
        labels.append([point.label for point in env.unwrapped.current_data_points])
        steps = [env.step(env.action_space.sample()) for _ in range(STEPS)]
        assert all(steps[-1][2] | steps[-1][3]), "an episode was expected to end here"
        images.append(np.stack([step[0]["sensor_img"][..., 0] for step in steps], axis=1))
        env.step(env.action_space.sample())  # begins the next episode, whatever the action
    env.close()
    return np.concatenate(images), np.concatenate(labels)


def kept(file: Path, make: Callable[[], tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Make a data set, or take it from an earlier run."""
    if not file.exists():
        images, labels = make()
        np.savez(file, images=images, labels=labels)
    with np.load(file) as stored:
        return stored["images"], stored["labels"]


def written(digits: Path, out: Path, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Touches of a set that was written for the same digits, as images and labels of rounds."""
    plan = tactile_sim.TouchPlan(rounds, STEPS)
    tactile_sim.generate(
        str(digits), tactile_sim.GenerateSpec((64, 64), "depth", plan=plan), str(out), ["train"]
    )
    found = realtouch.load(str(out), split="train")
    images = np.stack([np.stack([each.sensor_image[k][..., 0] for k in range(STEPS)]) for each in found])
    return images.astype(np.float32) / 255, np.array([each.label for each in found])


def reader(seed: int) -> nn.Module:
    torch.manual_seed(seed)
    layers: list[nn.Module] = [nn.AvgPool2d(2)]
    for before, after in ((1, 16), (16, 32), (32, 64)):
        layers += [nn.Conv2d(before, after, 5, stride=2, padding=2), nn.BatchNorm2d(after), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten(), nn.Dropout(0.3), nn.Linear(1024, 10))


def learn(images: np.ndarray, labels: np.ndarray, seed: int) -> nn.Module:
    net = reader(seed)
    x = torch.from_numpy(images.reshape(-1, 1, 64, 64))
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
    """Percent of single touches, and of episodes, that are read rightly."""
    x = torch.from_numpy(images.reshape(-1, 1, 64, 64))
    said = torch.cat([net(part).log_softmax(1) for part in x.split(512)]).reshape(*images.shape[:2], 10)
    y = torch.from_numpy(labels)
    single = (said.argmax(2) == y[:, None]).float().mean()
    return 100 * float(single), 100 * float((said.sum(1).argmax(1) == y).float().mean())


def main() -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(sys.argv[1] if len(sys.argv) > 1 else folder)
        digits = work / "digits"
        mnist3d.generate(mnist3d.GenerateSpec(SyntheticSource(), per_class=100), digits, ["train", "test"])
        provider = env_assets.AssetProvider(places={"mnist3d": str(digits)})
        test = kept(work / "test.npz", lambda: episodes(provider, "test", "opengl", TEST_EPISODES, 100))
        sources = {
            name: kept(
                work / f"{name}.npz", lambda name=name: episodes(provider, "train", name, TRAIN_EPISODES, 0)
            )
            for name in ("fast", "opengl")
        }
        sources["written set"] = written(digits, work / "touches", 1)
        for name, (images, labels) in sources.items():
            start_s, found = time.process_time(), []
            for seed in SEEDS:
                found.append(accuracies(learn(images, labels, seed), *test))
            single, together = np.array(found).T
            print(
                f"{name}: {images.shape[0] * images.shape[1]:,} touches learned; single touch "
                f"{single.mean():.1f} +- {single.std(ddof=1):.1f} %, episode {together.mean():.1f} +- "
                f"{together.std(ddof=1):.1f} % ({time.process_time() - start_s:.0f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
