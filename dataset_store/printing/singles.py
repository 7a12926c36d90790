"""One file per object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dataset_store.errors import InputError, ItemError
from dataset_store.mesh import MM_PER_M
from dataset_store.meshfile import FORMATS, pack_mesh, read_mesh
from dataset_store.printing.checked import Failure, require_same_solid, require_solid
from dataset_store.printing.folder import holds, prepare, refuse_others, settle
from dataset_store.printing.objects import PrintObject, require_scale, standing
from dataset_store.runner import runner_for

__all__ = ["FileExport", "FileForecast", "WrittenFile", "export_files", "forecast_files"]

_SAMPLED = 8

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
    """What :func:`export_files` would write: files, and about how many bytes, from a few of them."""

    files: int
    bytes: int
    sampled: int

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"files": self.files, "bytes": self.bytes, "sampled": self.sampled}


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
            return item.name, Failure(item.name, error.reason, str(error))

    def _done(self, item: PrintObject) -> WrittenFile | bool:
        mesh = standing(item.load(), self.scale)
        verdict = require_solid(mesh)
        content = pack_mesh(mesh, self.ending, item.name)
        place = Path(self.folder) / f"{item.name}{self.ending}"
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
        Replace files of the same name that hold something else.
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
        there = [item for item in objects if (Path(folder) / f"{item.name}{ending}").exists()]
        looked = runner.run(_Export(folder, ending, scale, only_look=True), there) if there else ()
        refuse_others(out, sorted(f"{name}{ending}" for name, same in looked if same is not True))
    found: dict[str, WrittenFile | Failure | bool] = {}
    for name, result in runner.run(_Export(folder, ending, scale), objects):
        found[name] = result
        on_progress(len(found), len(objects))
    results = [found[item.name] for item in objects]
    return FileExport(
        tuple(result for result in results if isinstance(result, WrittenFile)),
        tuple(result for result in results if isinstance(result, Failure)),
    )


def forecast_files(objects: Sequence[PrintObject], kind: str = "stl", scale: float = 1.0) -> FileForecast:
    """Say what :func:`export_files` would write.

    Parameters
    ----------
    objects, kind, scale
        As there.

    Raises
    ------
    InputError
        Unknown format, or a scale that is not positive.
    """
    ending = _ending(kind)
    require_scale(scale)
    places = np.unique(np.linspace(0, len(objects) - 1, _SAMPLED).astype(int))
    sample = [objects[place] for place in places]
    sizes = [len(pack_mesh(standing(item.load(), scale), ending, item.name)) for item in sample]
    return FileForecast(len(objects), round(sum(sizes) / len(sizes) * len(objects)), len(sizes))


def _ending(kind: str) -> str:
    ending = f".{kind.lower().removeprefix('.')}"
    if ending not in FORMATS:
        names = ", ".join(known[1:] for known in FORMATS)
        message = f"--format is {kind!r}; expected one of {names}"
        raise InputError(message)
    return ending
