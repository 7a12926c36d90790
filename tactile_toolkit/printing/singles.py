"""One file per object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.files import FORMATS, pack_mesh, read_mesh
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.printing.checked import (
    Failure,
    existing,
    holds,
    prepare,
    refuse_others,
    remove,
    require_same_solid,
    require_solid,
    settle,
)
from tactile_toolkit.printing.objects import PrintObject, require_scale, standing
from tactile_toolkit.run.processes import runner_for

__all__ = ["FileExport", "FileForecast", "WrittenFile", "export_files", "forecast_files"]

_SAMPLED = 32

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file that is there and was found to hold the solid.

    Attributes
    ----------
    item_name, file : str
        Name of the object and of its file.
    split, label : str
        Where the object comes from, and its class.
    id : int
        Its number there.
    size_mm : tuple of float
        Bounding box along x, y, z.
    volume_mm3 : float
        Volume.
    bytes : int
        Size of the file.
    state : str
        ``"written"``, or ``"kept"`` where the very same file was there already.
    """

    item_name: str
    file: str
    split: str
    label: str
    id: int
    size_mm: tuple[float, float, float]
    volume_mm3: float
    bytes: int
    state: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        width, depth, height = (round(side, 3) for side in self.size_mm)
        return {
            **{"name": self.item_name, "file": self.file, "split": self.split, "label": self.label},
            **{"id": self.id, "width_mm": width, "depth_mm": depth, "height_mm": height},
            **{"volume_mm3": round(self.volume_mm3, 3), "bytes": self.bytes, "state": self.state},
        }


@dataclass(frozen=True, slots=True)
class FileExport:
    """What :func:`export_files` did.

    Attributes
    ----------
    files : tuple of WrittenFile
        In the order of the objects.
    failures : tuple of Failure
        Objects of which there is no file.
    """

    files: tuple[WrittenFile, ...]
    failures: tuple[Failure, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "files": [file.to_dict() for file in self.files],
            "failed": [failure.to_dict() for failure in self.failures],
        }


@dataclass(frozen=True, slots=True)
class FileForecast:
    """What :func:`export_files` would write.

    Attributes
    ----------
    files : int
        How many, less those of the objects looked at that are no solids.
    bytes : int
        How large they are in all, about.
    sampled : int
        How many objects were looked at.
    failures : tuple of Failure
        Those of them of which there will be no file.
    """

    files: int
    bytes: int
    sampled: int
    failures: tuple[Failure, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        failed = [failure.to_dict() for failure in self.failures]
        return {"files": self.files, "bytes": self.bytes, "sampled": self.sampled, "failed": failed}


@dataclass(frozen=True, slots=True)
class _Export:
    """Picklable: write the file of one object, or only look whether another one stands in its place."""

    folder: str
    ending: str
    scale: float
    only_look: bool = False

    def __call__(self, item: PrintObject) -> tuple[str, WrittenFile | Failure | bool]:
        try:
            return item.name, self._done(item)
        except ItemError as error:
            return item.name, Failure(item.name, error.reason, f"{error}{self._without_old(item)}")

    def _place(self, item: PrintObject) -> Path:
        return Path(self.folder) / f"{item.name}{self.ending}"

    def _without_old(self, item: PrintObject) -> str:
        """Remove what an earlier export left under the name of what failed: it would pass for it."""
        if self.only_look or not self._place(item).exists():
            return ""
        remove([self._place(item)])
        return f"; {self._place(item).name} of an earlier export was removed"

    def _done(self, item: PrintObject) -> WrittenFile | bool:
        mesh = standing(item.load(), self.scale)
        verdict = require_solid(mesh)
        content = pack_mesh(mesh, self.ending, item.name)
        place = self._place(item)
        if self.only_look:
            return holds(place, content)
        state = settle(place, content, lambda path: require_same_solid(read_mesh(path), mesh, verdict))
        width, depth, height = np.ptp(mesh.bounds_m, axis=0) * MM_PER_M
        size_mm = (float(width), float(depth), float(height))
        return WrittenFile(
            *(item.name, place.name, item.split, item.label, item.id),
            *(size_mm, verdict.volume_mm3, len(content), state),
        )


def export_files(
    objects: Sequence[PrintObject],
    out: str,
    kind: str = "stl",
    *,
    scale: float = 1.0,
    overwrite: bool = False,
    workers: int = 1,
    on_progress: Progress = lambda _done, _total: None,
) -> FileExport:
    """Write one file per object, in the pose that it has, its lowest point at z = 0.

    Each file is read back from disk and has to be the same solid before it gets its name. A file that is
    there already with the very same bytes is kept, so a stopped export goes on where it was.

    Parameters
    ----------
    objects : sequence of PrintObject
        What to write.
    out : str
        Folder; made where it is not there.
    kind : str
        ``"stl"``, ``"3mf"``, ``"ply"``, ``"obj"`` (millimetres) or ``"glb"`` (metres).
    scale : float
        Factor on all lengths.
    overwrite : bool
        Replace files of the same name that hold something else; that of an object that fails is removed.
    workers : int
        Processes.
    on_progress : callable
        Told files done and in all.

    Returns
    -------
    FileExport
        Objects that are no solids are listed in it, and do not stop the others.

    Raises
    ------
    InputError
        Unknown format, a scale that is not positive, or files in the way: nothing was written.
    StorageError
        The folder cannot be written; finished files stay.
    """
    ending = _ending(kind)
    require_scale(scale)
    folder = str(prepare(out))
    runner = runner_for(workers)
    if not overwrite:
        _refuse_others(objects, out, _Export(folder, ending, scale, only_look=True), workers)
    found: dict[str, WrittenFile | Failure | bool] = {}
    for name, result in runner.run(_Export(folder, ending, scale), objects):
        found[name] = result
        on_progress(len(found), len(objects))
    results = [found[item.name] for item in objects]
    return FileExport(
        tuple(result for result in results if isinstance(result, WrittenFile)),
        tuple(result for result in results if isinstance(result, Failure)),
    )


def forecast_files(
    objects: Sequence[PrintObject],
    kind: str = "stl",
    scale: float = 1.0,
    *,
    out: str | None = None,
    overwrite: bool = False,
) -> FileForecast:
    """Say what :func:`export_files` would write.

    Parameters
    ----------
    objects, kind, scale, out, overwrite
        As there; without ``out``, no files are in the way.

    Raises
    ------
    InputError
        As there, as far as it can be told without writing.
    """
    ending = _ending(kind)
    require_scale(scale)
    folder = None if out is None else existing(out)
    if out is not None and folder is not None and not overwrite:
        _refuse_others(objects, out, _Export(str(folder), ending, scale, only_look=True), 1)
    places = np.unique(np.linspace(0, len(objects) - 1, _SAMPLED).astype(int))
    sizes, failures = [], []
    for item in (objects[place] for place in places):
        mesh = standing(item.load(), scale)
        try:
            require_solid(mesh)
            sizes.append(len(pack_mesh(mesh, ending, item.name)))
        except ItemError as error:
            failures.append(Failure(item.name, error.reason, str(error)))
    files = len(objects) - len(failures)
    return FileForecast(files, round(sum(sizes) / max(len(sizes), 1) * files), len(places), tuple(failures))


def _refuse_others(objects: Sequence[PrintObject], out: str, look: _Export, workers: int) -> None:
    """Refuse to go on where files with other content than would be written stand in the way."""
    there = [item for item in objects if (Path(look.folder) / f"{item.name}{look.ending}").exists()]
    looked = runner_for(workers).run(look, there) if there else ()
    refuse_others(out, sorted(f"{name}{look.ending}" for name, same in looked if same is not True))


def _ending(kind: str) -> str:
    ending = f".{kind.lower().removeprefix('.')}"
    if ending not in FORMATS:
        names = ", ".join(known[1:] for known in FORMATS)
        message = f"--format is {kind!r}; expected one of {names}"
        raise InputError(message)
    return ending
