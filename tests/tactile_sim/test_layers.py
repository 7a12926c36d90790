"""Printed solids: layers in closed form, compared with a walk through stacked layers."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import tactile_sim
from tactile_toolkit.errors import InputError
from tests.tactile_sim.solids import ball, block, tilted

LAYER_M = 0.0004


def _ramp(slope: float) -> trimesh.Trimesh:
    """Return a long wedge whose upper face rises along x, from z = 0 at x = -0.02."""
    height = 0.04 * slope
    ends = [[-0.02, y, 0] for y in (-0.03, 0.03)] + [[0.02, y, z] for y in (-0.03, 0.03) for z in (0, height)]
    return trimesh.convex.convex_hull(np.array(ends))


def _is_printed(x_m: np.ndarray, z_m: np.ndarray, slope: float) -> np.ndarray:
    """Return whether points of the section of the ramp are inside a layer, by definition."""
    inside = np.zeros(x_m.shape, bool)
    radius = LAYER_M / 2
    for number in range(int(np.floor(0.04 * slope / LAYER_M + 0.5))):
        middle = (number + 0.5) * LAYER_M
        # The outline of the ramp at the middle of the layer, or half a percent below.
        edge = -0.02 + (middle - 0.005 * LAYER_M) / slope
        bulge = np.sqrt(np.maximum(radius**2 - (z_m - middle) ** 2, 0))
        inside |= (np.abs(z_m - middle) <= radius) & (x_m >= edge + radius - bulge)
    return inside


@pytest.mark.parametrize("slope", [0.15, 0.5, 1.5])
def test_layers_are_where_a_walk_along_the_line_of_sight_meets_them(slope):
    ramp = _ramp(slope).apply_transform(tactile_sim.pose(turn_rad=0.6))  # lies along both axes of its mesh
    solid = tactile_sim.Pressable.of(ramp, layer_m=LAYER_M)
    sensor = tactile_sim.Sensor((41, 1), (0.004, 0.0001))
    x_m = -0.002 if slope < 1 else -0.01
    felt = tactile_sim.render_touch(solid, tactile_sim.pose(turn_rad=-0.6), tactile_sim.pose(x_m), sensor)
    heights = felt.sensor_z_m - felt.depth_m[0]
    expected = []
    for place in x_m + (np.arange(41) - 20) * 0.004 / 41:
        steps = slope * (place + 0.02) + np.arange(0.0012, -0.0012, -5e-7)
        printed = _is_printed(np.full(steps.shape, place), steps, slope)
        expected.append(steps[np.argmax(printed)])
    off = np.abs(heights - np.array(expected))
    assert np.sort(off)[-3] < 1e-6  # at the end of a layer, rounding decides


def test_a_print_that_leans_is_refused():
    solid = tactile_sim.Pressable.of(ball(), layer_m=LAYER_M)
    for poses in ((tilted(0.1, 0.3), tactile_sim.pose()), (tactile_sim.pose(), tilted(0.1, 0.3))):
        with pytest.raises(InputError, match="expected both upright; next: layer_m=0"):
            tactile_sim.render_touch(solid, *poses)


def test_layers_turn_and_move_with_their_solid():
    solid = tactile_sim.Pressable.of(ball(), layer_m=LAYER_M)
    sensor = tactile_sim.Sensor((65, 65), (0.01, 0.01))
    one = tactile_sim.render_touch(solid, tactile_sim.pose(), tactile_sim.pose(), sensor)
    place = tactile_sim.pose(0.011, -0.005, 0.001, turn_rad=0.7)
    other = tactile_sim.render_touch(solid, place, place, sensor)
    near = one.depth_m < 0.003
    assert near.sum() > 100
    assert np.percentile(np.abs(one.depth_m - other.depth_m)[near], 99) < 1e-12


@pytest.mark.parametrize("layer_m", [-0.0002, 0.2, float("nan"), "thin", None, 1e-6])
def test_invalid_layers_are_refused(layer_m):
    with pytest.raises(InputError, match=r"expected 2e-05 to 0\.002 m"):
        tactile_sim.Pressable.of(block(), layer_m=layer_m)
