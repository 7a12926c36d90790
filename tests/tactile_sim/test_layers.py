"""Printed solids: layers in closed form, against layers that are stacked and walked through."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import tactile_sim
from tactile_toolkit.errors import InputError
from tests.tactile_sim import reference
from tests.tactile_sim.solids import ball, block, tilted

LAYER_M = 0.0004


def _ramp(slope: float) -> trimesh.Trimesh:
    """A long wedge whose upper face rises along x, from z = 0 at x = -0.02."""
    height = 0.04 * slope
    ends = [[-0.02, y, 0] for y in (-0.03, 0.03)] + [[0.02, y, z] for y in (-0.03, 0.03) for z in (0, height)]
    return trimesh.convex.convex_hull(np.array(ends))


def _is_printed(x_m: np.ndarray, z_m: np.ndarray, slope: float) -> np.ndarray:
    """Whether points of the section of the ramp are inside a layer: the definition, layer by layer."""
    inside = np.zeros(x_m.shape, bool)
    radius = LAYER_M / 2
    for number in range(int(np.floor(0.04 * slope / LAYER_M + 0.5))):
        middle = (number + 0.5) * LAYER_M
        # The outline of the ramp at the middle of the layer, or half a percent below.
        edge = -0.02 + (middle - 0.005 * LAYER_M) / slope
        bulge = np.sqrt(np.maximum(radius**2 - (z_m - middle) ** 2, 0))
        inside |= (np.abs(z_m - middle) <= radius) & (x_m >= edge + radius - bulge)
    return inside


@pytest.mark.parametrize("lean", [-0.7, 0.0, 0.4])
@pytest.mark.parametrize("slope", [0.15, 0.5, 1.5])
def test_layers_are_where_a_walk_along_the_line_of_sight_meets_them(slope, lean):
    ramp = _ramp(slope)
    solid = tactile_sim.Pressable.of(ramp, layer_m=LAYER_M)
    sensor = tactile_sim.Sensor((41, 1), (0.004, 0.0001))
    target = tilted(abs(lean), 0.0 if lean >= 0 else np.pi, -0.002 if slope < 1 else -0.01)
    felt = tactile_sim.render_touch(solid, tactile_sim.pose(), target, sensor)
    heights = felt.sensor_z_m / target[2, 2] - felt.depth_m[0]
    along = target[:3, 2]
    places = (np.arange(41) - 20) * 0.004 / 41
    expected = []
    for place in places:
        foot = target[:3, :3] @ [place, 0, 0] + target[:3, 3]
        ideal = (slope * (foot[0] + 0.02) - foot[2]) / (along[2] - slope * along[0])
        steps = ideal + np.arange(0.0012, -0.0012, -5e-7)
        x, z = foot[0] + steps * along[0], foot[2] + steps * along[2]
        expected.append(steps[np.argmax(_is_printed(x, z, slope))])
    off = np.abs(heights - np.array(expected))
    assert np.sort(off)[-3] < 1e-6  # where one layer ends before another, rounding decides


@pytest.mark.sim
@given(
    st.sampled_from([(64, 64), (33, 20)]),
    st.floats(-np.pi, np.pi),
    st.floats(0, 3.1),
    st.floats(-0.01, 0.01),
    st.sampled_from([ball(subdivisions=3), block(), trimesh.creation.torus(0.01, 0.003)]),
)
def test_numba_and_numpy_give_the_same_layers(size, turn, lean, x_m, solid):
    prepared = tactile_sim.Pressable.of(solid, layer_m=LAYER_M)
    lying = tilted(lean, turn)
    lying[2, 3] = 0.02
    for object_pose, target in (
        (tactile_sim.pose(turn_rad=turn), tactile_sim.pose(x_m, 0.001)),
        (lying, tactile_sim.pose(x_m, 0.001)),
        (tactile_sim.pose(turn_rad=turn), tilted(min(lean, 0.8), turn, x_m)),
    ):
        found = [
            press(prepared, object_pose, target, tactile_sim.center_view(*size))
            for press in (tactile_sim.render_touch, reference.press)
        ]
        assert found[0].depth_m.tobytes() == found[1].depth_m.tobytes()
        assert found[0].sensor_z_m == found[1].sensor_z_m


def test_tops_end_at_whole_layers_and_feet_stay_flat():
    sensor = tactile_sim.full_view(64, 48)
    for height_mm, layers in ((4.0, 10), (4.19, 10), (4.2, 11), (4.41, 11)):
        solid = tactile_sim.Pressable.of(block((0.03, 0.03, height_mm / 1000)), layer_m=LAYER_M)
        felt = tactile_sim.render_touch(solid, tactile_sim.pose(), tactile_sim.pose(), sensor)
        assert felt.sensor_z_m == pytest.approx(layers * LAYER_M + sensor.press_m, abs=1e-12)
        assert np.ptp(felt.depth_m) < 1e-12
    turned = tilted(np.pi, 0.0)
    turned[2, 3] = 0.00441
    felt = tactile_sim.render_touch(solid, turned, tactile_sim.pose(), sensor)
    assert felt.sensor_z_m == pytest.approx(0.00441 + sensor.press_m, abs=1e-12)


def test_layers_turn_and_move_with_their_solid():
    solid = tactile_sim.Pressable.of(ball(), layer_m=LAYER_M)
    sensor = tactile_sim.Sensor((65, 65), (0.01, 0.01))
    one = tactile_sim.render_touch(solid, tactile_sim.pose(), tactile_sim.pose(), sensor)
    lean, place = tilted(0.5, 0.7), tactile_sim.pose(0.011, -0.005, 0.001)
    lean[:3, 3] += place[:3, 3]
    # The same relative pose: the ball and the sensor lean and move together.
    other = tactile_sim.render_touch(solid, lean, lean, sensor)
    near = one.depth_m < 0.003
    assert near.sum() > 100
    assert np.percentile(np.abs(one.depth_m - other.depth_m)[near], 99) < 1e-12


def test_layers_stay_near_the_solid():
    sensor = tactile_sim.center_view(200, 200)
    for lean in (0.0, 0.4, 0.9):
        target = tilted(lean, 0.3)
        target[:2, 3] = -0.008 * target[:2, 2] / target[2, 2]  # the axis goes through the middle of the ball
        smooth, printed = (
            tactile_sim.render_touch(
                tactile_sim.Pressable.of(ball(), layer_m=layer_m),
                tactile_sim.pose(),
                target,
                sensor,
            )
            for layer_m in (0.0, LAYER_M)
        )
        heights = [each.sensor_z_m / target[2, 2] - each.depth_m for each in (smooth, printed)]
        middle = np.hypot(*np.meshgrid(np.linspace(-7, 7, 200), np.linspace(-7, 7, 200))) < 3
        rise = (heights[1] - heights[0])[middle]
        assert rise.max() <= 0.51 * LAYER_M / np.sqrt(1 - (3 / 8) ** 2)
        assert rise.min() >= -1.5 * LAYER_M
        assert np.abs(rise).max() > 0.2 * LAYER_M


@pytest.mark.parametrize("layer_m", [-0.0002, 0.2, float("nan"), "thin", None, 1e-6])
def test_layers_that_cannot_be_are_refused(layer_m):
    with pytest.raises(InputError, match=r"expected 2e-05 to 0\.002 m"):
        tactile_sim.Pressable.of(block(), layer_m=layer_m)
