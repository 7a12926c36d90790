"""Recordings like those of laboratories, made by writers of other projects, with known content."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.realtouch.factories import RoundTruth, TouchTruth, make_round

SIZE = (96, 72)
FPS = 25
CLASSES = ("mug", "fork")


@dataclass(frozen=True)
class Session:
    """A recording: arguments of the import, and the expected touches.

    ``lossless`` states whether the import keeps the values of all pixels. ``position_m`` and ``quaternion``
    are empty if the source has no poses.
    """

    source: Path
    words: Sequence[str]
    pixels: list[np.ndarray]  # (N, H, W, 3) of a clip, (H, W, 3) of an image
    lossless: bool
    labels: list[str] = field(default_factory=list)
    position_m: list[np.ndarray] = field(default_factory=list)
    quaternion: list[np.ndarray] = field(default_factory=list)
    time_s: list[np.ndarray] = field(default_factory=list)
    force_n: list[np.ndarray] = field(default_factory=list)


def truth(touches: int = 4) -> RoundTruth:
    return make_round(3, touches, SIZE, (30, 40), noise=1.0)


def force_of(touch: TouchTruth) -> np.ndarray:
    """Return forces, newtons, nearly all of which float32 rounds."""
    return np.where(np.arange(touch.frames) >= touch.contact_start, 1.1, 0.1) + 0.01 * np.arange(touch.frames)


def write_video(path: Path, codec: str, pixels: np.ndarray, **options: str) -> None:
    """Write frames by FFmpeg."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(FPS), options=options)
        stream.height, stream.width = pixels.shape[1:3]
        stream.pix_fmt = {"mjpeg": "yuvj420p", "ffv1": "bgr0"}.get(codec, "yuv420p")
        for frame in pixels:
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)


def packets_of(path: Path) -> list[bytes]:
    """Return the packets of a video, in order."""
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def decoded_by_pillow(jpeg: bytes) -> np.ndarray:
    import io

    return np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB"))


def write_csv(path: Path, columns: dict[str, Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def mjpeg_avi(home: Path) -> Session:
    """One AVI for each touch, with poses and forces at the rate of the camera, and a table of classes."""
    touches = truth().touches
    home.mkdir()
    pixels = []
    for number, touch in enumerate(touches):
        file = home / f"take{number}.avi"
        write_video(file, "mjpeg", touch.pixels, **{"q:v": "2"})
        pixels.append(np.stack([decoded_by_pillow(packet) for packet in packets_of(file)]))
        position, quaternion = touch.position_m, touch.quaternion
        columns = {
            "time_s": touch.time_s,
            **dict(zip(("x_mm", "y_mm", "z_mm"), 1000 * position.T, strict=True)),
        }
        columns |= dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True)) | {
            "force_n": force_of(touch)
        }
        write_csv(home / f"take{number}.csv", {name: column.tolist() for name, column in columns.items()})
    labels = [CLASSES[number % 2] for number in range(len(touches))]
    write_csv(home / "labels.csv", {"file": [f"take{n}.avi" for n in range(len(touches))], "object": labels})
    return Session(
        home,
        ("--map", "label=object", "--map", "pose=x_mm,y_mm,z_mm,qx,qy,qz,qw"),
        pixels,
        lossless=True,
        labels=labels,
        position_m=[touch.position_m for touch in touches],
        quaternion=[touch.quaternion for touch in touches],
        time_s=[touch.time_s for touch in touches],
        force_n=[force_of(touch) for touch in touches],
    )


def h264_mp4(home: Path) -> Session:
    """One MP4 for each touch, in a folder for each class."""
    touches = truth().touches
    labels = []
    ordered = []
    for label in sorted(CLASSES):
        (home / label).mkdir(parents=True)
        for number, touch in enumerate(touches):
            if CLASSES[number % 2] == label:
                write_video(home / label / f"{number}.mp4", "libx264", touch.pixels, crf="12")
                labels.append(label)
                ordered.append(touch)
    pixels = [touch.pixels for touch in ordered]
    return Session(home, (), pixels, False, labels, time_s=[touch.time_s for touch in ordered])


def png_and_euler(home: Path) -> Session:
    """Images and a table in millimetres and degrees."""
    touches = truth().touches
    home.mkdir()
    peaks = [touch.pixels[touch.peak] for touch in touches]
    for number, picture in enumerate(peaks):
        Image.fromarray(picture).save(home / f"{number:03d}.png")
    position = np.stack([touch.position_m[touch.peak] for touch in touches])
    quaternion = np.stack([touch.quaternion[touch.peak] for touch in touches])
    euler = Rotation.from_quat(quaternion).as_euler("xyz", degrees=True)
    force = [float(force_of(touch)[touch.peak]) for touch in touches]
    labels = [CLASSES[number % 2] for number in range(len(touches))]
    columns: dict[str, Sequence[object]] = {
        "picture": [f"{number:03d}.png" for number in range(len(touches))]
    }
    columns |= dict(zip(("x", "y", "z"), (1000 * position.T).tolist(), strict=True))
    columns |= dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), euler.T.tolist(), strict=True))
    columns |= {"thing": labels, "Fz": force, "operator": ["ann"] * len(touches)}
    write_csv(home / "touches.csv", columns)
    words = ("--map", "image=picture", "--map", "label=thing", "--map", "force_n=Fz", "--length-unit", "mm")
    pose = ("--map", "pose=x,y,z,roll_deg,pitch_deg,yaw_deg", "--euler", "xyz")
    return Session(
        home, (*words, *pose), peaks, True, labels, list(position), list(quaternion),
        force_n=[np.float64(force_n) for force_n in force],
    )  # fmt: skip


def class_folders(home: Path) -> Session:
    """Images in a folder for each class."""
    labels, pixels = [], []
    for label in sorted(CLASSES):
        (home / label).mkdir(parents=True)
        for number, touch in enumerate(truth().touches):
            if CLASSES[number % 2] == label:
                Image.fromarray(touch.pixels[touch.peak]).save(home / label / f"{number}.png")
                labels.append(label)
                pixels.append(touch.pixels[touch.peak])
    return Session(home, (), pixels, True, labels)


def long_video(home: Path) -> Session:
    """One video of several touches, to be cut by contact; ``pixels`` are the frames of the contacts."""
    bare_gel = truth().touches[0].pixels[:1]
    touches = [touch for touch in truth(8).touches if touch.on_digit]
    parts, contacts = [np.repeat(bare_gel, 20, axis=0)], []
    for touch in touches:
        contacts.append(touch.pixels[touch.contact_start : touch.contact_end + 1])
        parts += [touch.pixels[: touch.contact_end + 1], np.repeat(bare_gel, 30, axis=0)]
    home.mkdir()
    write_video(home / "session.avi", "mjpeg", np.concatenate(parts), **{"q:v": "2"})
    return Session(home / "session.avi", ("--cut", "contact"), contacts, False)


def zarr3_buffer(home: Path) -> Session:
    """A replay buffer of Zarr 3: the frames of all touches one after another."""
    import zarr

    touches = truth().touches
    pixels = np.concatenate([touch.pixels for touch in touches])
    group = zarr.open_group(str(home), mode="w", zarr_format=3)
    data, meta = group.create_group("data"), group.create_group("meta")
    state = np.concatenate([np.hstack([touch.position_m, touch.quaternion]) for touch in touches])
    arrays = {
        "tactile": pixels,
        "state": state,
        "force": np.concatenate([force_of(touch) for touch in touches]),
    }
    for name, values in arrays.items():
        chunks = (16, *values.shape[1:])
        data.create_array(name, data=values, chunks=chunks, compressors=zarr.codecs.GzipCodec())
    ends = np.cumsum([touch.frames for touch in touches])
    meta.create_array("episode_ends", data=ends, chunks=ends.shape, compressors=None)
    return Session(
        home,
        ("--cut", "whole", "--map", "pose=state", "--map", "force_n=force"),
        [touch.pixels for touch in touches],
        False,
        position_m=[touch.position_m for touch in touches],
        quaternion=[touch.quaternion for touch in touches],
        force_n=[force_of(touch) for touch in touches],
    )
