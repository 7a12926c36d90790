"""Recorded touches of an environment, as arrays, and the printed digits that were touched."""

from __future__ import annotations

import hashlib
import logging
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import xxhash

import realtouch
from env_assets import MeshView, mesh_view
from env_assets.provider import KINDS, meshes_at
from tactile_envs import env_specs, mesh_pool, object_sets
from tactile_envs.config import RecordedConfig
from tactile_toolkit import cache, kind, run, store
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.touch import PRESS_DEPTH_M
from tactile_toolkit.value_types import Float32, Float64, Int64

Name = str | PathLike[str]
_DIGITS = "mnist3d"
_REPOSITORY = env_specs.REAL_TOUCHES.rpartition("/")[2]
_NAMES = [name for name, stored in realtouch.SHORT_NAMES.items() if stored == _REPOSITORY]

# Names of the folder of touches in a folder of data sets; messages suggest the shortest.
_FOLDERS = sorted([*_NAMES, _REPOSITORY], key=len)

NO_CONTACT_M = 1e-3
"""Height above the plate up to which a touch had no contact (0.13.0, EMPTY_TOUCH_Z_TOLERANCE_M), metres."""

_SEED = 0
_BATCH = 4
_QUIET_S = 2.0
_FORMAT = 1
_CHECKSUM_BYTES = 16
_SETTING = "real_base_depth_dataset"
_LEAVE_OUT = f'config={{"{_SETTING}": None}} to leave it out'

_ESTIMATES = cache.DiskCache(
    "environments", 8 << 30, warning="the depth of real touches is estimated again each time: {problem}"
)

_LOG = logging.getLogger(__name__)
_estimator = kind.lazy("tactile_sim.learned:DepthEstimator")  # imported by name: it needs the extra `torch`
Source = str | PathLike[str] | realtouch.TouchSingleDataset


class RecordedSources(NamedTuple):
    """Names of a data set of touches, and of the digits that were touched; None if they are not known."""

    touches: Name
    digits: Name | None

    @classmethod
    def of(cls, assets: Name | None, touches: Name | None) -> Self:
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
            command = f"tactile download {name} --out {shlex.quote(str(Path(assets) / name))}"
            raise InputError(
                f"{fspath(assets)!r} holds no recorded touches; expected a folder {name!r} in it",
                next=f"run `{command}`, or give `touches`",
            )
        return cls(recorded, digits)


def touches_in(assets: Name) -> Path | None:
    """Return the data set of touches in a folder of data sets; None if there is none."""
    inside = _sets_in(assets)
    return next((inside[name] for name in _FOLDERS if name in inside), None)


def _sets_in(assets: Name) -> dict[str, Path]:
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
    def open(cls, name: Name, split: str, config: RecordedConfig) -> Self:
        """Open the touches of a split, and read the positions and poses of all rounds.

        InputError: it is missing, has no images, or rounds too short for an episode. IntegrityError: a
        position or a pose is missing or damaged.
        """
        rounds = realtouch.load(name, split)
        named = f"{fspath(name)!r}, split {split!r},"
        if not isinstance(rounds, realtouch.TouchSingleDataset):
            raise InputError(
                f"{named} holds clips; expected one image a touch", next="run `realtouch stills`"
            )
        count = _touch_count(rounds, named, config.step_limit)
        positions_m = np.empty((len(rounds), count, 2))
        poses = np.empty((len(rounds), count, 4, 4))
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
        labels = self.rounds.labels
        classes = len(self.rounds.label_names)
        wrong = np.flatnonzero((labels < 0) | (labels >= classes))
        if len(wrong):
            row = int(wrong[0])
            raise InputError(
                f"round {self.rounds[row].id!r} has label {labels[row]}; expected 0 to {classes - 1}",
                next="give touches of objects whose classes are known",
            )
        return labels


def _touch_count(rounds: realtouch.TouchSingleDataset, named: str, step_limit: int) -> int:
    """Return the number of touches of each round; InputError if they are too few, or differ."""
    counts = set(rounds.touch_counts.tolist())
    if not counts:
        raise InputError(f"{named} holds no round", next="choose another split, or other touches")
    least, most = min(counts), max(counts)
    if least < most:
        raise InputError(
            f"{named} has rounds of {least} to {most} touches; expected rounds of one length",
            next="give rounds of one recording",
        )
    needed = step_limit + 2  # the first touch of an episode, and one that must be left after its last step
    if least < needed:
        raise InputError(
            f"{named} has rounds of {least} touches; an episode of {step_limit} steps needs {needed}",
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
    def open(cls, name: Name, split: str, touches: RecordedTouches, config: RecordedConfig) -> Self:
        """Open the meshes of a split; InputError if they do not fit, or lack a touched object."""
        records = meshes_at(name, split)
        named = f"{fspath(name)!r}, split {split!r},"
        view = MeshView.of(records)
        mesh_view.require_fitting_meshes(view, None, named, config.cell_size)
        numbers = {int(name): number for number, name in enumerate(view.column("id"))}
        touched = touches.rounds.int_column("object_id").tolist()
        unknown = sorted(set(touched) - numbers.keys())
        if unknown:
            raise InputError(
                f"{named} has no mesh of {len(unknown)} touched objects, such as object {unknown[0]}",
                next="give the digits that were touched",
            )
        which = np.array([numbers[name] for name in touched], np.int64)
        return cls(records, mesh_pool.MeshPool.of(records), which)

    def __getstate__(self) -> dict[str, object]:
        """Leave out the mapped meshes, which a copy maps again."""
        return {"records": self.records, "which": self.which}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, pool=mesh_pool.MeshPool.of(state["records"]))


def base_depths_m(source: Source, count: int, size_px: tuple[int, int]) -> Float32:
    """Return depth maps of real touches without contact.

    Parameters
    ----------
    given : str, path or realtouch.TouchSingleDataset
        The touches: a name, of which the split ``train`` is read, or an opened data set.
    count : int
        How many are chosen at random, with a fixed seed; all if there are fewer.
    size_px : tuple of int
        Width and height of the maps, pixels.

    Returns
    -------
    ndarray of float32, shape (k, h, w)
        Distances from the gel's camera, metres.

    Raises
    ------
    InputError
        There is no such data set, or it holds clips, or no touch without contact.
    IntegrityError
        A touch is damaged.
    MissingExtraError
        Estimates are missing, and the packages that make them are not installed.
    """
    touches = _opened(source).touches()
    empty = np.flatnonzero(touches.heights_m() <= NO_CONTACT_M)
    if not len(empty):
        raise InputError(
            f"{_SETTING} of the environment holds no touch without contact: none of its {len(touches):,} "
            f"touches stopped within {1e3 * NO_CONTACT_M:g} mm of the plate",
            next=f"give another data set, or {_LEAVE_OUT}",
        )
    # A smaller number gives a subset of a larger one.
    chosen = np.random.default_rng(_SEED).permutation(empty)[:count].tolist()
    # Others read the estimates in the cache.
    with cache.held("base-depth") as problem:
        if problem is not None:
            _LOG.warning("other processes are not waited for: %s", problem)
        return _estimates_m(touches, chosen, size_px)


def _opened(source: Source) -> realtouch.TouchSingleDataset:
    opened: object = source
    if isinstance(source, (str, PathLike)):
        try:
            opened = realtouch.load(fspath(source), "train")
        except ToolkitError as error:
            raise InputError(
                f"the environment shows the depth of real touches behind its own, and these cannot be read: "
                f"{error.what}",
                next=f"give {_SETTING} in `config` (the folder or name of a data set of real touches with "
                f"one image each, or an opened one), or {_LEAVE_OUT}",
            ) from error
    if not isinstance(opened, realtouch.TouchSingleDataset):
        raise InputError(
            f"{_SETTING} of the environment is {opened!r}; expected a data set of real touches with one "
            "image each",
            next=f"give another data set, or {_LEAVE_OUT}",
        )
    return opened


def _estimates_m(
    touches: realtouch.Touches[Any], numbers: Sequence[int], size_px: tuple[int, int]
) -> Float32:
    """Return the estimates of some touches, (k, h, w); those that are missing are made and kept."""
    content = touches.identity
    names = [_name(content, number, size_px) for number in numbers]
    estimates_m = {name: depth_m for name in names if (depth_m := _kept(name, size_px)) is not None}
    missing = [(name, number) for name, number in zip(names, numbers, strict=True) if name not in estimates_m]
    if missing:
        estimator = _estimator()
    with run.shown_progress(
        "estimating the depth of real touches without contact", "touches", _QUIET_S
    ) as show:
        for first in range(0, len(missing), _BATCH):
            batch = missing[first : first + _BATCH]
            images = touches.images([number for _, number in batch])
            for (name, _), depth_m in zip(batch, estimator.estimate_m(images, size_px), strict=True):
                estimates_m[name] = depth_m
                _keep(name, depth_m)
            show(first + len(batch), len(missing))
    return np.stack([estimates_m[name] for name in names])


def _name(content: str, number: int, size_px: tuple[int, int]) -> str:
    digest = hashlib.sha256(repr((_FORMAT, content, number, size_px)).encode())
    return f"base-depth-{digest.hexdigest()[:32]}"


def _keep(name: str, depth_m: Float32) -> None:
    content = np.ascontiguousarray(depth_m, np.float32).tobytes()
    checked = content + xxhash.xxh3_128_digest(content)
    _ESTIMATES.write(name, len(checked), lambda stream: stream.write(checked))


def _kept(name: str, size_px: tuple[int, int]) -> Float32 | None:
    """Return a depth map (h, w) of the cache; None if there is none, or it is damaged."""
    width, height = size_px
    path = _ESTIMATES.path(name)
    size = 4 * width * height
    try:
        with store.open_regular(path) as stream:
            content = stream.read(size + _CHECKSUM_BYTES + 1)
    except (OSError, IntegrityError):
        return None
    if content[size:] != xxhash.xxh3_128_digest(content[:size]):
        return None
    _ESTIMATES.mark_used(path)
    return np.frombuffer(content, np.float32, width * height).reshape(height, width)
