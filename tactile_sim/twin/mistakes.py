"""Find mistakes in recordings before anything is fitted.

Colours are compared with those of the gel at rest. Poses and solids predict where an image changes: at the
slopes of the solid. The stated ones and likely alternatives (a mirrored axis, another solid, another unit)
are compared by the correlation of these slopes with the change of the image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import scipy

from tactile_sim.press.sensors import GELSIGHT_MINI, SensorModel
from tactile_sim.twin.recordings import MIN_UNSATURATED, Recordings, Relief, shrunk
from tactile_toolkit.value_types import Bool, Float32, Float64, Int64
from tactile_toolkit.wording import with_count

MIN_TOUCHES = 5
"""Touches that a fit needs at least; 20 are enough."""

_WIDTH_PX = 80  # of the images that are compared
_SMOOTH_MM = 0.5
_SATURATED_LEVEL, _MAX_SATURATED = 254, 0.02
_CHANGED, _MIN_CHANGED = 12.0, 0.01  # levels; share of an image that a contact changes
_MARKER_PX, _MARKER_LEVELS, _MAX_MARKERS = 7.0, 8.0, 0.01
_MAX_DRIFT = 6.0  # levels between parts of a recording; up to 4.7 for sensors that did not change
# Mixed halves of a recording: (length of the runs of touches that alternate between them, shift of the runs).
# A drift must exceed theirs by a factor: it is up to 2.8 times as large if nothing changed, and at least 3.3
# times as large if the gel changed.
_MIXED = ((1, 0), (2, 0), (2, 1), (3, 0))
_ABOVE_MIXED = 3.0
_MAX_DISTANCE_M = 1.0  # of a sensor from its object; a setup on a desk is smaller
# Correlation of slopes with the change of an image: 0.5 to 0.9 for right poses, about 0 for wrong ones.
_LOW, _GAIN = 0.35, 0.15
_SHIFT_PX, _STEP_PX = 6, 2  # shifts that are tried because poses have errors: up to 1.4 mm
_HEIGHT_ERROR_MM = 1.0  # of the zero of stated heights and the thickness of the gel, together
_UNITS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}

_WORDS = {
    "mirrored": "an axis of the poses is mirrored",
    "mesh": "the solids are not those that were touched",
}

_MIRRORS = (
    ("with x mirrored", (-1.0, 1.0, 1.0)),
    ("with y mirrored", (1.0, -1.0, 1.0)),
    ("with the turn the other way round", (1.0, 1.0, -1.0)),
    ("with x and the turn mirrored", (-1.0, 1.0, -1.0)),
    ("with y and the turn mirrored", (1.0, -1.0, -1.0)),
)

_FLIPS = (("with the images upside down", 0), ("with the images mirrored", 1))


@dataclass(frozen=True, slots=True)
class Mistake:
    """Something that is wrong with recordings.

    Attributes
    ----------
    kind : str
        A stable word: ``"channels"``, ``"mesh"``, ``"units"``, ``"mirrored"``, ``"markers"``,
        ``"saturated"``, ``"gel-changed"``, ``"too-few"``, ``"flat"``, ``"light"``, ``"scale"``,
        ``"heights"``, ``"pose"``.
    detail : str
        A sentence that states the mistake and the measured value.
    figure : float
        The measured value.
    touches : tuple of int
        Numbers of the touches that show it; empty for all.
    """

    kind: str
    detail: str
    figure: float
    touches: tuple[int, ...] = ()

    @property
    def is_fatal(self) -> bool:
        """Whether no fit is possible; if the gel changed, the one with more touches is fitted."""
        return self.kind not in ("saturated", "markers", "gel-changed", "light", "scale", "heights", "pose")

    def __str__(self) -> str:
        return self.detail


def find_mistakes(recordings: Recordings, start: SensorModel = GELSIGHT_MINI) -> list[Mistake]:
    """Find what is wrong with recordings; takes a second.

    Parameters
    ----------
    recordings : Recordings
        Touches of known solids.
    start : SensorModel
        First guess of the geometry.

    Returns
    -------
    list of Mistake
        Empty if nothing was found.
    """
    mistakes: list[Mistake] = []
    count = len(recordings)
    if count < MIN_TOUCHES:
        detail = f"{with_count(count, 'touches')}; expected at least {MIN_TOUCHES}, better 20"
        mistakes.append(Mistake("too-few", detail, float(count)))
    gel_at_rest = recordings.gel_at_rest()
    factor = max(1, recordings.size_px[0] // _WIDTH_PX)
    images = np.stack([shrunk(image, factor) for image in recordings.images], dtype=np.float64)
    at_rest = shrunk(gel_at_rest, factor)
    for check in (_saturated, _channels, _changed_gel):
        mistakes += check(recordings, images, at_rest)
    mistakes += _markers(gel_at_rest)
    change = np.abs(images - at_rest).max(axis=3)
    shares = (change > _CHANGED).mean(axis=(1, 2))
    touching = shares >= _MIN_CHANGED
    if not touching.any():
        detail = f"no image shows a contact: at most {shares.max():.1%} of one differs from the gel at rest"
        return [*mistakes, Mistake("flat", detail, float(shares.max()))]
    named = {mistake.kind for mistake in mistakes}
    if recordings.sensor_m is not None:
        compare = _Comparison(recordings, change[touching], np.flatnonzero(touching), start)
        wrong: list[Mistake] = []
        if not named & {"channels", "gel-changed", "saturated"}:
            wrong += _poses(recordings, compare)
        mistakes += wrong or _heights(recordings, compare, start)
    return mistakes


def _saturated(recordings: Recordings, images: Float64, at_rest: Float32) -> Iterator[Mistake]:
    shares = np.array([(image >= _SATURATED_LEVEL).mean() for image in recordings.images])
    if np.median(shares) > _MAX_SATURATED:
        yield Mistake(
            "saturated",
            f"{np.median(shares):.1%} of the levels of an image are at the upper end of their range; "
            f"expected at most {_MAX_SATURATED:.0%}: shorten the exposure",
            float(np.median(shares)),
            tuple(np.flatnonzero(shares > _MAX_SATURATED).tolist()),
        )


def _channels(recordings: Recordings, images: Float64, at_rest: Float32) -> Iterator[Mistake]:
    """Compare the gel at rest with the median of the touches, in all orders of the channels."""
    usual = images
    if not recordings.backgrounds.size:
        usual = images[len(images) // 2 :]
        at_rest = np.median(images[: len(images) // 2], axis=0)
    if not len(usual):
        return
    shown = np.median(usual, axis=0)
    errors = {order: float(np.abs(shown[..., order] - at_rest).mean()) for order in permutations(range(3))}
    best = min(errors, key=lambda order: errors[order])
    stated = errors[0, 1, 2]
    if best != (0, 1, 2) and errors[best] < 0.5 * stated and stated > _MAX_DRIFT:
        names = "".join("RGB"[channel] for channel in best)
        yield Mistake(
            "channels",
            f"the channels are in another order in the touches than in the gel at rest: they differ by "
            f"{stated:.1f} levels as they are, and by {errors[best]:.1f} as {names}",
            stated,
        )


def _changed_gel(recordings: Recordings, images: Float64, at_rest: Float32) -> Iterator[Mistake]:
    """Find where the gel at rest changes in the order of the touches."""
    usable = np.flatnonzero(recordings.unsaturated_shares() >= MIN_UNSATURATED)
    images = images[usable]
    order = np.arange(len(usable))
    # The median of fewer touches would show their contacts, which move from touch to touch.
    least = max(MIN_TOUCHES, len(images) // 3)
    drifts = {cut: _drift(images, order < cut) for cut in range(least, len(images) - least + 1)}
    if not drifts:
        return
    cut = max(drifts, key=lambda touch: drifts[touch])
    # Contacts make any two halves differ. A changed gel makes the touches before and after the change differ,
    # but not mixed halves.
    mixed = min(_drift(images, (order + shift) // width % 2 == 0) for width, shift in _MIXED)
    if drifts[cut] > max(_MAX_DRIFT, _ABOVE_MIXED * mixed):
        yield Mistake(
            "gel-changed",
            f"gel or light changed at touch {usable[cut]}: most of the gel at rest differs by "
            f"{drifts[cut]:.1f} levels before and after; expected at most {_MAX_DRIFT:g}",
            drifts[cut],
            tuple(range(int(usable[cut]), len(recordings))),
        )


def _drift(images: Float64, part: Bool) -> float:
    """Return by how many levels most of the gel at rest differs between some images and the others."""
    within = np.median(images[part], axis=0)
    without = np.median(images[~part], axis=0)
    return float(np.median(np.abs(within - without).mean(axis=2)))


def _markers(gel_at_rest: Float32) -> Iterator[Mistake]:
    """Find small dark dots in the gel at rest."""
    grey = gel_at_rest.mean(axis=2)
    scale = grey.shape[1] / 320
    fine, wide = (scipy.ndimage.gaussian_filter(grey, sigma * scale) for sigma in (1.0, _MARKER_PX))
    share = float((fine - wide < -_MARKER_LEVELS).mean())
    if share > _MAX_MARKERS:
        yield Mistake(
            "markers",
            f"the gel has markers: {share:.1%} of it are small dark dots; expected at most "
            f"{_MAX_MARKERS:.0%}: a twin has no markers",
            share,
        )


def _poses(recordings: Recordings, compare: _Comparison) -> Iterator[Mistake]:
    """Compare the stated poses and solids with likely alternatives."""
    stated = compare.agreement(recordings)
    assert recordings.sensor_m is not None, "checked before"
    assert recordings.object_poses is not None, "set when recordings are made"
    distance_m = float(
        np.median(np.abs(recordings.sensor_m[:, :2] - recordings.object_poses[:, :2]).max(axis=1))
    )
    figure = f"the slopes of the solids and the change of the images agree by {stated:.2f}"
    if distance_m > _MAX_DISTANCE_M:
        agreements = {
            unit: compare.agreement(_rescaled(recordings, metres, metres)) for unit, metres in _UNITS.items()
        }
        unit = max(agreements, key=lambda name: agreements[name])
        words = f"; in {unit}, {figure.rpartition(' ')[0]} {agreements[unit]:.2f}"
        yield Mistake(
            "units",
            f"sensor and solid are {distance_m:.3g} m apart: positions are not in metres{words}",
            distance_m,
        )
        return
    if stated >= _LOW:
        return
    meant = [
        ("mirrored", words, compare.agreement(_rescaled(recordings, *signs))) for words, signs in _MIRRORS
    ]
    meant += [("mirrored", words, compare.agreement(recordings, flip)) for words, flip in _FLIPS]
    meant.append(("mesh", "with other solids of the set", compare.with_others(recordings)))
    kind, words, agrees_by = max(meant, key=lambda meaning: meaning[2])
    if agrees_by > max(stated + _GAIN, _LOW):
        yield Mistake(kind, f"{_WORDS[kind]}: {figure}, and {words} by {agrees_by:.2f}", stated)
        return
    detail = f"the solids or their poses are not those of the touches: {figure}; expected at least {_LOW:g}"
    yield Mistake("mesh", detail, stated)


def _heights(recordings: Recordings, compare: _Comparison, start: SensorModel) -> Iterator[Mistake]:
    """Compare the stated heights of the sensor with those at which a gel touches the solids."""
    assert recordings.sensor_m is not None, "checked before"
    press_m = start.gel_mm / 1e3 + compare.tops_m(recordings) - recordings.sensor_m[compare.touches, 2]
    known_mm = 1e3 * press_m[np.isfinite(press_m)]
    if not len(known_mm):
        return
    usual_mm = float(np.median(known_mm))
    if not -_HEIGHT_ERROR_MM < usual_mm < start.gel_mm + _HEIGHT_ERROR_MM:
        yield Mistake(
            "heights",
            f"by z_m, the solids reach {usual_mm:.3g} mm into a gel of {start.gel_mm:g} mm: heights are not "
            "used, but found from the images",
            usual_mm,
        )


class _Comparison:
    """Compares the slopes of solids in their poses with the change of images (n, h, w)."""

    def __init__(self, recordings: Recordings, change: Float64, touches: Int64, start: SensorModel) -> None:
        self.touches = touches
        self.reliefs = {key: Relief.of(recordings.mesh(key)) for key in recordings.solids}
        self.size = change.shape[1:]
        self.half_m = np.array([start.width_mm, start.height_mm]) / 2e3
        self.press_m = start.gel_mm / 1e3 - start.press_m
        self.sigma_px = _SMOOTH_MM / start.width_mm * self.size[1]
        self.change = _centred(_blurred(change, self.sigma_px))

    def agreement(self, recordings: Recordings, flip: int | None = None) -> float:
        """Return the median correlation over the touches; ``flip`` mirrors an axis of the images."""
        change = self.change
        if flip is not None:
            change = np.flip(change, 1 + flip)
        poses = recordings.poses_on_solids()
        assert poses is not None, "poses were stated"
        ids = recordings.object_ids[self.touches]
        correlations = [
            self._agreement(int(key), pose, touch_change)
            for key, pose, touch_change in zip(ids, poses[self.touches], change, strict=True)
        ]
        return float(np.median(correlations))

    def tops_m(self, recordings: Recordings) -> Float64:
        """Return the greatest height of the solid under the sensor at each touch, metres, (n,)."""
        poses = recordings.poses_on_solids()
        assert poses is not None, "poses were stated"
        ids = recordings.object_ids[self.touches]
        pairs = zip(ids, poses[self.touches], strict=True)
        return np.array(
            [self.reliefs[int(key)].sampled(pose, self.half_m, self.size).max() for key, pose in pairs]
        )

    def with_others(self, recordings: Recordings) -> float:
        """Return the median correlation if each touch is of the best of the other solids."""
        poses = recordings.poses_on_solids()
        correlations = []
        assert poses is not None, "poses were stated"
        for touch, touch_change in zip(self.touches, self.change, strict=True):
            others = [key for key in self.reliefs if key != recordings.object_ids[touch]]
            agreements = [self._agreement(key, poses[touch], touch_change) for key in others]
            correlations.append(max(agreements, default=0.0))
        return float(np.median(correlations))

    def _agreement(self, key: int, pose: Float64, touch_change: Float64) -> float:
        """Return the correlation of one touch, the greatest within the error of a pose."""
        slopes = self._slopes(self.reliefs[key], pose)
        norm = np.sqrt((slopes**2).sum() * (touch_change**2).sum())
        if norm == 0:
            return 0.0
        best = 0.0
        for down in range(-_SHIFT_PX, _SHIFT_PX + 1, _STEP_PX):
            for right in range(-_SHIFT_PX, _SHIFT_PX + 1, _STEP_PX):
                moved = np.roll(slopes, (down, right), axis=(0, 1))
                best = max(best, float((moved * touch_change).sum() / norm))
        return best

    def _slopes(self, relief: Relief, pose: Float64) -> Float64:
        heights = relief.sampled(pose, self.half_m, self.size)
        pressed = np.maximum(heights - (heights.max() - self.press_m), 0.0)
        down, right = np.gradient(_blurred(pressed[None], self.sigma_px)[0])
        return np.asarray(_centred(np.hypot(down, right)[None])[0])


def _blurred(images: Float64, sigma_px: float) -> Float64:
    smooth: Float64 = scipy.ndimage.gaussian_filter(images, (0, sigma_px, sigma_px))
    return smooth


def _centred(images: Float64) -> Float64:
    return np.asarray(images - images.mean(axis=(1, 2), keepdims=True))


def _rescaled(recordings: Recordings, x: float, y: float, turn: float = 1.0) -> Recordings:
    """Return recordings with positions and turns multiplied by factors."""
    assert recordings.sensor_m is not None, "poses were stated"
    assert recordings.object_poses is not None, "set when recordings are made"
    return replace(
        recordings,
        sensor_m=recordings.sensor_m * [x, y, 1.0],
        object_poses=recordings.object_poses * [x, y, turn],
    )
