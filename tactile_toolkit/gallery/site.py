"""Making the folder of a gallery: in a hidden folder within it, and put in place when it is complete.

A page cannot be made in place: whoever looks at it would see half of it for hours. Its marker lists its
files, so that a run replaces those and no other. Pages opened from a file system may not fetch files; scripts
they may load. So data is written as scripts that call a function of the page.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import uuid
import zipfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import metadata, resources
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path, PurePosixPath
from typing import Any, cast

from tactile_toolkit import toolkit_version
from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import SPLIT, Gallery, Item, RowsTask, natural_order
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.files import LOCK_FILE, expanded, locked, named_failures

MARKER_FILE = "gallery.json"
"""What a site is, and its files; nothing else is ever replaced."""

MOST_ITEMS = 20_000
"""The page keeps its index in memory and is tested up to this many items."""

MOST_BYTES = 2_000_000_000
"""Larger sites are refused: they would not be copied to look at a data set."""

# The first few items may be unusually large.
_JUDGED_AFTER = 24
_MARK = "tactile-toolkit gallery"
# Folders of runs that are not finished; each is locked as long as its run lives.
_PREFIX = ".gallery-"


@dataclass(frozen=True, slots=True)
class Site:
    """A site that is finished or planned: its folder, what it holds, and how many items of each split."""

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
    """Make the site of a gallery, whose page appears when all is there; equal galleries, equal bytes.

    ``overwrite`` replaces a gallery that is there; anything else is never touched. A folder that is there
    stays, and whoever is in it stays in it.
    InputError: the folder holds something, there is nothing to show, or the site would be too large.
    StorageError: it cannot be written, or the disk is full.
    """
    path = _require_free(out, overwrite=overwrite)
    _require_size(gallery)
    with named_failures(str(path)), _staging(path) as staging:
        site = _Files(gallery, staging)
        on_progress(0, gallery.size)
        # Each with the number on the page of its first item.
        firsts = accumulate((task.size for task in gallery.tasks), initial=0)
        tasks = list(zip(firsts, gallery.tasks, strict=False))
        made = cast("Generator[tuple[int, list[Item]]]", runner_for(runner).run(_make, tasks))
        # Closed, so that the workers end when an item is refused.
        with closing(made) as results:
            for first, items in results:
                site.add(first, items)
                forecast = site.size * gallery.size // max(len(site.shown), 1)
                # A site that grows too large stops as soon as that is known, not when the disk is full.
                is_judged = len(site.shown) >= _JUDGED_AFTER and forecast > MOST_BYTES
                if is_judged or site.size > MOST_BYTES:
                    raise InputError(
                        f"the gallery would take about {forecast / 1e9:.1f} GB; the most is "
                        f"{MOST_BYTES / 1e9:.0f} GB; what was written is removed",
                        next="choose fewer with --limit, --split or --per-class",
                    )
                on_progress(len(site.shown), gallery.size)
        site.finish()
        # Asked again is what may be replaced: hours may have passed.
        with locked(path):
            _replace(staging, path, site, _require_gallery(path, overwrite=overwrite))
    return Site(str(path), len(site.shown), len(site.names), site.size, dict(gallery.splits))


def _make(numbered: tuple[int, RowsTask]) -> tuple[int, list[Item]]:
    first, task = numbered
    return first, task.make()


class _Files:
    """The files of a site as they are made, in whatever order; without a folder they are only counted."""

    def __init__(self, gallery: Gallery, folder: Path | None = None) -> None:
        self.gallery, self.folder = gallery, folder
        self.names: list[str] = []
        self.size = 0
        self.shown: dict[int, Item] = {}  # what the page filters and sorts by, by number
        code, licence = viewer_library()
        self._write("index.html", page(gallery.title))
        self._write("LICENSES.txt", licence)
        self._write("assets/three.js", code)
        for name in ASSETS:
            self._write(f"assets/{name}", asset(name))

    def add(self, first: int, items: Iterable[Item]) -> None:
        """Write the files of some items, by the number of the first."""
        for number, item in enumerate(items, start=first):
            self.shown[number] = replace(item, thumbnail=b"", content={}, media={})
            self._write(f"thumbs/{number:06d}.png", item.thumbnail)
            self._write(f"items/{number:06d}.js", f"gallery.receive({number},{script_json(item.content)});\n")
            for ending, content in item.media.items():
                self._write(f"media/{number:06d}-{ending}", content)

    def finish(self) -> None:
        """Write the index of the items, and the marker, which lists all files but itself."""
        shown = [self.shown[number] for number in sorted(self.shown)]
        self._write("items.js", f"gallery.start({script_json(index_of(self.gallery, shown))});\n")
        self._write(MARKER_FILE, self.marker())

    def marker(self, further: Iterable[str] = ()) -> bytes:
        """Return the marker, with further files of which it says that they are those of a gallery."""
        content = {
            "what": _MARK,
            "kind": self.gallery.kind,
            "items": self.gallery.size,
            "version": toolkit_version(),
            "files": sorted({*self.names, *further} - {MARKER_FILE}),
        }
        return (json.dumps(content, indent=1) + "\n").encode()

    def _write(self, name: str, content: str | bytes) -> None:
        encoded = content.encode() if isinstance(content, str) else content
        if self.folder is not None:
            path = self.folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(encoded)
        self.names.append(name)
        self.size += len(encoded)


@contextmanager
def _staging(path: Path) -> Iterator[Path]:
    """Give a new folder within ``path``, which is removed in the end, and ``path`` too if it was made for it.

    What a killed process left there is removed first: its lock is free.
    """
    is_new = not path.is_dir()
    path.mkdir(parents=True, exist_ok=True)
    for left in path.glob(f"{_PREFIX}*"):
        with suppress(BlockingIOError, FileNotFoundError), locked(left, patience_s=0):
            shutil.rmtree(left, ignore_errors=True)
    staging = path / f"{_PREFIX}{uuid.uuid4().hex}"
    staging.mkdir()
    try:
        with locked(staging):
            yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # where it holds the page
                path.rmdir()


def _replace(staging: Path, path: Path, site: _Files, former: set[str]) -> None:
    """Replace the files of a gallery one by one; when it is ended at any point, it can be done once more."""

    def mark(content: bytes) -> None:
        (staging / MARKER_FILE).write_bytes(content)
        (staging / MARKER_FILE).replace(path / MARKER_FILE)

    # As long as files of both are there, the marker lists both: none is ever one that no gallery wrote.
    mark(site.marker(former))
    # The former ones first: where one is a link to a folder, nothing is written through it.
    for name in former.difference(site.names):
        (path / name).unlink(missing_ok=True)
        with suppress(OSError):
            (path / name).parent.rmdir()
    # The page itself, which is the first, at last.
    for name in reversed(site.names):
        (path / name).parent.mkdir(exist_ok=True)
        if name != MARKER_FILE and (staging / name).exists():
            (staging / name).replace(path / name)
    mark(site.marker())


def _require_free(out: str, *, overwrite: bool) -> Path:
    """Return where a site may be made; InputError where anything is there that it may not replace."""
    if "://" in out:
        raise InputError(
            f"--out is {out!r}; a gallery is made in a local folder", next="make it there, then copy it"
        )
    # Where a symbolic link leads: the link itself is not ours to replace.
    path = Path(os.path.realpath(expanded(out)))
    if path.is_dir():
        _require_gallery(path, overwrite=overwrite)
    elif path.exists():
        raise InputError(
            f"{str(path)!r} is a file; a gallery is a folder; nothing was changed", next="another --out"
        )
    return path


def _require_gallery(path: Path, *, overwrite: bool) -> set[str]:
    """Return the files of the gallery that a folder holds.

    InputError where it holds anything else, or a finished gallery that is not to be overwritten.
    """
    try:
        marker = json.loads((path / MARKER_FILE).read_bytes())
    except (OSError, ValueError):
        marker = None
    is_ours = isinstance(marker, dict) and marker.get("what") == _MARK
    listed = set(map(str, marker["files"])) if is_ours and isinstance(marker.get("files"), list) else set()
    # A run that was killed may leave a folder of its files empty.
    known = {LOCK_FILE, *listed, *(str(PurePosixPath(name).parent) for name in listed)}
    entries = [entry.relative_to(path).as_posix() for entry in _entries(path)]
    found = [name for name in entries if name != MARKER_FILE or not listed]
    strangers = [name for name in found if name not in known]
    if strangers:
        raise InputError(
            f"{str(path)!r} holds {strangers[0]!r}, which is not part of a gallery; nothing was changed",
            next="choose an empty or new folder with --out",
        )
    # Of one whose run was killed while it appeared, some files are missing.
    if listed and listed.issubset(found) and not overwrite:
        raise InputError(
            f"{str(path)!r} holds a gallery already; nothing was changed",
            next="replace it with --overwrite, or choose another folder with --out",
        )
    return listed.intersection(found)


def _entries(folder: Path) -> Iterator[Path]:
    """Yield all files, links and empty folders below a folder, but for those of unfinished runs."""
    for path in sorted(folder.iterdir()):
        if not path.name.startswith(_PREFIX):
            inside = list(_entries(path)) if path.is_dir() and not path.is_symlink() else []
            yield from inside or [path]


def _require_size(gallery: Gallery) -> None:
    one, many = gallery.nouns
    if gallery.size == 0:
        raise InputError(
            f"there is no {one} to show", next="choose another --split, or a data set that holds some"
        )
    if gallery.size > MOST_ITEMS:
        raise InputError(
            f"the gallery would show {gallery.size:,} {many}; the most is {MOST_ITEMS:,}; nothing was "
            "written",
            next="choose fewer with --limit, --split or --per-class",
        )


def forecast_site(gallery: Gallery, out: str, *, overwrite: bool = False) -> Site:
    """Make a few items, write nothing, and estimate what all would take; InputError as :func:`build_site`.

    Exact where there are so few that all are made.
    """
    path = _require_free(out, overwrite=overwrite)
    _require_size(gallery)
    site, tasks = _Files(gallery), gallery.tasks
    fixed_files, fixed_bytes = len(site.names), site.size
    # One, or three from first to last.
    for number in sorted({0, len(tasks) // 2, len(tasks) - 1}):
        site.add(len(site.shown), tasks[number].make())
    share = gallery.size / len(site.shown)
    files = fixed_files + round((len(site.names) - fixed_files) * share) + 2  # the index and the marker
    site.finish()
    size = fixed_bytes + round((site.size - fixed_bytes) * share)
    return Site(str(path), gallery.size, files, size, dict(gallery.splits))


_SCRIPTS = ("state.js", "filters.js", "grid.js", "viewer.js", "film.js", "dialog.js", "page.js")

ASSETS = ("page.css", "theme.js", *_SCRIPTS)
"""Our own files of the page, as they lie in the folder ``assets`` next to this module."""


def asset(name: str) -> str:
    """Read one of our own files of the page."""
    return (resources.files("tactile_toolkit.gallery") / "assets" / name).read_text(encoding="utf-8")


def page(title: str) -> str:
    """Return the page itself."""
    scripts = "\n".join(f'<script src="assets/{name}" defer></script>' for name in _SCRIPTS)
    filled = asset("page.html").replace("<!-- scripts -->", scripts)
    return filled.replace("{{title}}", html.escape(title))


def script_json(value: Any) -> str:
    """Write JSON that is harmless in a script and in a page: no ``<``, ``>`` or ``&``, ASCII only."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def index_of(gallery: Gallery, items: Sequence[Item]) -> dict[str, Any]:
    """Return what the page filters and sorts items by, as JSON values: columns, one entry per item."""
    facets = []
    for facet in gallery.facets:
        rows = [tuple(item.facets.get(facet.name, ())) for item in items]
        found = {value for row in rows for value in row}
        known = [
            value for value in (gallery.splits if facet.name == SPLIT else facet.values) if value in found
        ]
        values = known + natural_order(found.difference(known))
        numbers = {value: number for number, value in enumerate(values)}
        chosen = [[numbers[value] for value in row] for row in rows]
        facets.append({"title": facet.title, "values": values, "rows": chosen})
    return {
        "kind": gallery.kind,
        "title": gallery.title,
        "nouns": list(gallery.nouns),
        "version": toolkit_version(),
        "ids": [item.id for item in items],
        "titles": [item.title for item in items],
        "facets": facets,
        "measures": [
            {
                "title": measure.title,
                "unit": measure.unit,
                "decimals": measure.decimals,
                "values": [_rounded(item.measures.get(measure.name), measure.decimals) for item in items],
            }
            for measure in gallery.measures
        ],
    }


def _rounded(value: float | None, decimals: int) -> float | None:
    # NaN stands for "not measured" in reports, and JSON has no NaN.
    if value is None or value != value:
        return None
    return round(float(value), decimals or None)


# trimesh carries three.js in the template of its own notebook viewer, joined with that viewer's controls.
# Only the library itself is taken: one line of minified code below a comment that names its authors and
# licence.
_TEMPLATE = "resources/templates/viewer.zip"
_LIBRARY = re.compile(
    r"(?P<notice>/\*\*\n \* @license\n(?: \*[^\n]*\n)*? \*/)\n(?P<code>!function[^\n]*\.THREE=[^\n]*)\n"
)
_LICENSE_FILE = re.compile(r"(?:^|/)LICEN[CS]E[^/]*$", re.IGNORECASE)


def viewer_library() -> tuple[str, str]:
    """Take three.js out of the installed trimesh: its code, and the text of its licence.

    InputError where that does not carry it as known releases do, or not under the MIT licence.
    """
    distribution = metadata.distribution("trimesh")
    origin = f"trimesh {distribution.version}"
    # Found without importing trimesh, which takes two seconds and has no part in this.
    spec = find_spec("trimesh")
    try:
        with zipfile.ZipFile(Path(spec.origin if spec and spec.origin else "").parent / _TEMPLATE) as archive:
            found = _LIBRARY.search(archive.read("viewer.html.template").decode())
    except (OSError, KeyError, zipfile.BadZipFile):
        found = None
    licences = (str(file.read_text()) for file in distribution.files or [] if _LICENSE_FILE.search(str(file)))
    terms = next((text for text in licences if "Permission is hereby granted, free of charge" in text), None)
    if found is None or terms is None or "SPDX-License-Identifier: MIT" not in found["notice"]:
        raise InputError(
            f"the installed {origin} carries no three.js with its licence where releases 4.9 to 5.2 do "
            f"({_TEMPLATE})",
            next="pip install 'trimesh>=4.9,<=5.2.0'",
        )
    text = (
        f"three.js, in assets/three.js, was taken out of the Python package {origin} when this page was\n"
        f"built. Its notice:\n\n{found['notice']}\n\n"
        f"The MIT licence, as the package {origin} states it:\n\n{terms.strip()}\n"
    )
    return f"{found['notice']}\n{found['code']}\n", text
