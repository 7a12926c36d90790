"""Small sets of touches with all options that affect their bytes."""

from __future__ import annotations

from pathlib import Path

import tactile_sim

NOISE = tactile_sim.SensorNoise(0.0038, 1.4, 0.3, 0.0093, 4.0, 0.3, 0.047, 0.0094)


def touch_sets(scenes: Path, folder: Path) -> None:
    """Make sets of touches of a scene: depth, printed; Taxim, scaled, with noise; many rounds; elastic."""
    plan = tactile_sim.TouchPlan(2, 4, "object", seed=5)
    printed = tactile_sim.TouchSetSpec(
        (64, 48), "depth", plan=plan, image_format="png", layer_m=0.0002, limit=1
    )
    noisy = tactile_sim.TouchSetSpec((64, 64), "taxim", "full", plan, noise=NOISE, limit=1)
    many = tactile_sim.TouchSetSpec((32, 32), "depth", plan=tactile_sim.TouchPlan(20, 4, seed=5), limit=1)
    loads = {"force_n": (1.0, 6.0), "slide_m": (0.0, 0.0005), "twist_rad": (-0.1, 0.1)}
    press = tactile_sim.ElasticPress(**loads, markers=(5, 4), draw_markers=True, contact_maps=True)
    elastic = tactile_sim.TouchSetSpec((40, 30), "taxim", "full", plan, "png", limit=1, press=press)
    for name, spec in {"depth": printed, "taxim": noisy, "many": many, "elastic": elastic}.items():
        tactile_sim.generate(str(scenes), spec, folder / f"touches-{name}", ["train"])
