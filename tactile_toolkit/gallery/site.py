"""Making the folder of a gallery: staged beside its path, renamed when it is whole."""

from __future__ import annotations

import filecmp
import json
import os
import re
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import Gallery, Item, ItemTask
from tactile_toolkit.gallery.page import (
    ASSETS,
    IndexBuilder,
    asset,
    content_script,
    index_script,
    page,
    viewer_library,
)
from tactile_toolkit.gallery.staging import is_unfinished, staged_folder
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.folder import expanded, named_failures
from tactile_toolkit.versions import toolkit_version

__all__ = ["MARKER_FILE", "MOST_BYTES", "MOST_ITEMS", "Site", "SiteForecast", "build_site", "forecast_site"]

MARKER_FILE = "gallery.json"
"""What a site is, and its files; nothing else is ever replaced."""

MOST_ITEMS = 20_000
"""The page keeps its index in memory and is tested up to this many items."""

MOST_BYTES = 2_000_000_000
"""Larger sites are refused: nobody copies them to look at a data set."""

# The first few items may be unusually large.
_JUDGED_AFTER = 24
_SAMPLED_TASKS = 3
_MARK = "tactile-toolkit gallery"
# The files of older galleries, whose marker does not list them.
_UNLISTED = re.compile(
    r"LICENSES\.txt|index\.html|items\.js|items/\d{6}\.js|thumbs/\d{6}\.png|media/\d{6}-[\w.-]+|"
    r"assets/(page\.css|(dialog|film|filters|grid|page|state|theme|three|viewer)\.js)"
)


@dataclass(frozen=True, slots=True)
class Site:
    """A finished site: its folder, what it holds, and how many items of each split."""

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
    """Make the site of a gallery in a folder that appears whole or not at all; equal galleries, equal bytes.

    ``overwrite`` replaces another gallery that is there; the same one may be there, so that a run can be
    repeated; anything else is never touched. InputError: the folder holds something, there is nothing to
    show, or the site would be too large. StorageError: it cannot be written, or the disk is full.
    """
    path = _require_free(gallery, out, overwrite=overwrite)
    _require_size(gallery)

    def refuse(folder: Path, staging: Path) -> None:
        _refuse_unknown(path, folder)
        if not overwrite and not _is_part_of(folder, staging):
            raise _taken(path)

    with named_failures(str(path)), staged_folder(path, refuse, MARKER_FILE) as staging:
        index = IndexBuilder(gallery)
        writer = _Writer(staging)
        for name, content in _fixed_files(gallery).items():
            writer.write(name, content)
        on_progress(0, gallery.size)
        for items in _in_order(runner_for(runner), gallery.tasks):
            for item in items:
                for name, content in _item_files(index.add(item), item).items():
                    writer.write(name, content)
            forecast = writer.size * gallery.size // max(len(index), 1)
            # A site that grows too large stops as soon as that can be told, not when the disk is full.
            if writer.size > MOST_BYTES or (len(index) >= _JUDGED_AFTER and forecast > MOST_BYTES):
                message = (
                    f"the gallery would take about {forecast / 1e9:.1f} GB; the most is "
                    f"{MOST_BYTES / 1e9:.0f} GB; what was written is removed; next: choose fewer with "
                    "--limit, --split or --per-class"
                )
                raise InputError(message)
            on_progress(len(index), gallery.size)
        writer.write("items.js", index_script(index.to_dict()).encode())
        writer.write(MARKER_FILE, _marker(gallery, writer.names))
    return Site(str(path), len(index), len(writer.names), writer.size, dict(gallery.splits))


def _require_free(gallery: Gallery, out: str, *, overwrite: bool) -> Path:
    """Return where a site may be made; InputError where something stands that may not be replaced."""
    if "://" in out:
        message = f"--out is {out!r}; a gallery is made in a local folder; next: make it there, then copy it"
        raise InputError(message)
    # Where a symbolic link leads: the link itself is not ours to replace.
    path = Path(os.path.realpath(expanded(out)))
    if path.is_dir():
        _refuse_unknown(path, path)
        # Whether it is this gallery is known for certain when this one is made, and mostly before.
        if not overwrite and not _may_be(gallery, path):
            raise _taken(path)
    elif path.exists():
        message = f"{str(path)!r} is a file; a gallery is a folder; nothing was changed; next: another --out"
        raise InputError(message)
    return path


def _refuse_unknown(path: Path, folder: Path) -> None:
    """Refuse a folder, or what was moved out of ``path`` into it, that holds what no gallery wrote."""
    marker = _marker_in(folder)
    ours = {MARKER_FILE, *map(str, marker.get("files", ()))} if marker else set()
    is_listed = marker is None or "files" in marker
    for name in _entries(folder):
        if name not in ours and (is_listed or not _UNLISTED.fullmatch(name)):
            message = (
                f"{str(path)!r} holds {name!r}, which is not part of a gallery; nothing was changed; next: "
                "choose an empty or new folder with --out"
            )
            raise InputError(message)


def _taken(path: Path) -> InputError:
    return InputError(
        f"{str(path)!r} holds a gallery already; nothing was changed; next: replace it with "
        "--overwrite, or choose another folder with --out"
    )


def _marker_in(folder: Path) -> dict[str, Any] | None:
    """Return the marker of the gallery that a folder holds; None where it holds none."""
    try:
        marker = json.loads((folder / MARKER_FILE).read_bytes())
    except (OSError, ValueError):
        return None
    if not isinstance(marker, dict) or marker.get("what") != _MARK:
        return None
    return marker if isinstance(marker.get("files", []), list) else None


def _entries(folder: Path) -> Iterator[str]:
    """Yield the paths of all files, links and empty folders below a folder; links are not followed."""

    def refuse(error: OSError) -> None:
        raise error

    for root, folders, files in os.walk(folder, onerror=refuse):
        inside = Path(root).relative_to(folder)
        if root == str(folder):
            folders[:] = [name for name in folders if not is_unfinished(name)]
            files = [name for name in files if not is_unfinished(name)]
        elif not (folders or files):
            yield inside.as_posix()
        links = [name for name in folders if (Path(root) / name).is_symlink()]
        yield from ((inside / name).as_posix() for name in sorted(files + links))


def _may_be(gallery: Gallery, folder: Path) -> bool:
    """Return whether a folder may hold this gallery, or be empty, as far as its page and marker show."""
    if next(_entries(folder), None) is None:
        return True
    found = {**(_marker_in(folder) or {}), "files": []}
    index = folder / "index.html"
    return found == json.loads(_marker(gallery, ())) and (
        not index.exists() or index.read_bytes() == page(gallery.title).encode()
    )


def _is_part_of(folder: Path, staging: Path) -> bool:
    """Return whether everything that a folder holds is in another one too, byte for byte."""
    return all(
        (staging / name).is_file() and filecmp.cmp(folder / name, staging / name, shallow=False)
        for name in _entries(folder)
    )


def _require_size(gallery: Gallery) -> None:
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


def _fixed_files(gallery: Gallery) -> dict[str, bytes]:
    """Return the files that do not depend on the items, by path."""
    library = viewer_library()
    ours = {f"assets/{name}": asset(name).encode() for name in ASSETS}
    return {
        "index.html": page(gallery.title).encode(),
        "LICENSES.txt": library.license_text.encode(),
        "assets/three.js": library.code.encode(),
        **ours,
    }


def _item_files(number: int, item: Item) -> dict[str, bytes]:
    """Return the files of one item, by path."""
    name = f"{number:06d}"
    media = {f"media/{name}-{ending}": content for ending, content in item.media.items()}
    return {
        f"thumbs/{name}.png": item.thumbnail,
        f"items/{name}.js": content_script(number, item.content).encode(),
        **media,
    }


def _marker(gallery: Gallery, files: Iterable[str]) -> bytes:
    """Return the file that lists what a gallery is and holds, itself left out."""
    content = {
        "what": _MARK,
        "kind": gallery.kind,
        "items": gallery.size,
        "version": toolkit_version(),
        "files": sorted(files),
    }
    return (json.dumps(content, indent=1) + "\n").encode()


@dataclass
class _Writer:
    """Writes files below a folder and counts them."""

    folder: Path
    names: list[str] = field(default_factory=list)
    size: int = 0

    def write(self, name: str, content: bytes) -> None:
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        self.names.append(name)
        self.size += len(content)


def _make(numbered: tuple[int, ItemTask]) -> tuple[int, list[Item]]:
    number, task = numbered
    return number, task.make()


def _in_order(runner: Runner, tasks: tuple[ItemTask, ...]) -> Iterator[list[Item]]:
    """Yield the items of each task in the order of the tasks, whichever is finished first."""
    waiting: dict[int, list[Item]] = {}
    following = 0
    finished = cast("Generator[tuple[int, list[Item]]]", runner.run(_make, list(enumerate(tasks))))
    # Ends the workers when an item is refused.
    with closing(finished) as results:
        for number, items in results:
            waiting[number] = items
            while following in waiting:
                yield waiting.pop(following)
                following += 1


@dataclass(frozen=True, slots=True)
class SiteForecast:
    """What a run would make, told from a sample; exact where the sample is everything."""

    items: int
    files: int
    bytes: int
    seconds: float
    sampled: int  # how many items were made for the estimate
    fits: bool  # sites that do not fit are refused
    splits: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast_site(gallery: Gallery, out: str, workers: int, *, overwrite: bool = False) -> SiteForecast:
    """Make a few items, write nothing, and tell what all would take; InputError as :func:`build_site`."""
    _require_free(gallery, out, overwrite=overwrite)
    _require_size(gallery)
    fixed = _fixed_files(gallery)
    index = IndexBuilder(gallery)
    names: list[str] = []
    size = 0
    tasks = gallery.tasks
    if len(tasks) > _SAMPLED_TASKS:  # some, evenly from first to last
        steps = _SAMPLED_TASKS - 1
        tasks = tuple(tasks[step * (len(tasks) - 1) // steps] for step in range(_SAMPLED_TASKS))
    start_s = time.monotonic()
    for task in tasks:
        for item in task.make():
            made = _item_files(index.add(item), item)
            names += made
            size += sum(map(len, made.values()))
    elapsed_s = time.monotonic() - start_s
    share = gallery.size / len(index)
    size += len(index_script(index.to_dict()))
    listed = _marker(gallery, [*fixed, *names, "items.js"])
    total = round((size + len(listed)) * share) + sum(map(len, fixed.values()))
    return SiteForecast(
        items=gallery.size,
        files=round(len(names) * share) + len(fixed) + 2,  # the index of items and the marker
        bytes=total,
        seconds=elapsed_s * share / max(1, min(workers, len(gallery.tasks))),
        sampled=len(index),
        fits=total <= MOST_BYTES,
        splits=dict(gallery.splits),
    )
