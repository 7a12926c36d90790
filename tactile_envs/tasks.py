"""Tasks of prediction, one small class for each: spaces, targets, loss and metrics.

Values and spaces are those of the environments of `tactile-mnist` 0.13.0, compared with them in lock-step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import ap_gym
import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, softmax

from tactile_envs import config, drawing, episode_kernels, mesh_pool
from tactile_envs.config import Config
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Floating, Int64


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Loss of predictions, shape (n,), and their metrics."""

    loss: Floating
    metrics: dict[str, AnyArray]


class Classification:
    """Class of an object: cross-entropy of the logits, normalised by chance level.

    ``labels``, shape (n,), are the classes of all objects, and ``names`` those of the classes.
    """

    def __init__(self, labels: Int64, names: Sequence[str]) -> None:
        classes = len(names)
        if classes < 2:
            raise InputError("the objects are of one class; expected at least two", next="give more objects")
        self._labels, self._names = labels, tuple(names)
        self.prediction_space = ap_gym.LogitSpace(-np.inf, np.inf, shape=(classes,))
        self.target_space = gym.spaces.Discrete(classes)
        self.loss_fn = ap_gym.CrossEntropyLossFn(num_classes=classes).normalized
        self._scale = 1.0 / math.log(classes)

    def targets(self, chosen: Int64, objects: Float64) -> Int64:
        """Return labels, shape (n,)."""
        return self._labels[chosen]

    def score(self, predictions: AnyArray, targets: AnyArray) -> Score:
        """Score logits, shape (n, classes)."""
        entropies, is_right = episode_kernels.classify(np.ascontiguousarray(predictions, np.float32), targets)
        certainty = np.exp(-entropies).astype(np.float32)
        metrics = {"correct_label_prob": certainty, "accuracy": is_right.astype(np.float32)}
        return Score(entropies * self._scale, metrics)

    def view(self, predictions: AnyArray, targets: AnyArray) -> drawing.PredictionView:
        """Show the probability of each class."""
        return drawing.PredictionView(softmax(predictions, axis=1), targets, names=self._names)


class Task(Protocol):
    """What is predicted: spaces, true answers, loss and metrics.

    `loss_fn` is the loss for agents that differentiate it, an ``ap_gym.LossFn``; `score` must agree with it.
    """

    loss_fn: Any

    @property
    def prediction_space(self) -> config.Space:
        """Space of one prediction."""

    @property
    def target_space(self) -> config.Space:
        """Space of one answer."""

    def targets(self, chosen: Int64, objects: Float64) -> AnyArray:
        """Return the answers for objects by number (n,), at (n, 3): x, y, metres, and rotation, radians."""

    def score(self, predictions: AnyArray, targets: AnyArray) -> Score:
        """Return the loss of each prediction, and the metrics."""

    def view(self, predictions: AnyArray, targets: AnyArray) -> drawing.PredictionView:
        """Return what pictures show of predictions."""


class Regression:
    """Mean squared error, normalised by that of the best constant prediction: a base of tasks.

    ``space`` is that of predictions and answers, ``target_std`` the standard deviation of the answers.
    """

    def __init__(self, space: config.Space, target_std: ArrayLike) -> None:
        self.prediction_space = self.target_space = space
        self.loss_fn = ap_gym.MSELossFn(target_std=target_std).normalized
        self._scale = 1.0 / float(np.mean(np.asarray(target_std) ** 2))

    def score(self, predictions: AnyArray, targets: AnyArray) -> Score:
        """Score predictions, shape (n, k)."""
        off = targets - predictions
        square = off * off
        mean_square = square.mean(axis=1)
        distance = np.sqrt(square.sum(axis=1))
        metrics = {
            "euclidean_distance": distance,
            "mse": mean_square,
            **self.other_metrics(predictions, targets),
        }
        return Score(mean_square * self._scale, metrics)

    def other_metrics(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        """Return further metrics, shape (n,) each; none by default."""
        return {}

    def view(self, predictions: AnyArray, targets: AnyArray) -> drawing.PredictionView:
        """Show nothing of predictions."""
        return drawing.PredictionView()


class Volume(Regression):
    """Volume of an object, in standard deviations from the mean of all objects.

    ``volumes_m3``, shape (n,), are those of all objects. ``which``, if given, is the number of the
    object of each round of recorded touches, shape (R,).
    """

    def __init__(self, volumes_m3: Float64, which: Int64 | None = None) -> None:
        self._mean_m3, self._std_m3 = float(volumes_m3.mean()), float(volumes_m3.std())
        if not self._std_m3:
            raise InputError("the meshes are of one volume; expected at least two", next="give more meshes")
        self._most_m3 = float(volumes_m3.max())
        low, high = ((bound - self._mean_m3) / self._std_m3 for bound in (volumes_m3.min(), volumes_m3.max()))
        super().__init__(gym.spaces.Box(low, high, shape=(1,)), 1.0)
        if which is not None:
            volumes_m3 = volumes_m3[which]
        self._normalized = ((volumes_m3.astype(np.float32) - self._mean_m3) / self._std_m3)[:, None]

    def targets(self, chosen: Int64, objects: Float64) -> Float32:
        """Return volumes, shape (n, 1)."""
        return self._normalized[chosen]

    def view(self, predictions: AnyArray, targets: AnyArray) -> drawing.PredictionView:
        """Show the predicted and the true volume as shares of the largest."""
        both = np.concatenate([predictions, targets], axis=1) * self._std_m3 + self._mean_m3
        return drawing.PredictionView(
            both / self._most_m3, np.ones(len(both), np.int64), names=("guess", "truth")
        )

    def other_metrics(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        """Return the error in cm3, and the quotient of both volumes."""
        guess_m3 = predictions[:, 0] * self._std_m3 + self._mean_m3
        true_m3 = targets[:, 0] * self._std_m3 + self._mean_m3
        return {
            "abs_error_cm3": np.abs(guess_m3 - true_m3) * 1e6,
            # As the published metric of this name: a quotient, 1 where the volume is right.
            "rel_error": np.maximum(guess_m3, 0) / np.maximum(true_m3, 1e-10),
        }


class ObjectPose(Regression):
    """Position of an object, in halves of the cell, and direction of its x axis.

    With ``of_mass``, only the position of its centre of mass.
    """

    def __init__(self, pool: mesh_pool.MeshPool, config: Config, *, of_mass: bool) -> None:
        self._half_cell_m = np.array(config.cell_size) / 2
        self._centres_m = pool.measures[:, 4:6] * of_mass
        self._has_direction = not of_mass
        slip_m = 0.0
        if config.perturb_object_pose:
            # 99.99 % of the objects that start at the edge stay within this.
            std_m = config.translation_perturbation_scale * math.sqrt(config.step_limit)
            slip_m = std_m * float(ndtri(0.9999))
        bound = [1.0 + slip_m / self._half_cell_m.min()] * 2 + [1.0] * 2 * self._has_direction
        limits = np.array(bound, np.float32)
        super().__init__(gym.spaces.Box(-limits, limits), np.sqrt(self._variances(pool, config)))

    def targets(self, chosen: Int64, objects: Float64) -> Float64:
        """Return positions, and directions unless ``of_mass``, shape (n, 2 or 4)."""
        cosine, sine = np.cos(objects[:, 2]), np.sin(objects[:, 2])
        x, y = self._centres_m[chosen].T
        targets = np.empty((len(objects), 2 + 2 * self._has_direction))
        targets[:, 0] = (objects[:, 0] + (cosine * x - sine * y)) / self._half_cell_m[0]
        targets[:, 1] = (objects[:, 1] + (sine * x + cosine * y)) / self._half_cell_m[1]
        if self._has_direction:
            targets[:, 2], targets[:, 3] = cosine, sine
        return targets

    def view(self, predictions: AnyArray, targets: AnyArray) -> drawing.PredictionView:
        """Show the predicted position and direction."""
        directions = None
        if self._has_direction:
            directions = predictions[:, 2:]
        return drawing.PredictionView(
            positions_m=predictions[:, :2] * self._half_cell_m, directions=directions
        )

    def other_metrics(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        """Return the distance in metres, and the angle in radians if there is a direction."""
        off_m = (predictions[:, :2] - targets[:, :2]) * self._half_cell_m
        measured = {"linear_error": np.sqrt((off_m * off_m).sum(axis=1))}
        if self._has_direction:
            # A component that is almost 0 becomes 1e-5, whatever its sign.
            directions = np.where(np.abs(predictions[:, 2:]) < 1e-5, 1e-5, predictions[:, 2:])
            length = np.sqrt((directions * directions).sum(axis=1))
            aligned = (directions * targets[:, 2:]).sum(axis=1) / length
            measured["angular_error"] = np.arccos(np.clip(aligned, -1.0, 1.0))
        return measured

    def _variances(self, pool: mesh_pool.MeshPool, config: Config) -> Float64:
        """Return the variance of each target over all objects and their initial poses."""
        turns_rad = np.linspace(-1.0, 1.0, 16) * config.max_initial_angle_perturbation
        means, spreads = np.empty((len(pool), 2)), np.empty((len(pool), 2))
        cosine, sine = np.cos(turns_rad), np.sin(turns_rad)
        for number in range(len(pool)):
            bounds = [placements_m(pool.hull(number), turn_rad, config) for turn_rad in turns_rad.tolist()]
            low, high = np.array(bounds).transpose(1, 0, 2)
            x, y = self._centres_m[number]
            middle = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1) + (low + high) / 2
            means[number] = (middle / self._half_cell_m).mean(axis=0)
            spreads[number] = (((high - low) / self._half_cell_m) ** 2 / 12).mean(axis=0)
        variances = means.var(axis=0) + spreads.mean(axis=0)
        if self._has_direction:
            variances = np.concatenate([variances, [cosine.var(), sine.var()]])
        return np.asarray(variances)


def placements_m(hull: Float32, turn_rad: float, config: Config) -> tuple[Float64, Float64]:
    """Return the lowest and highest position, (2,) each, metres, of a turned object inside the cell.

    Both are the middle of the cell if the object does not fit.
    """
    least_x, least_y, most_x, most_y = episode_kernels.spread_of_turned(
        hull, math.cos(turn_rad), math.sin(turn_rad)
    )
    room_x, room_y = (side / 2 - config.object_placement_margin for side in config.cell_size)
    low = np.array([-room_x - least_x, -room_y - least_y])
    high = np.array([room_x - most_x, room_y - most_y])
    conflict = low > high
    if conflict.any():
        low[conflict] = high[conflict] = ((low + high) / 2)[conflict]
    return low, high
