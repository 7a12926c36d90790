"""Photographs of handwriting that tests compose, with their true ink.

A page has paper, lines and ink; light falls on it; it lies on a desk or under the lid of a scanner; a camera
blurs it, adds noise and packs it as JPEG. All of it is drawn from one seed.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy import ndimage
from skimage.morphology import skeletonize

from mnist3d.digit_options import SolidSpec
from mnist3d.ink.binarisation import clean
from mnist3d.sources.synthetic import SyntheticSource

Floats = NDArray[np.float64]

SIDE_PX = 700
THIN_PX = 12
EASY = ("hand", "corner", "gradient", "desk", "border", "ruled", "pen")
HARD = ("perspective", "squared", "thin")
REFUSED = ("several", "blank", "blank ruled", "blank desk")

_INKS = {
    "black": (0.08, 0.08, 0.1),
    "blue": (0.1, 0.16, 0.55),
    "red": (0.7, 0.1, 0.12),
    "pencil": (0.38, 0.38, 0.4),
}
_DESKS = (
    (0.22, 0.14, 0.08),
    (0.42, 0.28, 0.17),
    (0.1, 0.1, 0.11),
    (0.3, 0.32, 0.34),
    (0.13, 0.2, 0.28),
    (0.55, 0.42, 0.28),
)


@dataclass(frozen=True)
class Photograph:
    """A picture, uint8 (H, W, 3), and which of its pixels are ink; None where it must be refused."""

    pixels: NDArray[np.uint8]
    ink: NDArray[np.bool_] | None
    pen_px: float = 40.0


def strokes_of(strokes: Sequence[Sequence[Sequence[float]]], pen_px: float, height_px: float) -> Floats:
    """Draw strokes (y up, height 1) with a round pen; return the coverage of pixels, cropped to the ink."""
    fine = 3
    paths = [np.array(stroke) * (height_px - pen_px) for stroke in strokes]
    every = np.concatenate(paths)
    low, high = every.min(axis=0), every.max(axis=0)
    width, height = (high - low + pen_px + 4) * fine
    sheet = Image.new("L", (int(width), int(height)))
    draw, half = ImageDraw.Draw(sheet), pen_px * fine / 2
    for path in paths:
        at = np.stack([path[:, 0] - low[0], high[1] - path[:, 1]], axis=1) * fine + half + 2 * fine
        draw.line([tuple(point) for point in at.tolist()], fill=255, width=round(2 * half))
        for x, y in at.tolist():
            draw.ellipse((x - half, y - half, x + half, y + half), fill=255)
    small = sheet.resize((int(width) // fine, int(height) // fine), Image.Resampling.BOX)
    return np.asarray(small, np.float64) / 255


def _smooth(rng: np.random.Generator, shape: tuple[int, int], grain_px: float) -> Floats:
    """Return smooth noise with mean 0 and deviation 1."""
    coarse = rng.standard_normal([int(side / grain_px) + 4 for side in shape])
    noise = ndimage.zoom(coarse, grain_px, order=3)[: shape[0], : shape[1]]
    noise = np.pad(noise, [(0, max(0, s - n)) for s, n in zip(shape, noise.shape, strict=True)], mode="edge")
    return np.asarray((noise - noise.mean()) / (noise.std() + 1e-9))


def _grid() -> tuple[Floats, Floats]:
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] / SIDE_PX
    return y, x


def _light(kind: str, rng: np.random.Generator) -> Floats:
    """Return the light at each pixel."""
    y, x = _grid()
    turn = rng.uniform(0, 2 * np.pi)
    along = (x - 0.5) * np.cos(turn) + (y - 0.5) * np.sin(turn)
    light = 1 - rng.uniform(0.02, 0.12) * (along + 0.5)
    if kind == "gradient":
        light = light * (1 - rng.uniform(0.35, 0.65) * np.clip(along + 0.5, 0, 1))
    elif kind == "corner":
        corner = np.hypot(x - rng.integers(2), y - rng.integers(2)) / rng.uniform(0.5, 0.95)
        light = light * (1 - rng.uniform(0.4, 0.7) * np.clip(1 - corner, 0, 1) ** rng.uniform(0.7, 1.6))
    elif kind == "hand":
        rim = rng.uniform(-0.15, 0.35) + 0.05 * _smooth(rng, (SIDE_PX, SIDE_PX), 150)
        fade = rng.uniform(0.006, 0.08)
        light = light * (1 - rng.uniform(0.3, 0.6) / (1 + np.exp(np.clip((rim - along) / fade, -50, 50))))
    return np.asarray(light)


def _paper(rng: np.random.Generator) -> Floats:
    paper = rng.uniform(0.8, 0.95) * np.array([1, rng.uniform(0.96, 1), rng.uniform(0.88, 1)])
    grain = 1 + 0.008 * _smooth(rng, (SIDE_PX, SIDE_PX), 2.0)
    return np.asarray(grain[..., None] * paper)


def _lines(kind: str, pen_px: float, rng: np.random.Generator) -> Floats:
    """Return the coverage by printed lines."""
    cover = np.zeros((SIDE_PX, SIDE_PX))
    gap, wide = rng.uniform(30, 90), rng.uniform(1.2, max(1.4, min(4.0, 0.3 * pen_px)))
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float64)
    turn = np.deg2rad(rng.uniform(-4, 4))
    down, across = y * np.cos(turn) - x * np.sin(turn), x * np.cos(turn) + y * np.sin(turn)
    axes = (down, across) if kind == "squared" else (down,)
    for axis in axes:
        off = np.abs((axis + rng.uniform(0, gap)) % gap - gap / 2)
        cover = np.maximum(cover, np.clip(wide / 2 + 0.5 - off, 0, 1))
    if kind == "ruled" and rng.random() < 0.4:
        cover = np.maximum(cover, np.clip(1.5 - np.abs(across - rng.uniform(40, 120)), 0, 1))
    return cover


def _desk(rng: np.random.Generator) -> Floats:
    tone = np.array(_DESKS[rng.integers(len(_DESKS))]) * rng.uniform(0.7, 1.15)
    wood = ndimage.gaussian_filter1d(
        rng.standard_normal((SIDE_PX, SIDE_PX)), rng.uniform(20, 60), axis=rng.integers(2)
    )
    wood = wood / wood.std() * rng.uniform(0.01, 0.12) + 0.04 * _smooth(rng, (SIDE_PX, SIDE_PX), 90)
    return np.asarray(np.clip((1 + wood)[..., None] * tone, 0.01, 1))


def _quad(kind: str, rng: np.random.Generator) -> Floats:
    """Return the corners of the sheet, (x, y) in pixels, clockwise from the upper left."""
    reach = rng.uniform(0.32, 0.47)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * reach * np.array([rng.uniform(0.8, 1), 1])
    if kind == "perspective":
        corners = corners * (1 + rng.uniform(-0.16, 0.1, (4, 1)))
    turn = np.deg2rad(rng.uniform(-12, 12))
    spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.asarray((corners @ spin + 0.5 + rng.uniform(-0.03, 0.03, 2)) * SIDE_PX)


def _onto(quad: Floats) -> Floats:
    """Return the projection from pixels of the photograph to those of the sheet."""
    flat = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * SIDE_PX
    rows = []
    for (x, y), (u, v) in zip(quad, flat, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, u], [0, 0, 0, x, y, 1, -v * x, -v * y, v]]
    table = np.array(rows)
    return np.append(np.linalg.solve(table[:, :8], table[:, 8]), 1).reshape(3, 3)


def _seen(sheet: Floats, projection: Floats) -> Floats:
    """Return a layer of the sheet as the camera sees it; NaN beside it."""
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float64)
    u, v, w = np.tensordot(projection, np.stack([x, y, np.ones_like(x)]), axes=1)
    return np.asarray(ndimage.map_coordinates(sheet, [v / w, u / w], order=1, cval=np.nan))


def _camera(scene: Floats, rng: np.random.Generator) -> NDArray[np.uint8]:
    blur = rng.uniform(0.4, 1.1)
    scene = ndimage.gaussian_filter(scene, (blur, blur, 0))
    scene = scene * rng.uniform(0.85, 1.05) * np.array([1, rng.uniform(0.95, 1.02), rng.uniform(0.85, 1.05)])
    scene = scene + rng.normal(0, rng.uniform(0.004, 0.02), scene.shape)
    levels = np.rint(255 * np.clip(scene, 0, 1) ** (1 / rng.uniform(1, 1.6))).astype(np.uint8)
    packed = io.BytesIO()
    Image.fromarray(levels).save(packed, "JPEG", quality=int(rng.integers(60, 95)))
    return np.asarray(Image.open(packed).convert("RGB"))


def _placed(cover: Floats, at: tuple[float, float]) -> Floats:
    sheet = np.zeros((SIDE_PX, SIDE_PX))
    top = int(np.clip(at[0] * SIDE_PX - cover.shape[0] / 2, 20, SIDE_PX - 20 - cover.shape[0]))
    left = int(np.clip(at[1] * SIDE_PX - cover.shape[1] / 2, 20, SIDE_PX - 20 - cover.shape[1]))
    sheet[top : top + cover.shape[0], left : left + cover.shape[1]] = cover
    return sheet


def _border(rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the pixels beside the paper, which the lid of a scanner shows dark."""
    wide = rng.integers(3, 40, 4) * (rng.random(4) < 0.8)
    wide[rng.integers(4)] = rng.integers(6, 40)
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float64)
    lean = rng.uniform(-0.02, 0.02, 4)
    rows = (y + lean[0] * x < wide[0]) | (SIDE_PX - 1 - y + lean[1] * x < wide[1])
    return np.asarray(rows | (x + lean[2] * y < wide[2]) | (SIDE_PX - 1 - x + lean[3] * y < wide[3]))


def compose(covers: Sequence[Floats], kind: str, seed: int, pen_px: float = 40.0) -> Photograph:
    """Compose a photograph of a kind from the cropped ink of one digit, several or none."""
    rng = np.random.default_rng([seed, (*EASY, *HARD, *REFUSED).index(kind)])
    if len(covers) > 1:
        places: list[tuple[float, float]] = [
            (rng.uniform(0.4, 0.6), (number + 0.5) / len(covers)) for number in range(len(covers))
        ]
    else:
        places = [(rng.uniform(0.42, 0.58), rng.uniform(0.42, 0.58))]
    ink = np.zeros((SIDE_PX, SIDE_PX))
    for cover, place in zip(covers, places, strict=False):
        ink = np.maximum(ink, _placed(cover, place))
    ruling = {"ruled": "ruled", "squared": "squared", "blank ruled": "ruled"}.get(kind, "")
    if kind == "thin" and rng.random() < 0.3:
        ruling = "ruled"
    colours = {"pen": ("blue", "red"), **dict.fromkeys(("ruled", "thin"), ("black", "blue", "pencil"))}
    names = colours.get(kind, ("black", "black", "blue"))
    tone = np.array(_INKS[names[rng.integers(len(names))]])
    layers = _paper(rng)
    if ruling:
        grey = rng.uniform(0.35, 0.8) if rng.random() < 0.8 else 0.15
        colour = np.array([grey * 0.9, grey, min(1, grey * 1.15)])
        cover = _lines(ruling, pen_px, rng)[..., None]
        layers = layers * (1 - cover) + layers * colour * cover
    flow = np.clip(1 - 0.06 * np.abs(_smooth(rng, (SIDE_PX, SIDE_PX), 3.0)), 0, 1)
    layers = layers * (1 - ink * flow)[..., None] + tone * (ink * flow)[..., None]
    is_placed = kind in ("desk", "perspective", "blank desk") or (
        kind in ("thin", "several", "squared") and rng.random() < 0.3
    )
    if is_placed:
        projection = _onto(_quad(kind, rng))
        scene = np.stack([_seen(each, projection) for each in np.moveaxis(layers, -1, 0)], axis=-1)
        ink = _seen(ink, projection)
        desk = _desk(rng)
        beside = np.isnan(scene)
        shade = 1 - 0.35 * ndimage.gaussian_filter((~beside[..., 0]).astype(np.float64), 5)
        layers = np.where(beside, desk * shade[..., None], scene)
        ink = np.nan_to_num(ink)
    if kind == "border":
        dark = _border(rng) & (ink < 0.01)
        layers = np.where(dark[..., None], rng.uniform(0.0, 0.12), layers)
    light = kind
    if kind not in ("hand", "corner", "gradient"):
        light = "even" if rng.random() < 0.5 else str(rng.choice(["gradient", "hand"]))
    if kind == "border":
        light = "even"
    pixels = _camera(layers * _light(light, rng)[..., None], rng)
    return Photograph(pixels, ink > 0.5 if len(covers) == 1 and kind not in REFUSED else None, pen_px)


def drawn(label: int, number: int, height_px: float, pen_px: float | None = None) -> Floats:
    """Return the coverage of the cropped ink of a synthetic digit, with its own or another pen width."""
    page = SyntheticSource().image(140 * number + 14 * label).pixels
    # Without the specks that the source draws next to ink.
    ink = clean(page < 128, SolidSpec())
    if pen_px is not None:
        scale = height_px / np.ptp(np.flatnonzero(ink.any(axis=1)))
        ink = ndimage.distance_transform_edt(~skeletonize(ink)) <= pen_px / 2 / scale
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    cut = _levels(ink[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
    scale = height_px / cut.height
    size = (max(1, round(cut.width * scale)), round(height_px))
    return np.asarray(cut.resize(size, Image.Resampling.BOX), np.float64) / 255


def _levels(mask: NDArray[np.bool_]) -> Image.Image:
    return Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0)))


def likeness(found: NDArray[np.bool_], ink: NDArray[np.bool_], pen_px: float) -> float:
    """Return intersection over union of two masks, cropped to their ink; of thin pens within one pixel."""
    cuts = []
    for mask in (found, ink):
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        cuts.append(mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
    height, width = cuts[1].shape
    scaled = _levels(cuts[0]).resize((width, height), Image.Resampling.BILINEAR)
    one, other = np.asarray(scaled) > 127, cuts[1]
    if pen_px >= THIN_PX:
        return float((one & other).sum() / (one | other).sum())
    near = [ndimage.binary_dilation(np.pad(mask, 1), np.ones((3, 3)))[1:-1, 1:-1] for mask in (one, other)]
    return float(((one & near[1]).sum() + (other & near[0]).sum()) / (one.sum() + other.sum()))


def seven(side: int = 240) -> NDArray[np.bool_]:
    """Return ink of a 7 in the middle of a page."""
    ink = np.zeros((240, 240), bool)
    ink[50:74, 60:190] = True
    rows, columns = np.mgrid[:240, :240]
    ink |= (np.abs((columns - 175) + 0.55 * (rows - 62)) < 14) & (rows > 62) & (rows < 195)
    return np.kron(ink, np.ones((side // 240, side // 240), bool))


def page(ink: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.where(ink, np.uint8(20), np.uint8(240))
