"""The site of a gallery: its page, and a folder of files whose name is a digest of its content.

The files are written under a temporary name. The page, which names their folder, is replaced atomically, so
it shows one gallery at any time. A folder whose name matches its content was written by a gallery; no other
folder is ever removed.

Pages opened from a file system may not fetch files, but they may load scripts. Data are therefore written as
scripts that call a function of the page.
"""

from __future__ import annotations

import hashlib
import html
import json
import os
import re
import shutil
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import resources
from itertools import accumulate
from pathlib import Path
from typing import cast

from tactile_toolkit import __version__, run, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import Gallery, GalleryItem, RowsTask
from tactile_toolkit.rows import Column
from tactile_toolkit.store.addresses import local_folder_path
from tactile_toolkit.store.files import DRAFT, draft_of, named_failures, remove_drafts
from tactile_toolkit.store.locks import LOCK_FILE

PAGE_FILE = "index.html"

MAX_ITEMS = 20_000
"""Largest number of items: the page keeps its index in memory."""

MAX_BYTES = 2_000_000_000
"""Largest site; larger ones are impractical to copy."""

# The page in its folder of files, before the name of that folder is known.
_TEMPLATE_FILE = "page.template"
_FOLDER_PREFIX = "files-"

# Values of a facet for items without a value, and for items with an unknown value.
_NONE = "none"
_UNKNOWN = "unknown"

FOLDER_MARK = "{{files}}"
"""Placeholder in the page for the name of the folder of its files."""

_SCRIPTS = ("state.js", "filters.js", "grid.js", "viewer.js", "film.js", "dialog.js", "page.js")

ASSETS = ("page.css", "theme.js", *_SCRIPTS)
"""Own files of the page, in the folder ``assets`` next to this module."""

THREE = "three.js"
"""The library that draws meshes; its licence file states version and digest."""


@dataclass(frozen=True, slots=True)
class Site:
    """A site: its folder, sizes, the number of items of each split, and whether there was one before."""

    path: str
    items: int
    files: int
    bytes: int
    splits: dict[str, int]
    is_replaced: bool

    @property
    def page(self) -> str:
        """File to open in a browser."""
        return str(Path(self.path) / PAGE_FILE)


def build_site(
    gallery: Gallery,
    out: str,
    runner: run.Runner | int = 1,
    *,
    overwrite: bool = False,
    dry_run: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Site:
    """Write the site of a gallery; the page appears last. Equal galleries give equal bytes.

    ``overwrite`` replaces an existing gallery and nothing else. An existing folder is kept, not replaced.
    ``dry_run`` checks the same and writes nothing.

    Raises InputError if the folder holds something else, another run writes a gallery there, there is
    nothing to show, or the site would be too large; StorageError if it cannot be written.
    """
    path = _site_folder(gallery, out, overwrite=overwrite)
    is_replaced = (path / PAGE_FILE).exists()
    if dry_run:
        return Site(str(path), gallery.size, 0, 0, dict(gallery.splits), is_replaced)
    with named_failures(str(path)), _unfinished_folder(path) as folder:
        files = _Files(folder)
        files.write(_TEMPLATE_FILE, page(gallery.title))
        files.write("LICENSES.txt", asset("three-LICENSE.txt"))
        for name in (*ASSETS, THREE):
            files.write(f"assets/{name}", asset(name))
        items = _write_items(gallery, files, runner, on_progress)
        files.write("items.js", f"gallery.start({script_json(index_of(gallery, items))});\n")
        # Checked again, because hours may have passed.
        former = _former_folders(path, overwrite=overwrite)
        named = path / _name_of(folder)
        if named not in former:
            folder.rename(named)
        draft = draft_of(path / PAGE_FILE)
        files.bytes += draft.write_bytes(_page_of(named))
        draft.replace(path / PAGE_FILE)
        for former_folder in set(former) - {named}:
            retired = former_folder.rename(draft_of(former_folder))
            if _name_of(retired) != former_folder.name:  # a file was added meanwhile
                retired.rename(former_folder)
    return Site(str(path), len(items), files.count + 1, files.bytes, dict(gallery.splits), is_replaced)


class _Files:
    """Writes the files of a folder and counts them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.count = self.bytes = 0

    def write(self, name: str, content: str | bytes) -> None:
        """Write a file, in a folder that is created if needed."""
        data = content.encode() if isinstance(content, str) else content
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        self.bytes += path.write_bytes(data)
        self.count += 1


def _write_items(
    gallery: Gallery, files: _Files, runner: run.Runner | int, on_progress: Callable[[int, int], None]
) -> list[GalleryItem]:
    """Make the items and write their files; return what the page filters and sorts by, in order."""
    shown: dict[int, GalleryItem] = {}
    # Each task with the number of its first item on the page.
    firsts = accumulate((task.size for task in gallery.tasks), initial=0)
    tasks = list(zip(firsts, gallery.tasks, strict=False))
    on_progress(0, gallery.size)
    made = cast("Generator[tuple[int, list[GalleryItem]]]", run.runner_for(runner).run(_make, tasks))
    # Closed, so that workers end when an item fails.
    with closing(made) as results:
        for first, items in results:
            for number, item in enumerate(items, start=first):
                shown[number] = replace(item, thumbnail=b"", content={}, media={})
                content = f"gallery.receive({number},{script_json(item.content)});\n"
                files.write(f"thumbs/{number:06d}.png", item.thumbnail)
                files.write(f"items/{number:06d}.js", content)
                for ending, medium in item.media.items():
                    files.write(f"media/{number:06d}-{ending}", medium)
            if files.bytes > MAX_BYTES:
                raise InputError(
                    f"the gallery would take more than {MAX_BYTES / 1e9:.0f} GB with {len(shown):,} of "
                    f"{gallery.size:,} {gallery.nouns[1]}; what was written is removed",
                    next="choose fewer with --limit, --split or --per-class",
                )
            on_progress(len(shown), gallery.size)
    return [shown[number] for number in sorted(shown)]


def _make(numbered: tuple[int, RowsTask]) -> tuple[int, list[GalleryItem]]:
    first, task = numbered
    return first, task.make()


@contextmanager
def _unfinished_folder(path: Path) -> Iterator[Path]:
    """Create and lock ``path``, and yield a new folder in it.

    Remains of killed runs are removed first. At the end, the new folder is removed unless it was renamed, and
    so is ``path`` if it was created here and is empty.
    """
    is_new = not path.is_dir()
    path.mkdir(parents=True, exist_ok=True)
    try:
        with store.locked(path, patience_s=0):
            try:
                _remove_unfinished(path)
                folder = draft_of(path / "files")
                folder.mkdir()
                yield folder
            finally:
                _remove_unfinished(path)
    finally:
        if is_new:
            with suppress(OSError):  # unless it holds the page
                path.rmdir()


def _remove_unfinished(path: Path) -> None:
    remove_drafts(path)
    for left in path.iterdir():
        if re.match(DRAFT, left.name) and not left.is_symlink():
            shutil.rmtree(left)


def _name_of(folder: Path) -> str:
    """Return the name that follows from the content of a folder: a digest of all files and links."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        is_file = path.is_file() and not path.is_symlink()
        content = hashlib.sha256(path.read_bytes()).hexdigest() if is_file else f"{path.is_symlink()}"
        digest.update(f"{path.relative_to(folder).as_posix()}\n{content}\n".encode(errors="surrogateescape"))
    return f"{_FOLDER_PREFIX}{digest.hexdigest()[:16]}"


def _page_of(files: Path) -> bytes:
    return (files / _TEMPLATE_FILE).read_bytes().replace(FOLDER_MARK.encode(), files.name.encode())


def _site_folder(gallery: Gallery, out: str, *, overwrite: bool = False) -> Path:
    """Return the folder of the site of a gallery; raises InputError as :func:`build_site` does."""
    # The target of a symbolic link: the link itself is not replaced.
    path = Path(os.path.realpath(local_folder_path(out)))
    if path.is_dir():
        _former_folders(path, overwrite=overwrite)
    noun, nouns = gallery.nouns
    if gallery.size == 0:
        raise InputError(
            f"there is no {noun} to show", next="choose another --split, or a data set that holds some"
        )
    if gallery.size > MAX_ITEMS:
        raise InputError(
            f"the gallery would show {gallery.size:,} {nouns}; expected at most {MAX_ITEMS:,}; nothing was "
            "written",
            next="choose fewer with --limit, --split or --per-class",
        )
    return path


def _former_folders(path: Path, *, overwrite: bool) -> list[Path]:
    """Return the folders of files of an existing gallery in ``path``, complete or not.

    Raises InputError if ``path`` holds anything else, or a gallery that must not be overwritten.
    """
    former: list[Path] = []
    for entry in sorted(path.iterdir()):
        is_ours = entry.name == LOCK_FILE or re.match(DRAFT, entry.name) is not None
        if entry.name.startswith(_FOLDER_PREFIX) and entry.is_dir() and not entry.is_symlink():
            is_ours = entry.name == _name_of(entry)
            if is_ours:
                former.append(entry)
        elif entry.name == PAGE_FILE and entry.is_file() and not entry.is_symlink():
            # Sorted after the folders, one of which holds its template.
            is_ours = entry.read_bytes() in map(_page_of, former)
            if is_ours and not overwrite:
                raise InputError(
                    f"{str(path)!r} holds a gallery already; nothing was changed",
                    next="replace it with --overwrite, or choose another folder with --out",
                )
        if not is_ours:
            raise InputError(
                f"{str(path)!r} holds {entry.name!r}, which is not part of a gallery or was changed since; "
                "nothing was changed",
                next="choose an empty or new folder with --out",
            )
    return former


def asset(name: str) -> str:
    """Read a file of the page."""
    return (resources.files("tactile_toolkit.gallery") / "assets" / name).read_text(encoding="utf-8")


def page(title: str) -> str:
    """Return the page, with a placeholder for the folder of its files."""
    scripts = "\n".join(f'<script src="{FOLDER_MARK}/assets/{name}" defer></script>' for name in _SCRIPTS)
    filled = asset("page.html").replace("<!-- scripts -->", scripts)
    return filled.replace("{{title}}", html.escape(title))


def script_json(value: object) -> str:
    """Write JSON that is safe in scripts and pages: ASCII without ``<``, ``>`` and ``&``."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def index_of(gallery: Gallery, items: Sequence[GalleryItem]) -> dict[str, object]:
    """Return the columns by which the page filters and sorts, as JSON values with one entry for each item."""
    return {
        "kind": gallery.kind,
        "title": gallery.title,
        "nouns": list(gallery.nouns),
        "version": __version__,
        "ids": [item.id for item in items],
        "titles": [item.title for item in items],
        "facets": [_facet(column, items) for column in gallery.columns if column.role == "facet"],
        "measures": [_measure(column, items) for column in gallery.columns if column.role == "measure"],
    }


def _facet(column: Column, items: Sequence[GalleryItem]) -> dict[str, object]:
    rows = [_words(item.values[column.name]) if column.name in item.values else () for item in items]
    occurring = {value for row in rows for value in row}
    known = [value for value in column.values if value in occurring]
    values = known + sorted(occurring.difference(known), key=wording.natural_key)
    numbers = {value: number for number, value in enumerate(values)}
    chosen = [[numbers[value] for value in row] for row in rows]
    return {"title": column.title, "values": values, "rows": chosen}


def _words(value: object) -> tuple[str, ...]:
    if isinstance(value, (list, tuple)):
        return tuple(map(str, value)) or (_NONE,)
    return (_UNKNOWN if value is None else str(value),)


def _measure(column: Column, items: Sequence[GalleryItem]) -> dict[str, object]:
    values = [_rounded(item.values.get(column.name), column.decimals) for item in items]
    return {"title": column.title, "unit": column.unit, "decimals": column.decimals, "values": values}


def _rounded(value: float | None, decimals: int) -> float | None:
    # NaN means "not measured" in reports; JSON has no NaN.
    if value is None or value != value:
        return None
    return round(float(value), decimals or None)
