"""Sets of real touches in the published schema, with a known truth, made with real encoders.

A touch comes down onto a plate or onto a digit 7 mm above it. The gel is clear until it meets something; from
then on a blob is seen in it, the stronger the deeper the press. Clips end shortly after the arm lifts again.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import xxhash
from datasets import ClassLabel, Features, Image, List, Value, Video
from PIL import Image as Pictures

from tactile_toolkit.touch import MEDIA_TYPE, with_features

FPS = 25
DIGIT_HEIGHT_M = 0.007
LABELS = [str(number) for number in range(10)]
_ENCODED: dict[Any, bytes] = {}  # many tests use equal clips


@dataclass(frozen=True)
class TouchTruth:
    """Ground truth of one touch."""

    frames: int
    contact_start: int  # first frame that shows contact
    contact_end: int  # last frame that shows contact
    peak: int  # frame of the deepest press
    on_digit: bool
    position_m: np.ndarray  # (N, 3)
    quaternion: np.ndarray  # (N, 4), x y z w
    pixels: np.ndarray  # (N, H, W, 3) before encoding

    @property
    def time_s(self) -> np.ndarray:
        return np.arange(self.frames) / FPS


@dataclass(frozen=True)
class RoundTruth:
    id: str
    label: int
    object_id: int
    gel_id: int
    z_drift_m: float
    touches: list[TouchTruth] = field(repr=False)
    pos_in_cell_m: np.ndarray = field(repr=False)  # (T, 2)


@dataclass(frozen=True)
class Layout:
    """How a data set is stored; by default as the published ones."""

    nested: bool = False  # struct a{b, c} instead of flat a.b, a.c
    seconds: bool = False  # durations as float seconds
    padded: bool = True  # sequences padded to the longest clip
    fixed: bool = True  # fixed-size lists over the touches
    shards: int = 1
    group_rows: int = 10
    pad_null: bool = False  # padding by nulls instead of zeros
    leave_out: tuple[str, ...] = ()
    edit: Callable[[dict[str, Any], int], None] | None = None  # change a row before it is written


def make_round(
    index: int,
    touches: int,
    size: tuple[int, int] = (320, 240),
    frames: tuple[int, int] = (58, 90),
    noise: float = 0.0,
) -> RoundTruth:
    """Make one round; ``size`` is (width, height), ``noise`` the grey levels that vary between frames."""
    random = np.random.default_rng([7, index])
    drift_m = float(random.uniform(-0.003, 0.003))
    made = [
        _make_touch(
            random, touch % 3 != 2, drift_m, size, frames, noise
        )  # every third touch misses the digit
        for touch in range(touches)
    ]
    stamp = f"2023-09-28_15-{index // 60:02d}-{index % 60:02d}"
    xy = random.uniform(-0.05, 0.05, (touches, 2))
    return RoundTruth(f"{stamp}_{index % 10}-0", index % 10, 4000 + index, index // 2, drift_m, made, xy)


def _make_touch(
    random: np.random.Generator,
    on_digit: bool,
    drift_m: float,
    size: tuple[int, int],
    frames: tuple[int, int],
    noise: float,
) -> TouchTruth:
    count = int(random.integers(frames[0], frames[1] + 1))
    start, end = max(count - 8, 1), count - 2 if count > 4 else count - 1
    peak = (start + end + 1) // 2
    stop_m = (DIGIT_HEIGHT_M if on_digit else 0.0) + drift_m
    index = np.arange(count)
    depth = np.interp(index, [start - 1, peak, end + 1], [0.0, 1.0, 0.0])
    z_m = np.where(index < start, stop_m + 0.0006 + 0.0005 * (start - index), stop_m + 0.0006 * (1.0 - depth))
    xy = random.uniform(-0.05, 0.05, 2)
    position = np.column_stack([np.full(count, xy[0]), np.full(count, xy[1]), z_m])
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)) + random.normal(0, 1e-3, (count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    pixels = _render(random, depth, size, noise)
    return TouchTruth(count, start, end, peak, on_digit, position, quaternion, pixels)


@cache
def _gel(size: tuple[int, int]) -> np.ndarray:
    """Return light of three colours from three sides, as in a GelSight Mini."""
    width, height = size
    y, x = np.mgrid[0:height, 0:width]
    red, green, blue = 90 + 70 * x / width, 110 + 50 * y / height, 150 - 60 * x / width
    return np.stack([red, green, blue], axis=-1)


def _render(
    random: np.random.Generator, depth: np.ndarray, size: tuple[int, int], noise: float
) -> np.ndarray:
    width, height = size
    y, x = np.mgrid[0:height, 0:width]
    cx, cy = random.uniform(0.3, 0.7) * width, random.uniform(0.3, 0.7) * height
    radius = 0.18 * width
    bump = np.exp(-((((x - cx) ** 2 + (y - cy) ** 2) / radius**2) ** 2))
    dx, dy = np.gradient(bump, axis=1) * width / 8, np.gradient(bump, axis=0) * width / 8
    shade = np.stack([70 * dx, 70 * dy, -70 * dx - 40 * bump], axis=-1)
    base = _gel(size) + random.normal(0, 1.5, (height, width, 1))
    frames = np.empty((len(depth), height, width, 3), np.uint8)
    clear = np.clip(base, 0, 255).astype(np.uint8)
    for index, press in enumerate(depth):
        frames[index] = clear if press <= 0 else np.clip(base + press * shade, 0, 255)
        if noise:
            jitter = np.round(random.normal(0, noise, (height, width, 1))).astype(np.int16)
            frames[index] = np.clip(frames[index] + jitter, 0, 255)
    return frames


def encoded(pixels: np.ndarray | Pictures.Image, kind: str, **options: Any) -> bytes:
    """Encode pixels, or a picture of Pillow, by Pillow."""
    stream = io.BytesIO()
    picture = pixels if isinstance(pixels, Pictures.Image) else Pictures.fromarray(pixels)
    picture.save(stream, kind, **options)
    return stream.getvalue()


def encode_jpeg(pixels: np.ndarray, quality: int = 90) -> bytes:
    return encoded(pixels, "JPEG", quality=quality)


def encode_avi(frames: np.ndarray, codec: str = "mjpeg", container: str = "avi") -> bytes:
    """Encode (N, H, W, 3) uint8 as an AVI with MJPEG frames at 25 fps, as FFmpeg writes them."""
    key = (xxhash.xxh128_digest(np.ascontiguousarray(frames)), frames.shape, codec, container)
    if key not in _ENCODED:
        _ENCODED[key] = _encode_avi(frames, codec, container)
    return _ENCODED[key]


def _encode_avi(frames: np.ndarray, codec: str, container: str) -> bytes:
    stream = io.BytesIO()
    with av.open(stream, "w", format=container) as output:
        video = output.add_stream(codec, rate=FPS)
        video.height, video.width = frames.shape[1:3]
        video.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        video.options = {"q:v": "3"} if codec == "mjpeg" else {}
        if codec == "mjpeg":
            video.codec_context.qmin = video.codec_context.qmax = 3
        for index, pixels in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts = index
            output.mux(video.encode(frame))
        output.mux(video.encode(None))
    return stream.getvalue()


def single_rows(
    rounds: Sequence[RoundTruth], encode: Callable[[np.ndarray], bytes] = encode_jpeg
) -> list[dict]:
    rows = []
    for truth in rounds:
        peaks = [(touch, touch.peak) for touch in truth.touches]
        rows.append(
            {
                **_common(truth),
                "gel_pose_cell_frame.position": [touch.position_m[peak] for touch, peak in peaks],
                "gel_pose_cell_frame.quaternion": [touch.quaternion[peak] for touch, peak in peaks],
                "sensor_image": [
                    {"bytes": encode(touch.pixels[peak]), "path": f"{index}.jpg"}
                    for index, (touch, peak) in enumerate(peaks)
                ],
            }
        )
    return rows


def seq_rows(rounds: Sequence[RoundTruth], layout: Layout = Layout()) -> list[dict]:
    longest = max(touch.frames for truth in rounds for touch in truth.touches)
    rows = []
    for truth in rounds:
        touches = truth.touches

        def pad(values: np.ndarray, touch_longest: int = longest) -> list[Any]:
            filler = None if layout.pad_null else np.zeros_like(values[:1])[0]
            lacking = touch_longest - len(values) if layout.padded else 0
            return [*values, *[filler] * lacking]

        rows.append(
            {
                **_common(truth),
                "video_length_frames": [touch.frames for touch in touches],
                "gel_pose_cell_frame_seq.position": [pad(touch.position_m) for touch in touches],
                "gel_pose_cell_frame_seq.quaternion": [pad(touch.quaternion) for touch in touches],
                "time_stamp_rel_seq": [pad(_duration(touch.time_s, layout)) for touch in touches],
                "touch_start_time_rel": [
                    _duration(touch.time_s, layout)[touch.contact_start] for touch in touches
                ],
                "touch_end_time_rel": [
                    _duration(touch.time_s, layout)[touch.contact_end] for touch in touches
                ],
                "sensor_video": [
                    {"bytes": encode_avi(touch.pixels), "path": f"{index}.avi"}
                    for index, touch in enumerate(touches)
                ],
            }
        )
    return rows


def _common(truth: RoundTruth) -> dict[str, Any]:
    return {
        "id": truth.id,
        "label": truth.label,
        "object_id": truth.object_id,
        "info.gel_id": truth.gel_id,
        "info.notes": "",
        "info.object_pose.position": np.array([0.0, 0.001 * truth.label, 0.0]),
        "info.object_pose.quaternion": np.array([0.0, 0.0, 0.0, 1.0]),
        "pos_in_cell": truth.pos_in_cell_m,
    }


def _duration(time_s: np.ndarray, layout: Layout) -> np.ndarray:
    return time_s if layout.seconds else np.round(time_s * 1e6).astype("timedelta64[us]")


def features(kind: str, touches: int, layout: Layout = Layout()) -> Features:
    """Return the published features of ``"seq"`` or ``"single"``."""
    per_round = touches if layout.fixed else -1

    def vector(width: int) -> List:
        return List(Value("float64"), length=width)

    def per_touch(what: Any) -> List:
        return List(what, length=per_round)

    time = Value("float64") if layout.seconds else Value("duration[us]")
    columns: dict[str, Any] = {
        "id": Value("string"),
        "label": ClassLabel(names=LABELS),
        "object_id": Value("int64"),
        "info.gel_id": Value("int64"),
        "info.notes": Value("string"),
        "info.object_pose.position": vector(3),
        "info.object_pose.quaternion": vector(4),
        "pos_in_cell": per_touch(vector(2)),
    }
    if kind == "single":
        columns |= {
            "gel_pose_cell_frame.position": per_touch(vector(3)),
            "gel_pose_cell_frame.quaternion": per_touch(vector(4)),
            "sensor_image": per_touch(Image()),
        }
    else:
        columns |= {
            "video_length_frames": per_touch(Value("int64")),
            "gel_pose_cell_frame_seq.position": per_touch(List(List(Value("float64")))),
            "gel_pose_cell_frame_seq.quaternion": per_touch(List(List(Value("float64")))),
            "time_stamp_rel_seq": per_touch(List(time)),
            "touch_start_time_rel": per_touch(time),
            "touch_end_time_rel": per_touch(time),
            "sensor_video": per_touch(Video()),
        }
    kept = {name: what for name, what in columns.items() if name not in layout.leave_out}
    return Features(_nest(kept) if layout.nested else kept)


def _nest(columns: dict[str, Any]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for name, value in columns.items():
        *outer, last = name.split(".")
        place = nested
        for part in outer:
            place = place.setdefault(part, {})
        place[last] = value
    return nested


def write_set(folder: Path, rows: dict[str, list[dict]], kind: str, layout: Layout = Layout()) -> Path:
    """Write splits as ``data/SPLIT-00000-of-00001.parquet``, the way ``datasets`` uploads them."""
    (folder / "data").mkdir(parents=True, exist_ok=True)
    for split, split_rows in rows.items():
        touches = len(split_rows[0]["pos_in_cell"])
        schema = features(kind, touches, layout).arrow_schema
        parts = np.array_split(np.arange(len(split_rows)), layout.shards)
        for index, part in enumerate(parts):
            table = _table([split_rows[row] for row in part], schema, layout)
            place = folder / "data" / f"{split}-{index:05d}-of-{layout.shards:05d}.parquet"
            pq.write_table(table, place, row_group_size=layout.group_rows)
    return folder


def _table(rows: list[dict], schema: pa.Schema, layout: Layout) -> pa.Table:
    ready = []
    for index, row in enumerate(rows):
        copied = {name: value for name, value in row.items() if name not in layout.leave_out}
        if layout.edit is not None:
            layout.edit(copied, index)
        ready.append(_nest(copied) if layout.nested else copied)
    return pa.Table.from_pylist([_plain(row) for row in ready], schema=schema)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.timedelta64):
        return value.item()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def bare_set(
    folder: Path,
    kind: str,
    label: int | None = -1,
    extras: Callable[[str], dict[str, pa.Array]] = lambda _split: {},
    prefix: str = "r",
) -> Path:
    """Write a data set as imports of pictures without poses make it; ``extras`` are columns for a split.

    Rounds of train have 3 and 2 touches, that of test has 2; clips have 4 and more frames.
    """
    (folder / "data").mkdir(parents=True, exist_ok=True)
    layout = Layout(seconds=True, padded=False)
    rows_of = single_rows if kind == "single" else partial(seq_rows, layout=layout)
    for split, counts in BARE_TOUCHES.items():
        rounds = [make_round(number, count, (48, 36), (4, 6)) for number, count in enumerate(counts)]
        rows = rows_of(rounds)
        ids = [f"{prefix}-{split}-{number}" for number in range(len(rows))]
        columns: dict[str, Any] = {"id": pa.array(ids)}
        if label is not None:
            columns["label"] = pa.array([label] * len(rows), pa.int64())
        for name, data_type in _BARE[kind].items():
            columns[name] = pa.array([_plain(row[name]) for row in rows], data_type)
        table = pa.table(columns | extras(split))
        place = folder / "data" / f"{split}-00000-of-00001.parquet"
        pq.write_table(table.cast(with_features(table.schema, ())), place, write_page_checksum=True)
    return folder


BARE_TOUCHES = {"train": (3, 2), "test": (2,)}
_TIMES = pa.list_(pa.float64())
_BARE: dict[str, dict[str, pa.DataType]] = {
    "single": {"sensor_image": pa.list_(MEDIA_TYPE)},
    "seq": {
        "video_length_frames": pa.list_(pa.int64()),
        "time_stamp_rel_seq": pa.list_(_TIMES),
        "touch_start_time_rel": _TIMES,
        "touch_end_time_rel": _TIMES,
        "sensor_video": pa.list_(MEDIA_TYPE),
    },
}
