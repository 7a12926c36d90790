"""Recorded touches of an environment, as arrays, and the printed digits that were touched."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

import realtouch
from env_assets import KINDS, MeshView, mesh_view, meshes_at, require_fitting_meshes
from tactile_envs import env_specs, mesh_pool, object_sets
from tactile_envs.config import RecordedConfig
from tactile_toolkit import store
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import PRESS_DEPTH_M

Place = str | PathLike[str]

_DIGITS = "mnist3d"
_REPOSITORY = env_specs.REAL_TOUCHES.rpartition("/")[2]
_NAMES = [name for name, stored in realtouch.SHORT_NAMES.items() if stored == _REPOSITORY]
# Names of the folder of touches in a folder of data sets; messages suggest the shortest.
_FOLDERS = sorted([*_NAMES, _REPOSITORY], key=len)


class RecordedSources(NamedTuple):
    """Names of a data set of touches, and of the digits that were touched; None if they are not known."""

    touches: Place
    digits: Place | None

    @classmethod
    def of(cls, assets: Place | None, touches: Place | None) -> Self:
        """Return the sources for options of :func:`tactile_envs.make_vector`.

        InputError for a folder of data sets that holds no touches.
        """
        if touches == object_sets.PUBLISHED:
            touches = env_specs.REAL_TOUCHES
        if assets is None or assets == object_sets.PUBLISHED:
            return cls(
                env_specs.REAL_TOUCHES if touches is None else touches, KINDS[_DIGITS].published[0].repo_id
            )
        inside = _sets_in(assets)
        digits = inside.get(_DIGITS)
        if touches is not None:
            return cls(touches, digits if inside else assets)
        if not inside:
            return cls(assets, None)
        recorded = touches_in(assets)
        if recorded is None:
            name = _FOLDERS[0]
            command = f"realtouch download {name} --out {shlex.quote(str(Path(assets) / name))}"
            raise InputError(
                f"{fspath(assets)!r} holds no recorded touches; expected a folder {name!r} in it",
                next=f"run `{command}`, or give `touches`",
            )
        return cls(recorded, digits)


def touches_in(assets: Place) -> Path | None:
    """Return the data set of touches in a folder of data sets; None if there is none."""
    inside = _sets_in(assets)
    return next((inside[name] for name in _FOLDERS if name in inside), None)


def _sets_in(assets: Place) -> dict[str, Path]:
    """Return the data sets in a folder by name; empty if it is not a folder of data sets."""
    folder = store.expanded(fspath(assets))
    if not store.path_exists(folder):
        return {}
    return {name: folder / name for name in (*_FOLDERS, _DIGITS) if (folder / name).is_dir()}


@dataclass(frozen=True, eq=False)
class RecordedTouches:
    """Rounds of touches with one image each; R rounds of T touches.

    Attributes
    ----------
    rounds : realtouch.TouchSingleDataset
        The rounds, of which images are read.
    positions_m : ndarray of float64, shape (R, T, 2)
        Intended positions, metres, cell frame.
    poses : ndarray of float64, shape (R, T, 4, 4)
        Poses of the gel, metres, cell frame.
    """

    rounds: realtouch.TouchSingleDataset
    positions_m: Float64
    poses: Float64

    @classmethod
    def open(cls, place: Place, split: str, config: RecordedConfig) -> Self:
        """Open the touches of a split, and read the positions and poses of all rounds.

        InputError: it is missing, has no images, or rounds too short for an episode. IntegrityError: a
        position or a pose is missing or damaged.
        """
        rounds, where = realtouch.load(place, split), f"{fspath(place)!r}, split {split!r},"
        if not isinstance(rounds, realtouch.TouchSingleDataset):
            raise InputError(
                f"{where} holds clips; expected one image a touch", next="run `realtouch clips-to-images`"
            )
        count = _touch_count(rounds, where, config.step_limit)
        positions_m, poses = np.empty((len(rounds), count, 2)), np.empty((len(rounds), count, 4, 4))
        for number, record in rounds.rounds_without_media():
            positions_m[number] = record.pos_in_cell_m
            poses[number] = record.gel_pose_cell_frame.matrix
        if config.recalibrate_sensor_z:
            # The lowest touch met the plate, above which simulated sensors stop at this height.
            heights_m = poses[:, :, 2, 3]
            heights_m += PRESS_DEPTH_M - heights_m.min(axis=1, keepdims=True)
        return cls(rounds, positions_m, poses)

    def labels(self) -> Int64:
        """Return the class of each round, shape (R,); InputError if one has no class."""
        labels, classes = self.rounds.labels, len(self.rounds.label_names)
        wrong = np.flatnonzero((labels < 0) | (labels >= classes))
        if len(wrong):
            row = int(wrong[0])
            raise InputError(
                f"round {self.rounds[row].id!r} has label {labels[row]}; expected 0 to {classes - 1}",
                next="give touches of objects whose classes are known",
            )
        return labels


def _touch_count(rounds: realtouch.TouchSingleDataset, where: str, step_limit: int) -> int:
    """Return the number of touches of each round; InputError if they are too few, or differ."""
    counts = set(rounds.touch_counts.tolist())
    if not counts:
        raise InputError(f"{where} holds no round", next="choose another split, or other touches")
    least, most = min(counts), max(counts)
    if least < most:
        raise InputError(
            f"{where} has rounds of {least} to {most} touches; expected rounds of one length",
            next="give rounds of one recording",
        )
    needed = step_limit + 2  # the first touch of an episode, and one that must be left after its last step
    if least < needed:
        raise InputError(
            f"{where} has rounds of {least} touches; an episode of {step_limit} steps needs {needed}",
            next="give a smaller `step_limit` in `config`, or other touches",
        )
    return int(least)


@dataclass(frozen=True, eq=False)
class TouchedObjects:
    """Meshes of touched objects; ``which``, shape (R,), is the number of the mesh of each round."""

    records: Sequence[mesh_view.MeshRecord]
    pool: mesh_pool.MeshPool
    which: Int64

    @classmethod
    def open(cls, place: Place, split: str, touches: RecordedTouches, config: RecordedConfig) -> Self:
        """Open the meshes of a split; InputError if they do not fit, or lack a touched object."""
        records, where = meshes_at(place, split), f"{fspath(place)!r}, split {split!r},"
        view = MeshView.of(records)
        require_fitting_meshes(view, None, where, config.cell_size)
        numbers = {int(name): number for number, name in enumerate(view.column("id"))}
        touched = touches.rounds.int_column("object_id").tolist()
        unknown = sorted(set(touched) - numbers.keys())
        if unknown:
            raise InputError(
                f"{where} has no mesh of {len(unknown)} touched objects, such as object {unknown[0]}",
                next="give the digits that were touched",
            )
        which = np.array([numbers[name] for name in touched], np.int64)
        return cls(records, mesh_pool.MeshPool.of(records), which)

    def __getstate__(self) -> dict[str, object]:
        """Leave out the mapped meshes, which a copy maps again."""
        return {"records": self.records, "which": self.which}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, pool=mesh_pool.MeshPool.of(state["records"]))
