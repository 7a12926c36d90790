"""Pictures in files: planned first, then drawn one by one; equal pixels give equal bytes."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.render import Studio
from tactile_toolkit.store.folder import DataFolder

__all__ = [
    "Drawing",
    "PicturePlan",
    "Pixels",
    "PlannedPicture",
    "WrittenPicture",
    "as_rgb",
    "chosen_kinds",
    "file_stem",
    "plan_kinds",
    "png_bytes",
    "renamed",
    "whole_numbers",
    "write_pictures",
]

Pixels: TypeAlias = NDArray[np.uint8]
"""Grey levels of shape (H, W) or colours of shape (H, W, 3); row 0 at the top."""

PNG = ".png"
_COMPRESSION = 6


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A picture in memory.

    Attributes
    ----------
    pixels : ndarray of uint8, shape (H, W) or (H, W, 3)
        What is seen.
    notes : tuple of str
        What whoever looks at it should know, such as that no renderer was there.
    """

    pixels: Pixels
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PlannedPicture:
    """A picture that is not drawn yet.

    Attributes
    ----------
    name : str
        File name, ending in ``.png``.
    what : str
        What it shows, in a few words.
    draw : callable
        Draws it; takes the :class:`~tactile_toolkit.pictures.render.Studio` in which oblique views are made.
    """

    name: str
    what: str
    draw: Callable[[Studio], Drawing]


@dataclass(frozen=True, slots=True)
class PicturePlan:
    """What will be drawn.

    Attributes
    ----------
    pictures : tuple of PlannedPicture
        In order.
    left_out : tuple of str
        Why kinds that nobody named are not among them.
    """

    pictures: tuple[PlannedPicture, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class WrittenPicture:
    """A picture on disk.

    Attributes
    ----------
    name, what : str
        As planned.
    width, height, bytes : int
        Its size.
    notes : tuple of str
        As drawn.
    """

    name: str
    what: str
    width: int
    height: int
    bytes: int
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        size = {"width": self.width, "height": self.height, "bytes": self.bytes}
        return {"file": self.name, "what": self.what, **size, "notes": list(self.notes)}


def chosen_kinds(
    asked: Sequence[str], known: Sequence[str], usual: Sequence[str]
) -> tuple[tuple[str, ...], bool]:
    """Settle which kinds of pictures to draw.

    Parameters
    ----------
    asked : sequence of str
        What was asked for; ``"all"`` stands for all, nothing for the usual ones.
    known, usual : sequence of str
        All kinds, and those drawn when none is named.

    Returns
    -------
    kinds : tuple of str
        Each once, in the order of ``known``.
    by_name : bool
        Whether they were named one by one, so that one that cannot be drawn is an error.

    Raises
    ------
    InputError
        When there is no such kind.
    """
    unknown = [kind for kind in asked if kind not in (*known, "all")]
    if unknown:
        message = f"no pictures of kind {unknown[0]!r}; expected {', '.join(known)} or all"
        raise InputError(message)
    if "all" in asked:
        return tuple(known), False
    if not asked:
        return tuple(usual), False
    return tuple(kind for kind in known if kind in asked), True


def plan_kinds(
    kinds: Sequence[str], by_name: bool, plan: Callable[[str], Sequence[PlannedPicture]]
) -> PicturePlan:
    """Plan the pictures of each kind; what cannot be drawn and was not named is left out, with the reason.

    Raises
    ------
    ToolkitError
        As ``plan`` raises it, for a kind that was named, or when nothing at all can be drawn.
    """
    pictures: list[PlannedPicture] = []
    reasons: list[InputError] = []
    for kind in kinds:
        try:
            pictures += plan(kind)
        except InputError as error:
            if by_name:
                raise
            reasons.append(error)
    if not pictures and reasons:
        raise reasons[0]
    return PicturePlan(tuple(pictures), tuple(dict.fromkeys(str(reason) for reason in reasons)))


def write_pictures(
    folder: DataFolder,
    pictures: Sequence[PlannedPicture],
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[WrittenPicture]:
    """Draw pictures and write each whole or not at all; one of the same name is replaced.

    Parameters
    ----------
    folder : DataFolder
        Where they go.
    pictures : sequence of PlannedPicture
        What to draw.
    on_progress : callable
        Told how many of how many are done.

    Raises
    ------
    ToolkitError
        A picture cannot be drawn or written; those before it stay.
    """
    written = []
    with Studio() as studio:
        for done, planned in enumerate(pictures, start=1):
            drawing = planned.draw(studio)
            content = png_bytes(drawing.pixels)
            folder.write_bytes(planned.name, content)
            height, width = drawing.pixels.shape[:2]
            written.append(
                WrittenPicture(planned.name, planned.what, width, height, len(content), drawing.notes)
            )
            on_progress(done, len(pictures))
    return written


def renamed(pictures: Sequence[PlannedPicture], out: Path) -> tuple[Path, tuple[PlannedPicture, ...]]:
    """Take ``out`` as a folder or, where it ends in ``.png``, as the name of the only picture.

    Returns
    -------
    folder : Path
        Where the pictures go.
    pictures : tuple of PlannedPicture
        With their names.

    Raises
    ------
    InputError
        When several pictures were to go into one file.
    """
    if out.suffix.lower() != PNG:
        return out, tuple(pictures)
    if len(pictures) != 1:
        message = f"--out is the file {str(out)!r} for {len(pictures)} pictures; next: give a folder"
        raise InputError(message)
    return out.parent, (replace(pictures[0], name=out.name),)


def png_bytes(pixels: Pixels) -> bytes:
    """Encode a picture as PNG without times, names of programs or anything else but its pixels."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, "PNG", compress_level=_COMPRESSION)
    return stream.getvalue()


def as_rgb(pixels: Pixels) -> Pixels:
    """Return a picture in colours, shape (H, W, 3)."""
    return pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)


def whole_numbers(option: str, text: str | None) -> tuple[int, ...]:
    """Read ``3,17`` as numbers.

    Raises
    ------
    InputError
        A part is no whole number.
    """
    parts = [part.strip() for part in (text or "").split(",")] if text is not None else []
    for part in parts:
        if not (part.isascii() and part.isdigit()):
            message = f"{option} has {part!r}; expected whole numbers, such as 12,408"
            raise InputError(message)
    return tuple(int(part) for part in parts)


def file_stem(name: str) -> str:
    """Return what tells the pictures of data sets apart: the last part of a path, in plain letters."""
    place = Path(name).expanduser()
    last = place.resolve().name if place.is_dir() else place.stem if place.is_file() else place.name
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in last)
    return plain.strip("-.") or "pictures"
