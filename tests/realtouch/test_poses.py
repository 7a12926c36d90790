"""Poses have the attributes of SciPy and of the published type."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from realtouch.touches.poses import Poses, rigid_transform

numbers = st.floats(-2, 2).map(lambda value: round(value, 3))
positions = st.lists(numbers, min_size=3, max_size=3)
quaternions = st.lists(numbers, min_size=4, max_size=4).filter(lambda values: np.linalg.norm(values) > 0.1)


def read_only(values: Any) -> np.ndarray:
    array = np.array(values, np.float64)
    array.setflags(write=False)
    return array


@given(positions, quaternions)
def test_single_poses_equal_those_of_scipy(position: list[float], quaternion: list[float]) -> None:
    expected = RigidTransform.from_components(position, Rotation.from_quat(quaternion))
    pose = rigid_transform(read_only(position), read_only(quaternion))
    assert isinstance(pose, RigidTransform)
    assert pose.single
    np.testing.assert_allclose(pose.as_matrix(), expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(pose.matrix, expected.as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(pose.translation, position)
    np.testing.assert_array_equal(pose.quaternion, Rotation.from_quat(quaternion).as_quat())
    np.testing.assert_allclose(pose.inv.matrix @ pose.matrix, np.eye(4), atol=1e-14)
    np.testing.assert_array_equal(pose.inv().as_matrix(), pose.inv.matrix)
    np.testing.assert_allclose(pose.angle, np.linalg.norm(pose.rotvec), atol=1e-7)


@given(st.lists(st.tuples(positions, quaternions), min_size=1, max_size=5))
def test_poses_are_their_parts(parts: list[tuple[list[float], list[float]]]) -> None:
    poses = Poses(*(read_only(part) for part in zip(*parts, strict=True)))
    one_by_one = [rigid_transform(*(np.array(part) for part in pair)) for pair in parts]
    np.testing.assert_allclose(poses.matrix, [pose.matrix for pose in one_by_one], atol=1e-14)
    np.testing.assert_allclose(poses.inv.matrix, [pose.inv.matrix for pose in one_by_one], atol=1e-13)
    for name in ("rotvec", "angle", "translation"):
        expected = [getattr(pose, name) for pose in one_by_one]
        np.testing.assert_allclose(getattr(poses, name), expected, atol=1e-14)
    assert not poses.single
    np.testing.assert_array_equal(poses.transform[0].as_matrix(), poses.matrix[0])


def test_no_poses() -> None:
    none = Poses(read_only(np.empty((0, 3))), read_only(np.empty((0, 4))))
    assert none.matrix.shape == (0, 4, 4)
    assert len(none.inv) == 0


def test_products_are_poses_and_move_points() -> None:
    first = rigid_transform(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0, 1.0]))
    second = rigid_transform(np.array([0.0, 0.5, 0.0]), np.array([1.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose((first * second).matrix, first.matrix @ second.matrix, atol=1e-15)
    np.testing.assert_allclose((first @ second).matrix, first.matrix @ second.matrix, atol=1e-15)
    np.testing.assert_allclose(first.transform(second, inverse=True).matrix, (first.inv * second).matrix)
    points = read_only([[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    np.testing.assert_allclose(first * points, first.apply(np.array(points)))
    np.testing.assert_allclose(first.inv * (first * points), points, atol=1e-15)


def test_poses_pickle_copy_and_change() -> None:
    pose = rigid_transform(np.array([1.0, 2.0, 3.0]), -np.array([0.0, 0.6, 0.0, 0.8]))
    for again in (pickle.loads(pickle.dumps(pose)), copy.deepcopy(pose)):
        np.testing.assert_array_equal(again.quaternion, pose.quaternion)
        np.testing.assert_array_equal(again.matrix, pose.matrix)
    several = rigid_transform(np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]]))
    several[0] = pose
    np.testing.assert_allclose(several.rotation[0].as_matrix(), pose.rotation.as_matrix())


@pytest.mark.oracle
@given(st.lists(st.tuples(positions, quaternions), min_size=1, max_size=4))
def test_the_published_type_gives_the_same_values(parts: list[tuple[list[float], list[float]]]) -> None:
    package = pytest.importorskip("transformation", reason="transformation3d is not installed")
    published = package.Transformation
    position, quaternion = (np.array(part) for part in zip(*parts, strict=True))
    pairs = [
        (rigid_transform(position[0], quaternion[0]), published.from_pos_quat(position[0], quaternion[0])),
        (Poses(position, quaternion), published.from_pos_quat(position, quaternion)),
    ]
    for ours, theirs in pairs:
        assert ours.single == theirs.single
        for name in ("translation", "matrix", "rotvec", "angle"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-13)
        np.testing.assert_allclose(ours.rotation.as_quat(), theirs.quaternion, atol=1e-15)
        np.testing.assert_allclose(ours.inv.matrix, theirs.inv.matrix, atol=1e-13)
        for name, values in theirs.to_dict().items():
            np.testing.assert_allclose(ours.to_dict()[name], values, atol=1e-15)
    (one, their_one), (several, their_several) = pairs
    np.testing.assert_array_equal(one.quaternion, their_one.quaternion)
    np.testing.assert_allclose((one * several[-1]).matrix, (their_one * their_several[-1]).matrix, atol=1e-13)
    points = np.arange(6.0).reshape(2, 3)
    np.testing.assert_allclose(one * points, their_one * points, atol=1e-13)
    assert {"translation", "rotation", "quaternion", "matrix", "inv", "single"} <= set(dir(published))
