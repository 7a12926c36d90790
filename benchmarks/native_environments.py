"""Our environments next to the published ones, a step of a random policy, on one thread.

::

    python benchmarks/native_environments.py               # depth and Taxim, 1 to 256 environments
    python benchmarks/native_environments.py --repeats 3

Both take turns in one process; each figure is the median of several, in processor time. A step of the
environment without the start of an episode, and a start, have a row each; every mesh was used before. At 256
environments the task is the volume: the published classification fails there. The plain way is the depth
alone, by rays of Embree onto solids that it took before. Needs the extras `oracle` and `sim`.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
from figures import tell
from plain_ways import Rays

from tactile_envs import motion

EPISODE = 17
"""Steps from one start to the next: 16 touches and the first of another episode."""

DIGITS = 40
WARM_STARTS = 6 * DIGITS
"""After so many starts of episodes, each digit was very probably used."""

FIELDS = ((1, 60), (16, 100), (64, 100), (256, 100))
"""Numbers of environments, and how many times as fast ours are to be at least."""


def report_beside_published(root: Path, sensor: str, repeats: int, numbers: Any) -> None:
    """Time a step of one environment out of n."""
    from env_assets import AssetProvider
    from tactile_envs import make_vector
    from tests.published_envs import make

    provider = AssetProvider(root)
    plain = (plain_touch_s(root, repeats), f"depth alone, {Rays.name}")
    word = "-Depth" if sensor == "depth" else ""
    for count, target in numbers:
        family = "TactileMNISTVolume" if count == 256 else "TactileMNIST"
        env_id = f"{family}{word}-train-v0"
        theirs = make(env_id, provider=provider, num_envs=count)
        ours = make_vector(env_id, num_envs=count, assets=root)
        ours.action_space.seed(0)
        actions = [ours.action_space.sample() for _ in range(2 * EPISODE)]
        for env in (theirs, ours):
            for seed in range(-(-WARM_STARTS // count)):
                env.reset(seed=seed)
        touches = EPISODE - 1 if sensor == "depth" or count < 64 else 2
        episodes = max(1, 2000 // count // EPISODE)
        turns = [
            (episode_s(theirs, actions, 1, touches), episode_s(ours, actions, episodes))
            for _ in range(repeats)
        ]
        medians = np.median(turns, axis=0) / count
        alone = (touches_alone_s(ours, actions, episodes) / count, "the compiled touches alone")
        what = f"{sensor}, 64x64, {count} environments, random policy"
        for name, words, (theirs_s, ours_s), least in (
            (f"{sensor}_{count}", "a step", medians[:, 0], target),
            (f"start_{sensor}_{count}", "a start of an episode", medians[:, 1], 0),
        ):
            tell(
                name, f"{words}, {what}", float(ours_s), "s", statistic=f"median of {repeats}",
                published=float(theirs_s), plain=plain if sensor == "depth" and least else None,
                limit=alone if sensor == "depth" and least else None,
                target=f"at least {least}" if least else "",
            )  # fmt: skip
        theirs.close()
        ours.close()


def episode_s(env: Any, actions: list[Any], episodes: int, touches: int = EPISODE - 1) -> tuple[float, float]:
    """Return the processor seconds of a touch in all environments, and of the start of their episodes."""
    times: list[tuple[float, float]] = []
    for _ in range(episodes):
        start_s = time.process_time()
        env.reset()
        begun_s = time.process_time()
        times.append((step_s(env, actions, touches), begun_s - start_s))
    return tuple(statistics.mean(column) for column in zip(*times, strict=True))


def touches_alone_s(env: Any, actions: list[Any], episodes: int) -> float:
    """Return the processor seconds of a step that compiled code takes."""
    times: list[float] = []
    whole = motion.Toucher.touch

    def timed(*arguments: Any, **keywords: Any) -> Any:
        start_s = time.process_time()
        readings = whole(*arguments, **keywords)
        times.append(time.process_time() - start_s)
        return readings

    motion.Toucher.touch = timed
    try:
        for _ in range(episodes):
            env.reset()
            step_s(env, actions, EPISODE - 1)
    finally:
        motion.Toucher.touch = whole
    return statistics.median(times)


def plain_touch_s(root: Path, repeats: int) -> float:
    """Return the processor seconds of a depth map by rays, of digits in memory."""
    import mnist3d
    import tactile_sim

    sensor, random = tactile_sim.center_view(64, 64), np.random.default_rng(0)
    solids = [
        Rays(digit.vertices_m, digit.faces) for digit in mnist3d.load(str(root / "mnist3d"), "train")[:16]
    ]
    poses = [tactile_sim.pose(*random.uniform(-0.02, 0.02, 2)) for _ in solids]
    times = []
    for _ in range(repeats + 1):
        start_s = time.process_time()
        for rays, pose in zip(solids, poses, strict=True):
            rays.depth_m(np.eye(4), pose, sensor)
        times.append((time.process_time() - start_s) / len(solids))
    return statistics.median(times[1:])


def report_always_on_object(root: Path, repeats: int) -> None:
    """Time touches that all meet the object."""
    from tactile_envs import make_vector

    count = 64
    config = {"step_limit": 10_000, "perturb_object_pose": False}
    env = make_vector("TactileMNIST-Depth-train-v0", num_envs=count, assets=root, config=config)
    env.reset(seed=0)
    poses, random = env.current_object_poses_platform_frame.matrix, np.random.default_rng(0)
    starts = []
    record: Any
    for pose, record in zip(poses, env.current_data_points, strict=True):
        vertices_m = np.asarray(record.vertices_m, np.float64)
        top = vertices_m[vertices_m[:, 2] > vertices_m[:, 2].max() - 0.001]
        starts.append((pose @ [*top[random.integers(len(top))], 1.0])[:3])
    env.reset(seed=0, options={"initial_sensor_target_pose": starts})
    action = env.action_space.sample()
    action["action"]["sensor_target_pos_rel"][:] = 0
    step_s(env, [action], 5)
    seconds = statistics.median(step_s(env, [action], 60) for _ in range(repeats)) / count
    what = "steps a second and core, depth, 64x64, every touch on the object"
    tell("on_object", what, 1 / seconds, "steps", target="at least 20000")


def report_threads(root: Path, repeats: int) -> None:
    """Time steps of 256 environments by the clock, with one thread and with one a core."""
    from tactile_envs import make_vector

    cores = len(os.sched_getaffinity(0))
    if cores == 1:
        return
    walls: dict[int, list[float]] = {1: [], cores: []}
    envs = {
        threads: make_vector("TactileMNIST-Depth-train-v0", num_envs=256, assets=root, threads=threads)
        for threads in walls
    }
    actions = [envs[1].action_space.sample() for _ in range(EPISODE)]
    for env in envs.values():
        env.reset(seed=0)
        step_s(env, actions, 5)
    for _ in range(repeats):
        for threads, env in envs.items():
            start_s = time.perf_counter()
            step_s(env, actions, 6 * EPISODE)
            walls[threads].append(time.perf_counter() - start_s)
    one, all_of_them = (statistics.median(walls[threads]) for threads in (1, cores))
    what = f"speed of {cores} threads, a core, as a share of one thread's; by the clock"
    tell("threads", what, one / all_of_them / cores, "", target="at least 0.8")


def step_s(env: Any, actions: list[Any], count: int) -> float:
    """Return the processor seconds of a step."""
    start_s = time.process_time()
    for number in range(count):
        env.step(actions[number % len(actions)])
    return (time.process_time() - start_s) / count


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--digits", type=int, default=DIGITS)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    from mnist3d.digit_generation import DigitSetSpec, generate
    from mnist3d.sources.synthetic import SyntheticSource

    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        os.environ["TACTILE_TOOLKIT_CACHE"] = str(root / "cache")
        os.environ["HOME"] = str(root)  # where the published package keeps statistics of the data set
        spec = DigitSetSpec(SyntheticSource(), per_class=options.digits // 10)
        generate(spec, str(root / "mnist3d"), ("train",))
        report_always_on_object(root, options.repeats)
        report_threads(root, options.repeats)
        report_beside_published(root, "depth", options.repeats, FIELDS)
        report_beside_published(root, "Taxim", min(options.repeats, 3), ((1, 10), (16, 10), (64, 10)))


if __name__ == "__main__":
    main()
