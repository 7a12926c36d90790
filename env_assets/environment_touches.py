"""Recorded touches as the package ``tactile-mnist`` wants them: its own class, read by our loader."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from env_assets.environment_meshes import CacheSize
from env_assets.environment_packages import published_package
from env_assets.environment_rows import StoredRows, label_feature
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset

if TYPE_CHECKING:
    import tactile_mnist
else:
    tactile_mnist = published_package("tactile_mnist")

__all__ = ["StoredTouchDataset", "TouchPoint"]


@dataclass(frozen=True, eq=False)
class TouchPoint:
    """One round of touches, as the environments want it; positions are metres in the cell frame.

    Parameters
    ----------
    round : TouchSingleRound
        The stored row.
    """

    round: Any

    @property
    def id(self) -> str:
        """Name of the round."""
        return str(self.round.id)

    @property
    def label(self) -> int:
        """Class of the object."""
        return int(self.round.label)

    @property
    def object_id(self) -> int:
        """Id of the touched mesh in its data set of meshes."""
        return int(self.round.object_id)

    @cached_property
    def info(self) -> dict[str, Any]:
        """Metadata; poses in it are ``transformation.Transformation``."""
        return {name: _package_pose(value) for name, value in self.round.info.items()}

    @property
    def pos_in_cell(self) -> NDArray[np.floating]:
        """Intended positions, shape (T, 2), metres."""
        positions: NDArray[np.floating] = self.round.pos_in_cell_m
        return positions

    @cached_property
    def gel_pose_cell_frame(self) -> Any:
        """Pose of the gel at contact: a ``transformation.Transformation`` of length T."""
        return _package_pose(self.round.gel_pose_cell_frame)

    @property
    def sensor_image(self) -> Any:
        """Images, T of them, (H, W, 3) uint8, each decoded when it is asked for."""
        return self.round.sensor_image


class StoredTouchDataset(tactile_mnist.TouchSingleDataset):  # type: ignore[misc]
    """A ``tactile_mnist.TouchSingleDataset`` that reads rounds by our loader; see :func:`as_touch_dataset`.

    Parameters
    ----------
    rounds : realtouch.TouchSingleDataset
        What it holds.
    cache_size : int or "full"
        How many rounds are kept once read, as for every data set of the package.
    touches_per_round : int, optional
        How many touches each round has; counted by default.

    Raises
    ------
    InputError
        Clips instead of images, or rounds of unlike length.
    """

    def __init__(
        self, rounds: RecordDataset[Any], cache_size: CacheSize = 0, touches_per_round: int | None = None
    ) -> None:
        if touches_per_round is None:
            touches_per_round = _touches_per_round(rounds)
        super().__init__(_touch_rows(rounds, touches_per_round), cache_size=cache_size)
        self._rounds = rounds
        self._touches_per_round = touches_per_round

    @property
    def rounds(self) -> RecordDataset[Any]:
        """The records behind the points."""
        return self._rounds

    def __iter__(self) -> Iterator[TouchPoint]:
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._rounds, self.cache_size, self._touches_per_round))

    def _get_data_point_type(self) -> type[TouchPoint]:
        return TouchPoint

    def _get_item(self, index: int) -> TouchPoint:
        return TouchPoint(self._rounds[index])

    def _select(self, indices: NDArray[np.int64]) -> StoredTouchDataset:
        # Handed on, for a selection of no rounds has no number of touches of its own.
        return StoredTouchDataset(self._rounds[indices], self.cache_size, self._touches_per_round)


def _touch_rows(rounds: RecordDataset[Any], touches_per_round: int) -> StoredRows:
    from datasets import List, Value

    names = ("id", "label", "object_id", "info", "pos_in_cell", "gel_pose_cell_frame", "sensor_image")
    positions = List(List(Value("float64"), length=2), length=touches_per_round)
    features = {**label_feature(rounds), "pos_in_cell": positions}
    return StoredRows(rounds, {name: attrgetter(name) for name in names}, features)


def _touches_per_round(rounds: Any) -> int:
    counts = np.unique(rounds.touch_counts)
    if len(counts) <= 1:
        return int(counts[0]) if len(counts) else 0
    message = (
        f"the rounds of this data set have {counts[0]} to {counts[-1]} touches; the environments need "
        "the same number in every round; next: use a data set before touches were selected from it"
    )
    raise InputError(message)


def _package_pose(value: Any) -> Any:
    """Turn our poses into those of the package; leave everything else."""
    if hasattr(value, "translation") and hasattr(value, "rotation"):
        kind = published_package("transformation").Transformation
        return kind(np.asarray(value.translation), value.rotation)
    return value
