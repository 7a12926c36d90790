"""How fast touches are rendered: against the renderer of the published environments, and Taxim on JAX.

Usage: python benchmarks/touches.py [PART ...]

One thread, everything warm, processor time, so that a busy machine changes little; minima. The plain way for
a depth map has rays of Embree, onto solids that it took before.
"""

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ.setdefault(name, "0" if name.startswith("LP") else "1")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import dataclasses
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from figures import tell
from plain_ways import Rays

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.optics.rendering import make_optics
from tests.tactile_sim.oracle import Oracle

TOUCHES = 32


def best_ms(work: Callable[[], Any], count: int, rounds: int = 5) -> float:
    """Return the least processor time of one of ``count`` items, ms."""
    work()
    times = []
    for _ in range(rounds):
        start_s = time.process_time()
        work()
        times.append(time.process_time() - start_s)
    return 1e3 * min(times) / count


def touches_of(digits: Any, count: int) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """Solids, and poses at which something is felt."""
    rng = np.random.default_rng(0)
    solids = [tactile_sim.Pressable.of(digits[k % len(digits)], check=False) for k in range(count)]
    objects = np.stack([tactile_sim.pose(turn_rad=rng.uniform(-0.4, 0.4)) for _ in solids])
    corners = [solid.vertices_m[rng.integers(len(solid.vertices_m))] for solid in solids]
    targets = np.stack([tactile_sim.pose(*np.clip(c[:2], -0.038, 0.038)) for c in corners])
    return solids, objects, targets


def depth_and_taxim(digits: Any) -> None:
    """Time depth maps and pictures of single sizes."""
    from tests.published_envs import published_package

    backend = published_package("tactile_mnist.tactile_renderer.taxim_renderer_jax")
    device = published_package("tactile_mnist.tactile_renderer.tactile_renderer").Device("cpu")
    package, ours = backend.TaximRendererJAX(device), make_optics("taxim")
    solids, objects, targets = touches_of(digits, TOUCHES)
    for size in ((64, 64), (320, 240)):
        sensor = tactile_sim.center_view(*size)
        depth_ms = best_ms(lambda s=sensor: tactile_sim.render_touch(solids, objects, targets, s), TOUCHES)
        touches = list(zip(solids, objects, targets, strict=True))

        def alone(sensor: Any = sensor, touches: Any = touches) -> None:
            for touch in touches:
                tactile_sim.render_touch(*touch, sensor)

        alone_ms = best_ms(alone, TOUCHES)
        rays = [Rays(digits[k].vertices_m, digits[k].faces) for k in range(4)]
        pressed = tactile_sim.render_touch(solids[1], objects[1], targets[1], sensor).depth_m
        difference = abs(rays[1].depth_m(objects[1], targets[1], sensor) - np.minimum(pressed, sensor.gel_m))
        assert np.quantile(difference, 0.98) < 1e-5, "the depth maps differ"

        def by_rays(sensor: Any = sensor, rays: Any = rays) -> None:
            for number in range(TOUCHES):
                rays[number % 4].depth_m(objects[number], targets[number], sensor)

        plain = best_ms(by_rays, TOUCHES) / 1e3, Rays.name
        oracle = Oracle(*size)
        meshes = [digits[k].mesh for k in range(4)]

        def bare(oracle: Oracle = oracle, mesh: Any = meshes[0]) -> None:
            for target in targets:
                oracle.depth_m(mesh, objects[0], target)

        bare_ms = best_ms(bare, TOUCHES)
        depth_m = tactile_sim.render_touch(solids[:16], objects[:16], targets[:16], sensor).depth_m
        taxim_ms = best_ms(lambda s=sensor, d=depth_m: ours.render(d, s, s.size_px), 16)
        package_ms = best_ms(lambda s=size, d=depth_m: package.render(d, s), 16, 2)
        name, small = f"{size[0]}x{size[1]}", size[0] == 64
        for key, what, ours_ms, other_ms, peer, target in (
            (
                "depth",
                "depth of a touch, 32 a call; published, 1 a call",
                depth_ms,
                bare_ms,
                plain,
                10 if small else 6,
            ),
            ("single", "depth of a touch, 1 a call", alone_ms, bare_ms, plain, 0),
            ("taxim", "Taxim, 16 a call; published on JAX", taxim_ms, package_ms, None, 5 if small else 25),
        ):
            tell(
                f"{key}_{size[0]}", f"{what}, {name}", ours_ms / 1e3, "s", statistic="minimum of 5",
                published=other_ms / 1e3, plain=peer, target=f"at least {target}" if target else "",
            )  # fmt: skip


def sets(folder: str, split: str) -> None:
    """Time the writing of data sets of depth touches, in the plan of the defaults."""
    plan = tactile_sim.TouchPlan(16, TOUCHES)
    for size, limit in (((64, 64), 24), ((320, 240), 4)):
        spec = tactile_sim.TouchSetSpec(size, "depth", plan=plan, limit=limit)
        written_ms(folder, split, dataclasses.replace(spec, limit=1), 1)
        taken_ms = written_ms(folder, split, spec, 1) / (limit * plan.rounds * TOUCHES)
        what = f"a touch of a set written, {size[0]}x{size[1]}, all included"
        target = "at most 0.0005" if size[0] == 64 else "at most 0.008"
        tell(f"written_{size[0]}", what, taken_ms / 1e3, "s", target=target)


def workers(folder: str, split: str) -> None:
    """Compare the work of two workers with that of one: on a busy machine the clock says nothing.

    By the command: workers of a script import what the script imports, which this one would count as theirs.
    """
    words = [
        "--rounds",
        "64",
        "--touches",
        "64",
        "--limit",
        "20",
        "--size",
        "64x64",
        "--optics",
        "depth",
        "--quiet",
        "--split",
    ]
    made_s = []
    for count in ("1", "2"):
        with tempfile.TemporaryDirectory() as out:
            before = os.times()
            command = [sys.executable, "-m", "cli", "tactile-sim", "generate", folder, *words, split]
            subprocess.run([*command, "--workers", count, "--out", f"{out}/set"], check=True)
            after = os.times()
        made_s.append(sum(after[2:4]) - sum(before[2:4]))
    what = "touches that two workers make with a core for each, by their processor time; one makes 1"
    tell("workers", what, 2 * made_s[0] / made_s[1], "times", target="at least 1.8")


def written_ms(folder: str, split: str, spec: tactile_sim.TouchSetSpec, workers: int) -> float:
    """Return the processor time of a set in all processes, ms."""
    with tempfile.TemporaryDirectory() as out:
        before = os.times()
        tactile_sim.generate(folder, spec, out, [split], workers=workers)
        after = os.times()
    return 1e3 * sum(after[:4]) - 1e3 * sum(before[:4])


def main() -> None:
    parts = sys.argv[1:] or ["depth", "sets", "workers"]
    with tempfile.TemporaryDirectory() as folder:
        mnist3d.generate(mnist3d.DigitSetSpec(SyntheticSource(), per_class=4), folder, ["test"])
        if "depth" in parts:
            depth_and_taxim(mnist3d.load(folder, "test"))
        if "sets" in parts:
            sets(folder, "test")
        if "workers" in parts:
            workers(folder, "test")


if __name__ == "__main__":
    main()
