"""Galleries: their items, the tasks that make these, and the site of pages.

The page filters by columns that rows declare as facets, and sorts by those declared as measures. Pages opened
from a file system may not fetch files, but they may load scripts. Data are therefore written as scripts that
call a function of the page.

Files are written under a temporary name, into a folder whose name is a digest of its content. The page, which
names this folder, is replaced atomically, so it shows one gallery at any time. A folder whose name matches
its content was written by a gallery; no other folder is ever removed.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
import shutil
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import resources
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import pyarrow as pa
from PIL import Image

from tactile_toolkit import __version__, catalog, mesh, pictures, places, read, run, store, wording
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.rows import Column
from tactile_toolkit.store.addresses import local_folder_path
from tactile_toolkit.store.files import DRAFT, draft_of, named_failures, remove_drafts
from tactile_toolkit.store.locks import LOCK_FILE
from tactile_toolkit.touch import images
from tactile_toolkit.value_types import Floating, Int64, Integers, JsonDict, JsonObject, JsonValue, UInt8
from tactile_toolkit.wording import class_name

SPLIT = "split"
"""Name of the facet of splits, which all galleries of rows have."""

THUMBNAIL_PX = 144
"""Longer side of a thumbnail."""

STEP_MM = 0.01
"""Grid to which vertices are rounded, a twentieth of a printed layer; coarser for meshes above 655 mm, finer
for those below 10 mm."""

_SOLIDS_PER_TASK = 16
_MIN_STEPS = 1_000
_MIN_STEP_MM = 1e-6
_MAX_STEPS = np.iinfo(np.uint16).max
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
class GalleryItem:
    """An item of the page.

    ``values`` are those of facets and measures by name of the column; None is an unknown value, an empty list
    means no value.
    """

    id: str  # searched for by users
    title: str
    values: JsonObject
    thumbnail: bytes = field(repr=False)  # see thumbnail_of
    # JSON values that the page loads when the item is opened: "notes" (pairs of a title and a text) and
    # either "mesh" (see packed_mesh) or "touches".
    content: Mapping[str, object] = field(repr=False)
    # Further files by the end of their name, such as "000.jpg".
    media: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @staticmethod
    def thumbnail_of(pixels: UInt8) -> bytes:
        """Make a PNG thumbnail of grey levels or colours, also with opacity: (H, W) or (H, W, 2 to 4)."""
        picture = Image.fromarray(np.ascontiguousarray(pixels))
        picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.BOX)
        return images.encode_png(picture)


ItemMaker: TypeAlias = Callable[[Any, str, tuple[str, ...], Any], GalleryItem]
"""Function of a record, the split, the class names, and further information about the row."""


@dataclass(frozen=True)
class RowsTask:
    """Makes the items of some rows of a split.

    ``item`` takes a record, the split, the class names, and the entry of ``known`` for the row: further
    information, such as its report.
    """

    dataset: read.RecordDataset[Any]
    split: str
    item: ItemMaker
    known: tuple[object, ...] = field(repr=False)

    @property
    def size(self) -> int:
        """Number of items that it makes."""
        return len(self.dataset)

    def make(self) -> list[GalleryItem]:
        """Make the items, in order; their split and class are added to the values."""
        names = self.dataset.label_names
        made = []
        for record, known in zip(self.dataset, self.known, strict=True):
            item = self.item(record, self.split, names, known)
            label = class_name(names, record.label) if record.label >= 0 else None
            made.append(replace(item, values={**item.values, SPLIT: self.split, "label": label}))
        return made


def _no_facts(_record: pictures.DrawnSolid, _known: object) -> JsonObject:
    """Return no further values; not a lambda, since tasks travel to other processes."""
    return {}


@dataclass(frozen=True)
class Gallery:
    """Content of a site, and the tasks that make its items, in the order of the page."""

    kind: str  # of the data set, such as "mnist3d"
    title: str
    nouns: tuple[str, str]  # one item and several
    columns: tuple[Column, ...]  # facets, which the page filters by, and measures, which it sorts by
    tasks: tuple[RowsTask, ...]
    splits: Mapping[str, int]  # number of items of each that are shown

    @property
    def size(self) -> int:
        """Number of items."""
        return sum(task.size for task in self.tasks)

    @classmethod
    def of_rows(
        cls,
        chosen: pictures.ChosenRows,
        title: str,
        columns: Sequence[Column],
        item: ItemMaker,
        rows_per_task: int,
        known: Callable[[Any, str], Sequence[object]] = lambda rows, _: [None] * len(rows),
    ) -> Gallery:
        """Plan a gallery of chosen rows; see :class:`RowsTask` for ``item``.

        ``columns`` are the facets and measures, except the split. ``known`` takes the chosen rows of a split
        and the split, and returns an entry for each row, such as its report.
        """
        tasks: list[RowsTask] = []
        for split, rows in chosen.splits.items():
            known_values = tuple(known(rows, split))
            for start in range(0, len(rows), rows_per_task):
                part = slice(start, start + rows_per_task)
                tasks.append(RowsTask(rows[part], split, item, known_values[part]))
        shown = {split: len(rows) for split, rows in chosen.splits.items()}
        heading = chosen.titled(f"{title} · {catalog.short_name(chosen.place.name)}")
        kind = chosen.kind
        of_split = Column(pa.string(), name=SPLIT, role="facet", title="Split", values=tuple(shown))
        return cls(kind.name, heading, (kind.noun, kind.nouns), (*columns, of_split), tuple(tasks), shown)

    @classmethod
    def of_solids(
        cls,
        kind: DatasetKind,
        name: places.Name | places.Place,
        chosen: catalog.RowFilter = catalog.RowFilter.ALL,
        *,
        title: str,
        columns: Sequence[Column],
        facts: Callable[[Any, Any], JsonObject] = _no_facts,
        known: Callable[[Any, str], Sequence[object]] = lambda rows, _: [None] * len(rows),
    ) -> Gallery:
        """Plan a gallery of chosen solids that draw themselves; see :meth:`of_rows`.

        ``facts`` takes a record and its entry of ``known``, and returns values of columns that are neither
        stored nor a property of the record. Raises as :meth:`tactile_toolkit.pictures.ChosenRows.of`.
        """
        item = partial(_solid_item, tuple(column.name for column in columns), facts)
        picked = pictures.ChosenRows.of(kind, name, chosen, "tactile gallery")
        return cls.of_rows(picked, title, columns, item, _SOLIDS_PER_TASK, known)

    def write(
        self,
        out: str,
        runner: run.Runner | int = 1,
        *,
        overwrite: bool = False,
        dry_run: bool = False,
        on_progress: Callable[[int, int], None] = lambda _done, _total: None,
    ) -> Site:
        """Write the site; the page appears last. Equal galleries give equal bytes.

        ``overwrite`` replaces an existing gallery and nothing else. An existing folder is kept, not replaced.
        ``dry_run`` checks the same and writes nothing.

        Raises InputError if the folder holds something else, another run writes a gallery there, there is
        nothing to show, or the site would be too large; StorageError if it cannot be written.
        """
        path = _site_folder(self, out, overwrite=overwrite)
        is_replaced = (path / PAGE_FILE).exists()
        if dry_run:
            return Site(str(path), self.size, 0, 0, dict(self.splits), is_replaced)
        with named_failures(str(path)), _unfinished_folder(path) as folder:
            files = _Files(folder)
            files.write(_TEMPLATE_FILE, page(self.title))
            files.write("LICENSES.txt", asset("three-LICENSE.txt"))
            for name in (*ASSETS, THREE):
                files.write(f"assets/{name}", asset(name))
            items = _write_items(self, files, runner, on_progress)
            files.write("items.js", f"gallery.start({script_json(index_of(self, items))});\n")
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
        return Site(str(path), len(items), files.count + 1, files.bytes, dict(self.splits), is_replaced)


def _solid_item(
    shown: Sequence[str],
    facts: Callable[[Any, Any], JsonObject],
    record: pictures.DrawnSolid,
    split: str,
    label_names: Sequence[str],
    known: object,
) -> GalleryItem:
    """Show a solid. IntegrityError for a stored mesh that cannot be drawn."""
    surface = mesh.Mesh(record.vertices_m, record.faces)
    problem = surface.array_problem
    if problem is not None:
        raise IntegrityError(
            f"the mesh of id {record.id} in split {split!r} cannot be drawn: {problem[1]}",
            next="run `verify` and `validate` on the data set, then generate or download it again",
        )
    values: JsonDict = {
        "volume_mm3": surface.volume_m3 * mesh.MM_PER_M**3,
        "vertices": len(surface.vertices_m),
        "faces": len(surface.faces),
        **facts(record, known),
    }
    for name in shown:
        if name not in values and (hasattr(type(record), name) or record.row.has(name)):
            values[name] = _value(record, name)
    content = packed_mesh(surface.vertices_m, surface.faces, record.parts, flat=record.is_faceted)
    return GalleryItem(
        id=str(record.id),
        title=record.caption(label_names),
        values=values,
        thumbnail=GalleryItem.thumbnail_of(record.cutout(THUMBNAIL_PX)),
        content={"notes": record.notes, "mesh": content},
    )


def _value(record: pictures.DrawnSolid, name: str) -> JsonValue:
    """Return a property of a record, or a stored value; None if the data set does not have it."""
    try:
        value: JsonValue = getattr(record, name) if hasattr(type(record), name) else record.row.value(name)
    except InputError:
        return None
    return value


def packed_mesh(
    vertices_m: Floating,
    faces: Integers,
    parts: Sequence[tuple[int, str]] = (),
    *,
    flat: bool = False,
) -> dict[str, object]:
    """Pack a mesh, (V, 3) in metres with z up and (F, 3), as JSON values for the viewer of the page.

    ``parts`` are runs of triangles with their colour, ``"main"`` or ``"other"``; all are ``"main"`` by
    default. ``flat`` shows sharp edges instead of smooth shading. ``vertices`` and ``faces`` become base64 of
    zlib of four planes of bytes (lowest first) of zigzag numbers, each the difference to the number before;
    vertices are all x, all y, all z, in steps of ``step_mm`` above ``low_mm``.
    """
    vertices_mm = np.asarray(vertices_m, np.float64) * mesh.MM_PER_M
    low_mm = vertices_mm.min(axis=0)
    extent_mm = float((vertices_mm.max(axis=0) - low_mm).max())
    step_mm = max(min(STEP_MM, max(extent_mm / _MIN_STEPS, _MIN_STEP_MM)), extent_mm / _MAX_STEPS)
    steps = np.round((vertices_mm - low_mm) / step_mm).astype(np.int64)
    return {
        "vertices": _packed(steps.T.reshape(-1)),
        "faces": _packed(np.asarray(faces, np.int64).reshape(-1)),
        "vertex_count": len(vertices_mm),
        "face_count": len(faces),
        "step_mm": step_mm,
        "low_mm": [round(float(value), 6) for value in low_mm],
        "parts": [list(part) for part in parts] or [[len(faces), "main"]],
        "flat": flat,
    }


def _packed(numbers: Int64) -> str:
    # Neighbours differ little, so the upper planes of bytes are nearly all zero and compress well.
    change = np.diff(numbers, prepend=0)
    # Small differences of either sign become small numbers (as in Protocol Buffers).
    zigzag = ((change << 1) ^ (change >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


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
    """Return the folder of the site of a gallery; raises InputError as :meth:`Gallery.write` does."""
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
