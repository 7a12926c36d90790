"""Sensors that turn, compared with the published environments and with rays; properties of all actions."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")

from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

import mnist3d
from realtouch import Poses
from tactile_envs.entry_points import make_vector
from tactile_sim import center_view
from tactile_sim.optics.rendering import make_optics
from tactile_toolkit.errors import InputError
from tests.published_envs import make
from tests.tactile_envs.lockstep import walk

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

ENVS = 2
VOLUME, CENTRE = "ABCVolume-Depth-train-v0", "ABCCenterOfMass-Depth-train-v0"
TURN, TURNED = "sensor_target_rot_rel", "sensor_rot"
MOST_RAD = np.pi / 4
PRESS_M, GEL_M = 0.002125, 0.00425
HALF_MICROMETRE_M = 0.5e-6


def bracket() -> trimesh.Trimesh:
    """Return an L of two walls, millimetres, one solid."""
    outline = np.array([(0, 0), (30, 0), (30, 8), (8, 8), (8, 25), (0, 25)], float)
    cap = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    sides = [(k, (k + 1) % 6, (k + 1) % 6 + 6) for k in range(6)]
    sides += [(k, (k + 1) % 6 + 6, k + 6) for k in range(6)]
    vertices = np.vstack([np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, 12.0)]])
    return trimesh.Trimesh(vertices, np.vstack([cap[:, ::-1], cap + 6, sides]))


@pytest.fixture(scope="module")
def solids(tmp_path_factory: pytest.TempPathFactory, assets: Path) -> Path:
    """A folder of STL files, none of which lies on its broadest side."""
    folder = tmp_path_factory.mktemp("solids")
    made = {
        "block": trimesh.creation.box((30, 20, 40)),
        "bolt": trimesh.creation.cylinder(9, 40, sections=96),
        "nut": trimesh.creation.annulus(5, 12, 8),
        "ring": trimesh.creation.torus(18, 6, 64, 32),
        "bracket": bracket(),
    }
    for digit in mnist3d.load(str(assets / "mnist3d"), "train")[:2]:
        made[f"digit{digit.label}"] = trimesh.Trimesh(digit.vertices_m * 1000, digit.faces)
    for name, solid in made.items():
        assert solid.is_watertight
        solid.apply_transform(trimesh.transformations.rotation_matrix(0.9, (1, 2, 3))).export(
            folder / f"{name}.stl"
        )
    return folder


def _same(theirs: Any, ours: Any) -> None:
    """Compare everything except images and heights: directions to 3e-7, places to 20 micrometres, scores."""
    (there, seen, *outcome), (here, found, *result) = theirs, ours
    assert seen.keys() == found.keys()
    assert found[TURNED].dtype == seen[TURNED].dtype
    np.testing.assert_allclose(found[TURNED], seen[TURNED], atol=3e-7)
    # The published one leaves its space if a sensor slides along its axis out of its limits.
    np.testing.assert_allclose(found["sensor_pos"], np.clip(seen["sensor_pos"], -1, 1), atol=2e-3)
    assert (found["time_step"] == seen["time_step"]).all()
    targets = [env.current_sensor_target_poses_platform_frame.matrix for env in (there.unwrapped, here)]
    np.testing.assert_allclose(targets[1], targets[0], atol=2e-5)
    assert (there.unwrapped.current_data_point_indices == here.current_data_point_indices).all()
    lying = [env.current_object_poses_platform_frame.matrix for env in (there.unwrapped, here)]
    np.testing.assert_allclose(lying[1], lying[0], atol=1e-12)
    if len(outcome) == 1:
        return
    for one, other in zip(outcome[1:3], result[1:3], strict=True):
        assert (one == other).all()
    np.testing.assert_allclose(result[0], outcome[0], rtol=1e-5, atol=2e-5)
    theirs_info, info = outcome[-1], result[-1]
    assert theirs_info.keys() == info.keys()
    np.testing.assert_array_equal(info["base_reward"], theirs_info["base_reward"])
    target = theirs_info["prediction"]["target"]
    np.testing.assert_allclose(info["prediction"]["target"], target, rtol=1e-5, atol=2e-6)
    if "stats" in theirs_info:
        for name, values in theirs_info["stats"]["scalar"].items():
            shown = info["stats"]["scalar"][name]
            np.testing.assert_allclose(shown, np.ravel(values), rtol=1e-4, atol=2e-6)


@pytest.mark.sim
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("env_id", "steps", "config"),
    [
        (VOLUME, 132, {}),
        (CENTRE, 132, {}),
        ("TactileMNISTVolumeSnap-Depth-train-v0", 40, {"allow_sensor_rotation": True}),
        (VOLUME, 40, {"allow_sensor_rotation": False}),
        (
            VOLUME,
            40,
            {"max_tilt_angle": 0.2, "cell_padding": (0.0, 0.005), "randomize_initial_sensor_pose": False},
        ),
    ],
)
def test_same_episodes(env_id, steps, config, solids, packages):
    """Poses and depth to half a micrometre.

    A pixel in 20,000 beside an edge lies on its other side, as the driver rounds corners to 1/256 of a pixel.
    In one of some hundred touches it is the nearest one, and the sensor stops some micrometres apart.
    """
    theirs = make(env_id, assets=solids, num_envs=ENVS, config=config)
    ours = make_vector(env_id, assets=solids, num_envs=ENVS, config={**config, "depth_in_info": True})
    for name in ("action_space", "observation_space", "prediction_target_space"):
        assert getattr(theirs, name) == getattr(ours, name), name
    apart_m: list[Any] = []
    off: list[Any] = []

    def compare(one: Any, other: Any) -> None:
        if ours.config.allow_sensor_rotation:
            _same(one, other)
        info, native = one[-1], other[-1]
        apart_m.append(np.abs(info["sensor_pose"].matrix - native["sensor_pose"]).max(axis=(1, 2)))
        stopped_alike = apart_m[-1] < HALF_MICROMETRE_M
        far = np.abs(info["depth"] - native["depth"]) > HALF_MICROMETRE_M
        off.append((far & (info["depth"] < GEL_M))[stopped_alike])

    walk(theirs, ours, steps, compare)
    theirs.close()
    assert np.max(apart_m) < 2e-5
    assert (np.array(apart_m) > HALF_MICROMETRE_M).mean() < 0.01
    assert np.concatenate(off).mean() < 5e-5


@pytest.mark.sim
def test_pictures_are_those_of_the_optics_for_the_depth_that_is_stated(solids):
    """`test_lockstep.py` compares the optics with those of the published environments."""
    pytest.importorskip("taxim", reason="taxim (extra `sim`) is not installed")
    env = make_vector("ABCVolume-train-v0", assets=solids, num_envs=4, config={"depth_in_info": True})
    seen, info = env.reset(seed=3)
    for _ in range(3):
        depth_m = info["depth"].astype(np.float64)
        expected = make_optics("taxim").shades(depth_m, center_view(64, 64), (64, 64))
        np.testing.assert_allclose(seen["sensor_img"], expected, atol=1e-5)
        assert (np.abs(expected - expected[:, :1, :1]).max(axis=(1, 2, 3)) > 0.1).any()
        seen, *_, info = env.step(env.action_space.sample())


def _seen_by_rays(env: Any, row: int, axes: Any, from_m: Any) -> Any:
    """Return heights above ``from_m``, along the axis of a sensor, at which rays hit; -inf without a hit."""
    object_m = env.current_object_poses_platform_frame.matrix[row]
    record = env.current_data_points[row]
    solid = trimesh.Trimesh(record.vertices_m, record.faces, process=False).apply_transform(object_m)
    width_m, depth_m = env.config.cell_size
    plate = trimesh.creation.box((width_m, depth_m, 0.002)).apply_translation((0, 0, -0.001))
    view = center_view(*env.config.sensor_output_size)
    (width, height), (off_x, off_y) = view.size_px, view.sample_px
    across, up = np.meshgrid(np.arange(width) + 0.5 + off_x, height - 0.5 - np.arange(height) + off_y)
    flat = np.stack([across / width - 0.5, up / height - 0.5], axis=-1).reshape(-1, 2) * view.window_m
    far_m = 0.2
    starts = from_m + far_m * axes[:, 2] + flat @ axes[:, :2].T
    heights = np.full(len(starts), -np.inf)
    for mesh in (solid, plate):
        places, rays, _ = mesh.ray.intersects_location(starts, np.tile(-axes[:, 2], (len(starts), 1)))
        np.maximum.at(heights, rays, (places.reshape(-1, 3) - from_m) @ axes[:, 2])
    return heights.reshape(height, width)


@pytest.mark.parametrize("env_id", [VOLUME, "TactileMNIST-Depth-train-v0"])
def test_a_tilted_sensor_agrees_with_rays(env_id, solids):
    """Also at the edge of the plate, which the sensor sees here."""
    config = {
        "sensor_output_size": (24, 16),
        "depth_in_info": True,
        "allow_sensor_rotation": True,
        "perturb_object_pose": False,
        "cell_padding": (0.0, 0.0),
    }
    env = make_vector(env_id, assets=solids, num_envs=6, config=config)
    tilted, off_edge, on_object = 0, 0, 0
    for seed in range(2):
        _, info = env.reset(seed=seed)
        for row, (pose, depth_m) in enumerate(zip(info["sensor_pose"], info["depth"], strict=True)):
            seen_m = _seen_by_rays(env, row, pose[:3, :3], pose[:3, 3])
            # The gel's camera is at the sensor; the nearest point is pressed in by half the gel.
            assert depth_m.min() == pytest.approx(PRESS_M, abs=1e-8)
            hit = np.isfinite(seen_m)
            close = np.abs(depth_m + seen_m)[hit] < HALF_MICROMETRE_M
            assert close.mean() > 0.985
            assert (depth_m[~hit] > 0.1).mean() > 0.9 if (~hit).any() else True
            tilted += pose[2, 2] < 0.95
            off_edge += (~hit).any()
            on_object += np.ptp(depth_m) > GEL_M
    assert tilted > 4
    assert off_edge
    assert on_object


def test_without_tilt_it_agrees_with_upright_sensors(solids):
    starts = [np.array([0.004, -0.003]), np.eye(4)]
    options = {"datapoint_idx": [0, 3], "initial_object_pose": [(0.0, 0.0, 0.4)] * 2}
    seen = []
    for turns in (False, True):
        config = {"allow_sensor_rotation": turns, "depth_in_info": True, "perturb_object_pose": False}
        env = make_vector(VOLUME, assets=solids, num_envs=2, config=config)
        observation, info = env.reset(seed=0, options={**options, "initial_sensor_target_pose": starts})
        seen.append(
            (observation["sensor_pos"], observation["sensor_img"], info["depth"], info["sensor_pose"])
        )
    for one, other in zip(*seen, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5 if one is seen[0][1] else 2e-6)


@settings(max_examples=settings.default.max_examples // 4)
@given(
    seed=st.integers(0, 2**31),
    most_rad=st.floats(0, MOST_RAD),
    speed=st.sampled_from([1.0, 1000.0]),
    scale=st.sampled_from([0.0, 1.0, 1e3]),
)
def test_tilt_stays_in_its_limit_and_axes_orthonormal(solids, seed, most_rad, speed, scale):
    """For any action, even one that turns a sensor over."""
    config = {
        "max_tilt_angle": most_rad,
        "angular_velocity": speed,
        "angular_acceleration": 1e3 * speed,
        "sensor_output_size": (8, 8),
        "smallest_dimension_up": False,
    }
    env = make_vector(VOLUME, assets=solids, num_envs=3, config=config)
    env.action_space.seed(seed)
    results = [env.reset(seed=seed)]
    for _ in range(6):
        action = env.action_space.sample()
        action["action"][TURN] *= scale
        results.append(env.step(action))
    for observation, *_, info in results:
        assert observation in env.observation_space
        y, z = observation[TURNED].astype(float).reshape(-1, 2, 3).transpose(1, 0, 2)
        np.testing.assert_allclose([(y * y).sum(1), (z * z).sum(1)], 1, atol=1e-6)
        np.testing.assert_allclose((y * z).sum(1), 0, atol=1e-6)
        assert (np.hypot(z[:, 0], z[:, 1]) <= np.sin(most_rad) + 1e-7).all()
        assert (z[:, 2] > 0).all()
        axes = info["sensor_pose"][:, :3, :3]
        np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(axes), 1, atol=1e-12)
        targets = env.current_sensor_target_poses_platform_frame
    low_m, high_m = env.sensor_pos_limits
    assert (targets.translation >= low_m).all()
    assert (targets.translation <= high_m).all()


def test_turns_are_rotation_vectors_in_the_frame_of_the_cell(solids):
    """From any pose, not only from an upright one."""
    start = np.eye(4)
    start[:3, :3] = Rotation.from_euler("zyx", (0.3, 0.2, -0.4)).as_matrix()
    env = make_vector(VOLUME, assets=solids, num_envs=3)
    env.reset(seed=0, options={"initial_sensor_target_pose": [start] * 3})
    action = env.action_space.sample()
    action["action"][TURN] = np.array([(1, 0, 0), (0, 0.5, 0), (0, 0, 3)], np.float32)
    *_, info = env.step(action)
    longest_rad = 0.05 * np.pi / 2 + 0.5 * 10 * np.pi * 0.05**2  # full speed after 50 ms of 100 ms
    ways = longest_rad * np.array([(1, 0, 0), (0, 0.5, 0), (0, 0, 1)])
    expected = Rotation.from_rotvec(ways).as_matrix() @ start[:3, :3]
    np.testing.assert_allclose(info["sensor_pose"][:, :3, :3], expected, atol=1e-12)
    moves, turns = action["action"]["sensor_target_pos_rel"], action["action"][TURN]
    price = 1e-3 * ((moves**2).mean(axis=1) + (turns**2).mean(axis=1))
    np.testing.assert_allclose(info["base_reward"], -price, rtol=1e-6)


def test_a_first_touch_may_be_a_pose(solids):
    turn = Rotation.from_euler("zyx", (0.3, 0.2, -0.4))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), (0.01, -0.02, 0.003)
    poses = Poses(np.array([matrix[:3, 3]]), turn.as_quat()[None])
    given = [
        matrix,
        matrix.tolist(),
        poses[0],
        RigidTransform.from_matrix(matrix),
        (0.01, -0.02, 0.003),
        None,
    ]
    env = make_vector(VOLUME, assets=solids, num_envs=6)
    _, info = env.reset(seed=0, options={"initial_sensor_target_pose": given})
    found = env.current_sensor_target_poses_platform_frame.matrix
    np.testing.assert_allclose(found[:4], np.tile(matrix, (4, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(found[4, :3], np.c_[np.eye(3), matrix[:3, 3]], atol=1e-12)
    # Down along its own axis from its target.
    slid = np.linalg.inv(matrix) @ info["sensor_pose"][0]
    np.testing.assert_allclose(slid[:2, 3], 0, atol=1e-12)


def test_invalid_poses_are_named(solids):
    upright, tilting = (
        make_vector(VOLUME, assets=solids, config={"allow_sensor_rotation": turns}) for turns in (False, True)
    )
    for env, start, words in (
        (
            tilting,
            Rotation.from_euler("x", 0.9).as_matrix(),
            "tilts sensor 0 by 0.9000 rad; expected at most",
        ),
        (upright, Rotation.from_euler("x", 0.1).as_matrix(), "turns sensor 0, which stays upright"),
        (tilting, np.diag([1.0, 1.0, -1.0]), "a pose: a matrix of 4 x 4"),
        (tilting, 2 * np.eye(3), "a pose: a matrix of 4 x 4"),
        (tilting, np.full((3, 3), np.nan), "a pose: a matrix of 4 x 4"),
    ):
        matrix = np.eye(4)
        matrix[:3, :3] = start
        with pytest.raises(InputError, match=words):
            env.reset(options={"initial_sensor_target_pose": [matrix]})


def test_invalid_turns_are_named(solids):
    env = make_vector(VOLUME, assets=solids)
    env.reset(seed=0)
    action = env.action_space.sample()
    action["action"][TURN][0, 0] = np.nan
    with pytest.raises(ValueError, match=f"NaN values detected in {TURN}"):
        env.step(action)
    action["action"][TURN] = np.zeros((2, 3), np.float32)
    with pytest.raises(InputError, match=rf"{TURN} has shape \(2, 3\)"):
        env.step(action)


def test_objects_lie_on_their_broadest_side(solids):
    """Without turning, they lie as in their files; volumes are the same."""
    found = []
    for flat in (False, True):
        env = make_vector(CENTRE, assets=solids, num_envs=7, config={"smallest_dimension_up": flat})
        env.reset(seed=0, options={"datapoint_idx": list(range(7))})
        found.append([record.mesh for record in env.current_data_points])
    assert len(found[0]) == 7
    for given_mesh, turned in zip(*found, strict=True):
        least_m = min(given_mesh.bounding_box_oriented.primitive.extents)
        assert turned.extents[2] == pytest.approx(least_m, rel=1e-4)
        assert given_mesh.extents[2] > 1.01 * least_m
        assert turned.volume == pytest.approx(given_mesh.volume, rel=1e-5)


def test_copies_and_threads_give_the_same(solids):
    config = {"step_limit": 3}
    one = make_vector(CENTRE, assets=solids, num_envs=9, config=config)
    other = make_vector(CENTRE, assets=solids, num_envs=9, config=config, threads=3)
    for env in (one, other):
        env.reset(seed=0)
    third = copy.deepcopy(one)
    for _ in range(6):
        action = one.action_space.sample()
        first, *rest = (env.step(action) for env in (one, other, third))
        for observation, reward, *_ in rest:
            assert all((observation[name] == values).all() for name, values in first[0].items())
            assert (reward == first[1]).all()
    other.close()


def test_a_picture_frames_what_a_tilted_sensor_covers(solids):
    """From above, a window that is tilted around its y axis is narrower."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("y", MOST_RAD).as_matrix()
    sides = []
    for pose in (np.eye(4), matrix):
        env = make_vector(VOLUME, assets=solids, render_mode="rgb_array")
        env.reset(seed=0, options={"initial_sensor_target_pose": [pose]})
        (picture,) = env.render()
        rows, columns = np.nonzero(np.abs(picture[:, :240].astype(int) - (204, 41, 51)).max(axis=2) <= 1)
        sides.append((np.ptp(rows), np.ptp(columns)))
    assert sides[1][0] == pytest.approx(sides[0][0], abs=2)
    assert sides[1][1] == pytest.approx(sides[0][1] * np.cos(MOST_RAD), abs=2)
