"""Contact areas of presses of 5 N, next to those of the fixed press of the published environments.

Usage: python benchmarks/forces.py [DIGITS]

500 touches at random on digits (a folder of `mnist3d generate`; 50 digits are made without one), on an
elastic gel with the default properties: how deep they are, how much of the window they cover, and how far
the surface is from that of the fixed press.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.value_types import Float64

TOUCHES, FORCE_N = 500, 5.0
SHARES = (5, 50, 95)


class Areas(NamedTuple):
    """Depths, mm, and shares of the window in contact, %, each of shape (TOUCHES,)."""

    fixed_mm: Float64
    fixed_share: Float64
    force_mm: Float64
    force_share: Float64
    force_n: Float64


def contact_areas(folder: str) -> Areas:
    """Press on digits at random places, by depth and by force."""
    digits = mnist3d.load(folder, "test")
    sensor, gel = tactile_sim.center_view(64, 64), tactile_sim.Gel()
    plan = tactile_sim.TouchPlan(1, TOUCHES // len(digits), "object")
    found = []
    for record in digits:
        solid = tactile_sim.Pressable.of(record)
        touches = tactile_sim.plan_round(plan, solid, "test", record.id, 0)
        poses = touches.object_poses[:-1]
        targets = np.stack([tactile_sim.pose(*place) for place in touches.positions_m.tolist()])
        fixed = tactile_sim.render_touch(solid, poses, targets, sensor)
        pressed = tactile_sim.render_touch(
            solid, poses, targets, sensor, load=tactile_sim.GelLoad(force_n=FORCE_N, gel=gel)
        )
        for depth_m, contact in zip(fixed.depth_m, pressed.contacts, strict=True):
            fixed_mm = 1e3 * (sensor.gel_m - depth_m.min())
            fixed_share, force_share = (depth_m < sensor.gel_m).mean(), contact.is_contact.mean()
            found.append(
                (
                    fixed_mm,
                    100 * fixed_share,
                    1e3 * contact.depth_m,
                    100 * force_share,
                    contact.force_n[2],
                )
            )
    return Areas(*np.array(found).T)


def table(areas: Areas) -> str:
    """Return a table in Markdown."""
    lines = [
        f"| {len(areas.force_n)} touches of digits | {' | '.join(f'{each} %' for each in SHARES)} |",
        "| --- | " + " | ".join("---:" for _ in SHARES) + " |",
    ]
    for name, values, unit in (
        ("fixed press: depth", areas.fixed_mm, "mm"),
        ("fixed press: part of the window in contact", areas.fixed_share, "%"),
        (f"{FORCE_N:g} N: depth", areas.force_mm, "mm"),
        (f"{FORCE_N:g} N: part of the window in contact", areas.force_share, "%"),
    ):
        shown = (f"{value:.2f} {unit}" for value in np.percentile(values, SHARES))
        lines.append(f"| {name} | {' | '.join(shown)} |")
    capped = (areas.force_n < FORCE_N * 0.999).sum()
    lines += ["", f"Half of the gel was pressed in before {FORCE_N:g} N were reached: {capped} touches."]
    return "\n".join(lines)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        if not sys.argv[1:]:
            mnist3d.generate(mnist3d.DigitSetSpec(SyntheticSource(), per_class=5), folder, ["test"])
        print(table(contact_areas((sys.argv[1:] or [folder])[0])))


if __name__ == "__main__":
    main()
