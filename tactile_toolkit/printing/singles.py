"""One file per object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.files import FORMATS, pack_mesh, read_mesh
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.printing.checked import (
    KEPT,
    Failure,
    existing,
    holds,
    prepare,
    refuse_others,
    remove,
    require_same_solid,
    settle,
)
from tactile_toolkit.printing.objects import PrintObject, require_scale, standing
from tactile_toolkit.printing.simulator import MODELS, Physics, model_files, read_model
from tactile_toolkit.run.processes import runner_for

__all__ = ["FileExport", "FileForecast", "WrittenFile", "export_files", "forecast_files"]

# Objects that a forecast packs, from all over the list, to tell the size of all.
_SAMPLED = 32


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file that is there and was found to hold the solid: which object, which file, sizes in mm.

    ``state`` is ``"written"``, or ``"kept"`` where the very same file was there already.
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
    """What :func:`export_files` did: files in the order of the objects, and objects without one."""

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
    """What :func:`export_files` would write: how many files, and about how many bytes in all.

    So many objects were ``sampled``; ``failures`` are those of them that are not solids.
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
    """Picklable: write the file of one object, or only look what stands in its place.

    Whoever looks is told of a file that is as it should be, True where only other files are to be removed,
    and False or a failure where something else stands there.
    """

    folder: str
    ending: str
    scale: float
    physics: Physics
    only_look: bool = False

    def __call__(self, item: PrintObject) -> tuple[str, WrittenFile | Failure | bool]:
        try:
            mesh = standing(item.load(), self.scale)
            verdict = require_solid(mesh)
            *parts, (path, content) = self.files_of(item, mesh)
            # A body may have had more parts in an earlier export.
            stale = set((Path(self.folder) / item.name).glob("part-*.obj")) - dict(parts).keys()
            if self.only_look:
                is_same = all(holds(*each) for each in (*parts, (path, content)))
                if stale or not is_same:
                    return item.name, is_same
                state = KEPT
            else:
                for each in parts:
                    settle(*each)
                remove(stale)
                read = read_mesh if self.ending in FORMATS else read_model
                state = settle(path, content, lambda found: require_same_solid(read(found), mesh, verdict))
        except ItemError as error:
            detail, path = str(error), self.path_of(item)
            # What an earlier export left under this name would pass for this object.
            if not self.only_look and path.exists():
                remove([path])
                detail += f"; {path.name} of an earlier export was removed"
            return item.name, Failure(item.name, error.reason, detail)
        width, depth, height = (np.ptp(mesh.bounds_m, axis=0) * MM_PER_M).tolist()
        return item.name, WrittenFile(
            *(item.name, path.name, item.split, item.label, item.id),
            *((width, depth, height), verdict.volume_mm3),
            *(len(content) + sum(len(part) for _, part in parts), state),
        )

    def files_of(self, item: PrintObject, mesh: Mesh) -> list[tuple[Path, bytes]]:
        """Return the files of an object and what they hold, its own last, behind those that it refers to."""
        if self.ending in FORMATS:
            return [(self.path_of(item), pack_mesh(mesh, self.ending, item.name))]
        files = model_files(item.name, mesh, self.ending, self.physics)
        return [(Path(self.folder) / path, content) for path, content in files.items()]

    def path_of(self, item: PrintObject) -> Path:
        """Return where the file of an object stands."""
        return Path(self.folder) / f"{item.name}{self.ending}"


def export_files(
    objects: Sequence[PrintObject],
    out: str,
    kind: str = "stl",
    *,
    scale: float = 1.0,
    physics: Physics | None = None,
    overwrite: bool = False,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> FileExport:
    """Write one file per object, in the pose that it has, its lowest point at z = 0.

    Each file is read back from disk and has to be the same solid before it gets its name. A file that is
    there already with the very same bytes is kept, so a stopped export goes on where it was.

    Objects that are not solids are listed in the result, and do not stop the others. ``kind`` is ``"stl"``,
    ``"3mf"``, ``"ply"``, ``"obj"`` (millimetres), ``"glb"``, or ``"mjcf"``, ``"urdf"`` or ``"usd"`` for
    simulators (metres), whose masses follow from ``physics``; ``scale`` is a factor on all lengths.
    With ``overwrite``, files of the same name that hold something else are replaced, and that of an object
    that fails is removed.

    Raises InputError for an unknown format, a scale that is not positive, or files in the way, before
    anything is written, and StorageError where the folder cannot be written; finished files stay.
    """
    ending = _ending(kind)
    require_scale(scale)
    material = physics or Physics()
    folder = str(prepare(out))
    runner = runner_for(workers)
    found: dict[str, WrittenFile | Failure | bool] = {}
    if not overwrite:
        found = _kept(objects, out, _Export(folder, ending, scale, material, only_look=True), workers)
    # What was looked at is not made a second time: the convex parts of a body take longer than its file.
    left = [item for item in objects if item.name not in found]
    for name, result in runner.run(_Export(folder, ending, scale, material), left) if left else ():
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
    physics: Physics | None = None,
    out: str | None = None,
    overwrite: bool = False,
) -> FileForecast:
    """Say what :func:`export_files` would write; without ``out``, no files are in the way.

    Raises InputError as there, as far as it can be told without writing.
    """
    ending = _ending(kind)
    require_scale(scale)
    material = physics or Physics()
    folder = None if out is None else existing(out)
    if out is not None and folder is not None and not overwrite:
        _kept(objects, out, _Export(str(folder), ending, scale, material, only_look=True), 1)
    positions = np.unique(np.linspace(0, len(objects) - 1, _SAMPLED).astype(int))
    sizes, failures = [], []
    for item in (objects[position] for position in positions):
        mesh = standing(item.load(), scale)
        try:
            require_solid(mesh)
            files = _Export("", ending, scale, material).files_of(item, mesh)
            sizes.append(sum(len(content) for _, content in files))
        except ItemError as error:
            failures.append(Failure(item.name, error.reason, str(error)))
    count = len(objects) - len(failures)
    total = round(sum(sizes) / max(len(sizes), 1) * count)
    return FileForecast(count, total, len(positions), tuple(failures))


def _kept(
    objects: Sequence[PrintObject], out: str, look: _Export, workers: int
) -> dict[str, WrittenFile | Failure | bool]:
    """Return the files that are there already; refuse to go on where something else stands in the way."""
    there = [item for item in objects if look.path_of(item).exists()]
    looked = dict(runner_for(workers).run(look, there)) if there else {}
    others = [name for name, same in looked.items() if not (same is True or isinstance(same, WrittenFile))]
    refuse_others(out, sorted(f"{name}{look.ending}" for name in others))
    return {name: same for name, same in looked.items() if isinstance(same, WrittenFile)}


def _ending(kind: str) -> str:
    name = kind.lower().removeprefix(".")
    ending = MODELS.get(name, f".{name}")
    if ending not in FORMATS and name not in MODELS:
        names = ", ".join([*(known[1:] for known in FORMATS), *MODELS])
        message = f"--format is {kind!r}; expected one of {names}"
        raise InputError(message)
    return ending
