"""Processor time of first uses, on a machine where nothing is compiled: of this process and its workers.

python benchmarks/first_use.py

Each use runs in a new process with an empty cache, and again with the code that the first run compiled. The
second run is the limit of the first: imports and the work itself. PyTorch and JAX are hidden, because ap_gym
imports them where they are installed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from figures import tell

COUNTED = """
import atexit, json, resource, sys
sys.modules["torch"] = sys.modules["jax"] = None
def report():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print("\\n" + json.dumps(sum(part.ru_utime + part.ru_stime for part in used)))
atexit.register(report)
"""

USES = {
    "generate": (
        "first `mnist3d generate` of 100 digits",
        "at most 8",
        """
sys.argv = "mnist3d generate --split test --per-class 10 --out digits -q".split()
if __name__ == "__main__":
    from cli.start import mnist3d
    mnist3d()
""",
    ),
    "environment": (
        "first environment: the block of README.md, with digits made for it",
        "at most 9",
        """
import gymnasium, env_assets, tactile_envs
gymnasium.register_envs(tactile_envs)
env_assets.AssetProvider("assets", generate=True, per_class=1).meshes("mnist3d", "train")
env = gymnasium.make_vec("tactile_envs/TactileMNIST-Depth-train-v0", num_envs=16, assets="assets")
env.reset(seed=0)
env.step(env.action_space.sample())
env.close()
""",
    ),
    "elastic": (
        "first press of an elastic gel, 64 x 64 pixels, 5 N",
        "at most 3",
        """
import numpy as np, tactile_sim
x, y = np.meshgrid(np.linspace(-6e-3, 6e-3, 64), np.linspace(6e-3, -6e-3, 64))
load = tactile_sim.GelLoad(force_n=5.0, slide_m=(2e-4, 0.0))
tactile_sim.solve_contact(-(x**2 + y**2) / 0.02, 12e-3 / 63, load, thickness_m=4.25e-3)
""",
    ),
}
"""Name, what it is, target, and code."""


def main() -> None:
    """Measure and print."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for name, (what, target, code) in USES.items():
        with tempfile.TemporaryDirectory() as folder:
            first_s, second_s = (used_s(code, Path(folder), turn) for turn in ("first", "second"))
        tell(
            name, what, first_s, "s", statistic="one run", target=target,
            limit=(second_s, "the same, compiled before"),
        )  # fmt: skip


def used_s(code: str, home: Path, turn: str) -> float:
    """Return the processor time of a use in a folder of its own."""
    folder = home / turn
    folder.mkdir()
    script = folder / "use.py"
    script.write_text(COUNTED + code)
    caches = {"TACTILE_TOOLKIT_CACHE": str(home / "cache"), "NUMBA_CACHE_DIR": str(home / "compiled")}
    quiet = {"TACTILE_TOOLKIT_QUIET": "1"}
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=folder,
        env=os.environ | caches | quiet,
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return float(json.loads(done.stdout.splitlines()[-1]))


if __name__ == "__main__":
    main()
