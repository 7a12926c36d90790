"""What users of the touches do before training: backgrounds, differences, and contact told by the picture.

Grey is what OpenCV and JPEG call luma (ITU-R BT.601), in whole numbers: (4899 R + 9617 G + 1868 B + 8192) >>
14. Everything here is exact and gives the same numbers on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from realtouch.media.clips import TouchClip
from realtouch.media.images import in_parallel
from realtouch.rounds import TouchRound, TouchSingleRound
from realtouch.touches import Touches, with_empties
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch.jpeg import Pixels
from tactile_toolkit.wording import plain_number

__all__ = [
    "ContactRule",
    "ContactScore",
    "Contacts",
    "DifferenceForm",
    "background",
    "best_frame",
    "contact_score",
    "difference",
    "find_contacts",
]

DifferenceForm = Literal["signed", "grey", "absolute"]
DIFFERENCE_FORMS: tuple[DifferenceForm, ...] = get_args(DifferenceForm)

_BATCH_BYTES = 64 << 20


def background(pictures: Any) -> Pixels:
    """Return the median picture: what the gel looks like while nothing touches it.

    Parameters
    ----------
    pictures : TouchClip, TouchRound, Touches, TouchDataset, or array of shape (N, H, W, 3), uint8
        A clip, all frames of it; a round or touches, all of their images, or all frames of their clips. The
        background of one gel is that of its rounds: ``background(rounds.filter(lambda r: r.info["gel_id"] ==
        "3"))``.

    Returns
    -------
    ndarray, shape (H, W, 3), uint8
        Exact median of each pixel and channel; of an even number of pictures the mean of the two in the
        middle, rounded down. All pictures are read twice, a few at a time, so that any number fits in memory.

    Raises
    ------
    InputError
        There is no picture.
    IntegrityError
        A picture is damaged or of another size.
    """
    coarse = _counted(_batches(pictures), lambda batch: batch >> 4, np.arange(16, dtype=np.uint8))
    if coarse is None:
        message = "no pictures to take a background of; expected a clip, a round or touches that hold any"
        raise InputError(message)
    total = int(coarse[:, 0, 0, 0].sum())
    middles = []
    for rank in {(total - 1) // 2, total // 2}:
        # First the upper four bits of the value of that rank, then the lower four among those that share it.
        upper, before = _bin_of(coarse, np.full(coarse.shape[1:], rank))
        values = (upper.astype(np.uint8) << 4) + np.arange(16, dtype=np.uint8)[:, None, None, None]
        fine = _counted(_batches(pictures), lambda batch: batch, values)
        assert fine is not None
        middles.append(upper * 16 + _bin_of(fine, rank - before)[0])
    return ((middles[0] + middles[-1]) // 2).astype(np.uint8)


def _counted(
    batches: Iterable[Pixels], part: Callable[[Pixels], NDArray[Any]], values: NDArray[Any]
) -> NDArray[np.int64] | None:
    """Count for each pixel how many pictures hold each of 16 values there, shape (16, H, W, 3)."""
    counts: NDArray[np.int64] | None = None
    for batch in batches:
        seen = part(batch)
        if counts is None:
            counts = np.zeros((16, *batch.shape[1:]), np.int64)
        for count, value in zip(counts, values, strict=True):
            count += (seen == value).sum(axis=0, dtype=np.int32)
    return counts


def _bin_of(counts: NDArray[np.int64], rank: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for each pixel in which of 16 bins the item of a rank lies, and how many lie in bins before."""
    upto = counts.cumsum(axis=0)
    found = (upto > rank).argmax(axis=0)
    within = np.take_along_axis(counts, found[None], axis=0)[0]
    return found, np.take_along_axis(upto, found[None], axis=0)[0] - within


def _batches(pictures: Any) -> Iterator[Pixels]:
    """Yield pictures a few at a time, shape (n, H, W, 3)."""
    if isinstance(pictures, TouchClip):
        yield from _pieces(len(pictures), pictures.size, pictures.frames)
    elif isinstance(pictures, TouchSingleRound):
        images = pictures.sensor_image
        if len(images):
            yield from _pieces(len(images), images.size(), images.batch)
    elif isinstance(pictures, TouchRound):
        for clip in pictures.sensor_video:  # type: ignore[attr-defined]
            yield from _batches(clip)
    elif isinstance(pictures, Touches) and len(pictures):
        if isinstance(pictures[0].round, TouchSingleRound):
            yield from _pieces(len(pictures), pictures[0].image.shape[:2], pictures.images)
        else:
            for touch in pictures:
                yield from _batches(touch.clip)
    elif hasattr(pictures, "touches"):
        yield from _batches(pictures.touches())
    elif not isinstance(pictures, Touches) and len(found := _as_pictures(pictures)):
        yield found


def _pieces(count: int, size: Sequence[int], read: Callable[[Any], Pixels]) -> Iterator[Pixels]:
    length = max(1, _BATCH_BYTES // (3 * int(size[0]) * int(size[1])))
    for start in range(0, count, length):
        yield read(slice(start, start + length))


def _as_pictures(pictures: Any, dimensions: tuple[int, ...] = (4,)) -> Pixels:
    found = np.asarray(pictures)
    if found.dtype != np.uint8 or found.ndim not in dimensions or found.shape[-1] != 3:
        expected = " or ".join("(N, H, W, 3)" if each == 4 else "(H, W, 3)" for each in dimensions)
        message = (
            f"pictures are an array of shape {found.shape}, {found.dtype}; expected {expected}, uint8, or a "
            "clip, a round or touches"
        )
        raise InputError(message)
    return found


def difference(pictures: Pixels, background: Pixels, form: DifferenceForm = "signed") -> NDArray[Any]:
    """Return what changed against a background.

    Parameters
    ----------
    pictures : ndarray, shape (H, W, 3) or (N, H, W, 3), uint8
        One picture, or several.
    background : ndarray, shape (H, W, 3), uint8
        Such as :func:`background` gives.
    form : str
        ``"signed"``: picture - background; ``"grey"``: (picture - background + 256) // 2, in which 128 is no
        change and half of each difference is kept; ``"absolute"``: its absolute value.

    Returns
    -------
    ndarray, the shape of ``pictures``; int16 if signed, else uint8

    Raises
    ------
    InputError
        Arrays of other shapes or types, or another form.
    """
    if form not in DIFFERENCE_FORMS:
        message = f"no difference {form!r}; expected one of {', '.join(DIFFERENCE_FORMS)}"
        raise InputError(message)
    signed = _as_pictures(pictures, (3, 4)).astype(np.int16)
    base = _as_pictures(background, (3,))
    if signed.shape[-3:] != base.shape:
        message = f"the background has the shape {base.shape}; expected {signed.shape[-3:]}, as the pictures"
        raise InputError(message)
    signed -= base
    if form == "signed":
        return signed
    return (np.abs(signed) if form == "absolute" else (signed + 256) // 2).astype(np.uint8)


@dataclass(frozen=True)
class ContactRule:
    """When a picture shows contact.

    Attributes
    ----------
    min_change : int
        Grey levels above which a pixel has changed: grey of the absolute difference from the background.
    min_area_px : int
        Changed pixels from which a picture may show contact.
    min_intensity : float
        Mean grey of the changed pixels from which it does, levels.
    crop : float
        Share of height and width around the middle that is looked at, over 0 to 1.

    Notes
    -----
    The defaults are those of a known consumer of the published clips (median background of each clip, central
    half of the picture); see :func:`find_contacts`.
    """

    min_change: int = 10
    min_area_px: int = 40
    min_intensity: float = 12.0
    crop: float = 0.5

    def __post_init__(self) -> None:
        for name, least, most in (
            ("min_change", 0, 255),
            ("min_area_px", 0, 1 << 40),
            ("min_intensity", 0, 255),
            ("crop", 1e-6, 1),
        ):
            value = plain_number(getattr(self, name), float)
            if not isinstance(value, float) or not least <= value <= most:
                message = (
                    f"{name} of the contact rule is {getattr(self, name)!r}; expected {least:g} to {most:g}"
                )
                raise InputError(message)

    def holds(self, score: ContactScore) -> Any:
        """Tell whether pictures of such scores show contact: bool, or an array of them."""
        return (score.area_px >= self.min_area_px) & (score.intensity >= self.min_intensity)

    def window(self, height: int, width: int) -> tuple[slice, slice]:
        """Return rows and columns that are looked at."""
        margins = (round(height * (1 - self.crop) / 2), round(width * (1 - self.crop) / 2))
        rows, columns = (
            slice(margin, size - margin) for margin, size in zip(margins, (height, width), strict=True)
        )
        return rows, columns


@dataclass(frozen=True, eq=False)
class ContactScore:
    """How much of a picture changed, and by how much; numbers, or arrays of shape (N,) for N pictures.

    Attributes
    ----------
    area_px : int64
        Changed pixels.
    intensity : float64
        Mean grey of the changed pixels, levels; 0 where none has changed.
    """

    area_px: Any
    intensity: Any

    @property
    def weight(self) -> Any:
        """Grey levels of all changed pixels together: the picture of most weight shows the contact best."""
        return np.rint(self.area_px * self.intensity)


def contact_score(pictures: Pixels, background: Pixels, rule: ContactRule | None = None) -> ContactScore:
    """Score how clearly pictures show contact.

    Parameters
    ----------
    pictures : ndarray, shape (H, W, 3) or (N, H, W, 3), uint8
        One picture, or several.
    background : ndarray, shape (H, W, 3), uint8
        What they look like without contact.
    rule : ContactRule, optional
        Threshold of a changed pixel, and crop.

    Returns
    -------
    ContactScore

    Raises
    ------
    InputError
        As :func:`difference`.
    """
    rule = rule or ContactRule()
    found, base = _as_pictures(pictures, (3, 4)), _as_pictures(background, (3,))
    if found.shape[-3:] != base.shape:
        difference(found, base)  # says what is wrong
    rows, columns = rule.window(*base.shape[:2])
    score = _score(found.reshape(-1, *base.shape)[:, rows, columns], base[rows, columns], rule.min_change)
    return score if found.ndim == 4 else ContactScore(int(score.area_px[0]), float(score.intensity[0]))


def _score(pictures: Pixels, base: Pixels, min_change: int) -> ContactScore:
    area, total = np.zeros(len(pictures), np.int64), np.zeros(len(pictures), np.int64)
    for number, picture in enumerate(pictures):
        # The greater less the smaller stays within eight bits.
        change = (np.maximum(picture, base) - np.minimum(picture, base)).astype(np.int32)
        grey = (4899 * change[..., 0] + 9617 * change[..., 1] + 1868 * change[..., 2] + 8192) >> 14
        changed = grey[grey > min_change]
        area[number], total[number] = changed.size, changed.sum()
    return ContactScore(area, total / np.maximum(area, 1))


def best_frame(
    clip: TouchClip | Pixels, rule: ContactRule | None = None, *, base: Pixels | None = None
) -> tuple[int, ContactScore]:
    """Return the frame that shows the contact best, and its score.

    Parameters
    ----------
    clip : TouchClip, or ndarray of shape (N, H, W, 3), uint8
        At least one frame.
    rule : ContactRule, optional
        Threshold of a changed pixel, and crop. Whether the frame shows contact at all, ``rule.holds`` tells.
    base : ndarray, shape (H, W, 3), uint8, optional
        The background; by default the median of the clip.

    Returns
    -------
    frame : int
        The one with most :attr:`ContactScore.weight`, the earliest of equals.
    score : ContactScore

    Raises
    ------
    InputError
        There is no frame, or as :func:`difference`.
    IntegrityError
        A frame is damaged.
    """
    rule = rule or ContactRule()
    frames = clip.frames() if isinstance(clip, TouchClip) else _as_pictures(clip)
    if not len(frames):
        message = "the clip holds no frame; expected at least one"
        raise InputError(message)
    rows, columns = rule.window(*frames.shape[1:3])
    seen = frames[:, rows, columns]
    if base is None:
        scores = _score(seen, background(seen), rule.min_change)
    else:
        scores = contact_score(frames, base, rule)
    best = int(np.argmax(scores.weight))
    return best, ContactScore(int(scores.area_px[best]), float(scores.intensity[best]))


@dataclass(frozen=True, eq=False)
class Contacts:
    """The best picture of each touch, and whether it shows contact.

    Attributes
    ----------
    touches : Touches
        The touches, n of them.
    frame : ndarray of int64, shape (n,)
        Frame of the clip that shows the contact best; 0 in sets of images.
    area_px, intensity : ndarray of int64 and float64, shape (n,)
        Its score, see :class:`ContactScore`.
    contact : ndarray of bool, shape (n,)
        Whether it shows contact by the rule.
    """

    touches: Touches[Any]
    frame: NDArray[np.int64]
    area_px: NDArray[np.int64]
    intensity: NDArray[np.float64]
    contact: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.touches)

    def select(self, empties: float = 0.0, seed: int = 0) -> Contacts:
        """Return the touches with contact, and some without; see :meth:`Touches.sample`.

        Parameters
        ----------
        empties : float
            Share of touches without contact in what is returned, 0 to below 1, as far as there are any.
        seed : int
            Decides which.

        Raises
        ------
        InputError
            A share or seed that is none.
        """
        chosen = with_empties(self.touches, self.contact, empties, seed)
        return Contacts(
            self.touches[chosen],
            self.frame[chosen],
            self.area_px[chosen],
            self.intensity[chosen],
            self.contact[chosen],
        )

    def picture(self, index: int) -> Pixels:
        """Decode the best picture of one touch, shape (H, W, 3), uint8."""
        touch = self.touches[index]
        if isinstance(touch.round, TouchSingleRound):
            return touch.image
        return touch.clip[int(self.frame[index])]


def find_contacts(touches: Touches[Any], rule: ContactRule | None = None, *, threads: int = 1) -> Contacts:
    """Find the best picture of each touch, and tell by it whether there was contact.

    The background is the median of each clip; of images, which stand alone, the median of the round's images
    that are among these touches. With the defaults, ``find_contacts(touches).select(empties=0.015)`` is the
    selection of a known consumer, which kept 30,956 of the 153,600 touches.

    Parameters
    ----------
    touches : Touches
        ``rounds.touches()``, or a selection.
    rule : ContactRule, optional
        When a picture shows contact.
    threads : int
        How many clips to look at at a time.

    Returns
    -------
    Contacts

    Raises
    ------
    IntegrityError
        A picture is damaged; names file, row and touch.
    """
    rule, count = rule or ContactRule(), len(touches)
    frame, area = np.zeros(count, np.int64), np.zeros(count, np.int64)
    intensity = np.zeros(count)
    places = touches.round_positions

    def look(index: int) -> None:
        frame[index], score = best_frame(touches[index].clip, rule)
        area[index], intensity[index] = score.area_px, score.intensity

    def look_at_round(index: int) -> None:
        (chosen,) = np.nonzero(places == rounds[index])
        images = touches.images(chosen)
        score = contact_score(images, background(images), rule)
        area[chosen], intensity[chosen] = score.area_px, score.intensity

    rounds = np.unique(places)
    if count and isinstance(touches[0].round, TouchSingleRound):
        in_parallel(look_at_round, len(rounds), threads)
    else:
        in_parallel(look, count, threads)
    contact = np.asarray(rule.holds(ContactScore(area, intensity)), bool)
    return Contacts(touches, frame, area, intensity, contact)
