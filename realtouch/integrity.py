"""Checks of files, which must have the same columns, and of rounds; all faults are listed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial

from realtouch import damage, media, schema, stored_round
from tactile_toolkit import catalog, errors, read, run, wording
from tactile_toolkit.touch import MEDIA_COLUMN, decode_image, image_size


def modal_touch_count(shards: Sequence[read.Shard]) -> int | None:
    """Return the T that every round of a data set must have: the T of more than half of its readable rounds.

    None if rounds may differ: if there is no such T, or if the set has a manifest. Imported and selected
    rounds differ in length, and the manifest has their checksums.
    """
    if shards and catalog.manifest_beside(shards[0]) is not None:
        return None
    counts: Counter[int] = Counter()
    for shard, index in read.row_groups(shards):
        with suppress(errors.IntegrityError):
            counts.update(stored_round.stored_touch_counts(shard, index).tolist())
    return next((count for count, rounds in counts.items() if 2 * rounds > counts.total()), None)


def checked_rows(
    groups: Iterable[tuple[read.Shard, int]],
    expected_touches: int | None,
    class_names: Sequence[str] | None,
    *,
    decode: bool = True,
    workers: int = 1,
) -> Iterator[tuple[stored_round.StoredRound | None, list[damage.Damage]]]:
    """Yield all rows of row groups with the faults of each; None for unreadable rows.

    Arguments are as for :func:`check_round`; the result does not depend on the number of threads.
    """

    def checked(
        found: stored_round.StoredRound | damage.Damage,
    ) -> tuple[stored_round.StoredRound | None, list[damage.Damage]]:
        if isinstance(found, damage.Damage):
            return None, [found]
        return found, check_round(found, expected_touches, decode=decode, class_names=class_names)

    return run.in_threads(checked, readable_rows(groups), workers)


def readable_rows(
    groups: Iterable[tuple[read.Shard, int]],
) -> Iterator[stored_round.StoredRound | damage.Damage]:
    """Yield all rows; the damage stands for rows that cannot be read."""
    for shard, index in groups:
        try:
            yield from stored_round.rows_of(shard.blocks(index))
        except errors.IntegrityError as error:
            yield damage.unreadable_rows(shard, index, error)


def check_round(
    row: stored_round.StoredRound,
    expected_touches: int | None = None,
    *,
    decode: bool = True,
    class_names: Sequence[str] | None = None,
) -> list[damage.Damage]:
    """List the damage of one round: one entry per field of it, and one per field of each touch.

    ``expected_touches`` is the T that it must have, where that is known; the label must be one of
    ``class_names``, where those are stated. Without ``decode``, only headers of images and frames are read.
    """
    found: list[damage.Damage] = []
    noted = partial(_noted, found, row)
    scalars: dict[str, Callable[[], object]] = {
        "id": row.name,
        "object_id": partial(row.integer, "object_id"),
        "label": partial(row.label_value, class_names),
    }
    checks = [row.read_info] if row.has_info() else list[Callable[[], object]]()
    for check in [*checks, *(scalars[name] for name in filter(row.has, scalars))]:
        with noted():
            check()
    for name in schema.per_touch_columns(row.group.names):
        with noted():
            # A list of fixed length would hide a null.
            if not row.group.arrow(name)[row.index].is_valid:
                raise row.damaged(name, "no values are stored")
            row.entries_of(name)
        if found and found[-1].field == "pos_in_cell":
            return found  # the number of touches is unknown
    count = row.touch_total()
    if expected_touches is not None and count != expected_touches:
        found.append(
            damage.Damage(
                row.path,
                row.number,
                None,
                "pos_in_cell",
                f"{wording.with_count(count, 'touches')}; expected {expected_touches} as in the other rounds",
            )
        )
    for name in schema.extra_columns(row.group.names):
        with noted():
            row.extra_values(name)
    sizes = _check_touches(row, count, noted, decode=decode)
    # Several fields may report the same fault.
    return list(dict.fromkeys([*found, *_odd_sizes(row, sizes, MEDIA_COLUMN[row.kind])]))


def _check_touches(
    row: stored_round.StoredRound, count: int, noted: _Noted, *, decode: bool
) -> dict[int, tuple[int, ...]]:
    """Check position, pose and picture of each touch; return height and width of the pictures."""
    read_pose: Callable[[int], object] = row.poses
    picture_size: _PictureSize = _image_size
    size_of: _SizeOf = image_size
    if row.kind == "seq":
        read_pose, picture_size = row.pose_sequences, _clip_size
    if decode:
        size_of = _decoded_size
    start, stop = row.column_of(MEDIA_COLUMN[row.kind]).inside(0, row.index, row.index + 1)
    sizes: dict[int, tuple[int, ...]] = {}
    for touch in range(count):
        if row.has("pos_in_cell"):
            with noted():
                row.intended_positions(touch)
        if row.has_poses and row.has(f"{schema.POSE_COLUMN[row.kind]}.quaternion"):
            with noted():
                read_pose(touch)
        if touch < stop - start:  # if images or clips are missing, the others are checked
            with noted():
                sizes[touch] = picture_size(row, touch, size_of, noted)
    return sizes


@contextmanager
def _noted(found: list[damage.Damage], row: stored_round.StoredRound) -> Iterator[None]:
    """Add the damage to a list instead of raising it."""
    try:
        yield
    except damage.DamagedRoundError as error:
        found.append(error.damage)
    except (errors.InputError, errors.IntegrityError) as error:
        found.append(damage.Damage(row.path, row.number, None, "", error.what))
    except ValueError as error:
        found.append(damage.Damage(row.path, row.number, None, "", str(error)))


def _decoded_size(data: bytes | memoryview) -> tuple[int, int]:
    height, width, _ = decode_image(data).shape
    return height, width


_SizeOf = Callable[[memoryview], tuple[int, int]]
_Noted = Callable[[], AbstractContextManager[None]]
_PictureSize = Callable[[stored_round.StoredRound, int, _SizeOf, _Noted], tuple[int, ...]]


def _image_size(
    row: stored_round.StoredRound, touch: int, size_of: _SizeOf, _noted: _Noted
) -> tuple[int, ...]:
    """Return height and width of an image."""
    with row.naming("sensor_image", touch):
        return size_of(media.SensorImages(row).encoded(touch))


def _clip_size(row: stored_round.StoredRound, touch: int, size_of: _SizeOf, noted: _Noted) -> tuple[int, ...]:
    """Return height and width of all frames of a clip; empty for a clip without frames."""
    clip = media.TouchClip(row, touch)
    with noted():
        if row.has("touch_start_time_rel") and row.has("touch_end_time_rel"):
            _ = clip.contact_window
        else:
            _ = clip.timestamps_s
    first: tuple[int, ...] = ()
    for frame in range(len(clip)):
        with row.naming("sensor_video", touch, f"frame {frame}: "):
            size = size_of(clip.encoded(frame))
            first = first or size
            if size != first:
                raise ValueError(f"{_describe(size)}; expected {_describe(first)} as of the first frame")
    return first


def _odd_sizes(
    row: stored_round.StoredRound, sizes: dict[int, tuple[int, ...]], media: str
) -> Iterator[damage.Damage]:
    """List the touches whose pictures differ in size from most of the round; on a tie, from the first."""
    known = {touch: size for touch, size in sizes.items() if size}
    modal = max(known.values(), key=list(known.values()).count, default=())
    for touch, size in known.items():
        if size != modal:
            yield damage.Damage(
                row.path,
                row.number,
                touch,
                media,
                f"{_describe(size)}; expected {_describe(modal)} as of the other touches",
            )


def _describe(size: tuple[int, ...]) -> str:
    return f"{size[1]} x {size[0]} pixels"
