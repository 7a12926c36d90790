"""A gel in a moving world: how exact it is, and how fast.

Usage: python benchmarks/loop.py      (extra mujoco)

Tells the figures of the page "A gel in MuJoCo". Scenes are those of the tests. Times are processor time of
one thread, minima: a printed digit moves over the gel, with friction; each step gives forces and a depth map,
or an image by Taxim.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import math
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mujoco
import numpy as np
from figures import tell

import tactile_sim
from mnist3d.solid.algorithm import solidify
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.mujoco import GelCallback, GelSensor
from tests.tactile_sim import test_loop, test_mujoco_gels as scenes

STEPS, REPEATS = 100, 7


def force_at_rest(dt_s: float) -> tuple[float, float]:
    """Return error and swing of the force of a ball of 10 g at rest, relative to its weight."""
    model, data = scenes.simulation(scenes.FLAT + scenes.ball(0.01, 0.0082), dt_s)
    gel = GelSensor(model, data, "gel", tactile_sim.center_view(64, 64))
    mujoco.set_mjcb_control(GelCallback(gel))
    forces_n = []
    for _ in range(1000):
        mujoco.mj_step(model, data)
        forces_n.append(gel.wrench[2])
    late = np.array(forces_n[-200:]) / (0.01 * scenes.GRAVITY) - 1.0
    return float(abs(late.mean())), float(abs(late - late.mean()).max())


def mindlin_errors() -> tuple[float, float]:
    """Return the greatest errors with and without a history, relative to friction times force."""
    curve = np.array(list(test_loop.load_cycle()))
    full_n = test_loop.HalfSpace.friction * test_loop.HalfSpace().normal_n
    without = [test_loop.HalfSpace().load_n(shift_m) for shift_m in curve[:, 0]]
    return abs(curve[:, 1] - curve[:, 2]).max() / full_n, abs(np.array(without) - curve[:, 2]).max() / full_n


def accelerated_cylinder(acceleration_m_s2: float) -> tuple[float, float]:
    """Return slip, mm/s, and friction over force, of a cylinder that a gel drags for 30 ms.

    Rolling takes a third of the mass times the acceleration: it slips from 8.8 m/s2.
    """
    friction = 0.3
    model, data = scenes.simulation(
        '<body name="hand" mocap="true"><site name="gel" euler="180 0 0"/></body>'
        '<body pos="0 0 .00465" euler="90 0 0"><freejoint/>'
        '<geom name="roll" type="cylinder" size=".005 .006" mass=".05"/></body>',
        0.001,
    )
    gel = GelSensor(model, data, "gel", tactile_sim.center_view(64, 64), tactile_sim.Gel(friction=friction))
    mujoco.set_mjcb_control(GelCallback(gel))
    for step in range(280):
        time_s = max(step - 250, 0) * 0.001
        data.mocap_pos[0, 0] = acceleration_m_s2 * time_s**2 / 2
        mujoco.mj_step(model, data)
    # Without slip, its surface moves with the gel: it rolls back at a third of the acceleration.
    surface_m_s = data.qvel[0] + 0.005 * np.linalg.norm(data.qvel[3:])
    slip_m_s = acceleration_m_s2 * 0.029 - surface_m_s
    return 1e3 * slip_m_s, float(np.hypot(gel.wrench[0], gel.wrench[1]) / gel.wrench[2])


def greatest_share() -> float:
    """Return the greatest weight that two fingers hold, relative to twice friction times force."""
    shares = np.arange(0.9, 1.06, 0.02)
    return max(share for share in shares if scenes.grasp(share, 1.0)[0])


def poses(digit_top_m: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield poses of a digit and of a gel that moves over it."""
    for step in range(STEPS):
        angle = 0.02 * step
        yield (
            tactile_sim.pose(
                0.0005 * math.sin(angle), 0.0005 * math.cos(angle), turn_rad=0.02 * math.sin(angle)
            ),
            tactile_sim.pose(0.0, 0.0, digit_top_m - 0.0008 - 0.0003 * math.sin(0.7 * angle)),
        )


def step_s(sensor: tactile_sim.Sensor, optics: str) -> float:
    """Return the processor seconds of a step with forces and an image."""
    digit = tactile_sim.Pressable.of(solidify(SyntheticSource().image(1008).pixels))
    moves = list(poses(digit.vertices_m[:, 2].max()))
    state, camera = tactile_sim.GelState(sensor), tactile_sim.make_optics(optics)
    best_s = math.inf
    for _ in range(REPEATS):
        state.reset()
        start_s = time.process_time()
        for object_pose, gel_pose in moves:
            state.press([digit], object_pose, gel_pose)
            if optics == "depth":
                _ = state.depth_m
            else:
                camera.render(state.depth_m[None], sensor, sensor.size_px)
        best_s = min(best_s, (time.process_time() - start_s) / STEPS)
    return best_s


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", tactile_sim.GelWarning)
    for name, sensor in (("64", tactile_sim.center_view(64, 64)), ("320", tactile_sim.full_view())):
        for optics, what in (("depth", "a depth map"), ("taxim", "an image by Taxim")):
            taken_s = step_s(sensor, optics)
            words = f"a step with friction, forces and {what}, {name} pixels wide"
            tell(f"{optics}_{name}", words, taken_s, "s", statistic=f"minimum of {REPEATS}")
    for number, dt_s in (("2", 0.002), ("05", 0.0005)):
        words = f"ball {{}}, steps of {1e3 * dt_s:g} ms"
        error, swing = force_at_rest(dt_s)
        tell(f"weight_{number}", words.format("at rest: mean force off its weight"), 1e6 * error, "ppm")
        tell(f"swing_{number}", words.format("at rest: greatest swing of the force"), 1e6 * swing, "ppm")
        heights_m = scenes.bounces_m(dt_s, tactile_sim.center_view(64, 64))
        tops = scenes.tops_m(heights_m)[:5] / 0.005
        words = words.format("without relaxation: error of the height of five bounces")
        tell(f"bounce_{number}", words, 100 * float(abs(tops - 1).max()), "%")
    history, none = mindlin_errors()
    words = "force there, back and there, off Cattaneo and Mindlin, of friction times force"
    tell("mindlin", words, 100 * float(history), "%")
    tell("no_history", f"{words}, without a history", 100 * float(none), "%")
    for acceleration in (8.0, 9.5):
        slip_mm_s, _ = accelerated_cylinder(acceleration)
        words = (
            f"slip of a cylinder on a gel that accelerates by {acceleration:g} m/s2; it should slip from 8.8"
        )
        tell(f"slip_{acceleration:g}", words, slip_mm_s, "mm/s")
    tell("fingers", "weight that two fingers hold, of twice friction times force", greatest_share())
    mujoco.set_mjcb_control(None)


if __name__ == "__main__":
    main()
