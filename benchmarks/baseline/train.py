"""Train a first agent for an environment of the paper in minutes on one core, and write its reports.

``python benchmarks/baseline/train.py Toolbox --out runs/toolbox`` makes the objects on the first call, then

1. trains a reader of maps while the rule explores, and evaluates it (``rule``);
2. trains a second reader on random actions, from the first (``random``);
3. with ``--explore``, lets a network imitate the rule on its own episodes (``imitation``), then improves it
   by PPO, with the loss of the reader as the cost (``learned``).

Each evaluation is a report of ``tactile_envs.evaluate``; ``tactile-envs compare`` draws their curves.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from agents import Agent, LearnedAgent, RandomAgent, View, tensor
from networks import Explorer, Reader, nearest_ways
from numpy.typing import NDArray

import env_assets
import tactile_envs
from tactile_envs.env_specs import env_specs
from tactile_envs.episodes.touch_maps import OBJECT_RELIEF

_LINE_INTERVAL_S = 5.0


@dataclass(frozen=True)
class Task:
    """An environment of the paper: ids for training and test, and what the reader does.

    ``rate`` is the learning rate of the reader, ``per_class`` the number of training objects of each class.
    """

    trained: str
    tested: str
    view: View
    counts: bool = False
    locates: bool = False
    rate: float = 1e-3
    per_class: int = 300

    def reader(self, outputs: int) -> Reader:
        """Return an untrained reader with so many outputs."""
        return Reader(outputs, self.view.side, counts=self.counts, locates=self.locates)


TASKS = {
    "TactileMNIST": Task("TactileMNIST-Depth-train-v0", "TactileMNIST-Depth-test-v0", View()),
    "TactileMNISTVolume": Task(
        "TactileMNISTVolume-Depth-train-v0", "TactileMNISTVolume-Depth-test-v0", View()
    ),
    "Starstruck": Task(
        "Starstruck-Depth-train-v0",
        "Starstruck-Depth-test-v0",
        View(follows=False, side=64, pixel_m=0.0015),  # a star is 20 mm wide
        counts=True,
        rate=4e-3,
        per_class=1000,
    ),
    "Toolbox": Task(
        "Toolbox-Depth-v0",
        "Toolbox-Depth-v0",
        View(turns=True, side=64, pixel_m=0.003),  # its ends are 29 and 22 mm wide
        locates=True,
        rate=4e-3,
    ),
}


class Player:
    """Plays whole episodes of the training environments, all at once."""

    def __init__(self, spec: tactile_envs.EpisodeSpec) -> None:
        self.env, self.spec, self.group = spec.open(), spec, 0
        self.steps, self.count = self.env.config.step_limit, spec.num_envs

    def play(self, agent: Agent) -> dict[str, NDArray[Any]]:
        """Play the next episodes; return the values of each touch before the last one, (steps * n, ...)."""
        seed = self.spec.group_seed(self.group)
        self.group += 1
        observation, _ = self.env.reset(seed=seed)
        agent.begin(self.env, seed)
        values: dict[str, list[NDArray[Any]]] = {}
        for _ in range(self.steps):
            action = agent(observation)
            observation, _, _, _, info = self.env.step(action)
            touch = {"view": agent.view, "frames": agent.frames, "target": info["prediction"]["target"]}
            if isinstance(agent, LearnedAgent):
                touch["around_sensor"], touch["ways"] = agent.around_sensor, agent.ways.numpy()
                touch["rule"] = agent.maps.next_steps()[:, :2]
            for name, array in touch.items():
                values.setdefault(name, []).append(array)
        return {name: np.concatenate(arrays) for name, arrays in values.items()}

    def losses(self, reader: Reader, episode: dict[str, NDArray[Any]], chosen: Any) -> torch.Tensor:
        """Return the loss of a reader at some touches of episodes."""
        frames = torch.from_numpy(episode["frames"])[chosen]
        predictions = reader(tensor(episode["view"])[chosen], frames)
        targets = torch.from_numpy(episode["target"])[chosen]
        losses: torch.Tensor = self.env.loss_fn.torch(predictions, targets, (len(predictions),))
        return losses


def phase(name: str, seconds: float, losses: list[float]) -> Iterator[float]:
    """Yield the share of the processor time of a phase that has passed; print it and the last losses."""
    start_s, printed_s = time.process_time(), time.monotonic()
    while (share := (time.process_time() - start_s) / seconds) < 1:
        if time.monotonic() - printed_s > _LINE_INTERVAL_S:
            printed_s = time.monotonic()
            loss = np.mean(losses[-100:])
            print(f"{name:12} {share:.0%} of {seconds / 60:.1f} minutes, loss {loss:.3f}", flush=True)
        yield share


def train_reader(reader: Reader, player: Player, agent: Agent, seconds: float, rate: float) -> int:
    """Train on the maps of episodes until the time is over; return the number of touches."""
    optimiser = torch.optim.AdamW(reader.parameters(), rate, weight_decay=1e-2)
    touches, losses = 0, list[float]()
    reader.train()
    for share in phase(type(agent).__name__, seconds, losses):
        optimiser.param_groups[0]["lr"] = rate * min(1, 20 * share + 0.05) * (1 + np.cos(np.pi * share)) / 2
        episode = player.play(agent)
        is_met = episode["view"][:, 0].max(axis=(1, 2)) > OBJECT_RELIEF
        # Maps without an object are all alike: a tenth of them will do.
        is_useful = torch.from_numpy(is_met) | (torch.rand(len(is_met)) < 0.1)
        useful = is_useful.nonzero()[:, 0]
        for chosen in useful[torch.randperm(len(useful))].split(256):
            loss = player.losses(reader, episode, chosen).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
        touches += len(episode["view"])
    reader.eval()
    return touches


def imitate(explorer: Explorer, player: Player, view: View, seconds: float) -> int:
    """Learn the steps of the rule where the network itself goes; return the number of touches."""
    optimiser = torch.optim.Adam(explorer.actor.parameters(), 1e-3)
    touches, losses = 0, list[float]()
    for share in phase("imitation", seconds, losses):
        optimiser.param_groups[0]["lr"] = 1e-3 * (1 - share) + 1e-5
        episode = player.play(LearnedAgent(view, explorer))
        maps, steps = tensor(episode["around_sensor"]), nearest_ways(torch.from_numpy(episode["rule"]))
        for chosen in torch.randperm(len(maps)).split(256):
            loss = -explorer(maps[chosen]).log_prob(steps[chosen]).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
        touches += len(maps)
    return touches


def improve(explorer: Explorer, reader: Reader, player: Player, view: View, seconds: float) -> int:
    """Improve a network by PPO (clip 0.2, lambda 0.95); the reward is minus the loss of the reader."""
    optimiser = torch.optim.Adam(explorer.parameters(), 3e-4)
    agent = LearnedAgent(view, explorer)
    agent.samples = True
    touches, count, losses = 0, player.count, list[float]()
    for share in phase("learned", seconds, losses):
        optimiser.param_groups[0]["lr"] = 3e-4 * (1 - share) + 1e-6
        # At first only the critic learns: the network must not follow a wrong one away from the rule.
        learns = share > 0.1
        episode = player.play(agent)
        states = tensor(episode["around_sensor"])[:-count]
        ways = torch.from_numpy(episode["ways"])[:-count]
        with torch.inference_mode():
            every = torch.arange(count, len(states) + count)
            rewards = -player.losses(reader, episode, every).view(-1, count)
            before = explorer(states).log_prob(ways)
            values = explorer.value(states).view(-1, count)
        advantages = torch.zeros_like(rewards)
        last, value = torch.zeros(count), torch.zeros(count)
        for step in reversed(range(len(rewards))):
            last = rewards[step] + value - values[step] + 0.95 * last
            advantages[step], value = last, values[step]
        returns, gains = (advantages + values).reshape(-1), advantages.reshape(-1)
        gains = (gains - gains.mean()) / (gains.std() + 1e-6)
        for chosen in torch.cat([torch.randperm(len(states)) for _ in range(2)]).split(512):
            loss = 0.5 * (explorer.value(states[chosen]) - returns[chosen]).square().mean()
            if learns:
                ratio = (explorer(states[chosen]).log_prob(ways[chosen]) - before[chosen]).exp()
                gain = gains[chosen]
                loss = loss - torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(explorer.parameters(), 1.0)
            optimiser.step()
            losses.append(loss.item())
        touches += len(states) + count
    return touches


class Training:
    """Trains and evaluates with one seed."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options, self.task = options, TASKS[options.task]
        per_class = options.per_class or self.task.per_class
        provider = env_assets.AssetProvider(options.assets, generate=True, per_class=per_class)
        for env_id in (self.task.trained, self.task.tested):
            objects = env_specs()[env_id]
            provider.meshes(objects.assets, objects.split)
        spec = tactile_envs.EpisodeSpec(
            self.task.trained,
            num_envs=options.num_envs,
            episodes=options.num_envs,
            seed=options.seed,
            assets=options.assets,
        )
        self.player = Player(spec)
        self.seconds = 60 * options.minutes
        self.facts: dict[str, Any] = {"seed": options.seed, "minutes": options.minutes, "touches": {}}

    def evaluate(self, name: str, agent: Agent, touches: int) -> None:
        """Write the report of an agent."""
        spec = tactile_envs.EpisodeSpec(
            self.task.tested, episodes=self.options.episodes, num_envs=100, assets=self.options.assets
        )
        report = tactile_envs.evaluate(spec, agent, seeds=self.options.seeds)
        report.write(self.options.out / name, overwrite=True)
        self.facts["touches"][name] = touches
        self.options.out.joinpath("training.json").write_text(json.dumps(self.facts, indent=1) + "\n")
        metrics = {metric: f"{held.final.mean:.4g}" for metric, held in report.metrics.items()}
        print(f"{name:12} final {metrics}", flush=True)

    def run(self) -> None:
        """Train all parts, and write their reports and weights."""
        view = self.task.view
        shares = 0.8, 0.2, 0.0
        if self.options.explore:
            shares = 0.4, 0.1, 0.25
        outputs = self.player.env.prediction_space.shape[1]
        reader, explorer = self.task.reader(outputs), Explorer()
        touches = train_reader(reader, self.player, Agent(view), shares[0] * self.seconds, self.task.rate)
        self.evaluate("rule", Agent(view, reader), touches)
        second = self.task.reader(outputs)
        second.load_state_dict(reader.state_dict())
        touches = train_reader(
            second, self.player, RandomAgent(view), shares[1] * self.seconds, 0.3 * self.task.rate
        )
        self.evaluate("random", RandomAgent(view, second), touches)
        if self.options.explore:
            touches = imitate(explorer, self.player, view, shares[2] * self.seconds)
            self.evaluate("imitation", LearnedAgent(view, explorer, reader), touches)
            touches = improve(explorer, reader, self.player, view, shares[2] * self.seconds)
            self.evaluate("learned", LearnedAgent(view, explorer, reader), touches)
        networks = {"reader": reader, "random_reader": second, "explorer": explorer}
        torch.save(
            {name: network.state_dict() for name, network in networks.items()},
            self.options.out / "weights.pt",
        )


def main() -> None:
    """Train with one seed, and write the reports."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", choices=TASKS)
    parser.add_argument("--out", type=Path, required=True, help="folder of the reports")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60, help="processor time of all training")
    parser.add_argument("--explore", action="store_true", help="also train a network that explores")
    parser.add_argument("--assets", default="baseline-assets", help="folder of the objects")
    parser.add_argument(
        "--per-class", type=int, help="objects of each class for training (default: 300 digits, 1,000 scenes)"
    )
    parser.add_argument("--num-envs", type=int, default=128, help="environments side by side in training")
    parser.add_argument("--episodes", type=int, default=500, help="episodes of each seed of an evaluation")
    parser.add_argument("--seeds", type=int, default=5, help="seeds of an evaluation")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    Training(options).run()


if __name__ == "__main__":
    main()
