"""Preparation for training: backgrounds, and contact by the picture."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from itertools import islice

import numpy as np

from realtouch import contact
from realtouch.touches import media, rounds
from realtouch.touches.datasets import AnyTouches, Touches
from tactile_toolkit import checked_fields, errors
from tactile_toolkit.value_types import Bool, Float64, Int64, UInt8

# 291 pictures of 320 x 240: a clip is one batch, a round of images also.
_BATCH_BYTES = 64 << 20

_MAX_SHARED = 256  # images; their median is the background of images that are the only ones of their rounds


def background(pictures: object) -> UInt8:
    """Return the median image, which shows the gel without contact.

    Parameters
    ----------
    pictures : TouchClip, TouchRound, Touches, TouchDataset, or array of shape (N, H, W, 3), uint8
        All frames of a clip, or all images or frames of a round or of touches. For the background of one gel,
        choose its rounds: ``background(rounds.filter(lambda r: r.info["gel_id"] ==
        "3"))``.

    Returns
    -------
    ndarray, shape (H, W, 3), uint8
        Exact median of each pixel and channel; for an even number of pictures, the mean of the two middle
        values, rounded down. Pictures that do not fit in memory are read twice, a few at a time.

    Raises
    ------
    InputError
        There is no picture, or the sizes of pictures differ.
    IntegrityError
        A picture is damaged, or of another size than those of its set.
    """
    base, _ = _with_median(pictures)
    return base


def _with_median(pictures: object) -> tuple[UInt8, Iterable[UInt8]]:
    """Return the median of pictures, and an iterator over batches of them; InputError if there are none."""
    first = list(islice(_batches(pictures), 2))
    if not first:
        raise errors.InputError(
            "no pictures to take a background of; expected a clip, a round or touches that hold any"
        )
    if len(first) == 1:
        return contact.median_in_memory(first[0]), first
    return contact.median_of(lambda: _batches(pictures)), _batches(pictures)


def _batches(pictures: object) -> Iterator[UInt8]:
    """Yield pictures a few at a time, shape (n, H, W, 3)."""
    if isinstance(pictures, rounds.TouchSingleRound):
        pictures = pictures.sensor_image
    if isinstance(pictures, (media.TouchClip, media.SensorImages)):
        yield from _pieces(len(pictures), pictures.__getitem__)
    elif isinstance(pictures, rounds.TouchSeqRound):
        for clip in pictures.sensor_video:
            yield from _batches(clip)
    elif isinstance(pictures, Touches) and len(pictures):
        if isinstance(pictures[0].round, rounds.TouchSingleRound):
            yield from _pieces(len(pictures), pictures.images)
        else:
            for touch in pictures:
                yield from _batches(touch.clip)
    elif hasattr(pictures, "touches"):
        yield from _batches(pictures.touches())
    elif not isinstance(pictures, Touches) and len(stack := contact.as_pictures(pictures)):
        yield stack


def _pieces(count: int, read: Callable[[slice], UInt8]) -> Iterator[UInt8]:
    if not count:
        return
    length = max(1, _BATCH_BYTES // read(slice(1)).nbytes)
    for start in range(0, count, length):
        yield read(slice(start, start + length))


def best_frame(
    clip: media.TouchClip | UInt8,
    rule: contact.ContactThresholds | None = None,
    *,
    base: UInt8 | None = None,
) -> tuple[int, contact.ContactScore]:
    """Return the frame that shows the contact best, and its score.

    Parameters
    ----------
    clip : TouchClip, or ndarray of shape (N, H, W, 3), uint8
        At least one frame.
    rule : ContactThresholds, optional
        Threshold of a changed pixel, and crop. ``rule.holds`` returns whether the frame shows contact at all.
    base : ndarray, shape (H, W, 3), uint8, optional
        The background; by default the median of the clip.

    Returns
    -------
    frame : int
        The one with the greatest :attr:`ContactScore.total_change`, the earliest of equals.
    score : ContactScore

    Raises
    ------
    InputError
        There is no frame, or as :func:`difference`.
    IntegrityError
        A frame is damaged.
    """
    if not isinstance(clip, media.TouchClip):
        return contact.best_of(contact.as_pictures(clip), rule, base)
    pieces = list(islice(_batches(clip), 2)) or [clip.frames()]
    if len(pieces) == 1:
        return contact.best_of(pieces[0], rule, base)
    # A clip that does not fit in memory is processed a few frames at a time.
    if base is None:
        base = background(clip)
    start = 0
    best = (0, contact.ContactScore(0, 0.0))
    for piece in _batches(clip):
        frame, score = contact.best_of(piece, rule, base)
        if start == 0 or score.total_change > best[1].total_change:
            best = start + frame, score
        start += len(piece)
    return best


def with_no_contact(touches: AnyTouches, contact: Bool, fraction: float, seed: int) -> Int64:
    """Return the positions of all touches with contact, and of a share of those without.

    Raises InputError for an invalid fraction, seed or mask.
    """
    share = checked_fields.to_builtin(fraction, float)
    number = checked_fields.checked_integer(seed, "the seed")
    mask = np.asarray(contact)
    if not isinstance(share, float) or not 0 <= share < 1:
        raise errors.InputError(f"no_contact_fraction is {fraction!r}; expected 0 to below 1")
    if mask.dtype != bool or mask.shape != (len(touches),):
        raise errors.InputError(
            f"contact is {mask.dtype} of shape {mask.shape}; expected bool of shape ({len(touches)},)"
        )
    (empty,) = np.nonzero(~mask)
    count = min(len(empty), round((len(touches) - len(empty)) * share / (1 - share)))
    if not count:
        return np.flatnonzero(mask)
    ids = touches.dataset.ids[touches.round_positions[empty]].tolist()
    texts = zip(ids, touches.touch_indices[empty].tolist(), strict=True)
    keys = [f"{number} {name} {touch}".encode() for name, touch in texts]
    drawn = [hashlib.blake2b(key, digest_size=16).digest() for key in keys]
    order = sorted(range(len(drawn)), key=drawn.__getitem__)[:count]
    return np.sort(np.concatenate([np.flatnonzero(mask), empty[order]]))


@dataclass(frozen=True, eq=False)
class ImageContacts:
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

    touches: AnyTouches
    frame: Int64
    area_px: Int64
    intensity: Float64
    contact: Bool

    def __len__(self) -> int:
        return len(self.touches)

    def select(self, no_contact_fraction: float = 0.0, seed: int = 0) -> ImageContacts:
        """Return the touches with contact, and some without; see :meth:`Touches.sample`.

        Parameters
        ----------
        no_contact_fraction : float
            Fraction of touches without contact in the result, 0 to below 1; less if there are too few.
        seed : int
            Decides which.

        Raises
        ------
        InputError
            An invalid fraction or seed.
        """
        chosen = with_no_contact(self.touches, self.contact, no_contact_fraction, seed)
        return ImageContacts(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def picture(self, index: int) -> UInt8:
        """Decode the best picture of one touch, shape (H, W, 3), uint8."""
        chosen = self.touches[index]
        if isinstance(chosen.round, rounds.TouchSingleRound):
            return chosen.image
        return chosen.clip[int(self.frame[index])]


def contacts_by_image(
    touches: AnyTouches, rule: contact.ContactThresholds | None = None, *, threads: int = 1
) -> ImageContacts:
    """Find the image of each touch that shows contact best, and decide whether there was contact.

    The background is the median of each clip; for single images, the median of those images of the round that
    are among these touches. Where that is one image, it is the median of such images of all rounds (some 256
    of them, if there are more). With the defaults, ``contacts_by_image(touches).select(0.015)`` is the
    selection of an earlier project, which kept 30,956 of the 153,600 touches.

    Parameters
    ----------
    touches : Touches
        ``rounds.touches()``, or a selection.
    rule : ContactThresholds, optional
        When a picture shows contact.
    threads : int
        Number of clips that are decoded at a time.

    Returns
    -------
    ImageContacts

    Raises
    ------
    InputError
        The argument is not a selection of touches.
    IntegrityError
        A picture is damaged; names file, row and touch.
    """
    argument: object = touches
    if not isinstance(argument, Touches):
        raise errors.InputError(
            f"a {type(argument).__name__} was given; expected touches, such as "
            "`realtouch.load(...).touches()`"
        )
    rule = rule or contact.ContactThresholds()
    frame, area = np.zeros((2, len(touches)), np.int64)
    score = contact.ContactScore(area, np.zeros(len(touches)))
    if len(touches) and isinstance(touches[0].round, rounds.TouchSingleRound):
        _measure_images(touches, rule, threads, score)
    else:
        _measure_clips(touches, rule, threads, frame, score)
    return ImageContacts(touches, frame, area, score.intensity, np.asarray(rule.holds(score), bool))


def _measure_clips(
    touches: AnyTouches,
    rule: contact.ContactThresholds,
    threads: int,
    frame: Int64,
    score: contact.ContactScore,
) -> None:
    """Fill in the best frame of each clip and its score."""

    def measure(index: int) -> None:
        frame[index], score_of_clip = best_frame(touches[index].clip, rule)
        score.area_px[index], score.intensity[index] = score_of_clip.area_px, score_of_clip.intensity

    media.in_parallel(measure, len(touches), threads)


def _measure_images(
    touches: AnyTouches, rule: contact.ContactThresholds, threads: int, score: contact.ContactScore
) -> None:
    """Fill in the score of each image; images of a round share their background."""
    positions = touches.round_positions
    _, sizes = np.unique(positions, return_counts=True)
    by_round = np.split(np.argsort(positions, kind="stable"), np.cumsum(sizes)[:-1])
    alone = np.array([chosen[0] for chosen in by_round if len(chosen) == 1], np.int64)
    shared = np.zeros(0, np.uint8)
    if len(alone):
        shared = background(touches[np.sort(alone)[:: len(alone) // _MAX_SHARED + 1]])

    def measure(index: int) -> None:
        chosen = by_round[index]
        base, batches = _with_median(touches[chosen])
        if len(chosen) == 1:
            base = shared
        done = 0
        for images in batches:
            scores = contact.contact_score(images, base, rule)
            part = chosen[done : done + len(images)]
            score.area_px[part], score.intensity[part] = scores.area_px, scores.intensity
            done += len(images)

    media.in_parallel(measure, len(by_round), threads)
