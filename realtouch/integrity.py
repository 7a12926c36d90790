"""Checks of files, which must have the same columns, and of rounds; all faults are listed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial

from realtouch import schema, sensor_images, stored_columns, stored_round, touch_clips
from tactile_toolkit import catalog, errors, read, run, wording
from tactile_toolkit.touch import CLASS_NAMES, MEDIA_COLUMN, decode_image, image_size

_NAMES_SHOWN = 12


def agreeing_files(
    shards: Iterable[read.Shard], where: str, left_out: list[stored_columns.Damage] | None = None
) -> list[read.Shard]:
    """Return the files of a data set that can be read and agree with the first of them.

    The damage of the other files is added to ``left_out``. Without such a list it is raised: InputError for a
    file without touches, IntegrityError for a file that is damaged or differs.
    """
    files: list[read.Shard] = []
    for shard in shards:
        try:
            if not files:
                schema.media_kind(shard.schema, where)
            schema.require_types(shard)
            if files:
                _require_agreement(shard, files)
            files.append(shard)
        except (errors.InputError, errors.IntegrityError) as error:
            if left_out is None or (isinstance(error, errors.InputError) and not files):
                raise
            left_out.append(stored_columns.unreadable_file(shard.path, error))
    return files


def _require_agreement(shard: read.Shard, files: Sequence[read.Shard]) -> None:
    """Refuse a file of another kind, or with other classes, than those before it; IntegrityError."""
    first = schema.media_kind(files[0].schema, files[0].path)
    if schema.media_kind(shard.schema, shard.path) != first:
        raise errors.IntegrityError(
            f"{shard.path!r}, field {MEDIA_COLUMN[first]!r}: the column is not there; expected it as in "
            f"{files[0].path!r}",
            next="open files of one data set together",
        )
    names, expected = shard.class_names, stated_class_names(files)
    if names is not None and expected is not None and names != expected:
        found, wanted = (", ".join(each[:_NAMES_SHOWN]) for each in (names, expected))
        raise errors.IntegrityError(
            f"{shard.path!r}, field 'label': the classes are named {found}; expected {wanted} as in the "
            "files before it",
            next="open them apart, or make them again",
        )


def stated_class_names(shards: Iterable[read.RowSource]) -> tuple[str, ...] | None:
    """Return the names of the classes of the first file that states any, or None."""
    return next((shard.class_names for shard in shards if shard.class_names is not None), None)


def class_names_of(shards: Iterable[read.RowSource]) -> tuple[str, ...]:
    """Return the names of the classes as the first file states them, or else those of the digits.

    Empty for data sets without labels.
    """
    files = list(shards)
    stated = stated_class_names(files)
    if stated is None and any("label" in shard.schema.names for shard in files):
        return CLASS_NAMES
    return stated or ()


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
) -> Iterator[tuple[stored_round.StoredRound | None, list[stored_columns.Damage]]]:
    """Yield all rows of row groups with the faults of each; None for unreadable rows.

    Arguments are as for :func:`check_round`; the result does not depend on the number of threads.
    """

    def checked(
        found: stored_round.StoredRound | stored_columns.Damage,
    ) -> tuple[stored_round.StoredRound | None, list[stored_columns.Damage]]:
        if isinstance(found, stored_columns.Damage):
            return None, [found]
        return found, check_round(found, expected_touches, decode=decode, class_names=class_names)

    return run.in_threads(checked, readable_rows(groups), workers)


def readable_rows(
    groups: Iterable[tuple[read.Shard, int]],
) -> Iterator[stored_round.StoredRound | stored_columns.Damage]:
    """Yield all rows; the damage stands for rows that cannot be read."""
    for shard, index in groups:
        try:
            yield from stored_round.rows_of(shard.blocks(index))
        except errors.IntegrityError as error:
            yield stored_columns.unreadable_rows(shard, index, error)


def check_round(
    row: stored_round.StoredRound,
    expected_touches: int | None = None,
    *,
    decode: bool = True,
    class_names: Sequence[str] | None = None,
) -> list[stored_columns.Damage]:
    """List the damage of one round: one entry per field of it, and one per field of each touch.

    ``expected_touches`` is the T that it must have, where that is known; the label must be one of
    ``class_names``, where those are stated. Without ``decode``, only headers of images and frames are read.
    """
    found: list[stored_columns.Damage] = []
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
            stored_columns.Damage(
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
def _noted(found: list[stored_columns.Damage], row: stored_round.StoredRound) -> Iterator[None]:
    """Add the damage to a list instead of raising it."""
    try:
        yield
    except stored_columns.DamagedRoundError as error:
        found.append(error.damage)
    except (errors.InputError, errors.IntegrityError) as error:
        found.append(stored_columns.Damage(row.path, row.number, None, "", error.what))
    except ValueError as error:
        found.append(stored_columns.Damage(row.path, row.number, None, "", str(error)))


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
        return size_of(sensor_images.SensorImages(row).encoded(touch))


def _clip_size(row: stored_round.StoredRound, touch: int, size_of: _SizeOf, noted: _Noted) -> tuple[int, ...]:
    """Return height and width of all frames of a clip; empty for a clip without frames."""
    clip = touch_clips.TouchClip(row, touch)
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
) -> Iterator[stored_columns.Damage]:
    """List the touches whose pictures differ in size from most of the round; on a tie, from the first."""
    known = {touch: size for touch, size in sizes.items() if size}
    modal = max(known.values(), key=list(known.values()).count, default=())
    for touch, size in known.items():
        if size != modal:
            yield stored_columns.Damage(
                row.path,
                row.number,
                touch,
                media,
                f"{_describe(size)}; expected {_describe(modal)} as of the other touches",
            )


def _describe(size: tuple[int, ...]) -> str:
    return f"{size[1]} x {size[0]} pixels"
