"""Draw how exact a gel in MuJoCo is, beside theory.

Usage: python docs/loop.py      (extras mujoco, test and pictures; a minute)

``loop.png`` has what the tests compute for the table of ``mujoco.md``, as curves.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import tactile_sim
from docs.elastic import DOCS, FORMULA, OURS, label
from tests.tactile_sim import test_mujoco_gels as scenes
from tests.tactile_sim.test_loop import HalfSpace, load_cycle


def main() -> None:
    """Write the picture."""
    figure = Figure(figsize=(11, 6), dpi=110, layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    draw_bounces(axes[0])
    draw_mindlin(axes[1])
    draw_rolling(axes[2])
    draw_block(axes[3])
    draw_lift(axes[4])
    draw_slip(axes[5])
    mujoco.set_mjcb_control(None)
    FigureCanvasAgg(figure).print_figure(DOCS / "loop.png", metadata={"Software": None})


def draw_bounces(axes: Any) -> None:
    """Draw the height of a ball that bounces on an elastic gel over time."""
    axes.axhline(5.0, **FORMULA)
    for step_s, style in ((0.002, "."), (0.0005, "-")):
        heights_m = scenes.bounces_m(step_s, tactile_sim.center_view(64, 64))
        times_s = step_s * np.arange(1, len(heights_m) + 1)
        axes.plot(times_s, 1e3 * heights_m, style, label=f"steps of {1e3 * step_s:g} ms", linewidth=0.9)
    axes.set_ylim(top=7.0)
    axes.legend(fontsize=7, ncols=2, loc="upper center")
    label(axes, "ball that falls 5 mm, without relaxation: height", "s", "mm")


def draw_mindlin(axes: Any) -> None:
    """Draw the tangential force on a ball over its shift: load, unload, reload."""
    hertz = HalfSpace()
    full_n = hertz.friction * hertz.normal_n
    shifts_m, forces_n, theory_n = np.array(list(load_cycle())).T
    without_n = np.array([hertz.load_n(shift_m) for shift_m in np.sort(shifts_m)])
    axes.plot(shifts_m / hertz.slip_m, theory_n / full_n, **FORMULA, label="Cattaneo and Mindlin")
    axes.plot(np.sort(shifts_m) / hertz.slip_m, without_n / full_n, "k:", linewidth=0.9, label="no history")
    axes.plot(shifts_m / hertz.slip_m, forces_n / full_n, **OURS, label="here")
    axes.legend(fontsize=7)
    label(axes, "ball sheared there, back and there: force / (mu N)", "shift / shift of full slip", "")


def draw_rolling(axes: Any) -> None:
    """Draw how far a ball has rolled over how far the gel above has slid."""
    hand_m, ball_m = scenes.rolled("sphere")
    axes.plot(1e3 * hand_m, 0.5e3 * hand_m, **FORMULA, label="half of it")
    axes.plot(1e3 * hand_m[::10], 1e3 * (ball_m - ball_m[0])[::10], **OURS, label="ball")
    axes.legend(fontsize=7)
    label(axes, "ball that rolls under a sliding gel: path", "path of the gel, mm", "mm")


def draw_block(axes: Any) -> None:
    """Draw the friction of a block, and its path, over the force that pushes it."""
    shares = np.linspace(0.0, 0.36, 400)
    ratios, path_m = scenes.pushed([*np.zeros(100), *shares])
    axes.plot(shares, np.minimum(shares, 0.3), **FORMULA)
    axes.plot(shares[::10], ratios[100::10], **OURS, label="friction / force")
    axes.plot(shares, 1e2 * path_m[100:], color="tab:orange", linewidth=0.9, label="path, cm")
    axes.legend(fontsize=7)
    label(axes, "pushed block, mu = 0.3", "push / (m g)", "")


def draw_lift(axes: Any) -> None:
    """Draw the force with which two fingers lift over time."""
    for share, colour in ((0.9, "tab:blue"), (1.1, "tab:orange")):
        steps = [(gels[0].data.time, scenes.lift_n(gels)) for gels in scenes.lifting(share, 1.0)]
        times_s, lifts_n = np.transpose(steps)
        axes.axhline(min(share, 1.0), **FORMULA)
        axes.plot(times_s, lifts_n, color=colour, linewidth=0.9, label=f"m g = {share} N")
    axes.legend(fontsize=7)
    label(axes, "two fingers, 2 mu N = 1 N: force that lifts", "s", "N")


def draw_slip(axes: Any) -> None:
    """Draw how far a ball slips between two fingers over its mass."""
    shares = np.arange(0.9, 1.11, 0.02)
    slips_m = []
    for share in shares:
        heights_m = [scenes.ball_in_hand_m(gels[0].data) for gels in scenes.lifting(share, 1.0)]
        slips_m.append(heights_m[0] - heights_m[-1])
    axes.axvline(1.0, **FORMULA)
    axes.plot(shares, 1e3 * np.array(slips_m), **OURS)
    label(axes, "two fingers: motion of the ball in the hand", "mass / (2 mu N / g)", "mm")


if __name__ == "__main__":
    main()
