"""What is to be predicted, one small class for each task: spaces, targets, loss and metrics; and their log.

Values and spaces are those of the environments of `tactile-mnist` 0.13.0, tried against them in lock-step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import ap_gym
import gymnasium as gym
import numpy as np
from scipy.special import ndtri, softmax

from tactile_envs.config import Config, Registered
from tactile_envs.drawing import Shown
from tactile_envs.kernels import classify, spread_of_turned
from tactile_envs.meshes import MeshPool
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Floating, Int64
from tactile_toolkit.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Loss of predictions, shape (n,), and what else is measured of them."""

    loss: Floating
    metrics: dict[str, AnyArray]


def make_task(registered: Registered, config: Config, pool: MeshPool, classes: int) -> Task:
    """Make the task of an id on some meshes; InputError where all answers are equal."""
    if registered.task == "classification":
        return Classification(pool, classes)
    if registered.task == "volume":
        return Volume(pool)
    return ObjectPose(pool, config, of_mass=registered.frame == "mass")


class Classification:
    """Which class an object is of: logits against labels, cross entropy over that of a blind guess."""

    def __init__(self, pool: MeshPool, classes: int) -> None:
        if classes < 2:
            raise InputError("the meshes are of one class; expected at least two", next="give more meshes")
        self._labels = pool.fact("label").astype(np.int64)
        self.prediction_space = ap_gym.LogitSpace(-np.inf, np.inf, shape=(classes,))
        self.target_space = gym.spaces.Discrete(classes)
        self.loss_fn = ap_gym.CrossEntropyLossFn(num_classes=classes).normalized
        self._scale = 1.0 / math.log(classes)

    def targets(self, chosen: Int64, objects: Float64) -> Int64:
        """Return labels, shape (n,)."""
        return self._labels[chosen]

    def score(self, predictions: AnyArray, targets: AnyArray) -> Score:
        """Score logits, shape (n, classes)."""
        entropies, is_right = classify(np.ascontiguousarray(predictions, np.float32), targets)
        certainty = np.exp(-entropies).astype(np.float32)
        metrics = {"correct_label_prob": certainty, "accuracy": is_right.astype(np.float32)}
        return Score(entropies * self._scale, metrics)

    def shown(self, predictions: AnyArray, targets: AnyArray) -> Shown:
        """Show the probability of each class."""
        return Shown(shares=softmax(predictions, axis=1), right=targets)


class _Regression:
    """Mean squared error over that of the best blind guess."""

    def __init__(self, space: gym.Space[Any], target_std: Any) -> None:
        self.prediction_space = self.target_space = space
        self.loss_fn = ap_gym.MSELossFn(target_std=target_std).normalized
        self._scale = 1.0 / float(np.mean(np.asarray(target_std) ** 2))

    def score(self, predictions: AnyArray, targets: AnyArray) -> Score:
        """Score predictions, shape (n, k)."""
        off = targets - predictions
        square = off * off
        mean_square = square.mean(axis=1)
        distance = np.sqrt(square.sum(axis=1))
        metrics = {"euclidean_distance": distance, "mse": mean_square, **self._measured(predictions, targets)}
        return Score(mean_square * self._scale, metrics)

    def _measured(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        raise NotImplementedError


class Volume(_Regression):
    """How large an object is, in standard deviations from the mean of all objects."""

    def __init__(self, pool: MeshPool) -> None:
        volumes_m3 = pool.fact("volume_m3")
        self._mean_m3, self._std_m3 = float(volumes_m3.mean()), float(volumes_m3.std())
        if not self._std_m3:
            raise InputError("the meshes are of one volume; expected at least two", next="give more meshes")
        self._most_m3 = float(volumes_m3.max())
        low, high = ((bound - self._mean_m3) / self._std_m3 for bound in (volumes_m3.min(), volumes_m3.max()))
        super().__init__(gym.spaces.Box(low, high, shape=(1,)), 1.0)
        self._normalized = ((volumes_m3.astype(np.float32) - self._mean_m3) / self._std_m3)[:, None]

    def targets(self, chosen: Int64, objects: Float64) -> Float32:
        """Return volumes, shape (n, 1)."""
        return self._normalized[chosen]

    def shown(self, predictions: AnyArray, targets: AnyArray) -> Shown:
        """Show the volume that is predicted above the true one, as parts of the largest."""
        both = np.concatenate([predictions, targets], axis=1) * self._std_m3 + self._mean_m3
        return Shown(shares=both / self._most_m3, right=np.ones(len(both), np.int64))

    def _measured(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        found_m3, true_m3 = (each[:, 0] * self._std_m3 + self._mean_m3 for each in (predictions, targets))
        return {
            "abs_error_cm3": np.abs(found_m3 - true_m3) * 1e6,
            # As the published metric of this name: a quotient, 1 where the volume is right.
            "rel_error": np.maximum(found_m3, 0) / np.maximum(true_m3, 1e-10),
        }


class ObjectPose(_Regression):
    """Where an object lies, in halves of the cell, and which way its x axis points.

    With ``of_mass``, where its centre of mass is, and nothing of its direction.
    """

    def __init__(self, pool: MeshPool, config: Config, *, of_mass: bool) -> None:
        self._half_cell_m = np.array(config.cell_size) / 2
        self._centres_m = pool.facts[:, 4:6] if of_mass else np.zeros((len(pool), 2))
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
        """Return positions, and directions where these are asked for, shape (n, 2 or 4)."""
        cosine, sine = np.cos(objects[:, 2]), np.sin(objects[:, 2])
        x, y = self._centres_m[chosen].T
        found = np.empty((len(objects), 4 if self._has_direction else 2))
        found[:, 0] = (objects[:, 0] + (cosine * x - sine * y)) / self._half_cell_m[0]
        found[:, 1] = (objects[:, 1] + (sine * x + cosine * y)) / self._half_cell_m[1]
        if self._has_direction:
            found[:, 2], found[:, 3] = cosine, sine
        return found

    def shown(self, predictions: AnyArray, targets: AnyArray) -> Shown:
        """Show where the object is thought to be."""
        directions = predictions[:, 2:] if self._has_direction else None
        return Shown(places_m=predictions[:, :2] * self._half_cell_m, directions=directions)

    def _measured(self, predictions: AnyArray, targets: AnyArray) -> dict[str, AnyArray]:
        off_m = (predictions[:, :2] - targets[:, :2]) * self._half_cell_m
        measured = {"linear_error": np.sqrt((off_m * off_m).sum(axis=1))}
        if self._has_direction:
            # A component that is next to none is given as 1e-5, whichever sign it has.
            found = np.where(np.abs(predictions[:, 2:]) < 1e-5, 1e-5, predictions[:, 2:])
            length = np.sqrt((found * found).sum(axis=1))
            aligned = (found * targets[:, 2:]).sum(axis=1) / length
            measured["angular_error"] = np.arccos(np.clip(aligned, -1.0, 1.0))
        return measured

    def _variances(self, pool: MeshPool, config: Config) -> Float64:
        """Return the variance of each target over all objects and places where they may lie at first."""
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


Task = Classification | Volume | ObjectPose
"""What is to be predicted of objects."""


def placements_m(hull: Float32, turn_rad: float, config: Config) -> tuple[Float64, Float64]:
    """Return the lowest and highest position, (2,) each, metres, of a turned object inside the cell.

    Where the object does not fit, both are the middle.
    """
    least_x, least_y, most_x, most_y = spread_of_turned(hull, math.cos(turn_rad), math.sin(turn_rad))
    room_x, room_y = (side / 2 - config.object_placement_margin for side in config.cell_size)
    low, high = np.array([-room_x - least_x, -room_y - least_y]), np.array([room_x - most_x, room_y - most_y])
    conflict = low > high
    if conflict.any():
        low[conflict] = high[conflict] = ((low + high) / 2)[conflict]
    return low, high


class EpisodeLog:
    """Metrics of the steps of environments whose episodes begin and end together.

    Gives what the log wrappers of ap-gym 0.7.1 do: means, last values and curves.
    """

    def __init__(self, num_envs: int, step_limit: int) -> None:
        self._num_envs = num_envs
        self._step_limit = step_limit
        self._values: dict[str, Float32] = {}

    def add(self, step: int, metrics: Mapping[str, AnyArray]) -> None:
        """Note the metrics of a step, counted from 0, of an array (n,) each."""
        for name, values in metrics.items():
            if name not in self._values:
                self._values[name] = np.empty((self._step_limit, self._num_envs), np.float32)
            self._values[name][step] = values

    def stats(self) -> dict[str, Any]:
        """Return ``info["stats"]`` of an episode that ended."""
        done = np.ones(self._num_envs, np.bool_)
        scalar: dict[str, Any] = {}
        vector: dict[str, Any] = {}
        for name, values in self._values.items():
            for kind, reduced in (("avg", values.mean(axis=0)), ("final", values[-1].copy())):
                scalar[f"{kind}_{name}"], scalar[f"_{kind}_{name}"] = reduced, done
            vector[name], vector[f"_{name}"] = values.T.copy(), done
        if "accuracy" in self._values:
            scalar.update(_turning_points(self._values["accuracy"] > 0))
        return {"scalar": scalar, "_scalar": done, "vector": vector, "_vector": done}


def _turning_points(is_right: Bool) -> dict[str, Any]:
    """Return the first step that was right and the last that was wrong, and where there is one."""
    ever, always = is_right.any(axis=0), is_right.all(axis=0)
    last_wrong = len(is_right) - 1 - np.argmin(is_right[::-1], axis=0)
    return {
        "first_correct": np.where(ever, np.argmax(is_right, axis=0), -1).astype(np.int32),
        "_first_correct": ever,
        "last_incorrect": np.where(always, -1, last_wrong).astype(np.int32),
        "_last_incorrect": ~always,
    }
