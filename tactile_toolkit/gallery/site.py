"""Making the folder of a gallery: its page, and one folder of files that is named by all that it holds.

The files are made under a temporary name. The page, which names their folder, is replaced in one step: it
shows one gallery at any moment. A folder whose name is true holds what a gallery wrote and nothing else; only
such a one is ever removed. Pages opened from a file system may not fetch files; scripts they may load. So
data is written as scripts that call a function of the page.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import cast

from tactile_toolkit import run, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import Gallery, GalleryItem, RowsTask
from tactile_toolkit.gallery.page import ASSETS, FOLDER_MARK, THREE, asset, index_of, page, script_json

PAGE_FILE = "index.html"

MOST_ITEMS = 20_000
"""The page keeps its index in memory and is tested up to this many items."""

MOST_BYTES = 2_000_000_000
"""Larger sites are refused: they would not be copied to look at a data set."""

# In a folder of files: the page, before it is known how that folder is called.
_TEMPLATE_FILE = "page.template"
_FOLDER_PREFIX = "files-"


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
    runner: run.Runner | int = 1,
    *,
    overwrite: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Site:
    """Make the site of a gallery, whose page appears when all is there; equal galleries, equal bytes.

    ``overwrite`` replaces a gallery that is there; anything else is never touched. A folder that is there
    stays, and whoever is in it stays in it.
    InputError: the folder holds something, another run makes a gallery there, there is nothing to show, or
    the site would be too large. StorageError: it cannot be written, or the disk is full.
    """
    path = site_folder(gallery, out, overwrite=overwrite)
    written, shown = Counter[str](), dict[int, GalleryItem]()
    # Each with the number on the page of its first item.
    firsts = accumulate((task.size for task in gallery.tasks), initial=0)
    tasks = list(zip(firsts, gallery.tasks, strict=False))
    with store.named_failures(str(path)), _unfinished_folder(path) as folder:

        def write(place: Path, content: str | bytes) -> None:
            place.parent.mkdir(exist_ok=True)
            written["bytes"] += place.write_bytes(content.encode() if isinstance(content, str) else content)
            written["files"] += 1

        write(folder / _TEMPLATE_FILE, page(gallery.title))
        write(folder / "LICENSES.txt", asset("three-LICENSE.txt"))
        for name in (*ASSETS, THREE):
            write(folder / "assets" / name, asset(name))
        on_progress(0, gallery.size)
        made = cast("Generator[tuple[int, list[GalleryItem]]]", run.runner_for(runner).run(_make, tasks))
        # Closed, so that the workers end when an item is refused.
        with closing(made) as results:
            for first, items in results:
                for number, item in enumerate(items, start=first):
                    # What the page filters and sorts by.
                    shown[number] = replace(item, thumbnail=b"", content={}, media={})
                    content = f"gallery.receive({number},{script_json(item.content)});\n"
                    write(folder / f"thumbs/{number:06d}.png", item.thumbnail)
                    write(folder / f"items/{number:06d}.js", content)
                    for ending, medium in item.media.items():
                        write(folder / f"media/{number:06d}-{ending}", medium)
                if written["bytes"] > MOST_BYTES:
                    raise InputError(
                        f"the gallery would take more than {MOST_BYTES / 1e9:.0f} GB with {len(shown):,} of "
                        f"{gallery.size:,} {gallery.nouns[1]}; what was written is removed",
                        next="choose fewer with --limit, --split or --per-class",
                    )
                on_progress(len(shown), gallery.size)
        index = index_of(gallery, [shown[number] for number in sorted(shown)])
        write(folder / "items.js", f"gallery.start({script_json(index)});\n")
        # Asked again: hours may have passed.
        former, files = _former_folders(path, overwrite=overwrite), path / _name_of(folder)
        if files not in former:
            folder.rename(files)
        draft = store.draft_of(path / PAGE_FILE)
        write(draft, _page_of(files))
        draft.replace(path / PAGE_FILE)
        for each in set(former) - {files}:
            retired = each.rename(store.draft_of(each))
            if _name_of(retired) != each.name:  # a file was put there in this moment
                retired.rename(each)
    return Site(str(path), len(shown), written["files"], written["bytes"], dict(gallery.splits))


def _make(numbered: tuple[int, RowsTask]) -> tuple[int, list[GalleryItem]]:
    first, task = numbered
    return first, task.make()


@contextmanager
def _unfinished_folder(path: Path) -> Iterator[Path]:
    """Hold ``path``, which is made, and give a new folder in it.

    What a killed run left there is removed first. In the end the folder is removed where it still has its
    name, and so is ``path`` where it was made for it and is empty.
    """
    is_new = not path.is_dir()
    path.mkdir(parents=True, exist_ok=True)
    try:
        with store.locked(path, patience_s=0):
            try:
                _remove_unfinished(path)
                folder = store.draft_of(path / "files")
                folder.mkdir()
                yield folder
            finally:
                _remove_unfinished(path)
    finally:
        if is_new:
            with suppress(OSError):  # where it holds the page
                path.rmdir()


def _remove_unfinished(path: Path) -> None:
    store.remove_drafts(path)
    for left in path.iterdir():
        if re.match(store.DRAFT, left.name) and not left.is_symlink():
            shutil.rmtree(left)


def _name_of(folder: Path) -> str:
    """Return the name of a folder that holds what this one does: no file or link more, less or other."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        is_file = path.is_file() and not path.is_symlink()
        content = hashlib.sha256(path.read_bytes()).hexdigest() if is_file else f"{path.is_symlink()}"
        digest.update(f"{path.relative_to(folder).as_posix()}\n{content}\n".encode(errors="surrogateescape"))
    return f"{_FOLDER_PREFIX}{digest.hexdigest()[:16]}"


def _page_of(files: Path) -> bytes:
    return (files / _TEMPLATE_FILE).read_bytes().replace(FOLDER_MARK.encode(), files.name.encode())


def site_folder(gallery: Gallery, out: str, *, overwrite: bool = False) -> Path:
    """Return where the site of a gallery may be made; InputError where :func:`build_site` would raise it."""
    # Where a symbolic link leads: the link itself is not ours to replace.
    path = Path(os.path.realpath(store.local_folder_path(out)))
    if path.is_dir():
        _former_folders(path, overwrite=overwrite)
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
    return path


def _former_folders(path: Path, *, overwrite: bool) -> list[Path]:
    """Return the folders of files of the gallery that is in ``path``, complete or not.

    InputError where it holds anything else, or a gallery that is not to be overwritten.
    """
    former: list[Path] = []
    for entry in sorted(path.iterdir()):
        is_ours = entry.name == store.LOCK_FILE or re.match(store.DRAFT, entry.name) is not None
        if entry.name.startswith(_FOLDER_PREFIX) and entry.is_dir() and not entry.is_symlink():
            is_ours = entry.name == _name_of(entry)
            former += [entry] if is_ours else []
        elif entry.name == PAGE_FILE and entry.is_file() and not entry.is_symlink():
            # Sorted behind the folders: one of them holds what it was made of.
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
