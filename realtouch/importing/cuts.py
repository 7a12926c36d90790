"""Cut the recordings of a source into touches as ``--cut`` says, and draw the cuts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath

import numpy as np
from scipy.ndimage import median_filter

from realtouch import contact, touch_options
from realtouch.contact import ContactThresholds
from realtouch.importing import fields, import_options, source_files, source_touches
from realtouch.touches import media
from realtouch.video import avi
from tactile_toolkit import errors, pictures, touch, wording
from tactile_toolkit.columns import column_types, tables, units
from tactile_toolkit.value_types import Bool, Float64, Int64, UInt8

RECORDING_COLUMNS = ("recording", "file")
_FRAME = "start_frame"
MAX_PICTURES = 64
"""Maximum number of recordings whose cuts are drawn; the first ones are."""
JOIN_S = 0.2
"""Longest gap between two runs of contact that are joined to one touch, in seconds."""
JOIN_PICTURES = 5
"""The same limit for recordings without times, in pictures."""
MIN_PICTURES = 3
"""Minimum number of pictures with contact in a touch."""
MIN_MARGIN = 12
"""Minimum number of pictures before and after a contact; fewer where the next touch is close."""
# Pictures spread over the recording, from which the background is made.
_MAX_SAMPLES = 48
_MIN_SAMPLES = 5
_SAMPLE_BYTES = 64 << 20
_MIN_AT_REST = 3
_LIGHT_WINDOW = 9  # samples; the level of the light is a running median over them
_DARK = 16  # grey level; below it, the ratio of two pixels is mostly noise
_PIXEL_STEP = 2
_TILE_PX = 108
_GAP_PX = 8
_TILES_PER_ROW = 10
_MAX_TILES = 60
_WIDTH_PX = _TILES_PER_ROW * (_TILE_PX + _GAP_PX) - _GAP_PX
_STRIP_PX = 72
_GREY = (238, 240, 242)
_CLIP = (198, 222, 240)
_CONTACT = touch_options.ORANGE
_CURVE, _LIMIT = touch_options.BLUE, touch_options.VERMILION


class CutTable:
    """A table with a row for each touch; a row belongs to one recording.

    Raises
    ------
    InputError
        There is no table at ``path``, or it does not say when touches start and end.
    """

    def __init__(self, path: str, columns: import_options.ImportColumns) -> None:
        home, name = source_files.source_of(path)
        if not home.exists(name):
            raise errors.InputError(
                f"no cut {path!r}{wording.did_you_mean(path, source_touches.CUTS)}; expected "
                f"{', '.join(source_touches.CUTS)} or the path of a table"
            )
        self._address = home.address(name)
        self._table = source_files.read_table(tables.Table.of(home, name), columns, RECORDING_COLUMNS)
        names = [*self._table.columns]
        known = [_FRAME, *(f"start_{unit}" for unit in units.Quantity.TIME.per_unit)]
        if columns.time_unit:
            known.append("start")
        starts = [name for name in known if name in names]
        if len(starts) != 1:
            columns_text = " and ".join(starts) or ", ".join(map(str, names)) or "none"
            raise errors.InputError(
                f"{self._address!r} needs one column for the start of touches and one for the end; "
                f"found columns {columns_text}",
                next="name the columns start_s and end_s (or _ms, _us, _ns), or start_frame and end_frame",
            )
        (self._start_column,) = starts
        self._end_column = self._start_column.replace("start", "end")
        self._recording_column = next((name for name in RECORDING_COLUMNS if name in names), None)
        self._own_columns = list(filter(None, (self._start_column, self._end_column, self._recording_column)))
        source_files.require_columns(names, self._own_columns, self._address)
        # Another name than "start" states the unit.
        self._time_unit = columns.time_unit if self._start_column == "start" else None
        self.has_times = self._start_column != _FRAME
        self._recording_of_row: dict[int, str] = {}
        self._stated_recordings = [""] * self._table.rows
        if self._recording_column is not None:
            self._stated_recordings = [
                source_files.path_of(text) for text in self._table.texts(self._recording_column)
            ]
        self._rows_that_state: dict[str, list[int]] = {}
        for row, stated in enumerate(self._stated_recordings):
            self._rows_that_state.setdefault(stated, []).append(row)

    def touches_of(self, recording: source_touches.Recording) -> source_touches.SourceTouches:
        """Return the touches of a recording in the order of the table.

        A touch that cannot be cut has a problem. Raises InputError if a row fits several recordings.
        """
        clips = []
        clock: errors.ItemError | tuple[Float64, float]
        try:
            clock = self._clock_of(recording)  # once, since a table may have a row for each picture
        except errors.ItemError as error:
            clock = error
        for count, row in enumerate(self._rows_of(recording)):
            owner = self._recording_of_row.setdefault(row, recording.name)
            if owner != recording.name:
                raise errors.InputError(
                    f"{self._address!r}: row {row + 1:,} could mean {owner!r} or {recording.name!r}",
                    next=f"write whole paths below the source, in a column {RECORDING_COLUMNS[0]!r}",
                )
            name = f"{recording.name}_{count:03d}"
            try:
                if isinstance(clock, errors.ItemError):
                    raise clock
                start, stop = self._interval(*clock, row)
            except errors.ItemError as error:
                clips.append(recording.unusable(error, name))
                continue
            values = self._table.values(row)
            fields = {key: value for key, value in values.items() if key not in self._own_columns}
            clips.append(source_touches.Clip(start, stop, name, fields=fields))
        if not clips:
            problem = errors.ItemError("cut", f"no row of {self._address!r} names this recording")
            clips = [recording.unusable(problem)]
        return recording.clips(clips)

    def unused(self) -> source_touches.SourceTouches:
        """Return the rows whose recording was not found, each with this problem."""
        rows = [row for row in range(self._table.rows) if row not in self._recording_of_row]
        problems = {}
        for index, row in enumerate(rows):
            stated = fields.shown(self._stated_recordings[row])
            problems[index] = errors.ItemError(
                "recording", f"names {stated!r}; expected a recording of the source"
            )
        names = [f"row {row + 1} of the cuts" for row in rows]
        return source_touches.SourceTouches.of(names, self._address, "", {}, problems=problems)

    def _rows_of(self, recording: source_touches.Recording) -> Sequence[int]:
        """Return the rows of a recording; all rows if no column names recordings."""
        if self._recording_column is None:
            return range(self._table.rows)
        path = PurePosixPath(recording.path)
        without_ending = recording.path.removesuffix(path.suffix)
        names = {recording.name, recording.path, path.name, without_ending, path.stem} - {""}
        return sorted(row for name in names for row in self._rows_that_state.get(name, ()))

    def _clock_of(self, recording: source_touches.Recording) -> tuple[Float64, float]:
        """Return the times of a recording in the unit of the table, shape (frames,), and the usual step.

        Raises ItemError if the recording cannot be used.
        """
        problem = recording.problem
        if problem is not None:
            raise problem
        times = recording.time_s
        if self._start_column == _FRAME:
            times = np.arange(recording.frames, dtype=np.float64)
        if times is None:
            raise errors.ItemError(
                "times", "the recording has no times", next="state start_frame and end_frame"
            )
        return times, float(np.median(np.diff(times))) if len(times) > 1 else 0.0

    def _interval(self, times: Float64, tolerance: float, row: int) -> tuple[int, int]:
        """Return the number of the first picture of a touch and of the one after its last.

        Raises ItemError if the row cannot be used.
        """
        ends = [self._table.columns[name].slice(row, 1) for name in (self._start_column, self._end_column)]
        first, last = fields.times_s(column_types.joined(ends), self._start_column, self._time_unit).tolist()
        start = int(times.searchsorted(first))
        stop = int(times.searchsorted(last, side="right"))
        if start >= stop or first < times[0] - tolerance or last > times[-1] + tolerance:
            raise errors.ItemError(
                "interval",
                f"{self._start_column} is {first:g}, {self._end_column} {last:g}; expected pictures of the "
                f"recording, which lasts from {times[0]:g} to {times[-1]:g}",
            )
        return start, stop


class Cutter:
    """Cuts the recordings of a source into touches.

    Parameters
    ----------
    cut : str or None
        One of :data:`CUTS`, or the path of a table of touches; None cuts each recording as it states itself.
    contents : callable
        Reads the pictures of touches in the format of the source.
    columns : ImportColumns, optional
        Its unit of time applies to the columns ``start`` and ``end`` of a table, whose names state none.
    default : str
        One of the first two of :data:`CUTS`, for recordings that state no cut.

    Attributes
    ----------
    pictures : dict
        Drawings of the cuts found by contact, as PNG, by the name of the recording with ``-`` for ``/``;
        complete after the last recording.
    reads_times : bool
        Whether the cuts are those of a table with times.
    done : str
        How the last recording was cut: one of :data:`CUTS`, or "table"; empty before the first recording.

    Raises
    ------
    InputError
        ``cut`` is neither one of those names nor a table of touches.
    """

    def __init__(
        self,
        cut: str | None,
        contents: source_files.ReadContents,
        columns: import_options.ImportColumns | None = None,
        default: str = "frames",
    ) -> None:
        self.pictures: dict[str, bytes] = {}
        self.done = ""
        self.reads_times = False
        self._cut, self._contents, self._default, self._rule = cut, contents, default, ContactThresholds()
        self._table = None
        if cut is not None and cut not in source_touches.CUTS:
            self._table = CutTable(cut, columns or import_options.ImportColumns())
            self.reads_times = self._table.has_times

    def cut(self, recording: source_touches.Recording) -> source_touches.SourceTouches:
        """Return the touches of a recording in order; a recording that cannot be cut is one touch.

        That touch has the problem. Raises InputError if a row of a table fits several recordings.
        """
        recording = recording.checked()
        if self._table is not None:
            self.done = "table"  # not its path: paths are not recorded in a data set
            return self._table.touches_of(recording)
        self.done = self._cut or recording.cut or self._default
        if recording.problem is None and self.done == "contact":
            return recording.clips(list(self._by_contact(recording)))
        return source_touches.touches_of(recording, self.done)

    def unused(self) -> list[source_touches.SourceTouches]:
        """Return the rows of a table whose recordings were not found, each with this problem."""
        return [] if self._table is None else [self._table.unused()]

    def _by_contact(self, recording: source_touches.Recording) -> Iterator[source_touches.Clip]:
        try:
            contacts = find_contacts(recording, self._contents, self._rule)
        except errors.ItemError as error:
            yield recording.unusable(error)
            return
        if len(self.pictures) < MAX_PICTURES:
            name = recording.name.replace("/", "-")
            self.pictures[name] = draw_cuts(recording, contacts, self._contents, self._rule)
        for number, run in enumerate(contacts.runs):
            name = f"{recording.name}_{number:03d}"
            yield source_touches.Clip(
                run.start, run.stop, name, (run.first - run.start, run.last - run.start)
            )


@dataclass(frozen=True, slots=True)
class ContactRun:
    """A touch as numbers of pictures: start and stop of its clip, first and last contact, best picture."""

    start: int
    stop: int
    first: int
    last: int
    best: int


@dataclass(frozen=True, slots=True, eq=False)
class ContactRuns:
    """The touches of a recording, in order, and how they were found.

    Attributes
    ----------
    area_px : ndarray of int64, shape (frames,)
        Changed pixels of each picture; 0 if it cannot be read.
    runs : tuple of ContactRun
    too_short : int
        Number of runs with fewer than :data:`MIN_PICTURES` pictures with contact.
    unreadable : int
        Number of pictures that cannot be read, or are of another size.
    """

    area_px: Int64 = field(repr=False)
    runs: tuple[ContactRun, ...]
    too_short: int
    unreadable: int


def pictures_of(
    recording: source_touches.Recording, parts: Iterable[range], contents: source_files.ReadContents
) -> Iterator[UInt8 | None]:
    """Yield the pictures of some ranges, in order, shape (H, W, 3); None for an unreadable picture."""
    locations = (recording.location(part.start, part.stop) for part in parts)
    for content in contents(locations):
        try:
            yield None if isinstance(content, errors.ItemError) else touch.decode_image(content)
        except ValueError:
            yield None


class GelAtRest:
    """The background of each picture of a recording, within the window of the rule.

    The first background is the median of samples: pictures spread over the recording. The final one is the
    median of the samples that show no contact against the first. It is right where every pixel is at rest in
    more than half of the samples. The background follows slow changes of the light: each channel is scaled by
    its level in the samples, smoothed by a running median, which touches do not change. The samples are kept
    in memory, cropped.

    Raises ItemError if no sample can be read.
    """

    def __init__(
        self,
        recording: source_touches.Recording,
        contents: source_files.ReadContents,
        rule: contact.ContactThresholds,
    ) -> None:
        self.shape: tuple[int, ...] = ()
        cropped = self._read_samples(recording, contents, rule)
        self._numbers, samples = list(cropped), np.stack(list(cropped.values()))
        self._base = contact.median_in_memory(samples)
        self._levels = self._levels_of(samples)
        uncropped = replace(rule, crop=1.0)
        shows_contact = np.array(
            [
                rule.holds(contact.contact_score(sample, self.at(number), uncropped))
                for number, sample in cropped.items()
            ]
        )
        at_rest = ~shows_contact
        if at_rest.sum() >= _MIN_AT_REST:
            levels = np.float32(self._levels[at_rest, np.newaxis, np.newaxis])
            same_light = np.minimum(np.rint(samples[at_rest] / levels), 255).astype(np.uint8)
            self._base = contact.median_in_memory(same_light)
            self._levels = self._levels_of(samples)

    def _read_samples(
        self,
        recording: source_touches.Recording,
        contents: source_files.ReadContents,
        rule: contact.ContactThresholds,
    ) -> dict[int, UInt8]:
        """Return samples by their number, cropped; the first readable one sets shape and window."""
        spread = media.evenly_spaced(recording.frames, _MAX_SAMPLES)
        samples: dict[int, UInt8] = {}
        step = 1
        pictures_read = pictures_of(recording, (range(number, number + 1) for number in spread), contents)
        for index, (number, picture) in enumerate(zip(spread, pictures_read, strict=False)):
            if picture is not None and not self.shape:
                self.shape, self.window = picture.shape, rule.window(*picture.shape[:2])
                fitting = max(_MIN_SAMPLES, _SAMPLE_BYTES // picture[self.window].nbytes)
                step = -(-_MAX_SAMPLES // fitting)
            cropped = self.cropped(picture)
            if cropped is not None and (index % step == 0 or not samples):
                samples[number] = cropped.copy()
        if not samples:
            raise errors.ItemError("image", f"none of {len(spread):,} pictures of the recording can be read")
        return samples

    def cropped(self, picture: UInt8 | None) -> UInt8 | None:
        """Return the window of a picture; None if it is unreadable or of another size."""
        if picture is None or picture.shape != self.shape:
            return None
        return picture[self.window]

    def at(self, number: int) -> UInt8:
        """Return the background of the picture with this number."""
        levels = np.array(
            [np.interp(number, self._numbers, channel) for channel in self._levels.T], np.float32
        )
        background: UInt8 = np.minimum(np.rint(self._base * levels), 255).astype(np.uint8)
        return background

    def _levels_of(self, pictures: UInt8) -> Float64:
        """Return the levels of n samples relative to the background, (n, 3) channels, smooth in time."""
        levels = np.ones((len(pictures), 3))
        parts, base = (pixels[..., ::_PIXEL_STEP, ::_PIXEL_STEP, :] for pixels in (pictures, self._base))
        for channel in range(3):
            bright = base[..., channel] >= _DARK
            if bright.any():
                ratios = parts[:, bright, channel] / base[bright, channel].astype(np.float32)
                levels[:, channel] = np.median(ratios, axis=1)
        smooth: Float64 = median_filter(levels, (_LIGHT_WINDOW, 1), mode="nearest")
        return smooth


def find_contacts(
    recording: source_touches.Recording,
    contents: source_files.ReadContents,
    rule: contact.ContactThresholds,
) -> ContactRuns:
    """Find the touches of a recording; ItemError if it has none, or if no picture can be read."""
    area_px, change = np.zeros((2, recording.frames), np.int64)
    holds = np.zeros(recording.frames, bool)
    unreadable = 0
    background = GelAtRest(recording, contents, rule)
    uncropped = replace(rule, crop=1.0)
    numbers = range(recording.frames)
    for number, picture in zip(numbers, pictures_of(recording, [numbers], contents), strict=False):
        cropped = background.cropped(picture)
        if cropped is None:
            unreadable += 1
            continue
        score = contact.contact_score(cropped, background.at(number), uncropped)
        area_px[number], change[number], holds[number] = score.area_px, score.total_change, rule.holds(score)
    starts, stops = _joined(holds, recording.time_s)
    counts = [int(holds[start:stop].sum()) for start, stop in zip(starts, stops, strict=True)]
    long = np.array(counts, np.int64) >= MIN_PICTURES
    runs = tuple(_with_margins(starts[long], stops[long], change))
    if not runs:
        raise errors.ItemError(
            "contact",
            f"no touch in {recording.frames:,} pictures; a touch needs {MIN_PICTURES} pictures in which "
            f"{rule.min_area_px:,} pixels differ by more than {rule.min_change} levels from the gel at rest",
            next="take it whole (`--cut whole`), or give a table of its touches (`--cut TABLE`)",
        )
    return ContactRuns(area_px, runs, int(np.sum(~long)), unreadable)


def _joined(holds: Bool, time_s: Float64 | None) -> tuple[Int64, Int64]:
    """Return the starts and stops of runs of pictures with contact; close runs are joined."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]])))
    starts = edges[::2]
    stops = edges[1::2]
    if not len(starts):
        return starts, stops
    if time_s is None:
        is_far = starts[1:] - stops[:-1] > JOIN_PICTURES
    else:
        is_far = time_s[starts[1:]] - time_s[stops[:-1] - 1] > JOIN_S
    return starts[np.append(True, is_far)], stops[np.append(is_far, True)]


def _with_margins(starts: Int64, stops: Int64, change: Int64) -> Iterator[ContactRun]:
    """Yield each run as a clip with margins as long as the contact, at most half way to the next run."""
    middles = (stops[:-1] + starts[1:]) // 2
    limits = [0, *middles.tolist(), len(change)]
    for number, (start, stop) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
        margin = min(max(stop - start, MIN_MARGIN), max(0, avi.MAX_CLIP_FRAMES - (stop - start)) // 2)
        best = start + int(np.argmax(change[start:stop]))
        yield ContactRun(
            max(start - margin, limits[number]), min(stop + margin, limits[number + 1]), start, stop - 1, best
        )


def draw_cuts(
    recording: source_touches.Recording,
    contacts: ContactRuns,
    contents: source_files.ReadContents,
    rule: contact.ContactThresholds,
) -> bytes:
    """Draw the cuts of a recording as PNG: a strip of all pictures, and the best picture of each touch.

    If there are many touches, only the first ones are shown by a picture.
    """
    best = [run.best for run in contacts.runs[:_MAX_TILES]]
    best_pictures = pictures_of(recording, [range(frame, frame + 1) for frame in best], contents)
    tiles = [
        pictures.Tile(_small(picture), f"{number:03d}: #{frame:,}")
        for number, (frame, picture) in enumerate(zip(best, best_pictures, strict=True))
        if picture is not None
    ]
    touches = wording.with_count(len(contacts.runs), "touches")
    frames = f"{recording.frames:,} pictures"
    captions = [
        f"{touches} in {frames}: "
        f"{rule.min_area_px} changed pixels or more (red line), by {rule.min_intensity:g} levels on average",
        "height: square root of the changed pixels; orange: contact; blue: margin of the clip; "
        f"{contacts.too_short:,} too short, {wording.with_count(contacts.unreadable, 'unreadable pictures')}",
    ]
    strip = pictures.sheet([pictures.Tile(_strip(contacts, rule))], 1, recording.name, captions)
    small = pictures.sheet(tiles, _TILES_PER_ROW, gap_px=_GAP_PX)
    width = max(strip.shape[1], small.shape[1])
    parts = [
        np.pad(part, ((0, 0), (0, width - part.shape[1]), (0, 0)), "edge")  # the edge is blank
        for part in (strip, small)
    ]
    return touch.encode_image(np.vstack(parts), "png")


def _small(picture: UInt8) -> UInt8:
    height, width = picture.shape[:2]
    scale = _TILE_PX / max(height, width)
    return touch.resized(picture, max(1, round(scale * width)), max(1, round(scale * height)))


def _strip(contacts: ContactRuns, rule: contact.ContactThresholds) -> UInt8:
    """Draw the changed area over all pictures; a column shows the largest area of its pictures."""
    frames = len(contacts.area_px)
    colours = np.full((_WIDTH_PX, 3), _GREY, np.uint8)
    clips = [(run.start, run.stop - 1, _CLIP) for run in contacts.runs]
    for first, last, colour in [*clips, *((run.first, run.last, _CONTACT) for run in contacts.runs)]:
        colours[first * _WIDTH_PX // frames : last * _WIDTH_PX // frames + 1] = colour
    edges = np.arange(_WIDTH_PX) * frames // _WIDTH_PX
    heights = np.sqrt([*np.maximum.reduceat(contacts.area_px, edges), rule.min_area_px])
    *heights, limit = (heights / heights.max() * (_STRIP_PX - 1)).round()
    above = np.arange(_STRIP_PX)[::-1, np.newaxis]
    strip = np.repeat(colours[np.newaxis], _STRIP_PX, axis=0)
    strip[(above <= heights) & (np.array(heights) > 0)] = _CURVE
    strip[above[:, 0] == limit] = _LIMIT
    return strip
