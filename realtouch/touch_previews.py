"""Pictures of a round: touches as a grid, or at their positions in the cell; pressure and moving markers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from realtouch import contact, touch_options
from realtouch.kind import KIND
from realtouch.touches import loading, media, rounds
from realtouch.touches.rounds import Touch
from tactile_toolkit import arithmetic, errors, pictures, places, wording
from tactile_toolkit.touch import CELL_M, resized
from tactile_toolkit.value_types import AnyArray, Float32, Float64, UInt8

ARROWS = 5
"""Length of arrows relative to the motion of markers, which is a few pixels at most."""

_MIN_PX = 160
_BRIGHTEST = 98
_PAPER = (250, 250, 248)
_INK = (30, 60, 110)
# From no pressure to the greatest of the picture.
_COLOURS = np.array(
    [(14, 12, 44), (110, 26, 110), (222, 73, 62), (252, 165, 40), (252, 250, 190)], np.float64
)
_HEAD = 0.35
_HALF_HEAD_RAD = 0.45  # of an arrow
CONTACT = touch_options.BLUE
"""Colour of the frame around touches with contact."""

_COLUMNS = 8
_TILE_PX = 160
_PX_PER_MM = 7.0
SENSING_AREA_M = (0.01888, 0.01416)
"""Width and height of what the sensor sees, metres (package tactile-mnist 0.13.0, GelSight Mini)."""

_AFFINE = Image.Transform.AFFINE
# Share of a side over which a picture fades, so that overlapping touches show no edges.
_FEATHER = 0.06
# Touches of bare plate count a little, so that areas with no other touch show something.
_PLAIN_WEIGHT = 0.02
_MAX_THREADS = 4


def force_views(touch: Touch) -> list[UInt8]:
    """Return the picture of a touch, and pictures of its pressure and its moving markers, if it has them.

    They have one size. Maps of another size than the image, as after `realtouch resize`, are left out.
    """
    image = touch.image
    extra = touch.extra
    height, width = image.shape[:2]
    views = []
    if "pressure_kpa" in extra and np.size(extra["pressure_kpa"]) == height * width:
        views.append(pressure_picture(np.reshape(extra["pressure_kpa"], (height, width))))
    if {"marker_positions_px", "marker_flow_px"} <= set(extra):
        positions, flow = (np.reshape(extra[f"marker_{name}_px"], (-1, 2)) for name in ("positions", "flow"))
        views.append(flow_picture(positions - flow, flow, (width, height)))
    if not views:
        return [image]
    scale = max(1, -(-_MIN_PX // width))
    shape = (width * scale, height * scale)
    return [resized(view, *shape) for view in (image, *views)]


def pressure_picture(pressure: AnyArray) -> UInt8:
    """Return a map of pressure (H, W), of any unit, as colours (H, W, 3).

    The brightest colour begins at the 98th percentile of the contact, as single pixels at edges have far more
    pressure.
    """
    known = np.nan_to_num(np.asarray(pressure, np.float64))
    most = 1.0
    if (known > 0).any():
        most = float(np.percentile(known[known > 0], _BRIGHTEST))
    positions = np.clip(known / most, 0, 1) * (len(_COLOURS) - 1)
    first = np.minimum(positions.astype(np.int64), len(_COLOURS) - 2)
    part = (positions - first)[..., None]
    mixed = _COLOURS[first] * (1 - part) + _COLOURS[first + 1] * part
    return np.asarray(np.rint(mixed), np.uint8)


def flow_picture(rest_px: AnyArray, flow_px: AnyArray, size_px: tuple[int, int]) -> UInt8:
    """Return arrows from markers at rest (n, 2), :data:`ARROWS` times as long as their motion (n, 2), pixels.

    The picture (H, W, 3) shows an image of ``size_px``, width and height, and has at least 160 columns.
    """
    scale = max(1, -(-_MIN_PX // size_px[0]))
    canvas = Image.new("RGB", (size_px[0] * scale, size_px[1] * scale), _PAPER)
    draw = ImageDraw.Draw(canvas)
    for (x, y), (dx, dy) in zip(rest_px.tolist(), flow_px.tolist(), strict=True):
        begin = np.array([(x + 0.5) * scale, (y + 0.5) * scale])
        arrow = np.array([dx, dy]) * scale * ARROWS
        if np.isfinite([*begin, *arrow]).all():
            _draw_arrow(draw, begin, arrow)
    return np.asarray(canvas)


def _draw_arrow(draw: ImageDraw.ImageDraw, begin: Float64, arrow: Float64) -> None:
    end = begin + arrow
    draw.ellipse([*(begin - 1), *(begin + 1)], fill=_INK)
    draw.line([*begin, *end], fill=_INK, width=1)
    cosine = np.cos(_HALF_HEAD_RAD)
    sine = np.sin(_HALF_HEAD_RAD)
    for side in (-sine, sine):
        turned = np.array([cosine * arrow[0] - side * arrow[1], side * arrow[0] + cosine * arrow[1]])
        draw.line([*end, *(end - _HEAD * turned)], fill=_INK, width=1)


def plan_previews(
    name: places.Name | places.Place, spec: touch_options.TouchPreviewSpec
) -> pictures.PicturePlan:
    """Plan the pictures of a data set that :func:`realtouch.load` opens; draws nothing.

    Kinds are grid and overlay. InputError: no such data set, split, round or kind, an empty split, or an
    overlay of a set without positions. IntegrityError and HubError as :func:`realtouch.load`.
    """
    data_set = places.open_place(name).require(KIND, "tactile preview").require_complete(spec.split)
    split = data_set.split(spec.split)
    dataset = loading.load(data_set, split)
    if not len(dataset):
        raise errors.InputError(
            f"split {split!r} of {data_set.name!r} holds no round", next="choose another split"
        )
    number = spec.round_number
    if not 0 <= number < len(dataset):
        raise errors.InputError(
            f"is {number}; split {split!r} has rounds 0 to {len(dataset) - 1}", field="round_number"
        )
    record = dataset[number]
    stem = "-".join(filter(None, (pictures.PictureTask.stem_of(data_set.name), split)))

    def tasks_of(kind: str, what: str, draw: Callable[[], UInt8]) -> list[pictures.PictureTask]:
        return [pictures.PictureTask(f"{stem}-round-{number}-{kind}.png", what, draw)]

    def on_map() -> list[pictures.PictureTask]:
        if not (record.row.has_poses or record.row.has("pos_in_cell")):
            raise record.row.missing_column("pos_in_cell")
        return tasks_of(
            "overlay", f"all touches of {record!r} at their positions", lambda: draw_overlay(record)
        )

    plans = {
        "grid": lambda: tasks_of("grid", f"touches of {record!r}", lambda: draw_grid(record, spec.touches)),
        "overlay": on_map,
    }
    return pictures.PicturePlan.of_kinds(spec.kinds, plans)


def draw_grid(record: rounds.TouchRound, most: int) -> UInt8:
    """Draw touches of a round, evenly spaced, with their numbers.

    Touches with contact are framed, if stored values state it. Pressure and moving markers are beside the
    picture of a touch that has them.
    """
    row = record.row
    contact_source = row.contact_source
    rule = None if contact_source.has_column else contact_source.heights
    is_contact = row.stated_contact() if contact_source.has_column else np.zeros(record.touch_count, bool)
    if rule is not None:
        z_m = row.contact_z_m()
        heights_m = contact.contact_heights_m(z_m, plate_z_m=row.plate_z_m(rule))
        is_contact = heights_m >= rule.min_height_m
    tiles = []
    most_views = 1
    for number in media.evenly_spaced(record.touch_count, most):
        caption = f"{number}"
        if rule is not None:
            caption = f"{number}: {heights_m[number] * 1e3:.1f} mm"
        frame = CONTACT if is_contact[number] else None
        views = force_views(Touch(record, number))
        most_views = max(most_views, len(views))
        pixels = np.hstack([pictures.fitted(view, _TILE_PX) for view in views])
        tiles.append(pictures.Tile(pixels, caption, frame))
    words = [f"{len(tiles)} of {_touches_in_words(record)}"]
    if rule is not None:
        words += [f"framed: {rule.height_text}; its height next to the number"]
    elif contact_source.has_column:
        words += [f"framed: {contact_source}"]
    return pictures.sheet(tiles, _COLUMNS // most_views, _title(record), ("; ".join(words),))


def draw_overlay(record: rounds.TouchRound) -> UInt8:
    """Draw all touches of a round at their positions on a map of the cell."""
    touches = placed_touches(record, range(record.touch_count))
    cell = cell_map(touches, _PX_PER_MM)
    tile = pictures.Tile(overlay(touches, cell), frame=(205, 210, 215)).with_scale_bar(_PX_PER_MM)
    x_mm, y_mm = (side / _PX_PER_MM for side in cell.size_px)
    words = (
        f"{_touches_in_words(record)} at their positions",
        f"{x_mm:.0f} x {y_mm:.0f} mm around the middle of the cell, x right, y up",
    )
    return pictures.sheet([tile], 1, _title(record), words)


def _touches_in_words(record: rounds.TouchRound) -> str:
    of_object = f" of object {record.object_id}" if record.row.has("object_id") else ""
    return f"{wording.with_count(record.touch_count, 'touches')}{of_object}"


def _title(record: rounds.TouchRound) -> str:
    return ", ".join([f"Round {record.id}", *record.label_words()])


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTouch:
    """The picture of a touch and its position.

    ``centre_m``, shape (2,), is the middle of the picture: x and y, metres, cell frame. The rows of ``axes``,
    shape (2, 2), are the directions along x and y in which columns and rows of the picture grow; they are
    shorter than one if the gel was tilted.
    """

    pixels: UInt8
    centre_m: Float64
    axes: Float64


@dataclass(frozen=True, slots=True)
class CellMap:
    """A map of the cell, x right and y up, the origin of the cell in its middle."""

    size_px: tuple[int, int]
    px_per_m: float

    def point_px(self, point_m: Sequence[float] | AnyArray) -> tuple[float, float]:
        """Return the column and row of a point of the cell; 0 is the outer edge of the first pixel."""
        x, y = float(point_m[0]), float(point_m[1])
        return self.size_px[0] / 2 + x * self.px_per_m, self.size_px[1] / 2 - y * self.px_per_m


def placed_touches(record: rounds.TouchRound, touches: Sequence[int]) -> list[PlacedTouch]:
    """Read the pictures of some touches and the positions of the gel; for clips, the last frame of contact.

    If the data set stores no pose of the gel, the intended position without rotation is taken.
    """
    placed: dict[int, PlacedTouch] = {}

    def read(number: int) -> None:
        touch = Touch(record, int(touches[number]))
        if not record.row.has_poses:
            centre_m = np.asarray(touch.pos_in_cell_m, np.float64)
            placed[number] = PlacedTouch(touch.image, centre_m, np.diag([1.0, -1.0]))
            return
        pose = touch.gel_pose
        # Columns of the picture grow along +x of the gel, rows along -y (package tactile-mnist 0.13.0).
        turned = pose.rotation.apply([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        centre_m = np.asarray(pose.translation[:2], np.float64)
        placed[number] = PlacedTouch(touch.image, centre_m, np.asarray(turned[:, :2]))

    media.in_parallel(read, len(touches), _MAX_THREADS)
    return [placed[number] for number in range(len(touches))]


def cell_map(touches: Sequence[PlacedTouch], px_per_mm: float) -> CellMap:
    """Return a map that shows the cell and every touch completely."""
    # Touches near the edge of the cell reach beyond it.
    reach = np.array(CELL_M) / 2
    for touch in touches:
        half = np.abs(touch.axes * np.array(SENSING_AREA_M)[:, None] / 2).sum(axis=0)
        reach = np.maximum(reach, np.abs(touch.centre_m) + half)
    width, height = (2 * np.ceil(reach * px_per_mm * 1e3 - 1e-6).astype(int)).tolist()
    return CellMap((width, height), px_per_mm * 1e3)


def overlay(touches: Sequence[PlacedTouch], cell: CellMap) -> UInt8:
    """Paste touches, pictures of one size, into one picture of the cell, (H, W, 3); white where no touch was.

    Where touches overlap, the weight of each grows with its difference from the gel at rest (the median of
    all touches), so that objects stay visible under touches of the bare plate.
    InputError: the pictures differ in size.
    """
    sizes = sorted({touch.pixels.shape[1::-1] for touch in touches})
    if len(sizes) > 1:
        sizes_text = ", ".join(f"{width} x {height}" for width, height in sizes[:4])
        raise errors.InputError(
            f"the pictures of the round have different sizes ({sizes_text} pixels); an overlay needs "
            "one size",
            next="make them alike with `realtouch resize`",
        )
    width, height = cell.size_px
    sums = np.zeros((height, width, 3))
    weights = np.zeros((height, width, 1))
    bare_gel = np.median([touch.pixels for touch in touches], axis=0)
    for touch in touches:
        window, back = _back_to_touch(touch, cell)
        weight = _weight(touch.pixels, bare_gel)
        layers = np.dstack([touch.pixels.astype(np.float32), weight])
        sampled = _sampled(layers, window, back, Image.Resampling.BILINEAR)
        inside = _sampled(np.ones_like(layers[..., :1]), window, back, Image.Resampling.NEAREST) > 0.5
        weight = np.where(inside, sampled[..., 3:], 0.0)
        sums[window] += weight * sampled[..., :3]
        weights[window] += weight
    mixed = np.where(weights > 0, sums / np.where(weights > 0, weights, 1.0), 255.0)
    return np.round(mixed).astype(np.uint8)


def _weight(pixels: UInt8, bare_gel: Float64) -> Float32:
    """Return the weight of each pixel: its difference from the bare gel, fading towards the edges."""
    height, width = pixels.shape[:2]
    change = np.abs(pixels - bare_gel).mean(axis=2) / 255.0
    edge = [
        np.minimum(1.0, (0.5 + np.minimum(np.arange(side), np.arange(side)[::-1])) / (_FEATHER * side))
        for side in (height, width)
    ]
    faded = edge[0][:, None] * edge[1][None, :]
    return np.asarray((_PLAIN_WEIGHT + change) ** 2 * faded, np.float32)


def _back_to_touch(touch: PlacedTouch, cell: CellMap) -> tuple[tuple[slice, slice], tuple[float, ...]]:
    """Return the window of the map that a touch covers, and the affine map from there to its pixels."""
    height, width = touch.pixels.shape[:2]
    # Metres along columns and rows of the touch -> pixels of the map, whose rows grow along -y.
    to_map = touch.axes.T * cell.px_per_m * np.array([[1.0], [-1.0]])
    per_px = np.array([SENSING_AREA_M[0] / width, SENSING_AREA_M[1] / height])
    forward = to_map * per_px
    centre = np.array(cell.point_px(touch.centre_m))
    half = np.abs(forward * np.array([width, height]) / 2).sum(axis=1)
    low = np.maximum(np.floor(centre - half).astype(int), 0)
    high = np.minimum(np.ceil(centre + half).astype(int), cell.size_px)
    back = arithmetic.inverse_affine(forward, centre - low, np.array([width, height]) / 2)
    window = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    return window, back


def _sampled(
    layers: Float32, window: tuple[slice, slice], back: tuple[float, ...], method: Image.Resampling
) -> Float32:
    """Sample layers of a picture, (H, W, n), at the pixels of a window of the map; 0 beyond its edge."""
    size = (window[1].stop - window[1].start, window[0].stop - window[0].start)
    planes = map(Image.fromarray, np.moveaxis(np.ascontiguousarray(layers), 2, 0))
    return np.dstack([np.asarray(plane.transform(size, _AFFINE, back, method)) for plane in planes])
