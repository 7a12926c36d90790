"""Fits geometry, response and poses of a twin to touches of known solids.

For a fixed geometry, an image is linear in the coefficients of the response. They are eliminated from each
Gauss-Newton step (variable projection: Golub and Pereyra, Inverse Problems 19, 2003), which moves the other
unknowns: the geometry, and for each touch the point under the sensor, the turn and the press depth. Sums are
taken touch by touch, so memory hardly grows with their number. The normal matrix of the coefficients leaves
out the blur of the camera. This shortens their steps and does not change where they converge.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from tactile_sim.twin import gel, gel_kernels, view_kernels
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.recordings import MOST_LEVEL, frame_gains, shrunk, unsaturated

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tactile_sim.twin.recordings import Recordings, Relief
    from tactile_toolkit.value_types import Bool, Float32, Float64

_SHARED = len(Fitted)
_OWN = 4
# Steps of the finite differences for derivatives by geometry and pose; expected deviations from the guess.
_SHAPE_STEPS = 0.004, 0.01, 3e-5, 5e-5, 1.5e-5, 0.03, 2e-5, 2.0, 0.05, -0.004, 0.04, 0.02, 0.05, 0.02
_POSE_STEPS = 6e-5, 6e-5, 0.008, 3e-5
_STEPS = np.array([*_SHAPE_STEPS, *_POSE_STEPS])
_SHAPE_SPREAD = np.array([0.15, 0.05, 2e-3, 4e-4, 4e-5, 0.15, 5e-5, 40.0, 0.5, 0.015, 0.3, 0.15, 0.5, 0.1])
_OUTLIER = 4.0  # residuals beyond this multiple of the noise weigh little: dust, layer lines, shadows
_FIRST_NOISE, _MIN_NOISE = 10.0, 0.3  # levels
# Weights of the penalty: of the terms of an entry, and of the entries of slopes and of lamps.
_TERM_COST = np.array([1.0, 3.0, 3.0, 6.0, 6.0, 6.0, 3.0, 3.0, 3.0])
_ENTRY_COST, _LAMP_COST = 1e-4, 1e-3
_LEVEL_COST = 30.0  # of a response where the gel is level, which would end abruptly there
_STEP_FACTORS = (1.0, 0.5, 0.25, 0.125)  # of a step, tried until one makes the images no worse
_NO_WORSE = 1.001  # largest ratio of the costs after and before
_UNSEEN = 0.02  # weight of saturated light at rest, in images that show how bright it is
_DARK = 0.02  # light of a lamp that counts as none, over that of the brightest
_GLARE = 0.03  # standard deviation over which saturated light at rest is smooth, of the width
MIN_DRIFT = 0.01
"""Root mean square of the gains of frames, less 1, below which all of them count as 1."""

FIRST_DRIFT = 0.006
"""The same after the first round, whose response takes up part of the gains; up to 0.004 in steady light."""

ALIKE_PX = 200.0
"""Number of pixels whose residuals are correlated, so that they count as one."""

RIDGES = (1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0)


def _penalty() -> Float64:
    """Return the matrix that penalises what the table adds to lamps, unless it is linear in the slopes.

    A linear response is a sine of the direction, and grows from 0 at rest with the square of the index of
    steepness; matte gels respond like this. A geometry that is fitted with a high ridge therefore suits most
    gels.
    """
    directions = np.eye(view_kernels.TURNS)
    around = np.roll(directions, 1, axis=0) + np.roll(directions, -1, axis=0)
    around -= 2 * np.cos(2 * np.pi / len(directions)) * directions
    steps = np.eye(view_kernels.STEPS)
    steep = np.vstack([np.diff(steps, 3, axis=0), _LEVEL_COST * steps[:1]])
    slopes = np.kron(around.T @ around, steps)
    slopes += np.kron(directions, steep.T @ steep + _ENTRY_COST * steps)
    lamps = _LAMP_COST * np.eye(gel_kernels.LAMPS)
    return np.asarray(scipy.linalg.block_diag(np.kron(slopes, np.diag(_TERM_COST)), lamps))


@dataclass(slots=True)
class Steps:
    """Progress of a calibration: ``done`` of ``total`` steps, which take about as long as each other."""

    on_progress: Callable[[int, int], None] | None = None
    total: int = 0
    done: int = 0

    def advance(self, count: int = 1) -> None:
        """Report that some more steps are done."""
        self.done += count
        if self.on_progress is not None:
            self.on_progress(self.done, self.total)


@dataclass(eq=False)
class Fit:
    """State of a fit: geometry, poses and response.

    ``shape`` is the geometry, by :class:`~tactile_sim.twin.gel.Fitted`. ``poses`` (N, 4) are x and y, metres,
    the turn, radians, and a correction that is added to the press depth, metres; ``spread`` (N, 4) is how far
    they are expected to be off. ``guess_m`` is the guess of half the width and half the height of the image,
    ``level_m`` (N,) the height of the sensor at each touch, metres. ``off`` (N,) are the touches whose stated
    poses do not explain their images.
    """

    recordings: Recordings
    reliefs: dict[int, Relief] = field(repr=False)
    guess_m: Float64
    shape: Float64
    poses: Float64
    level_m: Float64
    spread: Float64
    background: Float32 = field(repr=False)
    ridge: float = 0.1
    coefficients: Float64 = field(default_factory=lambda: np.zeros((gel_kernels.COEFFICIENTS, 3)), repr=False)
    off: Bool = field(init=False)
    likely: Bool = field(init=False)
    used: Bool = field(init=False)
    rms: Float64 = field(init=False)
    explained: float = field(init=False, default=0.0)
    shrink: int = field(init=False, default=1)

    def __post_init__(self) -> None:
        count = len(self.recordings)
        self.off = np.zeros(count, bool)
        self.likely, self.used = np.ones(count, bool), np.ones(count, bool)
        self.rms = np.full(count, np.nan)
        self.robust_std = np.zeros(count)
        self.gains = np.ones((count, 3))
        self.at_rest = self.background
        self.lit = unsaturated(self.background)
        self.shape_guess, self.pose_guess = self.shape.copy(), self.poses.copy()
        self.information = np.zeros((count, _OWN, _OWN))
        self.penalty = _penalty()
        self.lamps = gel_kernels.ALL_LAMPS
        self.set_shrink(1)

    def set_shrink(self, shrink: int) -> None:
        """Shrink the images by a factor in further steps."""
        self.shrink = shrink
        width, height = (side // shrink for side in self.recordings.size_px)
        self.size = (height, width)
        self.behind = shrunk(self.background, shrink)
        self.terms = gel.position_terms(self.behind)
        self.noise = _FIRST_NOISE

    def image(self, touch: int) -> tuple[Float32, Bool]:
        """Return an image in the current size, levels, and a mask of the pixels that are not saturated.

        The image is divided by the gains of its frame.
        """
        image = self.recordings.images[touch]
        mask = (unsaturated(image) & self.lit).astype(np.float32)
        levels = shrunk(image.astype(np.float32), self.shrink) / self.gains[touch].astype(np.float32)
        return levels, shrunk(mask, self.shrink) > 0.99

    def refresh_gains(self, least: float) -> None:
        """Fit the gains of each frame to the background and the rendered changes; below ``least``, none."""
        for touch in range(len(self.poses)):
            self._refresh_gain(touch, self.rendered(touch, self.poses[touch], self.shape))
        if self.light_drift < least:
            self.gains[:] = 1.0

    def _refresh_gain(self, touch: int, base: Float32) -> None:
        image, _ = self.image(touch)
        self.gains[touch] *= frame_gains(image, self.behind + base, self.noise)

    @property
    def light_drift(self) -> float:
        """Root mean square of how far the gains of the frames are from 1."""
        return float(np.sqrt(np.mean((self.gains - 1) ** 2)))

    def change(self, touch: int) -> float:
        """Return how much an image differs from the gel at rest: RMS, levels."""
        image, mask = self.image(touch)
        return float(np.sqrt(np.mean((image - self.behind)[mask] ** 2))) + 1e-9

    def half_m(self, shape: Float64) -> Float64:
        """Return half the width and half the height of the image, metres."""
        return np.asarray(self.guess_m * np.exp(shape[Fitted.SIZE]))

    def pitch_m(self, shape: Float64) -> Float64:
        """Return the size of a pixel along x and y in the current size of the images, metres."""
        return 2 * self.half_m(shape) / self.size[::-1]

    def indentation(self, touch: int, pose: Float64, shape: Float64, margin: int = 0) -> Float64:
        """Return how far the solid reaches into the gel at rest, metres, (H, W), in the size of the images.

        The map is not seen through the lens, and has ``margin`` pixels more on each side.
        """
        size = tuple(side + 2 * margin for side in self.size)
        span = np.array(size[::-1]) / self.size[::-1]
        relief = self.reliefs[int(self.recordings.object_ids[touch])]
        level_m = self.level_m[touch] - shape[Fitted.GEL] - pose[3]
        return relief.sampled(pose, self.half_m(shape), size, span, level_m)

    def press_m(self, touch: int) -> float:
        """Return how far the highest point of the solid inside the image reaches into the gel, metres."""
        return float(self.indentation(touch, self.poses[touch], self.shape).max())

    def set_press(self, touch: int, press_m: float) -> None:
        """Set the height of the sensor so that a touch has this press depth, metres."""
        self.level_m[touch] = self.shape[Fitted.GEL] + self.poses[touch, 3]  # nothing lies below this level
        self.level_m[touch] += self.press_m(touch) - press_m

    def seen_depth_m(self, touch: int) -> Float32:
        """Return how far the solid reaches into the gel at rest, metres, (H, W), as the camera sees it."""
        margin = gel.margin_px(self.size[1])
        reach_m = self.indentation(touch, self.poses[touch], self.shape, margin)
        return -gel.seen_through(-reach_m, self.pitch_m(self.shape), self.shape, margin)

    def pressed(self, touch: int, pose: Float64, shape: Float64) -> Float32:
        """Return the surface of the gel at a touch with a margin, metres, before the camera sees it."""
        margin = gel.margin_px(self.size[1])
        indentation_m = self.indentation(touch, pose, shape, margin)
        return gel.pressed_surface(indentation_m, self.pitch_m(shape), shape, margin)

    def seen(self, pressed: Float32, shape: Float64) -> Float32:
        """Return the surface of the gel as the camera sees it, (H, W), metres."""
        return gel.seen_through(pressed, self.pitch_m(shape), shape, gel.margin_px(self.size[1]))

    def shown(self, seen: Float32, shape: Float64) -> Float32:
        """Return the rendered change of an image against the background, (H, W, 3), levels."""
        return gel.response(
            seen, self.pitch_m(shape), shape, gel.response_table(self.coefficients), self.terms
        )

    def rendered(self, touch: int, pose: Float64, shape: Float64) -> Float32:
        """Return the rendered change of the image of a touch, (H, W, 3), levels."""
        return self.shown(self.seen(self.pressed(touch, pose, shape), shape), shape)

    def residual(self, touch: int, base: Float32 | None = None) -> tuple[Float32, Float32]:
        """Return the residuals of an image (H, W, 3), levels, and its weights (H, W).

        ``base`` is its rendered change, if it is known.
        """
        if base is None:
            base = self.rendered(touch, self.poses[touch], self.shape)
        image, mask = self.image(touch)
        residuals = image - self.behind - base
        # Geman and McClure's weights: outliers lose their influence.
        largest = np.square(residuals / np.float32(_OUTLIER * self.noise)).max(axis=-1)
        weights = (mask / np.square(1 + largest)).astype(np.float32)
        self.rms[touch] = np.sqrt(np.mean(residuals[mask] ** 2)) if mask.any() else np.nan
        self.robust_std[touch] = 1.4826 * float(np.median(np.abs(residuals)))
        return residuals, weights

    def step(self, moving: tuple[Fitted, ...] = ()) -> float:
        """Take a step, and return how far the whole step moves the geometry, in parts of its expected spread.

        Less than the whole step is taken if the images would get worse. The response always changes. If any
        of the geometry is ``moving``, the poses move too.
        """
        sums = _Sums(len(self.poses))
        cost = sum(self._add(sums, touch, moving) for touch in np.flatnonzero(self.used).tolist())
        before = self.shape, self.poses, self.coefficients
        moved = sums.solve(self, moving)
        shift = np.abs(moved[:_SHARED] / _SHAPE_SPREAD).max()
        self.shape = self.shape + moved[:_SHARED]
        self.shape = gel.bounded(self.shape, self.half_m(self.shape), self.size[1])
        self.poses = self.poses + moved[_SHARED:].reshape(-1, _OWN)
        after = self.shape, self.poses, self.coefficients
        for factor in _STEP_FACTORS:
            self.shape, self.poses, self.coefficients = (
                old + factor * (new - old) for old, new in zip(before, after, strict=True)
            )
            if self._cost() <= _NO_WORSE * cost:
                break
        self.noise = max(float(np.median(self.robust_std[self.used])), _MIN_NOISE)
        # If all touches are pressed in deeper, the gel is thicker.
        common_m = float(self.poses[self.used, 3].mean())
        if Fitted.GEL in moving:
            self.shape[Fitted.GEL] += common_m
        self.poses[:, 3] -= common_m
        return float(shift)

    def _cost(self) -> float:
        """Return the weighted sum of squared residuals of all used touches."""
        total = 0.0
        for touch in np.flatnonzero(self.used).tolist():
            residuals, weights = self.residual(touch)
            total += _robust_square(residuals, weights)
        return total

    def _add(self, sums: _Sums, touch: int, moving: tuple[Fitted, ...]) -> float:
        """Add a touch to the sums of a step, and return its weighted sum of squared residuals."""
        pressed = self.pressed(touch, self.poses[touch], self.shape)
        seen = self.seen(pressed, self.shape)
        base = self.shown(seen, self.shape)
        if moving and self.light_drift:  # gains and geometry settle together
            self._refresh_gain(touch, base)
        residuals, weights = self.residual(touch, base)
        columns = [residuals]
        unknowns: list[int] = []
        if moving:
            columns += self.derivatives(touch, self.poses[touch], pressed, base, moving)
            own = _SHARED + _OWN * touch
            unknowns += [*map(int, moving), *range(own, own + _OWN)]
        pitch_m = self.pitch_m(self.shape)
        features = gel.surface_features(seen, pitch_m, self.shape, self.lamps)
        blur_px = self.shape[Fitted.BLUR] / pitch_m
        sums.add(
            features, self.terms, weights, np.stack(columns, axis=2, dtype=np.float32), unknowns, blur_px
        )
        return _robust_square(residuals, weights)

    def derivatives(
        self, touch: int, pose: Float64, pressed: Float32, base: Float32, moving: tuple[Fitted, ...] = ()
    ) -> Iterator[Float32]:
        """Yield the derivatives (H, W, 3) of a rendered change by some of the geometry, and by the pose.

        ``pressed`` and ``base`` are the surface with its margin, and its rendered change.
        """
        carried = dict(enumerate(self._carried(pose, pressed), _SHARED))
        for unknown in (*map(int, moving), *range(_SHARED, _SHARED + _OWN)):
            step = np.zeros(len(_STEPS))
            step[unknown] = _STEPS[unknown]
            shape = self.shape + step[:_SHARED]
            moved = pressed
            if unknown in carried:
                moved = pressed + np.float32(_STEPS[unknown]) * carried[unknown]
            elif unknown not in gel.OF_THE_VIEW:
                moved = self.pressed(touch, pose + step[_SHARED:], shape)
            yield (self.shown(self.seen(moved, shape), shape) - base) / np.float32(_STEPS[unknown])

    def _carried(self, pose: Float64, pressed: Float32) -> Iterator[Float32]:
        """Yield the derivatives of a surface with a margin by x, y and turn: the solid carries it along."""
        pitch_x, pitch_y = self.pitch_m(self.shape).astype(np.float32).tolist()
        down, across = np.gradient(pressed)
        across = across / pitch_x
        up = -down / pitch_y
        cosine = float(np.cos(pose[2]))
        sine = float(np.sin(pose[2]))
        yield cosine * across + sine * up
        yield cosine * up - sine * across
        rows, columns = pressed.shape
        x_m = np.arange(0.5 - columns / 2, columns / 2, dtype=np.float32) * pitch_x
        y_m = np.arange(rows / 2 - 0.5, -rows / 2, -1, dtype=np.float32) * pitch_y
        yield y_m[:, None] * across - x_m * up

    def rescale(self, scale: float) -> None:
        """Multiply all lengths by a factor, which leaves the rendered images as they are."""
        beyond_gel_m = self.level_m - self.shape[Fitted.GEL]
        self.shape[Fitted.GEL : Fitted.CONTACT] *= scale
        self.shape[Fitted.BLUR] *= scale
        self.shape[Fitted.CAMERA] /= scale
        self.level_m = scale * beyond_gel_m + self.shape[Fitted.GEL]
        self.guess_m = self.guess_m * scale
        self.poses = self.poses * [scale, scale, 1.0, scale]
        for key, relief in self.reliefs.items():
            self.reliefs[key] = replace(
                relief, heights_m=relief.heights_m * np.float32(scale), corner=relief.corner * scale
            )

    def refresh_background(self) -> None:
        """Average the images without contact and the touches less their rendered change, in full size.

        Where it is saturated, only touches that darken it tell how much brighter it is.
        """
        assert self.shrink == 1, "the background has the size of the images"
        is_least = self.at_rest > MOST_LEVEL
        share = np.where(is_least, _UNSEEN, len(self.recordings.backgrounds)) + 1e-6
        total = share * self.at_rest
        for touch in np.flatnonzero(self.used):
            base = self.rendered(int(touch), self.poses[touch], self.shape)
            image, _ = self.image(int(touch))
            mask = unsaturated(self.recordings.images[touch])
            # The response is known to about 8 %.
            far = 0.08 * np.abs(base).max(axis=-1, keepdims=True) / self.noise
            weight = mask[..., None] / (1 + far * far)
            total += weight * (image - base)
            share += weight
        smooth_total, smooth_share = (
            np.where(is_least, values, 0).astype(np.float32) for values in (total, share)
        )
        for values in (smooth_total, smooth_share):
            gel.blur_colours(values, np.full(2, _GLARE * self.size[1]))
        bright = np.maximum(smooth_total / np.maximum(smooth_share, 1e-12), self.at_rest)
        self.background = np.where(is_least, bright, total / share).astype(np.float32)
        self.behind = self.background
        self.terms = gel.position_terms(self.behind)

    def choose_lamps(self) -> None:
        """Keep the lamps that shine if their light, which is not negative, has to explain the images.

        There are a few rows of lamps. Their shadows are sharper without all others.
        """
        sums = _Sums(len(self.poses))
        for touch in np.flatnonzero(self.used).tolist():
            self._add(sums, touch, ())
        light = sums.brightness(self)
        is_dark = (light < _DARK * light.max()).all(axis=1)
        self.lamps = np.flatnonzero(~is_dark)
        self.coefficients[-gel_kernels.LAMPS :][is_dark] = 0.0
        self.step()

    def choose_ridge(self) -> None:
        """Choose the ridge with which a fit to the other touches predicts every fifth touch best.

        ``explained`` becomes the share of the squared change of the images of every fifth touch that the
        response of this fit explains, median.
        """
        parts = [_Sums(len(self.poses)), _Sums(len(self.poses))]
        used = np.flatnonzero(self.used)
        is_held_out = np.arange(len(used)) % 5 == min(4, len(used) - 1)
        for touch, part in zip(used.tolist(), is_held_out.tolist(), strict=True):
            self._add(parts[part], touch, ())
        train, held_out = parts
        if not (train.weight and held_out.weight):
            return
        before = self.coefficients
        errors = []
        changes = []
        for ridge in RIDGES:
            cost = ridge * train.scale * self.penalty
            factor = scipy.linalg.cho_factor(train.normal + cost, lower=True, check_finite=False)
            right = train.products[:, 0] - cost @ before
            change = scipy.linalg.cho_solve(factor, right, check_finite=False)
            errors.append(
                np.sum(change * (held_out.full() @ change)) - 2 * np.sum(change * held_out.products[:, 0])
            )
            changes.append(change)
        best = int(np.argmin(errors))
        self.ridge = RIDGES[best]
        self.coefficients = before + changes[best]
        self.explained = float(np.median([self.explained_share(touch) for touch in used[is_held_out]]))
        self.coefficients = before

    def explained_share(self, touch: int) -> float:
        """Return the share of the squared change of an image that the fit explains."""
        self.residual(touch)
        return float(1 - (self.rms[touch] / self.change(touch)) ** 2)


class _Sums:
    """Sums of a step over touches: normal equations of the coefficients, and of the geometry and poses."""

    def __init__(self, count: int) -> None:
        many = _SHARED + _OWN * count
        self.normal = np.zeros((gel_kernels.COEFFICIENTS, gel_kernels.COEFFICIENTS))
        self.products = np.zeros((gel_kernels.COEFFICIENTS, 1 + many, 3))
        self.moves = np.zeros((many, many))
        self.slope = np.zeros(many)
        self.weight = 0.0

    @property
    def scale(self) -> float:
        """Weighted number of pixels for each entry of the tables."""
        return self.weight / gel_kernels.ENTRIES

    def full(self) -> Float64:
        """Return the normal matrix of the coefficients with both of its triangles."""
        return np.asarray(self.normal + np.tril(self.normal, -1).T)

    def add(
        self,
        features: gel.Features,
        terms: Float32,
        weights: Float32,
        columns: Float32,
        unknowns: list[int],
        blur_px: Float64,
    ) -> None:
        """Add a touch: ``columns`` (H, W, 1 + m, 3) are the residuals and derivatives by ``unknowns``."""
        height, width, many, _ = columns.shape
        gel_kernels.add_normal(self.normal, *features, terms, weights)
        products = np.zeros((gel_kernels.COEFFICIENTS, many * 3))
        # The blur of the camera is its own transpose.
        weighed = columns.reshape(height, width, -1) * weights[..., None]
        gel.blur_colours(weighed, blur_px)
        gel_kernels.add_products(products, *features, terms, weighed)
        at = np.array([0, *(1 + unknown for unknown in unknowns)])
        self.products[:, at] += products.reshape(gel_kernels.COEFFICIENTS, many, 3)
        self.weight += float(weights.sum())
        if unknowns:
            flat = columns.reshape(-1, many, 3).transpose(1, 0, 2).reshape(many, -1)
            square = (flat * np.repeat(weights.ravel(), 3)) @ flat.T
            self.moves[np.ix_(unknowns, unknowns)] += square[1:, 1:]
            self.slope[unknowns] += square[1:, 0]

    def brightness(self, fit: Fit) -> Float64:
        """Return how bright each lamp is in each colour, (LAMPS, 3), that is not negative and fits best."""
        normal = self.full()
        wanted = self.products[:, 0] + normal @ fit.coefficients
        normal += fit.ridge * self.scale * fit.penalty
        slopes, lamps = slice(-gel_kernels.LAMPS), slice(-gel_kernels.LAMPS, None)
        # What slopes explain is eliminated.
        across = scipy.linalg.solve(normal[slopes, slopes], normal[slopes, lamps], assume_a="pos").T
        upper = scipy.linalg.cholesky(normal[lamps, lamps] - across @ normal[slopes, lamps])
        right = scipy.linalg.solve_triangular(upper, wanted[lamps] - across @ wanted[slopes], trans=1)
        return np.column_stack([scipy.optimize.nnls(upper, right[:, colour])[0] for colour in range(3)])

    def solve(self, fit: Fit, moving: tuple[Fitted, ...]) -> Float64:
        """Update the response of a fit, and return the moves of its geometry and poses."""
        penalty = fit.ridge * self.scale * fit.penalty
        factor = scipy.linalg.cho_factor(self.normal + penalty, lower=True, check_finite=False)
        right = self.products
        right[:, 0] -= penalty @ fit.coefficients
        solved = scipy.linalg.cho_solve(
            factor, right.reshape(gel_kernels.COEFFICIENTS, -1), check_finite=False
        ).reshape(right.shape)
        moved = np.zeros(len(self.slope))
        if moving:
            flat = right[:, 1:].transpose(1, 0, 2).reshape(len(moved), -1)
            answer = solved.transpose(1, 0, 2).reshape(1 + len(moved), -1)
            matrix = self.moves - flat @ answer[1:].T
            slope = self.slope - flat @ answer[0]
            moved = self._moved(fit, matrix, slope, moving)
        # Images are not linear in the geometry: no part of it moves by more than its expected spread.
        moved /= max(float(np.abs(moved[:_SHARED] / _SHAPE_SPREAD).max()), 1.0)
        change = solved[:, 0] - np.einsum("cmk,m->ck", solved[:, 1:], moved)
        fit.coefficients = fit.coefficients + change
        return moved

    def _moved(self, fit: Fit, matrix: Float64, slope: Float64, moving: tuple[Fitted, ...]) -> Float64:
        # Residuals are correlated over patches: slopes beyond the table, shadows, blocks of JPEG.
        variance = ALIKE_PX * fit.noise**2
        own = [_SHARED + _OWN * int(touch) + own for touch in np.flatnonzero(fit.used) for own in range(_OWN)]
        for touch in np.flatnonzero(fit.used):
            at = slice(_SHARED + _OWN * int(touch), _SHARED + _OWN * int(touch) + _OWN)
            fit.information[touch] = matrix[at, at] / variance
        expected = np.concatenate([_SHAPE_SPREAD, fit.spread.ravel()])
        deviation = np.concatenate([fit.shape - fit.shape_guess, (fit.poses - fit.pose_guess).ravel()])
        matrix = matrix + np.diag(variance / expected**2)
        slope = slope - variance / expected**2 * deviation
        active = np.array([*map(int, moving), *own])
        moved = np.zeros(len(slope))
        moved[active] = np.linalg.solve(matrix[np.ix_(active, active)], slope[active])
        return moved


def _robust_square(residuals: Float32, weights: Float32) -> float:
    # Of Geman and McClure, whose weights are the squares of these.
    return float(np.sum(np.sqrt(weights)[..., None] * residuals * residuals, dtype=np.float64))
