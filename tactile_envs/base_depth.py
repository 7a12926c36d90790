"""Depth of real touches without contact, which a network estimates from their images; it is not flat.

Environments of recorded touches show what the network makes of them. A simulated touch looks like them if
such a depth map lies behind its own. Estimates take about a second each, and are kept in the cache folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
from collections.abc import Iterator, Sequence
from os import PathLike, fspath
from typing import Any

import numpy as np
import xxhash

import realtouch
from tactile_toolkit import cache, kind, progress, store
from tactile_toolkit.array_types import Float32
from tactile_toolkit.errors import BusyError, InputError, IntegrityError, ToolkitError

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


def base_depths_m(given: Source, count: int, size_px: tuple[int, int]) -> Float32:
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
    touches = _opened(given).touches()
    empty = np.flatnonzero(touches.heights_m() <= NO_CONTACT_M)
    if not len(empty):
        raise InputError(
            f"{_SETTING} of the environment holds no touch without contact: none of its {len(touches):,} "
            f"touches stopped within {1e3 * NO_CONTACT_M:g} mm of the plate",
            next=f"give another data set, or {_LEAVE_OUT}",
        )
    # A smaller number gives a subset of a larger one.
    chosen = np.random.default_rng(_SEED).permutation(empty)[:count].tolist()
    with _one_process():
        return _estimates_m(touches, chosen, size_px)


def _opened(given: Source) -> realtouch.TouchSingleDataset:
    found: object = given
    if isinstance(given, (str, PathLike)):
        try:
            found = realtouch.load(fspath(given), "train")
        except ToolkitError as error:
            raise InputError(
                f"the environment shows the depth of real touches behind its own, and these cannot be read: "
                f"{error.what}",
                next=f"give {_SETTING} in `config` (the folder or name of a data set of real touches with "
                f"one image each, or an opened one), or {_LEAVE_OUT}",
            ) from error
    if not isinstance(found, realtouch.TouchSingleDataset):
        raise InputError(
            f"{_SETTING} of the environment is {found!r}; expected a data set of real touches with one image "
            "each",
            next=f"give another data set, or {_LEAVE_OUT}",
        )
    return found


@contextlib.contextmanager
def _one_process() -> Iterator[None]:
    """Let one process at a time make estimates, if the cache folder is writable; others read them there."""
    path = _ESTIMATES.path("base-depth.lock")
    with contextlib.ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(store.locked(path, is_patient=True))
        except (OSError, BusyError) as error:
            _LOG.warning("other processes are not waited for: %s", error)
        yield


def _estimates_m(
    touches: realtouch.Touches[Any], numbers: Sequence[int], size_px: tuple[int, int]
) -> Float32:
    """Return the estimates of some touches, (k, h, w); those that are missing are made and kept."""
    content = touches.identity
    names = [_name(content, number, size_px) for number in numbers]
    found = {name: depth_m for name in names if (depth_m := _kept(name, size_px)) is not None}
    missing = [(name, number) for name, number in zip(names, numbers, strict=True) if name not in found]
    if missing:
        estimator = _estimator()
    with progress.shown_progress(
        "estimating the depth of real touches without contact", "touches", _QUIET_S
    ) as show:
        for first in range(0, len(missing), _BATCH):
            batch = missing[first : first + _BATCH]
            images = touches.images([number for _, number in batch])
            for (name, _), depth_m in zip(batch, estimator.estimate_m(images, size_px), strict=True):
                found[name] = depth_m
                _keep(name, depth_m)
            show(first + len(batch), len(missing))
    return np.stack([found[name] for name in names])


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
    path, size = _ESTIMATES.path(name), 4 * width * height
    try:
        with store.open_regular(path) as stream:
            content = stream.read(size + _CHECKSUM_BYTES + 1)
    except (OSError, IntegrityError):
        return None
    if content[size:] != xxhash.xxh3_128_digest(content[:size]):
        return None
    _ESTIMATES.mark_used(path)
    return np.frombuffer(content, np.float32, width * height).reshape(height, width)
