"""Making the folder of a gallery: staged beside its place, renamed when it is whole."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.index import IndexBuilder
from tactile_toolkit.gallery.items import Gallery, Item, ItemTask
from tactile_toolkit.gallery.library import viewer_library
from tactile_toolkit.gallery.staging import is_unfinished, staged_folder
from tactile_toolkit.gallery.texts import ASSETS, asset, content_script, index_script, page
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.folder import named_failures
from tactile_toolkit.versions import toolkit_version

__all__ = [
    "MARKER_FILE",
    "MOST_BYTES",
    "MOST_ITEMS",
    "Site",
    "SiteForecast",
    "build_site",
    "fixed_files",
    "forecast_site",
    "item_files",
    "marker",
    "require_place",
    "require_size",
]

MARKER_FILE = "gallery.json"
"""Says what a site is; only folders that hold it are ever replaced."""

MOST_ITEMS = 20_000
"""The page keeps its index in memory and is tested up to this many items."""

MOST_BYTES = 2_000_000_000
"""Larger sites are refused: nobody copies them to look at a data set."""

_JUDGED_AFTER = 24
_MARK = "tactile-toolkit gallery"
_OURS = {"items": r"\d{6}\.js", "thumbs": r"\d{6}\.png", "media": r"\d{6}-[\w.-]+", "assets": r"[\w.-]+"}
_TOP = ("LICENSES.txt", MARKER_FILE, "index.html", "items.js", *_OURS)


@dataclass(frozen=True, slots=True)
class Site:
    """A finished site.

    Attributes
    ----------
    path : str
        Its folder.
    items, files, bytes : int
        What it holds.
    splits : dict of str to int
        Items of each split.
    """

    path: str
    items: int
    files: int
    bytes: int
    splits: dict[str, int]


def build_site(
    gallery: Gallery,
    out: str,
    runner: Runner | int = 1,
    *,
    overwrite: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Site:
    """Make the site of a gallery; the same gallery gives the same bytes.

    Parameters
    ----------
    gallery : Gallery
        What to show.
    out : str
        Folder to make. It appears whole or not at all.
    runner : Runner or int
        Who makes the items, or how many worker processes do.
    overwrite : bool
        Replace a gallery that stands there. Anything else is never touched.
    on_progress : callable
        Told items done and in all.

    Raises
    ------
    InputError
        The folder holds something, there is nothing to show, or the site would be too large.
    StorageError
        The folder cannot be written, or the disk is full.
    """
    place = require_place(out, overwrite=overwrite)
    require_size(gallery)
    refuse = partial(_refuse_taken, place, overwrite=overwrite)
    with named_failures(str(place)), staged_folder(place, refuse) as staging:
        index = IndexBuilder(gallery)
        writer = _Writer(staging)
        for name, content in fixed_files(gallery).items():
            writer.write(name, content)
        on_progress(0, gallery.size)
        for items in _in_order(runner_for(runner), gallery.tasks):
            for item in items:
                for name, content in item_files(index.add(item), item).items():
                    writer.write(name, content)
            _refuse_bulk(writer.size, len(index), gallery.size)
            on_progress(len(index), gallery.size)
        writer.write("items.js", index_script(index.to_dict()).encode())
        writer.write(MARKER_FILE, marker(gallery))
    return Site(str(place), len(index), writer.files, writer.size, dict(gallery.splits))


def require_place(out: str, *, overwrite: bool) -> Path:
    """Return where a site may be made.

    Raises
    ------
    InputError
        Something stands there that may not be replaced.
    """
    if "://" in out:
        message = f"--out is {out!r}; a gallery is made in a local folder; next: make it there, then copy it"
        raise InputError(message)
    # Where a symbolic link leads: the link itself is not ours to replace.
    place = Path(os.path.realpath(Path(out).expanduser()))
    if place.is_dir():
        _refuse_taken(place, place, overwrite=overwrite)
    elif place.exists():
        raise _not_ours(place, place.name)
    return place


def _refuse_taken(place: Path, folder: Path, *, overwrite: bool) -> None:
    """Refuse a folder, or what was moved out of ``place`` into it, that may not be replaced."""
    names = sorted(entry.name for entry in folder.iterdir() if not is_unfinished(entry.name))
    stranger = _stranger(folder, names)
    if stranger is not None:
        raise _not_ours(place, stranger)
    if names and not overwrite:
        message = (
            f"{str(place)!r} holds a gallery already; nothing was changed; next: replace it with "
            "--overwrite, or choose another folder with --out"
        )
        raise InputError(message)


def _not_ours(place: Path, stranger: str) -> InputError:
    return InputError(
        f"{str(place)!r} holds {stranger!r}, which is no part of a gallery; nothing was changed; next: "
        "choose an empty or new folder with --out"
    )


def require_size(gallery: Gallery) -> None:
    """Refuse a gallery of no items, or of more than a page can show.

    Raises
    ------
    InputError
        In both cases.
    """
    one, many = gallery.nouns
    if gallery.size == 0:
        message = f"there is no {one} to show; next: choose another --split, or a data set that holds some"
        raise InputError(message)
    if gallery.size > MOST_ITEMS:
        message = (
            f"the gallery would show {gallery.size:,} {many}; the most is {MOST_ITEMS:,}; nothing was "
            "written; next: choose fewer with --limit, --split or --per-class"
        )
        raise InputError(message)


def fixed_files(gallery: Gallery) -> dict[str, bytes]:
    """Return the files that do not depend on the items, by path.

    Raises
    ------
    InputError
        The viewer's library is not where known releases of its package carry it.
    """
    library = viewer_library()
    ours = {f"assets/{name}": asset(name).encode() for name in ASSETS}
    return {
        "index.html": page(gallery.title).encode(),
        "LICENSES.txt": library.license_text.encode(),
        "assets/three.js": library.code.encode(),
        **ours,
    }


def item_files(number: int, item: Item) -> dict[str, bytes]:
    """Return the files of one item, by path."""
    name = f"{number:06d}"
    media = {f"media/{name}-{ending}": content for ending, content in item.media.items()}
    return {
        f"thumbs/{name}.png": item.thumbnail,
        f"items/{name}.js": content_script(number, item.content).encode(),
        **media,
    }


def marker(gallery: Gallery) -> bytes:
    """Return the file that tells a gallery from any other folder."""
    content = {"what": _MARK, "kind": gallery.kind, "items": gallery.size, "version": toolkit_version()}
    return (json.dumps(content, indent=1) + "\n").encode()


@dataclass
class _Writer:
    """Writes files below a folder and counts them."""

    folder: Path
    files: int = 0
    size: int = 0

    def write(self, name: str, content: bytes) -> None:
        place = self.folder / name
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(content)
        self.files += 1
        self.size += len(content)


@dataclass(frozen=True, slots=True)
class _Numbered:
    number: int
    task: ItemTask


def _make(numbered: _Numbered) -> tuple[int, list[Item]]:
    return numbered.number, numbered.task.make()


def _in_order(runner: Runner, tasks: tuple[ItemTask, ...]) -> Iterator[list[Item]]:
    """Yield the items of each task in the order of the tasks, whichever is finished first."""
    waiting: dict[int, list[Item]] = {}
    following = 0
    numbered = [_Numbered(*pair) for pair in enumerate(tasks)]
    with closing(cast("Generator[tuple[int, list[Item]]]", runner.run(_make, numbered))) as results:
        for number, items in results:
            waiting[number] = items
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _refuse_bulk(written: int, done: int, total: int) -> None:
    """Stop a site that grows too large as soon as that can be told."""
    forecast = written * total // max(done, 1)
    if written > MOST_BYTES or (done >= _JUDGED_AFTER and forecast > MOST_BYTES):
        message = (
            f"the gallery would take about {forecast / 1e9:.1f} GB; the most is {MOST_BYTES / 1e9:.0f} GB; "
            "what was written is removed; next: choose fewer with --limit, --split or --per-class"
        )
        raise InputError(message)


def _stranger(place: Path, names: list[str]) -> str | None:
    """Return something in a folder that is no part of a gallery."""
    if not _is_gallery(place):
        return names[0] if names else None
    for name in names:
        if name not in _TOP:
            return name
    for folder, pattern in _OURS.items():
        if (place / folder).is_dir():
            for entry in (place / folder).iterdir():
                if not re.fullmatch(pattern, entry.name):
                    return f"{folder}/{entry.name}"
    return None


def _is_gallery(place: Path) -> bool:
    try:
        marker = json.loads((place / MARKER_FILE).read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(marker, dict) and marker.get("what") == _MARK


_SAMPLED_TASKS = 3


@dataclass(frozen=True, slots=True)
class SiteForecast:
    """What a run would make.

    Attributes
    ----------
    items : int
        How many items are shown.
    files, bytes : int
        What the site would hold; from a sample, and exact where the sample is everything.
    seconds : float
        Time, from the same sample.
    sampled : int
        How many items were made for the estimate.
    fits : bool
        Whether a site of that size is made; larger ones are refused.
    splits : dict of str to int
        Items of each split.
    """

    items: int
    files: int
    bytes: int
    seconds: float
    sampled: int
    fits: bool
    splits: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast_site(gallery: Gallery, out: str, workers: int, *, overwrite: bool = False) -> SiteForecast:
    """Make a few items of a gallery, write nothing, and tell what all would take.

    Raises
    ------
    InputError
        As :func:`tactile_toolkit.gallery.site.build_site`.
    """
    require_place(out, overwrite=overwrite)
    require_size(gallery)
    fixed = fixed_files(gallery)
    index = IndexBuilder(gallery)
    files = size = 0
    start_s = time.monotonic()
    for task in _spread(gallery.tasks):
        for item in task.make():
            made = item_files(index.add(item), item)
            files += len(made)
            size += sum(map(len, made.values()))
    elapsed_s = time.monotonic() - start_s
    share = gallery.size / len(index)
    size += len(index_script(index.to_dict()))
    total = round(size * share) + sum(map(len, fixed.values())) + len(marker(gallery))
    return SiteForecast(
        items=gallery.size,
        files=round(files * share) + len(fixed) + 2,  # the index of items and the marker
        bytes=total,
        seconds=elapsed_s * share / max(1, min(workers, len(gallery.tasks))),
        sampled=len(index),
        fits=total <= MOST_BYTES,
        splits=dict(gallery.splits),
    )


def _spread(tasks: tuple[Any, ...]) -> list[Any]:
    """Choose some tasks, evenly from first to last."""
    if len(tasks) <= _SAMPLED_TASKS:
        return list(tasks)
    return [tasks[place * (len(tasks) - 1) // (_SAMPLED_TASKS - 1)] for place in range(_SAMPLED_TASKS)]
