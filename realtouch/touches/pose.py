"""Rigid transforms that also have the attributes of the published poses (package `transformation3d`).

This is a file of its own because importing scipy.spatial takes longer than converting a small data set.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from tactile_toolkit.value_types import AnyArray, Float64


class Pose(RigidTransform):
    """One rigid transform, or several: scipy's, with the attributes of the published type next to its own.

    ``translation``, ``rotation`` and ``single`` mean the same in both. ``inv`` is the inverse, as published;
    ``inv()`` gives the same, as in scipy. Positions are metres.
    """

    @classmethod
    def of(cls, position_m: AnyArray, quaternion: AnyArray) -> Pose:
        """Make poses from positions (..., 3), metres, and quaternions (..., 4), x, y, z, w."""
        rotation = Rotation.from_quat(np.array(quaternion))  # a copy: scipy takes no empty read-only view
        matrix = np.zeros((*np.shape(position_m)[:-1], 4, 4))
        matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = rotation.as_matrix(), position_m, 1.0
        # Not normalised again, because that would change the last bits.
        made = cls(matrix, normalize=False, copy=False)
        # Kept, as a matrix does not show which of two quaternions of opposite sign was stored.
        made._rotation = rotation
        return made

    _rotation: Rotation | None = None

    @property
    def rotation(self) -> Rotation:
        """Orientation."""
        return super().rotation if self._rotation is None else self._rotation

    @property
    def matrix(self) -> Float64:
        """Homogeneous matrix, shape (4, 4), or (n, 4, 4) of several."""
        return np.asarray(self.as_matrix())

    @property
    def quaternion(self) -> Float64:
        """Orientation x, y, z, w of length one, shape (4,) or (n, 4)."""
        return np.asarray(self.rotation.as_quat())

    @property
    def rotvec(self) -> Float64:
        """Orientation as axis times angle, radians, shape (3,) or (n, 3)."""
        return np.asarray(self.rotation.as_rotvec())

    @property
    def angle(self) -> Float64:
        """Angle of the rotation, radians, 0 to pi."""
        sine = np.linalg.norm(self.quaternion[..., :3], axis=-1)
        return np.asarray(2.0 * np.arctan2(sine, np.abs(self.quaternion[..., 3])))

    @property
    def inv(self) -> InversePose:
        """Inverse; calling it returns the same pose, as scipy's method does."""
        return InversePose(super().inv().as_matrix(), normalize=False)

    def to_dict(self) -> dict[str, list[object]]:
        """Return ``translation`` and ``rotation`` (x, y, z, w) as lists."""
        return {"translation": self.translation.tolist(), "rotation": self.quaternion.tolist()}

    def transform(self, operand: RigidTransform | ArrayLike, inverse: bool = False) -> Any:
        """Apply to a pose, which gives a :class:`Pose`, or to positions, shape (3,) or (n, 3), metres."""
        if not isinstance(operand, RigidTransform):
            return self.apply(np.array(operand), inverse=inverse)  # a copy: scipy takes no read-only view
        first: RigidTransform = super().inv() if inverse else self
        return Pose(RigidTransform.__mul__(first, operand).as_matrix(), normalize=False)

    def __mul__(self, operand: Any) -> Any:
        return self.transform(operand)

    def __matmul__(self, operand: Any) -> Any:
        return self.transform(operand)

    def __getitem__(self, index: Any) -> Pose:
        return Pose(super().__getitem__(index).as_matrix(), normalize=False)

    def __setitem__(self, index: Any, value: RigidTransform) -> None:
        super().__setitem__(index, value)
        self._rotation = None

    def __reduce__(self) -> tuple[object, ...]:
        # Pickled by the stored values; pickling by scipy would lose the sign of the quaternion.
        return (Pose.of, (self.translation, self.quaternion))


class InversePose(Pose):
    """The inverse of a pose, which can be used as an attribute or called."""

    def __call__(self) -> Pose:
        """Return the inverse as a plain pose."""
        return Pose(self.as_matrix(), normalize=False)
