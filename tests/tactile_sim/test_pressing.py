"""Depth of touches: compared with another method and with geometry, and input that is refused."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform

import tactile_sim
from tactile_sim.press import pressable
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.errors import InputError
from tests.tactile_sim.solids import ball, block, tilted


def _press(solid, object_pose, target, sensor):
    return tactile_sim.render_touch(solid, object_pose, target, sensor)


def _rays(mesh: trimesh.Trimesh, object_pose, target, sensor):
    """Return heights by casting a ray for each pixel, with another library."""
    width, height = sensor.size_px
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    x = (columns + 0.5 + sensor.sample_px[0]) / width * sensor.window_m[0] - sensor.window_m[0] / 2
    y = sensor.window_m[1] / 2 - (rows + 0.5 - sensor.sample_px[1]) / height * sensor.window_m[1]
    world = mesh.copy()
    world.apply_transform(object_pose)
    plate = trimesh.creation.box(
        [0.12, 0.12, 0.002], trimesh.transformations.translation_matrix([0, 0, -0.001])
    )
    world = trimesh.util.concatenate([world, plate])
    start = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.2), np.ones(x.size)]) @ target.T
    along = np.tile(-target[:3, 2], (x.size, 1))
    tracer = trimesh.ray.ray_triangle.RayMeshIntersector(world)
    places, ray, _ = tracer.intersects_location(start[:, :3], along, multiple_hits=True)
    found = np.full(x.size, -np.inf)
    np.maximum.at(found, ray, ((places - start[ray, :3]) @ target[:3, 2]) + 0.2)
    return found.reshape(x.shape)


@pytest.mark.parametrize("lean", [0.0, 0.2, 0.7])
@pytest.mark.parametrize(
    "solid",
    [ball(subdivisions=3), block(), trimesh.creation.torus(0.01, 0.003)],
    ids=["ball", "block", "torus"],
)
def test_every_pixel_is_where_a_ray_meets_the_surface(solid, lean):
    sensor = tactile_sim.center_view(24, 18)
    rng = np.random.default_rng(3)
    for _ in range(4):  # the sensor sees the solid whole, and all its sides
        object_pose = tactile_sim.pose(*rng.uniform(-0.02, 0.02, 2), turn_rad=rng.uniform(-3, 3))
        target = tilted(lean, rng.uniform(-3, 3), *rng.uniform(-0.01, 0.01, 2))
        pressed = _press(solid, object_pose, target, sensor)
        heights = _rays(solid, object_pose, target, sensor)
        expected = sensor.press_m + heights.max() - heights
        assert np.abs(pressed.depth_m - expected).max() < 1e-9
        assert pressed.sensor_z_m == pytest.approx(target[2, 2] * (heights.max() + sensor.press_m), abs=1e-9)


def test_a_pose_of_scipy_is_a_pose():
    lies = tactile_sim.pose(0.002, -0.001, turn_rad=0.3)
    sensors = RigidTransform.from_matrix(np.stack([tactile_sim.pose(), tactile_sim.pose(0.001)]))
    from_objects = tactile_sim.render_touch(ball(), RigidTransform.from_matrix(lies), sensors)
    from_matrices = tactile_sim.render_touch(ball(), lies, sensors.as_matrix())
    np.testing.assert_allclose(from_objects.depth_m, from_matrices.depth_m, atol=1e-12)


def test_a_bare_plate_is_felt_all_over():
    pressed = _press(ball(), tactile_sim.pose(), tactile_sim.pose(0.03, 0.03), tactile_sim.center_view())
    assert (pressed.depth_m == 0.002125).all()
    assert (pressed.image == 0).all()
    assert pressed.sensor_z_m == 0.002125


def test_a_block_is_felt_at_its_height_in_its_place():
    sensor = tactile_sim.full_view(320, 240)
    pressed = _press(block((0.01, 0.004, 0.003)), tactile_sim.pose(0.001, 0.002), tactile_sim.pose(), sensor)
    assert pressed.sensor_z_m == pytest.approx(0.003 + 0.002125, abs=1e-12)
    top = pressed.image == 0
    rows, columns = np.nonzero(top)
    per_m = 320 / 0.01888
    assert columns.min() == pytest.approx(160 + (0.001 - 0.005) * per_m, abs=1)
    assert columns.max() == pytest.approx(160 + (0.001 + 0.005) * per_m, abs=1)
    assert rows.min() == pytest.approx(120 - (0.002 + 0.002) * per_m, abs=1)  # up is away from the robot
    assert (pressed.image[~top] == 1).all()


def test_beyond_the_plate_the_depth_is_twice_its_longer_side():
    """A sensor over the edge: one half shows the plate, the other no surface."""
    sensor, place, edge = tactile_sim.full_view(32, 24), tactile_sim.pose(), tactile_sim.pose(0.04)
    pressed = tactile_sim.render_touch(ball(), place, edge, sensor, cell_m=(0.08, 0.05))
    assert (pressed.depth_m[:, :16] == 0.002125).all()
    assert pressed.depth_m[:, 16:] == pytest.approx(np.full((24, 16), 0.002125 + 2 * 0.08), abs=1e-12)


def _open_mesh():
    mesh = ball()
    mesh.update_faces(np.arange(len(mesh.faces)) > 3)
    return mesh


def _inside_out():
    mesh = ball()
    mesh.invert()
    return mesh


def _moved(row, column, value):
    pose = tactile_sim.pose()
    pose[row, column] = value
    return pose


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"solid": _open_mesh()}, "bounds no solid (not-manifold"),
        ({"solid": _inside_out()}, "bounds no solid (inside-out"),
        ({"solid": 7}, "a int holds no triangles"),
        ({"object_pose": _moved(0, 3, np.nan)}, "object_pose holds NaN"),
        ({"object_pose": _moved(0, 0, -1.0)}, "object_pose is not a rigid pose"),
        ({"target": _moved(0, 0, 1.5)}, "sensor_pose is not a rigid pose"),
        ({"target": np.zeros(3)}, "sensor_pose is an array of float64 of the shape (3,)"),
        ({"target": "up"}, "sensor_pose is 'up'"),
        ({"target": tactile_sim.pose(0.07)}, "sensor_pose 0 is at x 70.0 mm"),
        ({"target": tilted(2.0, 0.0)}, "115 degrees from the vertical"),
        (
            {"object_pose": np.stack([np.eye(4)] * 2), "target": np.stack([np.eye(4)] * 3)},
            "2 object poses for 3",
        ),
    ],
)
def test_bad_input_is_named(change, words):
    given_values = {"solid": ball(), "object_pose": tactile_sim.pose(), "target": tactile_sim.pose()} | change
    with pytest.raises(InputError, match=re.escape(words)):
        _press(sensor=tactile_sim.center_view(), **given_values)


@pytest.mark.parametrize(
    "values",
    [
        *({"size_px": wrong} for wrong in ((64, "a"), (0, 64), (64.5, 64), (10**5, 10**5), 64)),
        *({"window_m": (np.nan, 0.01)}, {"window_m": (0.0, 0.01)}),
        *({"press_m": 0.005}, {"press_m": "deep"}, {"sample_px": (0.6, 0.0)}),
    ],
)
def test_invalid_sensors_are_refused(values):
    with pytest.raises(InputError, match="expected"):
        dataclasses.replace(tactile_sim.full_view(), **values)


def test_a_solid_is_checked_once_and_again_when_it_was_changed(monkeypatch):
    checked = []
    monkeypatch.setattr(pressable, "_SOLIDS", MemoryCache(1 << 20, lambda solid: solid.vertices_m.nbytes))
    check = pressable._require_closed
    monkeypatch.setattr(pressable, "_require_closed", lambda mesh: (checked.append(mesh), check(mesh)))
    sensor, place = tactile_sim.full_view(32, 24), tactile_sim.pose()
    solid = trimesh.creation.box((0.02, 0.02, 0.01))
    solid.apply_translation((0, 0, 0.005))
    before = tactile_sim.render_touch(solid, place, place, sensor)
    again = tactile_sim.render_touch(solid.copy(), place, place, sensor)
    assert np.array_equal(before.depth_m, again.depth_m)
    assert len(checked) == 1
    solid.vertices[:, 0] /= 2  # in place
    changed = tactile_sim.render_touch(solid, place, place, sensor)
    assert len(checked) == 2
    fresh = tactile_sim.render_touch(
        trimesh.Trimesh(solid.vertices.copy(), solid.faces), place, place, sensor
    )
    assert np.array_equal(changed.depth_m, fresh.depth_m)
    assert not np.array_equal(changed.depth_m, before.depth_m)
    # The cached solid does not change with the mesh.
    solid.vertices[:, 0] *= 2
    back = tactile_sim.render_touch(solid, place, place, sensor)
    assert np.array_equal(back.depth_m, before.depth_m)
    solid.faces = solid.faces[1:]
    with pytest.raises(InputError, match="bounds no solid"):
        tactile_sim.render_touch(solid, place, place, sensor)
