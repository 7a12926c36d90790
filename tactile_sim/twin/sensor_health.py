"""Check whether a sensor has changed since its calibration: its twin is compared with recent touches.

The touched objects need not be known: the twin reads depth from each image and renders an image of that
depth, and both images are compared. The twin cannot reproduce the images of a gel that has changed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass
from os import PathLike, fspath

import numpy as np
from scipy import ndimage

from tactile_sim.kind import KIND
from tactile_sim.optics.rendering import in_size_of
from tactile_sim.press.sensors import SensorModel
from tactile_sim.twin.sources import image_paths, read_image, spaced
from tactile_sim.user_values import shown
from tactile_toolkit import places, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Bool, Float32, Float64, JsonDict, UInt8
from tactile_toolkit.wording import with_count

MIN_IMAGES = 5
MAX_IMAGES = 64
"""Greatest number of images that are compared; of more images, evenly spaced ones are used."""

# Name, greatest value of a healthy sensor, and meaning of each figure. In the tests, twelve images with noise
# of 3 levels stay below half of each limit.
_FIGURES = (
    (
        "background drift",
        2.0,
        "levels by which the image without contact differs; above: light, exposure or gel changed",
    ),
    ("colour gain", 0.03, "greatest relative change of a colour; above: exposure or white balance changed"),
    (
        "residual",
        1.5,
        "difference of the touches from their twin, relative to that of the calibration; above: the gel "
        "is worn, or another one",
    ),
    (
        "markers",
        0.01,
        "share of the image in small dark dots that the twin does not have; above: another gel, or dirt",
    ),
    ("saturation", 0.01, "share of levels at the end of their range; above: the exposure is too long"),
)
_MARKER_PX, _MARKER_LEVELS = 7.0, 12.0  # a marker is smaller than this, and darker
_SMOOTH_PX = 2.0
_NO_CONTACT_M = 2e-5
# Colours that are compared with those of the calibration, and their names in its report: brightness, and the
# differences of colours, which compression keeps least. Their finest detail, the noise of the camera, differs
# by at most 4 % between recordings of one sensor, and is halved at least by JPEG, H.264 or scaling.
_DETAIL = {
    "brightness_detail_levels": np.array([[0.25, 0.5, 0.25]]),
    "colour_detail_levels": np.array([[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]]),
}
_MIN_DETAIL, _MAX_DETAIL = 0.6, 1.7  # relative to the calibration
_LEAST_LEVELS = 0.2  # rounding to levels gives more
_MIN_KNOWN = 0.2  # share of the gel that must be seen without contact
_SATURATED_LEVEL = 254
_BATCH = 4


@dataclass(frozen=True, slots=True)
class HealthFigure:
    """One figure: its name, value, greatest value of a healthy sensor, and what it says."""

    name: str
    value: float
    limit: float
    meaning: str

    @property
    def ok(self) -> bool:
        """Whether it is within its limit."""
        return self.value <= self.limit


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """The figures of a check.

    Attributes
    ----------
    images : int
        Number of images that were compared.
    figures : tuple of HealthFigure
        Each with its limit.
    recording : str
        How size or compression of the images differ from those of the calibration; empty if they do not.
    """

    images: int
    figures: tuple[HealthFigure, ...]
    recording: str = ""

    @property
    def ok(self) -> bool:
        """Whether all figures are within their limits."""
        return all(figure.ok for figure in self.figures)

    @property
    def cause(self) -> str:
        """What is likely to have moved figures beyond their limits; empty if all are within."""
        beyond = [figure.name for figure in self.figures if not figure.ok]
        are_slight = all(figure.value < 2 * figure.limit for figure in self.figures)
        if beyond and {*beyond} <= {"residual", "background drift"} and are_slight and self.recording:
            return (
                f"more likely the recording than the sensor: {self.recording}; record as for the calibration"
            )
        return "the sensor has changed: calibrate it again" if beyond else ""

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        figures = [{**asdict(figure), "ok": figure.ok} for figure in self.figures]
        return {
            "ok": self.ok,
            "images": self.images,
            "figures": figures,
            "recording": self.recording,
            "cause": self.cause,
        }


def check_sensor(model: SensorModel, images: Iterable[UInt8]) -> SensorHealth:
    """Compare the twin of a sensor with recent images of it.

    Parameters
    ----------
    model : SensorModel
        A sensor that :func:`tactile_sim.calibrate` made.
    images : iterable of ndarray, uint8, shape (H, W, 3)
        Touches of anything, at different places of the gel; images without contact may be among them.

    Returns
    -------
    SensorHealth
        Drift of the background, gain of the colours, residual, markers, saturation.

    Raises
    ------
    InputError
        The sensor has no twin, there are fewer than five images, or their proportions are not those of the
        sensor.
    """
    if not isinstance(images, Iterable) or getattr(images, "ndim", 1) == 0:
        raise InputError(f"images are {shown(images)}; expected images, uint8, (H, W, 3)")
    size_px = (model.width_px, model.height_px)
    arrays = [np.asarray(image) for image in images]
    scaled = [in_size_of(size_px, image[None])[0] for image in arrays]
    if len(scaled) < MIN_IMAGES:
        raise InputError(
            f"{with_count(len(scaled), 'images')} to compare with the sensor; expected at least {MIN_IMAGES}",
            next="record more touches, at different places of the gel",
        )
    stack = np.stack(scaled)
    depth_m = _depth_of(model, stack)
    plain = model.render_read(np.zeros_like(depth_m[:1]))[0].astype(np.float64)
    today, known = _background(stack, depth_m)
    difference = np.where(known[..., None], today - plain, 0.0)
    drift = _smoothed(difference, _SMOOTH_PX)[known]
    gains = (today[known] * plain[known]).sum(axis=0) / (plain[known] ** 2).sum(axis=0)
    # Residual of the touches of the calibration itself, levels.
    expected = max(model.report["residual_levels"], model.report["noise_levels"])
    values = (
        np.sqrt((drift**2).mean()),
        np.abs(gains - 1).max(),
        np.median(_residuals(model, stack, depth_m)) / expected,
        _marker_share(difference, known),
        (stack >= _SATURATED_LEVEL).mean(),
    )
    figures = (
        HealthFigure(name, float(value), limit, meaning)
        for value, (name, limit, meaning) in zip(values, _FIGURES, strict=True)
    )
    return SensorHealth(len(stack), tuple(figures), _recording(model, arrays))


def detail_levels(images: Collection[UInt8] | UInt8) -> dict[str, float]:
    """Return the finest detail of images (H, W, 3), levels, by its name in the report of a calibration."""
    levels = {}
    for name, colours in _DETAIL.items():
        maps = (image @ colours.T for image in images)
        bends = (2 * mixed[:, 1:-1] - mixed[:, :-2] - mixed[:, 2:] for mixed in maps)
        # Of noise that is independent at each pixel, this is its standard deviation.
        levels[name] = float(np.median([np.sqrt((bend * bend).mean() / 6) for bend in bends]))
    return levels


def _recording(model: SensorModel, images: Collection[UInt8]) -> str:
    """Return how size or compression of images differ from those of the calibration; empty if they do not."""
    sizes = {image.shape[1::-1] for image in images} - {(model.width_px, model.height_px)}
    if sizes:
        (width, height), *_ = sorted(sizes)
        return (
            f"images have {width} x {height} pixels, those of the calibration {model.width_px} x "
            f"{model.height_px}"
        )
    today = detail_levels(images)
    shares = {
        name: max(level, _LEAST_LEVELS) / max(model.report[name], _LEAST_LEVELS)
        for name, level in today.items()
        if name in model.report  # calibrations by earlier versions have none
    }
    if len(shares) < len(_DETAIL):
        return ""
    brightness, colour = shares.values()
    if min(brightness, colour) >= _MIN_DETAIL and colour <= _MAX_DETAIL:
        return ""
    return (
        f"the finest detail of images is {brightness:.2f} times that of the calibration in brightness and "
        f"{colour:.2f} times in colour: they were compressed otherwise"
    )


def images_of(source: str | PathLike[str], most: int = MAX_IMAGES) -> list[UInt8]:
    """Return images of a data set of touches, or of a folder of image files, evenly spaced.

    Clips give the frame at the end of the contact. InputError for a place that holds neither.
    """
    root = store.expanded(fspath(source))
    files = image_paths(root)
    if files:
        return [read_image(files[number]) for number in spaced(len(files), most)]
    dataset = places.open_place(source)
    touches = [KIND.load(dataset, split).touches() for split in dataset.splits]
    numbered = [(split, number) for split in touches for number in range(len(split))]
    chosen = [numbered[index] for index in spaced(len(numbered), most)]
    return [split[number].image for split, number in chosen]


def _depth_of(model: SensorModel, images: UInt8) -> Float32:
    parts = [images[start : start + _BATCH] for start in range(0, len(images), _BATCH)]
    return np.concatenate([model.read_depth_m(part) for part in parts])


def _residuals(model: SensorModel, images: UInt8, depth_m: Float32) -> Float64:
    """Return the difference of each image from its twin: root mean square, levels, shape (n,)."""
    deviations = []
    for start in range(0, len(images), _BATCH):
        part = slice(start, start + _BATCH)
        residuals = images[part].astype(np.float64) - model.render_read(depth_m[part])
        deviations.append(np.sqrt((residuals**2).mean(axis=(1, 2, 3))))
    return np.concatenate(deviations)


def _background(images: UInt8, depth_m: Float32) -> tuple[Float64, Bool]:
    """Return the image without contact, (H, W, 3), and a mask of where enough images show it, (H, W)."""
    free = depth_m < _NO_CONTACT_M
    # The gel is also pulled down around a contact: pixels within at least half a millimetre are left out.
    reach = max(images.shape[2] // 40, 1)
    free = ~_dilated(~free, reach)
    known = free.sum(axis=0) >= 2
    if known.mean() < _MIN_KNOWN:
        # In different light, the depth shows contact everywhere: the median of all images is compared.
        return np.asarray(np.median(images, axis=0), np.float64), np.ones_like(known)
    shown = np.where(free[:, known, None], images[:, known], np.float32(np.nan))
    today = np.zeros(images.shape[1:])
    today[known] = np.nanmedian(shown, axis=0)
    return today, known


def _dilated(mask: Bool, reach: int) -> Bool:
    dilated: Bool = ndimage.maximum_filter(mask, (0, 2 * reach + 1, 2 * reach + 1))
    return dilated


def _smoothed(image: Float64, sigma_px: float) -> Float64:
    smooth: Float64 = ndimage.gaussian_filter(image, (sigma_px, sigma_px, 0))
    return smooth


def _marker_share(difference: Float64, known: Bool) -> float:
    """Return the share of the known pixels that are darker than their surroundings, unlike in the twin."""
    grey = difference.mean(axis=2, keepdims=True)
    fine = _smoothed(grey, _SMOOTH_PX / 2) - _smoothed(grey, _MARKER_PX)
    return float((fine[..., 0] < -_MARKER_LEVELS)[known].mean())
