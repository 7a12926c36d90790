"""Pictures in files and notebooks: planned first, then drawn one by one; equal pixels give equal bytes."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from tactile_toolkit import store, touch
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError

TILE_STYLE = "margin:0;text-align:center;font-size:smaller"
"""Style of a small picture among others in a notebook."""


@dataclass(frozen=True, slots=True)
class PlannedPicture:
    """A picture that is not drawn yet: its file name (``.png``) and a short description."""

    name: str
    what: str
    draw: Callable[[], UInt8]


@dataclass(frozen=True, slots=True)
class PicturePlan:
    """The pictures to draw, in order, and why some kinds are left out."""

    pictures: tuple[PlannedPicture, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class WrittenPicture:
    """A picture on disk: name and description as planned, size in pixels and bytes."""

    file: str
    what: str
    width: int
    height: int
    bytes: int


def plan_kinds(
    asked: Sequence[str], plans: Mapping[str, Callable[[], Sequence[PlannedPicture]]]
) -> PicturePlan:
    """Plan the pictures of each requested kind, or of the first one.

    ``"all"`` stands for all kinds. Kinds that cannot be drawn are left out with the reason, unless they were
    named. Raises InputError for an unknown kind, for a named kind that cannot be drawn, and where no kind can
    be drawn.
    """
    unknown = [kind for kind in asked if kind not in (*plans, "all")]
    if unknown:
        raise InputError(f"no pictures of kind {unknown[0]!r}; expected {', '.join(plans)} or all")
    named = bool(asked) and "all" not in asked
    wanted = plans if "all" in asked else asked or next(iter(plans))
    pictures: list[PlannedPicture] = []
    reasons: list[InputError] = []
    for kind in filter(wanted.__contains__, plans):
        try:
            pictures += plans[kind]()
        except InputError as error:
            if named:
                raise
            reasons.append(error)
    if not pictures and reasons:
        raise reasons[0]
    # Several kinds may need the same missing package.
    return PicturePlan(tuple(pictures), tuple(dict.fromkeys(str(reason) for reason in reasons)))


def write_pictures(
    folder: store.DataFolder,
    pictures: Sequence[PlannedPicture],
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[WrittenPicture]:
    """Draw and write pictures; existing ones of the same name are replaced.

    Each is written completely or not at all. If one fails, those before it are kept.
    """
    written = []
    for done, planned in enumerate(pictures, start=1):
        pixels = planned.draw()
        content = png_bytes(pixels)
        folder.write_bytes(planned.name, content)
        height, width = pixels.shape[:2]
        written.append(WrittenPicture(planned.name, planned.what, width, height, len(content)))
        on_progress(done, len(pictures))
    return written


def png_bytes(pixels: UInt8) -> bytes:
    """Encode a picture as PNG, without metadata."""
    return touch.encode_png(Image.fromarray(np.ascontiguousarray(pixels)))


def figure_html(pixels: UInt8, caption: str, style: str = "") -> str:
    """Return HTML for notebooks of a picture and its caption, which is plain text."""
    source = base64.b64encode(png_bytes(pixels)).decode("ascii")
    styled = ""
    if style:
        styled = f' style="{style}"'
    return (
        f'<figure{styled}><img src="data:image/png;base64,{source}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def file_stem(name: str) -> str:
    """Return the beginning of the names of pictures of a data set: the last part of its path, made safe."""
    path = store.expanded(name)
    last = path.name
    if path.is_dir():
        last = path.resolve().name
    elif path.is_file():
        last = path.stem
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in last)
    # A leading dot would hide the file, and a leading dash make it an option.
    return plain.strip("-.") or "pictures"
