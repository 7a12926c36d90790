"""Train a reader of digits and policies of touching, in minutes on one core, and write their curves.

``python benchmarks/baseline/train.py --seed 0 --out runs/0`` makes digits on the first call, then

1. trains a reader of maps while a rule explores: go where the digit goes on and was not seen;
2. trains a second reader on random actions, from the first;
3. lets a policy imitate the rule on its own episodes until it does as well, then improves it by PPO, with the
   loss of the reader as the cost.

``result.json`` holds which digits of ``test`` were read after each touch, and how certainly; ``curves.py``
draws all seeds.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from networks import WAYS, Policy, chosen_of, trunk
from torch.nn import functional
from touch_map import OBJECT_CM, TouchMaps

import env_assets
import tactile_envs

gymnasium.register_envs(tactile_envs)
ID = "tactile_envs/TactileMNIST-Depth-{}-v0"
Act = Callable[[TouchMaps], np.ndarray]
"""From what was felt to ways (n, 2), in parts of the longest."""

_LINE_INTERVAL_S = 5.0

TOUCHES = 17
"""Touches of an episode; a prediction after the last one counts for nothing, so 16 are scored."""


class Player:
    """Plays whole episodes in all environments at once."""

    def __init__(self, assets: Path, split: str, count: int, seed: int) -> None:
        self.env = gymnasium.make_vec(ID.format(split), num_envs=count, assets=str(assets))
        self.count, self.maps = count, TouchMaps(count)
        self.random = np.random.default_rng(seed)
        self.observation, _ = self.env.reset(seed=seed)

    def play(self, act: Act, objects: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Play one episode; return maps (16, n, 3, 32, 32) around sensor and object, ways, labels (n,)."""
        maps = self.maps
        if objects is not None:
            self.observation, _ = self.env.reset(options={"datapoint_idx": list(objects)})
        maps.begin()
        found: dict[str, list[np.ndarray]] = {"maps": [], "centred": [], "ways": []}
        for touch in range(TOUCHES):
            maps.add(self.observation)
            if touch < TOUCHES - 1:
                found["maps"].append(maps.around_sensor())
                found["centred"].append(maps.centred())
            ways = act(maps)
            found["ways"].append(ways)
            way = np.zeros((self.count, 3), np.float32)
            way[:, :2] = ways
            prediction = np.zeros((self.count, 10), np.float32)
            if touch == TOUCHES - 1 and objects is not None:
                break
            step = {"action": {"sensor_target_pos_rel": way}, "prediction": prediction}
            self.observation, _, _, _, info = self.env.step(step)
            if touch == 0:
                labels = np.asarray(info["prediction"]["target"])
        return {**{name: np.stack(each) for name, each in found.items()}, "labels": labels}


def frontier(maps: TouchMaps) -> np.ndarray:
    """Go where the digit was met and not yet seen."""
    return maps.frontier()


def anywhere(random: np.random.Generator) -> Act:
    """Go in any direction, as a sample of the action space does."""
    return lambda maps: random.uniform(-1, 1, (len(maps.maps), 2)).astype(np.float32)


def tensor(maps: np.ndarray) -> torch.Tensor:
    """Return maps (..., 3, 32, 32) as one batch."""
    batch = torch.from_numpy(maps.reshape(-1, *maps.shape[-3:]))
    return batch.contiguous(memory_format=torch.channels_last)


@contextlib.contextmanager
def told(state: Callable[[], str]) -> Iterator[None]:
    """Print a state every few seconds, however long a step of the work takes."""
    over = threading.Event()

    def tell() -> None:
        while not over.wait(_LINE_INTERVAL_S):
            print(state(), flush=True)

    threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        over.set()


def phase(what: str, seconds: float) -> Iterator[float]:
    """Yield the share of the processor time of a phase that has passed."""
    began = time.process_time()

    def passed() -> float:
        return (time.process_time() - began) / seconds

    with told(lambda: f"{what:12} {min(passed(), 1):.0%} of {seconds / 60:.1f} minutes of training"):
        while (now := passed()) < 1:
            yield now


def train_reader(reader: torch.nn.Module, player: Player, act: Act, seconds: float, rate: float) -> int:
    """Train on the maps of episodes until the time is over; return how many touches that took."""
    optimiser = torch.optim.AdamW(reader.parameters(), rate, weight_decay=1e-2)
    touches = 0
    for passed in phase("reader", seconds):
        for group in optimiser.param_groups:
            group["lr"] = rate * min(1.0, 20 * passed + 0.05) * (0.5 + 0.5 * np.cos(np.pi * passed))
        episode = player.play(act)
        maps = tensor(episode["centred"])
        labels = torch.from_numpy(episode["labels"]).repeat(TOUCHES - 1)
        for chosen in torch.randperm(len(maps)).split(256):
            loss = functional.cross_entropy(reader(maps[chosen]), labels[chosen])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        touches += len(maps)
    return touches


def imitate(policy: Policy, player: Player, seconds: float) -> int:
    """Learn the ways of the rule where the policy itself goes."""
    optimiser = torch.optim.Adam(policy.body.parameters(), 1e-3)
    touches = 0
    for passed in phase("imitation", seconds):
        for group in optimiser.param_groups:
            group["lr"] = 1e-3 * (1 - passed) + 1e-5
        wanted: list[np.ndarray] = []

        def act(maps: TouchMaps, wanted: list[np.ndarray] = wanted, passed: float = passed) -> np.ndarray:
            wanted.append(maps.frontier())
            return wanted[-1] if passed < 0.1 else follow(policy)(maps)

        maps = tensor(player.play(act)["maps"])
        targets = chosen_of(torch.from_numpy(np.concatenate(wanted[: TOUCHES - 1])))
        for chosen in torch.randperm(len(maps)).split(256):
            loss = -policy(maps[chosen]).log_prob(targets[chosen]).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        touches += len(maps)
    return touches


def follow(policy: Policy, explore: bool = False) -> Act:
    """Go where the policy wants, or near it."""

    def act(maps: TouchMaps) -> np.ndarray:
        with torch.inference_mode():
            wanted = policy(tensor(maps.around_sensor()))
            return WAYS[wanted.sample() if explore else wanted.probs.argmax(1)].numpy()

    return act


def improve(policy: Policy, reader: torch.nn.Module, player: Player, seconds: float) -> int:
    """Improve a policy by PPO (clip 0.2, lambda 0.95); the reward is minus the loss of the reader."""
    optimiser = torch.optim.Adam(policy.parameters(), 3e-4)
    touches = 0
    for passed in phase("learned", seconds):
        for group in optimiser.param_groups:
            group["lr"] = 3e-4 * (1 - passed) + 1e-6
        # At first only the critic learns: the policy must not follow a wrong one away from the rule.
        learns = passed > 0.1
        episode = player.play(follow(policy, explore=True))
        maps, count = tensor(episode["maps"]), player.count
        labels = torch.from_numpy(episode["labels"]).repeat(TOUCHES - 1)
        ways = chosen_of(torch.from_numpy(episode["ways"][: TOUCHES - 2].reshape(-1, 2)))
        with torch.inference_mode():
            logits = reader(tensor(episode["centred"]))
            scores = -functional.cross_entropy(logits, labels, reduction="none").view(TOUCHES - 1, count)
            states = maps[: (TOUCHES - 2) * count]
            before = policy(states).log_prob(ways)
            values = policy.value(states).view(TOUCHES - 2, count)
        rewards = scores[1:]
        advantages = torch.zeros_like(rewards)
        last, value = torch.zeros(count), torch.zeros(count)
        for t in reversed(range(TOUCHES - 2)):
            last = rewards[t] + value - values[t] + 0.95 * last
            advantages[t], value = last, values[t]
        returns, gains = (advantages + values).reshape(-1), advantages.reshape(-1)
        gains = (gains - gains.mean()) / (gains.std() + 1e-6)
        for _ in range(2):
            for chosen in torch.randperm(len(states)).split(512):
                loss = 0.5 * (policy.value(states[chosen]) - returns[chosen]).square().mean()
                if learns:
                    ratio = (policy(states[chosen]).log_prob(ways[chosen]) - before[chosen]).exp()
                    gain = gains[chosen]
                    loss = loss - torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
                optimiser.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
                optimiser.step()
        touches += len(maps)
    return touches


def evaluate(reader: torch.nn.Module, player: Player, act: Act, digits: int) -> dict[str, np.ndarray]:
    """Return what was found after each touch, (digits, 16) each.

    ``right``: whether the digit was read; ``certainty``: how probable the reader held it; ``met``: whether it
    had been touched.
    """
    found: dict[str, list[np.ndarray]] = {"right": [], "certainty": [], "met": []}
    for first in range(0, digits, player.count):
        objects = np.arange(first, first + player.count) % digits
        episode = player.play(act, objects)
        with torch.inference_mode():
            shares = reader(tensor(episode["centred"])).softmax(1).view(TOUCHES - 1, player.count, 10).numpy()
        is_met = episode["centred"][:, :, 0].max(axis=(2, 3)) > OBJECT_CM
        certainty = np.take_along_axis(shares, episode["labels"][None, :, None], axis=2)[..., 0]
        right = shares.argmax(2) == episode["labels"]
        for name, values in (("right", right), ("certainty", certainty), ("met", is_met)):
            found[name].append(values.T[: digits - first])
    return {name: np.concatenate(values) for name, values in found.items()}


def main() -> None:
    """Train with one seed, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60, help="processor time of all training")
    parser.add_argument("--assets", type=Path, default=Path("baseline-digits"))
    parser.add_argument("--per-class", type=int, default=300, help="digits of each class for training")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    provider = env_assets.AssetProvider(options.assets, generate=True, per_class=options.per_class)
    digits = {split: len(provider.meshes("mnist3d", split)) for split in ("train", "test")}
    player = Player(options.assets, "train", 256, options.seed)
    tested = Player(options.assets, "test", 250, 1000 + options.seed)
    seconds = 60 * options.minutes
    reader, policy = trunk(10), Policy()
    result: dict[str, Any] = {"seed": options.seed, "minutes": options.minutes, "digits": digits}

    def measure(name: str, touches: int, read: torch.nn.Module, act: Act) -> None:
        with told(lambda: f"{name:12} reads the digits of test"):
            found = evaluate(read, tested, act, digits["test"])
        right = found["right"]
        result[name] = {
            "touches": touches,
            "minutes": time.process_time() / 60,
            "met": found["met"].mean(0).tolist(),
            "right": right.astype(int).tolist(),
            "certainty": found["certainty"].astype(float).round(4).tolist(),
        }
        print(f"{name:12} final {right[:, -1].mean():.1%}, average {right.mean():.1%}", flush=True)
        options.out.mkdir(parents=True, exist_ok=True)
        options.out.joinpath("result.json").write_text(json.dumps(result))
        torch.save({"reader": reader.state_dict(), "policy": policy.state_dict()}, options.out / "weights.pt")

    touches = train_reader(reader, player, frontier, 0.4 * seconds, 1e-3)
    measure("rule", touches, reader, frontier)
    second = trunk(10)
    second.load_state_dict(reader.state_dict())
    touches = train_reader(second, player, anywhere(player.random), 0.1 * seconds, 3e-4)
    measure("random", touches, second, anywhere(player.random))
    touches = imitate(policy, player, 0.25 * seconds)
    measure("imitation", touches, reader, follow(policy))
    touches = improve(policy, reader, player, 0.25 * seconds)
    measure("learned", touches, reader, follow(policy))


if __name__ == "__main__":
    main()
