"""Gels in MuJoCo: weight, bounces, momentum, rolling, slip and grasps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from tactile_sim import Gel, GelWarning, Sensor, center_view
from tactile_toolkit.errors import InputError

mujoco = pytest.importorskip("mujoco", reason="needs mujoco, of the extra mujoco")

from tactile_sim.mujoco import GelCallback, GelSensor, gel_geom_xml  # noqa: E402  # it needs MuJoCo

pytestmark = pytest.mark.mujoco

SENSOR = center_view(32, 32)
GRAVITY = 9.81
FLAT = '<site name="gel" euler="180 0 0"/>'
"""A gel that is fixed to the world, at its origin, and faces up."""


@pytest.fixture(autouse=True)
def no_callback() -> Iterator[None]:
    """MuJoCo has one callback for all models, and compiles none while there is one."""
    mujoco.set_mjcb_control(None)
    yield
    mujoco.set_mjcb_control(None)


def simulation(body: str, step_s: float = 0.002, option: str = ""):
    mujoco.set_mjcb_control(None)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step_s}" {option}/><asset><mesh name="wedge" vertex="0 0 0 .012 0 0 0 '
        f'.012 0 0 0 .012"/></asset><worldbody>{body}</worldbody></mujoco>'
    )
    return model, mujoco.MjData(model)


def ball(mass_kg: float, z_m: float, radius_m: float = 0.008) -> str:
    return (
        f'<body name="ball" pos="0 0 {z_m}"><freejoint/>'
        f'<geom name="ball" type="sphere" size="{radius_m}" mass="{mass_kg}"/></body>'
    )


def steps(model, data, gels, count: int) -> None:
    mujoco.set_mjcb_control(GelCallback(*gels))
    for _ in range(count):
        mujoco.mj_step(model, data)


def test_a_ball_at_rest_bears_its_weight():
    model, data = simulation(FLAT + ball(0.05, 0.0085))
    gel = GelSensor(model, data, "gel", SENSOR)
    steps(model, data, [gel], 300)
    force_n = 0.05 * GRAVITY
    np.testing.assert_allclose(gel.wrench[:3], [0, 0, force_n], atol=1e-3 * force_n)
    assert gel.contact.force_n[2] == pytest.approx(force_n, rel=1e-3)
    pressed_m = 0.008 - data.qpos[2]
    assert gel.depth_m.min() == pytest.approx(SENSOR.gel_m - pressed_m, abs=1e-5)
    assert np.unique(gel.image).size > 10
    assert gel.markers_px((7, 9)).shape == (9, 7, 2)
    assert abs(data.qvel[:3]).max() < 1e-3


def bounces_m(step_s: float, sensor: Sensor = SENSOR) -> np.ndarray:
    """Return the heights in each step of a ball of 10 g that falls 5 mm onto a gel without relaxation."""
    model, data = simulation(FLAT + ball(0.01, 0.013), step_s)
    gel = GelSensor(model, data, "gel", sensor, relaxation_s=0.0)
    mujoco.set_mjcb_control(GelCallback(gel))
    heights_m = []
    for _ in range(round(0.4 / step_s)):
        mujoco.mj_step(model, data)
        heights_m.append(data.qpos[2] - 0.008)
    return np.array(heights_m)


def tops_m(heights_m: np.ndarray) -> np.ndarray:
    """Return the heights between bounces."""
    middle_m = heights_m[1:-1]
    return middle_m[(middle_m > heights_m[:-2]) & (middle_m >= heights_m[2:]) & (middle_m > 0)]


@pytest.mark.parametrize("step_s", [0.002, 0.0005])
def test_an_elastic_gel_gives_back_the_energy_of_a_ball(step_s):
    heights_m = tops_m(bounces_m(step_s))
    assert len(heights_m) >= 5
    np.testing.assert_allclose(heights_m, 0.005, rtol=0.03 if step_s > 0.001 else 0.003)


GEOMS = {
    "ball": 'type="sphere" size=".008"',
    "box": 'type="box" size=".005 .006 .004" euler="20 30 0"',
    "cylinder": 'type="cylinder" size=".006 .006" euler="70 0 0"',
    "capsule": 'type="capsule" size=".004 .006" euler="80 0 10"',
    "mesh": 'type="mesh" mesh="wedge"',
}


def dropped(geom: str, mass_kg: float, seed: int) -> float:
    """Return what a body has gained, of the energy of its fall, when it leaves the gel."""
    turn = np.random.default_rng(seed).uniform(-40, 40, 3)
    model, data = simulation(
        FLAT + f'<body pos="0 0 .018" euler="{turn[0]} {turn[1]} {turn[2]}"><freejoint/>'
        f'<geom {GEOMS[geom]} mass="{mass_kg}"/></body>'
    )
    gel = GelSensor(model, data, "gel", SENSOR)
    mujoco.set_mjcb_control(GelCallback(gel))
    energies_j, touches = [], []
    for _ in range(150):
        mujoco.mj_step(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        energies_j.append(data.energy.sum())
        touches.append(gel.wrench[2] > 0)
        # Later, it comes from the side of the gel.
        if len(touches) > 1 and touches[-2] and not touches[-1]:
            return (energies_j[-1] - energies_j[0]) / (mass_kg * GRAVITY * 0.01)
    assert touches[-1]
    return 0.0


@pytest.mark.parametrize("geom", GEOMS)
def test_a_gel_feels_all_types_of_geoms_and_adds_no_energy(geom):
    assert dropped(geom, 0.005, 0) < 0.01


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::tactile_sim.loop.gel_state.GelWarning")
@pytest.mark.parametrize("geom", GEOMS)
def test_drops_add_no_energy(geom):
    assert max(dropped(geom, 0.005, seed) for seed in range(24)) < 0.015


def test_momentum_is_kept():
    body = (
        '<body name="slab" pos="0 0 -.01" euler="180 0 0"><freejoint/>'
        '<geom type="box" size=".02 .02 .005" mass=".1" contype="0" conaffinity="0"/>'
        '<site name="gel" pos="0 0 -.01"/></body>' + ball(0.02, 0.0085)
    )
    model, data = simulation(
        body.replace('pos="0 0 0.0085"', 'pos=".004 .002 0.0085"'), 0.001, 'gravity="0 0 0"'
    )
    data.qvel[8] = -0.3
    gel = GelSensor(model, data, "gel", SENSOR)
    mujoco.mj_forward(model, data)
    momentum, angular = momenta(model, data)
    peak_n = 0.0
    mujoco.set_mjcb_control(GelCallback(gel))
    for _ in range(60):
        mujoco.mj_step(model, data)
        peak_n = max(peak_n, gel.wrench[2])
    assert peak_n > 0.5
    assert gel.wrench[2] == 0
    after, angular_after = momenta(model, data)
    np.testing.assert_allclose(after, momentum, atol=1e-15)
    np.testing.assert_allclose(angular_after, angular, atol=2e-4 * 0.02 * 0.3 * 0.01)


def momenta(model, data) -> tuple[np.ndarray, np.ndarray]:
    """Return the momentum of all bodies, and the angular one about the origin."""
    mujoco.mj_forward(model, data)
    total, angular = np.zeros((2, 3))
    for body in range(1, model.nbody):
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
        turn = data.ximat[body].reshape(3, 3)
        spin = turn @ (model.body_inertia[body] * (turn.T @ velocity[:3]))
        total += model.body_mass[body] * velocity[3:]
        angular += spin + np.cross(data.xipos[body], model.body_mass[body] * velocity[3:])
    return total, angular


def rolled(geom: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions in each step of a gel that slides over a body, and of the body, metres."""
    size = '".005"' if geom == "sphere" else '".005 .008"'
    lies = "" if geom == "sphere" else 'euler="90 0 0"'
    model, data = simulation(
        '<geom name="floor" type="plane" size="1 1 .1" friction="1"/>'
        '<body name="hand" mocap="true" pos="0 0 .0095"><site name="gel"/></body>'
        f'<body pos="0 0 .005" {lies}><freejoint/>'
        f'<geom name="roll" type="{geom}" size={size} mass=".01" friction="1" condim="3"/></body>'
    )
    gel = GelSensor(model, data, "gel", SENSOR, geoms=["roll"])
    mujoco.set_mjcb_control(GelCallback(gel))
    hand_m, body_m = [], []
    for step in range(300):
        data.mocap_pos[0, 0] = 0.01 * 0.002 * max(step - 100, 0)
        mujoco.mj_step(model, data)
        hand_m.append(data.mocap_pos[0, 0])
        body_m.append(data.qpos[0])
    return np.array(hand_m), np.array(body_m)


@pytest.mark.parametrize("geom", ["sphere", "cylinder"])
def test_a_body_rolls_at_half_the_speed_of_a_gel_that_slides_over_it(geom):
    hand_m, body_m = rolled(geom)
    assert (body_m[-1] - body_m[150]) / (hand_m[-1] - hand_m[150]) == pytest.approx(0.5, abs=0.02)


def pushed(shares: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Push a block by a share of its weight in each step; return friction over force, and path, metres."""
    model, data = simulation(
        FLAT + '<body name="block" pos="0 0 .0039"><freejoint/>'
        '<geom type="box" size=".004 .004 .004" mass=".05"/></body>'
    )
    gel = GelSensor(model, data, "gel", SENSOR, Gel(friction=0.3))
    mujoco.set_mjcb_control(GelCallback(gel))
    block = model.body("block").id
    ratios = []
    path_m = []
    for share in shares:
        data.xfrc_applied[block, 0] = share * 0.05 * GRAVITY
        mujoco.mj_step(model, data)
        ratios.append(gel.wrench[0] / gel.wrench[2])
        path_m.append(data.qpos[0])
    return np.array(ratios), np.array(path_m)


def test_a_block_that_is_pushed_is_carried_or_slips():
    ratios, path_m = pushed([0.25] * 150 + [0.35] * 60)
    assert ratios[149] == pytest.approx(0.25, rel=0.02)
    assert path_m[149] < 0.002
    assert ratios[-1] == pytest.approx(0.3, rel=0.02)
    assert path_m[-1] - path_m[149] > 0.002


def hand(mass_kg: float) -> str:
    """Two gels on fingers that close along x, on a hand that goes up."""

    def finger(name: str, x_m: float, side: int) -> str:
        return (
            f'<body pos="{x_m} 0 0" xyaxes="0 {side} 0 0 0 1">'
            f'<joint type="slide" axis="0 0 -1" name="{name}"/>'
            f'{gel_geom_xml(name, SENSOR)}<geom type="box" size=".01 .008 .004" pos="0 0 .009" mass=".05" '
            'contype="0" conaffinity="0"/></body>'
        )

    return (
        '<geom name="floor" type="plane" size="1 1 .1"/><body name="hand" pos="0 0 .012">'
        '<joint name="lift" type="slide" axis="0 0 1"/><geom size=".01" mass=".5" pos="0 0 .1" contype="0" '
        f'conaffinity="0"/>{finger("left", -0.012, -1)}{finger("right", 0.012, 1)}</body>'
        + ball(mass_kg, 0.01, 0.01)
    )


ACTUATORS = (
    '<actuator><position joint="lift" kp="2000" dampratio="1"/><motor joint="left"/><motor joint="right"/>'
    "</actuator>"
)


def lifting(share: float, grip_n: float) -> Iterator[list[GelSensor]]:
    """Grip and lift a ball whose weight is a share of what friction bears; yield the gels in each step."""
    mass_kg = share * 2 * 0.5 * grip_n / GRAVITY
    mujoco.set_mjcb_control(None)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep=".002"/><worldbody>{hand(mass_kg)}</worldbody>{ACTUATORS}</mujoco>'
    )
    data = mujoco.MjData(model)
    gels = [GelSensor(model, data, name, SENSOR, geoms=["ball"]) for name in ("left", "right")]
    mujoco.set_mjcb_control(GelCallback(*gels))
    for step in range(450):
        data.ctrl[:] = min(max(step - 150, 0) * 1e-4, 0.02) + 0.5 * GRAVITY / 2000, grip_n, grip_n
        mujoco.mj_step(model, data)
        yield gels


def lift_n(gels: list[GelSensor]) -> float:
    """Return the force with which gels lift a body."""
    return -sum((gel.pose[:3, :3] @ gel.wrench[:3])[2] for gel in gels)


def ball_in_hand_m(data) -> float:
    """Return the height of the ball relative to the hand."""
    return data.body("ball").xpos[2] - data.body("hand").xpos[2]


def grasp(share: float, grip_n: float) -> tuple[bool, list[GelSensor]]:
    """Grip and lift a ball whose weight is a share of what friction bears; return whether it is held."""
    *_, gels = lifting(share, grip_n)
    return bool(gels[0].data.body("ball").xpos[2] > 0.02), gels


@pytest.mark.parametrize(("share", "holds"), [(0.3, True), (0.9, True), (1.1, False)])
def test_two_fingers_hold_what_friction_bears(share, holds):
    is_held, gels = grasp(share, 1.0)
    assert is_held == holds
    if holds:
        data = gels[0].data
        assert lift_n(gels) == pytest.approx(share, rel=2e-3)
        assert gels[0].wrench[2] == pytest.approx(1.0, rel=0.01)
        before_m = ball_in_hand_m(data)
        for _ in range(150):
            mujoco.mj_step(gels[0].model, data)
        assert abs(ball_in_hand_m(data) - before_m) < 2e-6


def offsets_m(gain_per_s: float) -> np.ndarray:
    """Return how far a ball on a circling floor is from the middle of a gel above it, in each step, metres.

    Fifty times a second, the gel looks at its depth map alone, and moves at a gain times the offset it sees.
    """
    model, data = simulation(
        '<body name="floor"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<geom name="floor" type="box" size=".1 .1 .01" pos="0 0 -.01" mass="5" friction="1"/></body>'
        '<body name="hand" mocap="true" pos="0 0 .0095"><site name="gel"/></body>' + ball(0.01, 0.005, 0.005)
    )
    gel = GelSensor(model, data, "gel", SENSOR, geoms=["ball"])
    mujoco.set_mjcb_control(GelCallback(gel))
    rows, columns = np.indices(gel.depth_m.shape) - (len(gel.depth_m) - 1) / 2
    xy_m = np.stack([columns, -rows]) * np.reshape(SENSOR.pixel_m, (2, 1, 1))
    velocity_m_s = np.zeros(2)
    offsets_xy_m = []
    for step in range(1000):
        if step % 10 == 0:
            pressed_m = SENSOR.gel_m - gel.depth_m
            weights = np.maximum(pressed_m - pressed_m.max() / 2, 0)
            velocity_m_s = gain_per_s * (xy_m * weights).sum(axis=(1, 2)) / max(weights.sum(), 1e-9)
        data.mocap_pos[0, :2] += velocity_m_s * 0.002
        data.qvel[:2] = 0.06 * np.array([np.sin(step * 0.006), np.cos(step * 0.006)])
        mujoco.mj_step(model, data)
        offsets_xy_m.append(data.body("ball").xpos[:2] - data.mocap_pos[0, :2])
    return np.linalg.norm(offsets_xy_m, axis=1)


def test_a_policy_that_sees_only_depth_keeps_a_ball_on_a_moving_floor():
    assert offsets_m(30.0).max() < 0.0031
    # Without it, the ball leaves the gel.
    assert offsets_m(0.0).max() > 0.01


def test_a_callback_is_the_same_as_own_steps():
    results = []
    for is_callback in (True, False):
        model, data = simulation(FLAT + ball(0.02, 0.0085))
        gel = GelSensor(model, data, "gel", SENSOR)
        callback = GelCallback(gel)
        if is_callback:
            mujoco.set_mjcb_control(callback)
        for _ in range(40):
            if is_callback:
                mujoco.mj_step(model, data)
            else:
                mujoco.mj_step1(model, data)
                callback(model, data)
                mujoco.mj_step2(model, data)
        results.append((data.qpos.copy(), gel.wrench))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_forces_of_users_stay():
    model, data = simulation(FLAT + ball(0.02, 0.0085) + ball(0.02, 0.1).replace('"ball"', '"free"'))
    gel = GelSensor(model, data, "gel", SENSOR)
    body, free = model.body("ball").id, model.body("free").id
    data.xfrc_applied[free, 1] = 0.5
    data.xfrc_applied[body, 2] = -0.1
    steps(model, data, [gel], 200)
    # Set once, it acts in each step.
    assert gel.wrench[2] == pytest.approx(0.02 * GRAVITY + 0.1, rel=0.01)
    assert data.xfrc_applied[free, 1] == 0.5
    # Cleared, as viewers do, only the gel pushes.
    for _ in range(200):
        data.xfrc_applied[:] = 0
        mujoco.mj_step(model, data)
    assert gel.wrench[2] == pytest.approx(0.02 * GRAVITY, rel=0.01)
    assert data.xfrc_applied[body, 2] == pytest.approx(gel.wrench[2])


def test_a_gel_without_reaction_only_sees():
    model, data = simulation(FLAT + ball(0.02, 0.0075), option='gravity="0 0 0"')
    gel = GelSensor(model, data, "gel", SENSOR, reaction=False)
    steps(model, data, [gel], 5)
    assert gel.wrench[2] > 0.1
    assert (data.xfrc_applied == 0).all()
    assert data.qpos[2] == 0.0075


def test_a_reset_begins_anew():
    model, data = simulation(FLAT + ball(0.02, 0.0085))
    gel = GelSensor(model, data, "gel", SENSOR)
    steps(model, data, [gel], 100)
    first = data.qpos.copy()
    mujoco.mj_resetData(model, data)
    for _ in range(100):
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.qpos, first)


def test_a_body_that_is_too_light_for_the_step_is_named():
    model, data = simulation(FLAT + ball(0.0005, 0.0095), 0.004)
    gel = GelSensor(model, data, "gel", SENSOR)
    with pytest.warns(GelWarning, match="body 'ball' is too light for steps of 4 ms"):
        steps(model, data, [gel], 20)


def test_models_that_do_not_fit_are_refused():
    model, data = simulation(FLAT + ball(0.02, 0.0085), option='integrator="RK4"')
    with pytest.raises(InputError, match=r"model and data are 3 and .*; expected an MjModel and its MjData"):
        GelSensor(3, data, "gel")
    with pytest.raises(InputError, match=r"no such site or geom.*'gel'"):
        GelSensor(model, data, "gell")
    with pytest.raises(InputError, match=r"no such site or geom.*'ball'"):
        GelSensor(model, data, "gel", geoms=["bal"])
    with pytest.raises(InputError, match="relaxation_s is -1"):
        GelSensor(model, data, "gel", relaxation_s=-1.0)
    gel = GelSensor(model, data, "gel", SENSOR)
    mujoco.mj_forward(model, data)
    with pytest.raises(InputError, match="the integrator is RK4"):
        GelCallback(gel)(model, data)
    with pytest.raises(InputError, match="there are 0 gels"):
        GelCallback()
    with pytest.raises(InputError, match=r"as in GelCallback\(left, right\)"):
        GelCallback([gel])
