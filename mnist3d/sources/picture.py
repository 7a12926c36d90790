"""One picture file as dark ink on white paper, whatever its mode, depth and polarity."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mnist3d.sources.canvas import as_grey
from tactile_toolkit.errors import ItemError

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["read_picture"]

_CONTRAST = 24
_CLEAR_SHARE = 0.75


def read_picture(path: Path, ink: str = "auto") -> NDArray[np.uint8]:
    """Read a picture of a digit in its own size.

    Colours become grey, transparency shows paper, the orientation in EXIF is followed, and of an animation
    the first frame counts. Grey levels are then stretched so that paper is white and ink black; a picture of
    black on white comes back unchanged, and one without contrast (an empty page) is not stretched.

    Parameters
    ----------
    path : Path
        Anything Pillow reads.
    ink : str
        ``"dark"`` or ``"light"``, or ``"auto"``: the margin of the picture is paper, so the ink is whatever
        the margin is not, on either side of Otsu's threshold.

    Returns
    -------
    ndarray of uint8, shape (H, W)
        Ink 0, paper 255.

    Raises
    ------
    ItemError
        ``"unreadable"``; ``"unclear-ink"`` when less than three quarters of the margin are on one side of
        the threshold; ``"not-finite"`` or ``"bad-pixels"`` for floating-point pictures.
    """
    grey = _brightness(_decoded(path), ink, path)
    threshold = _otsu(grey)
    if ink == "light" or (ink == "auto" and _paper_is_dark(grey, threshold, path)):
        grey, threshold = 255 - grey, 254 - threshold
    return _stretched(grey, threshold)


def _decoded(path: Path) -> Image:
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as picture:
                upright = ImageOps.exif_transpose(picture)
        return upright if _is_deep(upright) else upright.convert(_simple_mode(upright))
    # Decoders of broken files raise whatever comes: OSError, SyntaxError, ValueError, struct.error, ...
    except Exception as error:
        reason = "unreadable"
        message = (
            f"{path}: cannot be read as a picture ({type(error).__name__}: {error}), expected a whole image "
            "file; next: replace or remove it"
        )
        raise ItemError(reason, message) from error


def _is_deep(picture: Image) -> bool:
    return picture.mode in ("F", "I") or picture.mode.startswith("I;16")


def _simple_mode(picture: Image) -> str:
    if picture.has_transparency_data:
        return "RGBA"
    return "L" if picture.mode in ("1", "L") else "RGB"


def _brightness(picture: Image, ink: str, path: Path) -> NDArray[np.uint8]:
    if picture.mode == "RGBA":
        return _over_paper(picture, ink)
    if picture.mode in ("L", "RGB"):
        return np.asarray(picture.convert("L"))
    values = np.asarray(picture)
    white = _full_scale(picture.mode, float(np.fmax.reduce(values, axis=None, initial=0)))
    return as_grey(values, white, str(path))


def _full_scale(mode: str, largest: float) -> float:
    """White of a picture of more than 8 bits: 16-bit files use their whole range, floats end at 1 or 255."""
    if mode == "F":
        return 1.0 if largest <= 1 else 255.0
    return 65535.0 if mode != "I" or largest > 255 else 255.0


def _over_paper(picture: Image, ink: str) -> NDArray[np.uint8]:
    """Lay a transparent picture on white paper, or on black if light ink is all there is on it."""
    alpha = np.asarray(picture.getchannel("A"), np.float32) / 255
    light = np.asarray(picture.convert("RGB").convert("L"), np.float32)
    cut_out = ink == "auto" and _margin(alpha).mean() < 0.5
    bright_ink = cut_out and (light * alpha).sum() > 127.5 * alpha.sum()
    paper = 0 if ink == "light" or bright_ink else 255
    return np.rint(light * alpha + paper * (1 - alpha)).astype(np.uint8)


def _otsu(grey: NDArray[np.uint8]) -> int:
    from skimage.filters import threshold_otsu

    if np.ptp(grey) < _CONTRAST:
        return 127
    counts = np.bincount(grey.ravel(), minlength=256)
    return int(threshold_otsu(hist=(counts, np.arange(256))))  # type: ignore[no-untyped-call]


def _paper_is_dark(grey: NDArray[np.uint8], threshold: int, path: Path) -> bool:
    if np.ptp(grey) < _CONTRAST:
        return False
    light = float((_margin(grey) > threshold).mean())
    if 1 - _CLEAR_SHARE < light < _CLEAR_SHARE:
        reason = "unclear-ink"
        message = (
            f"{path}: the ink cannot be told from the paper, found {light:.0%} of the margin light and the "
            "rest dark, expected nearly all of it to be paper; next: say --ink dark or --ink light, or crop "
            "the image"
        )
        raise ItemError(reason, message)
    return light <= 1 - _CLEAR_SHARE


def _margin(values: NDArray[Any]) -> NDArray[Any]:
    """Pixels of a frame along the edge, a fiftieth of the shorter side wide."""
    wide = max(1, min(values.shape) // 50)
    inside = np.zeros(values.shape, bool)
    inside[wide:-wide, wide:-wide] = True
    return values[~inside]


def _stretched(grey: NDArray[np.uint8], threshold: int) -> NDArray[np.uint8]:
    """Map typical paper to white and the darker ink to black, and the levels between them evenly."""
    dark = grey <= threshold
    if np.ptp(grey) < _CONTRAST or dark.all() or not dark.any():
        return grey
    # Ink of thin strokes is mostly edge, so its median would be too light; single dark pixels are specks.
    ink, paper = float(np.percentile(grey[dark], 10)), float(np.median(grey[~dark]))
    table = np.clip((np.arange(256) - ink) * (255 / (paper - ink)), 0, 255)
    levels: NDArray[np.uint8] = np.rint(table).astype(np.uint8)[grey]
    return levels
