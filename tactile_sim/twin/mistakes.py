"""What is wrong with recordings, found before anything is fitted, each with the figure that shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tactile_sim.sensor_models import GELSIGHT_MINI, SensorModel
from tactile_sim.taxim_kernels import blur
from tactile_sim.twin import gel
from tactile_sim.twin.fitting import Fit, shrunk
from tactile_sim.twin.recordings import Recordings
from tactile_sim.twin.rounds_of_fit import first_background, start_fit
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.touch import CELL_M
from tactile_toolkit.wording import with_count

LEAST_TOUCHES = 6
_SATURATED = 0.02  # share of pixels
_SWAPPED = 0.7  # of the difference as it is
_SWAPPED_LEVELS = 2.0
_DOTS = (0.01, 0.35)  # share of an image that markers cover
_DOT_LEVELS, _DOT_WIDTHS = 8.0, 0.02
_CHANGED, _CHANGED_LEVELS = 2.5, 2.5
_FLAT_LEVELS = 6.0
_SMALL_PX = 64  # width of the images that are compared
# Correlations of what is seen with what the poses foretell.
_BETTER, _TOO_LOW = 0.12, 0.2


@dataclass(frozen=True, slots=True)
class Mistake:
    """A fault of recordings.

    Attributes
    ----------
    kind : str
        ``"channels"``, ``"mesh"``, ``"units"``, ``"mirrored"``, ``"markers"``, ``"saturated"``,
        ``"gel-changed"``, ``"too-few"`` or ``"flat"``.
    detail : str
        What was found, with its figures.
    figure : float
        The figure that shows it.
    touches : tuple of int
        Which touches, by their place; empty if it concerns all.
    """

    kind: str
    detail: str
    figure: float
    touches: tuple[int, ...] = ()

    @property
    def is_fatal(self) -> bool:
        """Whether nothing can be fitted."""
        return self.kind not in ("saturated", "gel-changed")


def find_mistakes(recordings: Recordings, start: SensorModel = GELSIGHT_MINI) -> list[Mistake]:
    """Return what is wrong with recordings; empty if nothing is.

    Parameters
    ----------
    recordings : Recordings
        Touches of known solids.
    start : SensorModel
        First guess of the geometry.

    Returns
    -------
    list of Mistake
        The most basic first. Faults of the poses are looked for if nothing else is wrong.
    """
    background = first_background(recordings)
    checks = (_too_few, _saturated, _channels, _markers, _flat, _gel_changed)
    found = [each for check in checks for each in check(recordings, background)]
    if not any(each.is_fatal for each in found) and recordings.sensor_m is not None:
        found += _poses(recordings, start, background)
    return found


def _too_few(recordings: Recordings, _background: Float32) -> Iterator[Mistake]:
    count = len(recordings)
    if count < LEAST_TOUCHES:
        text = f"there are {with_count(count, 'touches')}; a sensor needs at least {LEAST_TOUCHES}, better 20"
        yield Mistake("too-few", text, count)


def _saturated(recordings: Recordings, _background: Float32) -> Iterator[Mistake]:
    shares = np.array([((each >= 255) | (each <= 0)).any(axis=-1).mean() for each in recordings.images])
    share = float(np.median(shares))
    if share > _SATURATED:
        text = f"{100 * share:.1f} % of the pixels are at 0 or 255; expected at most {100 * _SATURATED:.0f} %"
        yield Mistake("saturated", text, share, tuple(np.flatnonzero(shares > _SATURATED).tolist()))


def _channels(recordings: Recordings, background: Float32) -> Iterator[Mistake]:
    swapped, ratios = [], []
    for number, image in enumerate(recordings.images):
        plain, turned = (
            float(np.median(np.abs(each - background).mean(axis=-1))) for each in (image, image[..., ::-1])
        )
        if turned < _SWAPPED * plain and plain - turned > _SWAPPED_LEVELS:
            swapped.append(number)
            ratios.append(plain / max(turned, 0.1))
    if len(swapped) > 0.2 * len(recordings):
        text = (
            f"{with_count(len(swapped), 'images')} of {len(recordings)} have red and blue in another order than the "
            f"background: exchanged, they are {np.median(ratios):.1f} times as close to it"
        )
        yield Mistake("channels", text, float(np.median(ratios)), tuple(swapped))


def _markers(_recordings: Recordings, background: Float32) -> Iterator[Mistake]:
    grey = background.mean(axis=-1).astype(np.float64)
    rows, columns = grey.shape
    around = grey.copy()
    kernels = [gel.half_kernel(_DOT_WIDTHS * columns, side, 2.0) for side in (columns, rows)]
    blur(around, *kernels, 1, np.zeros(grey.shape, bool), around)
    share = float((grey - around < -_DOT_LEVELS).mean())
    if _DOTS[0] < share < _DOTS[1]:
        text = (
            f"{100 * share:.1f} % of the image without contact are dark dots, as of a gel with markers, which a "
            "twin does not render"
        )
        yield Mistake("markers", text, share)


def _flat(recordings: Recordings, background: Float32) -> Iterator[Mistake]:
    shrink = max(1, recordings.size_px[0] // _SMALL_PX)
    behind = shrunk(background, shrink)
    changes = [
        float(np.percentile(np.abs(shrunk(each.astype(np.float32), shrink) - behind).max(axis=-1), 99))
        for each in recordings.images
    ]
    if np.median(changes) < _FLAT_LEVELS:
        text = (
            f"the images differ from the background by {np.median(changes):.1f} levels at most, so the gel was "
            f"pressed flat everywhere; expected at least {_FLAT_LEVELS:g}"
        )
        yield Mistake("flat", text, float(np.median(changes)))


def _gel_changed(recordings: Recordings, _background: Float32) -> Iterator[Mistake]:
    count = len(recordings)
    if count < 2 * LEAST_TOUCHES:
        return
    shrink = max(1, recordings.size_px[0] // _SMALL_PX)
    small = np.stack([shrunk(each.astype(np.float32), shrink) for each in recordings.images])
    by_chance = _difference(small[::2], small[1::2])
    splits = range(count // 4, count - count // 4 + 1)
    differences = {at: _difference(small[:at], small[at:]) for at in splits}
    at = max(differences, key=differences.__getitem__)
    if differences[at] > max(_CHANGED * by_chance, _CHANGED_LEVELS):
        text = (
            f"the gel changed before touch {recordings.names[at]}: what both parts show without contact differs by "
            f"{differences[at]:.1f} levels, against {by_chance:.1f} of touches taken in turns"
        )
        yield Mistake("gel-changed", text, differences[at], tuple(range(at, count)))


def _difference(one: Float32, other: Float32) -> float:
    return float(np.median(np.abs(np.median(one, axis=0) - np.median(other, axis=0))))


def _poses(recordings: Recordings, start: SensorModel, background: Float32) -> Iterator[Mistake]:
    assert recordings.sensor_m is not None, "asked for by the caller"
    farthest_m = float(np.abs(recordings.sensor_m[:, :2]).max())
    if farthest_m > 5 * max(CELL_M):
        text = f"the sensor was at up to {farthest_m:.4g} m from the middle of the cell; expected metres"
        yield Mistake("units", text, farthest_m)
        return
    seen = _Seen(recordings, start, background)
    given = seen.agreement(recordings)
    others = {name: seen.agreement(change(recordings)) for name, change in _CHANGES.items()}
    best = max(others, key=lambda name: float(np.median(others[name])))
    now, then = float(np.median(given)), float(np.median(others[best]))
    if then > now + _BETTER:
        kind = best.partition(":")[0]
        text = f"{best.partition(': ')[2]}: the images then agree with the poses by {then:.2f}, and by {now:.2f} as given"
        yield Mistake(kind, text, then)
        return
    wrong, ids = seen.other_meshes(recordings, given)
    if len(wrong) > 0.2 * len(recordings) or now < _TOO_LOW:
        text = (
            f"{with_count(len(wrong), 'touches')} of {len(recordings)} look more like another solid of the set"
            f"{ids}; images and solids agree by {now:.2f}"
        )
        yield Mistake("mesh", text, now, tuple(wrong))


class _Seen:
    """What images show of contacts, to be compared with what poses foretell."""

    def __init__(self, recordings: Recordings, start: SensorModel, background: Float32) -> None:
        self._start = start
        self._shrink = max(1, recordings.size_px[0] // _SMALL_PX)
        behind = shrunk(background, self._shrink)
        changes = (
            np.abs(shrunk(each.astype(np.float32), self._shrink) - behind).mean(axis=-1)
            for each in recordings.images
        )
        self._shown = [each - each.mean() for each in changes]

    def agreement(self, recordings: Recordings) -> Float64:
        """Return the correlation of each image with the slopes that its pose foretells, shape (N,)."""
        places = recordings.places()
        assert places is not None and recordings.sensor_m is not None, "asked for by the caller"
        # The height is not used: a thicker gel than guessed would hide what is right.
        fit = start_fit(recordings, places, None, self._start)
        fit.look(self._shrink)
        return np.array([_agreement(fit, number, shown) for number, shown in enumerate(self._shown)])

    def other_meshes(self, recordings: Recordings, given: Float64) -> tuple[list[int], str]:
        """Return the touches that another solid suits better, and how they are named."""
        best, ids = given + _BETTER, recordings.object_ids.copy()
        for other in recordings.solids:
            changed = replace(
                recordings, object_ids=np.full(len(ids), other), solids={other: recordings.mesh(other)}
            )
            found = self.agreement(changed)
            ids[found > best] = other
            best = np.maximum(best, found)
        wrong = np.flatnonzero(ids != recordings.object_ids).tolist()
        named = [f"{recordings.names[each]}: {ids[each]}" for each in wrong[:3]]
        return wrong, f" ({', '.join(named)}, ...)" if named else ""


def _agreement(fit: Fit, number: int, shown: Float32) -> float:
    pitch_m = fit.pitch_m(fit.shape)
    soft = gel.gel_surface(fit.indentation(number, fit.poses[number], fit.shape), pitch_m, fit.shape)
    down, across = np.gradient(soft, pitch_m[1], pitch_m[0])
    slopes = np.hypot(down, across)
    slopes -= slopes.mean()
    size = np.sqrt((slopes**2).sum() * (shown**2).sum())
    return float((slopes * shown).sum() / size) if size > 0 else 0.0


def _scaled(recordings: Recordings, factor: float) -> Recordings:
    assert recordings.sensor_m is not None and recordings.object_poses is not None, "asked for by the caller"
    poses = recordings.object_poses.copy()
    poses[:, :2] *= factor
    return replace(recordings, sensor_m=recordings.sensor_m * factor, object_poses=poses)


def _turned(recordings: Recordings, factor: float) -> Recordings:
    assert recordings.object_poses is not None, "set when the recordings are made"
    return replace(recordings, object_poses=recordings.object_poses * [1, 1, factor])


def _mirrored(recordings: Recordings, axis: int) -> Recordings:
    assert recordings.sensor_m is not None and recordings.object_poses is not None, "asked for by the caller"
    sign = np.ones(3)
    sign[axis] = -1
    poses = recordings.object_poses * sign
    return replace(recordings, sensor_m=recordings.sensor_m * sign, object_poses=poses)


def _mirrored_turn(recordings: Recordings, axis: int) -> Recordings:
    return _turned(_mirrored(recordings, axis), -1)


_CHANGES: Mapping[str, Callable[[Recordings], Recordings]] = {
    "mirrored: x of the poses points the other way": lambda each: _mirrored(each, 0),
    "mirrored: y of the poses points the other way": lambda each: _mirrored(each, 1),
    "mirrored: turns go the other way": lambda each: _turned(each, -1),
    "mirrored: x and turns go the other way": lambda each: _mirrored_turn(each, 0),
    "mirrored: y and turns go the other way": lambda each: _mirrored_turn(each, 1),
    "units: lengths of the poses are in mm": lambda each: _scaled(each, 1e-3),
    "units: lengths of the poses are in cm": lambda each: _scaled(each, 1e-2),
    "units: lengths of the poses are a thousandth": lambda each: _scaled(each, 1e3),
    "units: turns are in degrees": lambda each: _turned(each, np.pi / 180),
}
