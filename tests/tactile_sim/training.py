"""A small training: six digits, touches of them, pairs, and six steps."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.sets.set_options import PairSetSpec, TrainConfig
from tests.tactile_sim.sets import NOISE

SPEC = PairSetSpec((32, 32), 60, without_contact=0.2, min_height_m=0.006, window="center")
CONFIG = TrainConfig(
    2, 1, 4, steps=6, crop=1.0, pool=3, checkpoint_every=2, log_every=1, sensor_noise=NOISE, noise=0.05,
    discriminator_noise=0.1, pretrain_steps=3,
)  # fmt: skip


def make_sources(folder: Path) -> tuple[str, str]:
    """Make six digits and touches of them, and return their folders."""
    digits, touches = (str(folder / name) for name in ("digits", "touches"))
    source = SyntheticSource(seed=1)
    mnist3d.generate(mnist3d.DigitSetSpec(source, limit=6), digits, splits=("train",))
    plan = tactile_sim.TouchPlan(rounds=1, touches=32, seed=3)
    spec = tactile_sim.TouchSetSpec((32, 32), "taxim", plan=plan, image_format="png")
    tactile_sim.generate(digits, spec, touches)
    return digits, touches


def losses_of_steps(folder: Path) -> dict[str, list[float]]:
    """Return each kind of loss, step by step."""
    found = pq.read_table(folder / "losses.parquet").to_pydict()
    return {name: [float(f"{value:.6g}") for value in values] for name, values in found.items()}
