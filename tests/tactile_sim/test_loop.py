"""A gel among bodies in their poses: heights, forces and the history of friction."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import tactile_sim
from tactile_sim import Gel, GelState, GelWarning, Sensor, Shape, center_view, pose, press_at
from tactile_toolkit.errors import InputError

FACING_UP = np.diag([1.0, -1.0, -1.0, 1.0])
"""A gel at the origin whose surface faces up: z into the gel points down."""


def turned(*rotation: float, position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    matrix[:3, 3] = position_m
    return matrix


def over(pressed_m: float, radius_m: float, x_m: float = 0.0) -> np.ndarray:
    """A ball of a radius, pressed into a gel that faces up."""
    return pose(x_m, 0.0, radius_m - pressed_m)


def dome() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(3, 0.008)


def test_a_stop_on_the_plate_is_a_touch_of_render_touch():
    sensor = center_view(64, 64)
    lies = pose(0.001, 0.002, 0.008, turn_rad=0.3)
    stopped = tactile_sim.render_touch(dome(), lies, pose(0.002, 0.0), sensor)
    gel_pose = pose(0.002, 0.0, stopped.sensor_z_m - sensor.gel_m)
    pressed = press_at(dome(), lies, gel_pose, sensor)
    # The plate lies deeper than the gel.
    np.testing.assert_allclose(pressed.depth_m, np.minimum(stopped.depth_m, sensor.gel_m), atol=1e-15)
    assert pressed.sensor_z_m == pytest.approx(stopped.sensor_z_m)
    assert pressed.contacts == ()


def test_an_elastic_gel_has_the_forces_of_render_touch():
    sensor = center_view(64, 64)
    lies = pose(0.0005, 0.001, 0.008)
    load = tactile_sim.GelLoad(depth_m=0.001)
    stopped = tactile_sim.render_touch(dome(), lies, pose(), sensor, load=load)
    gel_pose = pose(0.0, 0.0, stopped.sensor_z_m - sensor.gel_m)
    pressed = press_at([dome()], lies, gel_pose, sensor, gel=Gel())
    np.testing.assert_allclose(pressed.wrenches[0, :3], stopped.contact.force_n, atol=1e-3)
    np.testing.assert_allclose(pressed.depth_m, stopped.depth_m, atol=5e-5)
    assert np.abs(pressed.depth_m - stopped.depth_m).mean() < 3e-6
    assert pressed.contact.force_n == pytest.approx(tuple(pressed.wrenches[0, :3]))


def test_only_relative_poses_matter():
    bodies = [Shape("sphere", (0.006,)), Shape("box", (0.002, 0.003, 0.004))]
    steps = [
        np.stack([turned(0.1 * step, 0, 0, position_m=(-0.003, step * 1e-4, 0.0055)), pose(0.004, 0, 0.0035)])
        for step in range(3)
    ]
    everything = turned(0.4, -1.1, 2.0, position_m=(0.3, -0.2, 0.7))
    state, moved_state = (GelState(center_view(32, 32)) for _ in range(2))
    for poses in steps:
        wrenches = state.press(bodies, poses, FACING_UP)
        moved = moved_state.press(bodies, everything @ poses, everything @ FACING_UP)
        np.testing.assert_allclose(moved, wrenches, atol=1e-6)
    assert (wrenches[:, 2] > 0.1).all()
    np.testing.assert_allclose(state.contact.force_n, wrenches[:, :3].sum(axis=0))


def capsule() -> trimesh.Trimesh:
    """The one of trimesh has a gap."""
    ends = [trimesh.creation.icosphere(5, 0.006).apply_translation((0, 0, z_m)) for z_m in (-0.006, 0.006)]
    return trimesh.util.concatenate([trimesh.creation.cylinder(0.006, 0.012, sections=800), *ends])


MESHES = {
    "sphere": ((0.01,), lambda: trimesh.creation.icosphere(5, 0.01), 4e-6),
    "ellipsoid": (
        (0.006, 0.007, 0.011),
        lambda: trimesh.creation.icosphere(5, 1.0).apply_scale((0.006, 0.007, 0.011)),
        5e-6,
    ),
    "box": ((0.004, 0.005, 0.01), lambda: trimesh.creation.box((0.008, 0.01, 0.02)), 1e-12),
    "cylinder": ((0.006, 0.009), lambda: trimesh.creation.cylinder(0.006, 0.018, sections=800), 2e-7),
    "capsule": ((0.006, 0.006), capsule, 4e-6),
}


@pytest.mark.parametrize("turn", [(0.3, 0.8, -0.5), (0.0, 0.0, 0.0)], ids=["tilted", "upright"])
@pytest.mark.parametrize("kind", MESHES)
def test_shapes_are_as_their_meshes(kind, turn):
    size_m, make, error_m = MESHES[kind]
    mesh = make()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    matrix = turned(*turn, position_m=(0.0011, -0.0007, 0.0))
    matrix[2, 3] = 0.001 - (matrix[:3, :3] @ mesh.vertices.T)[2].max()
    sensor = Sensor((61, 47))
    shape = press_at(Shape(kind, size_m), matrix, np.eye(4), sensor)
    np.testing.assert_allclose(
        shape.depth_m,
        press_at(tactile_sim.Pressable.of(mesh, check=False), matrix, np.eye(4), sensor).depth_m,
        atol=error_m,
    )
    assert 20 < (shape.depth_m < sensor.gel_m).sum() < shape.depth_m.size


def test_a_plane_is_the_half_space_below_it():
    sensor = Sensor((8, 6))
    pressed = press_at(Shape("plane"), turned(0.0, 0.01, 0.0, position_m=(0, 0, 0.001)), np.eye(4), sensor)
    x_m = (np.arange(8) - 3.5) * sensor.pixel_m[0]
    np.testing.assert_allclose(sensor.gel_m - pressed.depth_m, np.tile(0.001 - np.tan(0.01) * x_m, (6, 1)))


def test_bodies_behind_the_gel_are_not_felt():
    sensor = Sensor((16, 12))
    box = Shape("box", (0.02, 0.02, 0.002))
    poses = np.stack([pose(0, 0, 0.02), pose(0, 0, -0.001)])
    pressed = press_at([box, box], poses, np.eye(4), sensor)
    np.testing.assert_allclose(pressed.depth_m, sensor.gel_m - 0.001)


def test_a_gel_inside_a_hollow_body_feels_the_wall_in_front():
    tube = trimesh.creation.annulus(0.03, 0.034, 0.08)
    faces_x = turned(0.0, -np.pi / 2, 0.0, position_m=(0.0305, 0.0, 0.0))
    pressed = press_at(tube, pose(), faces_x, center_view(33, 33))
    assert pressed.depth_m[16, 16] == pytest.approx(0.00425 - 0.0005, abs=5e-5)


def test_a_gel_that_touches_nothing_is_at_rest():
    state = GelState(center_view(16, 16))
    assert (state.depth_m == state.sensor.gel_m).all()
    ball = Shape("sphere", (0.005,))
    state.press([ball], over(0.001, 0.005), FACING_UP)
    assert state.depth_m.min() < state.sensor.gel_m - 0.0009
    assert (state.press([ball], over(-0.001, 0.005), FACING_UP) == 0).all()
    assert (state.depth_m == state.sensor.gel_m).all()
    assert state.contact.force_n == (0.0, 0.0, 0.0)
    assert not state.contact.is_contact.any()


class HalfSpace:
    """A ball on a gel that is much thicker than its contact: Hertz, Cattaneo and Mindlin."""

    radius_m, depth_m, friction = 0.002, 0.00002, 0.4
    gel = Gel(0.2e6, 0.5, friction)

    @property
    def normal_n(self) -> float:
        return 4 / 3 * self.gel.youngs_modulus_pa / 0.75 * self.radius_m**0.5 * self.depth_m**1.5

    @property
    def slip_m(self) -> float:
        """The shift at which all of the contact slips."""
        contact_m = (self.radius_m * self.depth_m) ** 0.5
        return 3 * self.friction * self.normal_n * 1.5 / (16 * contact_m * self.gel.shear_modulus_pa)

    def load_n(self, shift_m: float) -> float:
        """Tangential force of a first load, to either side."""
        share = min(abs(shift_m) / self.slip_m, 1.0)
        return math.copysign(self.friction * self.normal_n * (1 - (1 - share) ** 1.5), shift_m)


def load_cycle() -> Iterator[tuple[float, float, float]]:
    """Yield shift (m), force (N) and that of the theory, while a ball is sheared there, back and there."""
    hertz = HalfSpace()
    sensor = Sensor((64, 64), (0.0008, 0.0008), gel_m=0.05, surface_m=(0.0008, 0.0008))
    state = GelState(sensor, hertz.gel, solved_m=0.0000126)
    ball = Shape("sphere", (hertz.radius_m,))
    for depth_m in np.linspace(0.2, 1, 5) * hertz.depth_m:
        state.press([ball], over(depth_m, hertz.radius_m), FACING_UP)
    assert state.wrenches[0, 2] == pytest.approx(hertz.normal_n, rel=0.01)
    # Masing's rule: a branch is the first load at twice the size, from where it turned.
    turn_m = turn_n = 0.0
    scale = 1
    for start_m, end_m in ((0.0, 0.7), (0.7, -0.2), (-0.2, 0.7)):
        for shift_m in np.linspace(start_m, end_m, 10) * hertz.slip_m:
            theory_n = turn_n + scale * hertz.load_n((shift_m - turn_m) / scale)
            wrench = state.press([ball], over(hertz.depth_m, hertz.radius_m, shift_m), FACING_UP)[0]
            yield shift_m, wrench[0], theory_n
        turn_m, turn_n, scale = shift_m, theory_n, 2


def test_friction_remembers_as_that_of_mindlin():
    shifts_m, forces_n, theory_n = np.array(list(load_cycle())).T
    full_n = HalfSpace.friction * HalfSpace().normal_n
    assert np.abs(forces_n - theory_n).max() < 0.01 * full_n
    # The curve back is not the one forth.
    there_n = np.interp(shifts_m[14], shifts_m[:10], theory_n[:10])
    assert there_n - theory_n[14] > 0.1 * full_n


def test_a_sheared_contact_does_not_creep():
    state = GelState(center_view(64, 64))
    ball = Shape("sphere", (0.008,))
    for step in range(20):
        state.press([ball], over(5e-5 * step, 0.008, 1e-5 * step), FACING_UP)
    first = state.press([ball], over(1e-3, 0.008, 2e-4), FACING_UP)
    for _ in range(300):
        last = state.press([ball], over(1e-3, 0.008, 2e-4), FACING_UP)
    assert first[0, 0] > 0.2
    np.testing.assert_allclose(last, first, atol=5e-4 * first[0, 2])
    for _ in range(100):
        np.testing.assert_allclose(state.press([ball], over(1e-3, 0.008, 2e-4), FACING_UP), last, atol=1e-6)


def test_a_sliding_ball_feels_friction_times_its_force():
    state = GelState(center_view(64, 64), Gel(friction=0.3))
    ball = Shape("sphere", (0.008,))
    for step in range(40):
        wrench = state.press([ball], over(0.0008, 0.008, 5e-5 * step), FACING_UP)[0]
    assert wrench[0] == pytest.approx(0.3 * wrench[2], rel=0.01)


def test_a_body_that_is_new_has_not_moved():
    ball = Shape("sphere", (0.008,))
    state, other_state = GelState(center_view(32, 32)), GelState(center_view(32, 32))
    state.press([ball], over(-0.02, 0.008), FACING_UP, ["first"])
    wrench = state.press([ball], over(0.001, 0.008, 0.003), FACING_UP, ["second"])
    np.testing.assert_allclose(wrench, other_state.press([ball], over(0.001, 0.008, 0.003), FACING_UP))


@pytest.mark.parametrize("turn_rad", [0.0, 0.1, 0.5])
def test_the_gel_is_somewhere_beside_the_edge_of_a_box(turn_rad):
    """A block of pixels that is in contact may lie partly beside the body, which has no height there."""
    state = GelState(center_view(64, 64))
    for pressed_m in (8e-5, 5e-4):
        pose_of_box = turned(0.0, 0.0, turn_rad, position_m=(0.0, 0.0, 0.003 - pressed_m))
        state.press([Shape("box", (0.003, 0.003, 0.003))], pose_of_box, FACING_UP)
        assert np.isfinite(state.contact.displacement_m).all()
        assert state.depth_m.min() == pytest.approx(state.sensor.gel_m - pressed_m)
        assert state.depth_m.max() < state.sensor.gel_m + pressed_m


def test_what_the_theory_does_not_carry_is_named():
    ball = Shape("sphere", (0.008,))
    state = GelState(center_view(32, 32))
    state.press([ball], over(0.0015, 0.008, 0.02), FACING_UP, ["ball"])
    with pytest.warns(GelWarning, match="body 'ball' is 1.50 mm deep in the gel in its first step"):
        state.press([ball], over(0.0015, 0.008), FACING_UP, ["ball"])
    state.press([ball], over(0.0016, 0.008), FACING_UP, ["ball"])
    with pytest.warns(GelWarning, match="body 'ball' is 2.40 mm deep in a gel of 4.25 mm"):
        state.press([ball], over(0.0024, 0.008), FACING_UP, ["ball"])
    state.press([ball], over(0.0025, 0.008), FACING_UP, ["ball"])  # once for each body
    state.press([ball], over(-0.001, 0.008), FACING_UP, ["ball"])
    # It comes from the front.
    state.press([ball], over(0.001, 0.008), FACING_UP, ["other"])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Shape("cone", (0.1,)), "kind is 'cone'"),
        (lambda: Shape("box", (0.1, 0.1)), "expected 3 numbers"),
        (lambda: Shape("sphere", (-1.0,)), "expected 1 numbers above 0"),
        (lambda: GelState(gel=0.2e6), "expected a Gel"),
        (lambda: GelState("digit"), "sensor is str"),
        (lambda: GelState().press([Shape("plane")], np.stack([pose()] * 2), pose()), "2 object_poses"),
        (
            lambda: GelState().press([Shape("plane")] * 2, [pose()] * 2, pose(), ["a", "a"]),
            "1 different keys",
        ),
        (lambda: press_at(Shape("plane"), 2 * np.eye(4), pose()), "object_poses is not a rigid pose"),
    ],
)
def test_input_that_is_none_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
