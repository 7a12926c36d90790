"""Options that several commands share, declared once."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

from cli.output import Sink
from tactile_toolkit import places, run, store
from tactile_toolkit.checked_fields import integer, switch, text
from tactile_toolkit.errors import InputError

JOB = "Job options"
"""Panel of the help for options that decide how the work is done, not what is made."""


def local_place(text: str | Path) -> Path:
    """Read a local path: ``~`` is the home folder, and addresses such as ``s3://...`` are refused.

    ``Path`` alone would turn ``//`` into ``/``, so that an address would become a local folder.
    """
    if "://" in str(text):
        raise InputError(
            f"{str(text)!r} is a remote address; expected a local path",
            next="give a path of this machine",
        )
    return store.expanded(text)


def _runner_name(text: str) -> str:
    name, equals, address = text.partition("=")
    if name not in ("processes", "ray") or (equals and (name != "ray" or not address)):
        raise InputError(f"{text!r} is not a runner; expected processes, ray, or ray=HOST:PORT")
    return text


def parse_address(text: str | Path) -> str:
    """Read a folder or file, local (``~`` is the home folder) or in a store (``s3://BUCKET/FOLDER``)."""
    path = store.local_path(str(text))
    return store.open_folder(str(text)).root if path is None else str(path)


def argument(metavar: str, help: str, **option: Any) -> Any:
    """Declare a positional argument."""
    return text(option.pop("default", MISSING), argument=True, metavar=metavar, help=help, **option)


def out_folder(default: Any = MISSING) -> Any:
    """Declare the folder that a command writes, on this machine or in an object store."""
    return text(default, name="--out -o", metavar="DIR", read=parse_address, help="Folder to write.")


def local_out_folder(default: str) -> Any:
    """Declare the folder that a command writes on this machine."""
    return text(Path(default), name="--out -o", metavar="DIR", read=local_place, help="Folder to write.")


FOLDER = argument("DIR", "Folder of a generated data set.", read=parse_address)
FOLDERS = argument("DIR|FILE...", "Data set folders, or files of meshes.", read=parse_address, several=True)
ANY_SET = argument("DIR", "Data set: a folder, a Parquet file or a Hub repository.")
TOUCH_SET = argument("NAME|DIR", "Short name (real-single-64x64), Hub id, folder or file.")
REVISION = text(metavar="REV", help="Branch, tag or commit of a Hub data set.")
CONFIG = text(metavar="NAME", help="Configuration, if the card of the data set has several.")
INCOMPLETE = switch(False, help="Use the finished shards of an unfinished data set.")
WORKERS = integer(
    0, name="--workers -w", panel=JOB, help="Number of workers; 0 means one per processor core."
)
DRY_RUN = switch(False, panel=JOB, help="Print what would be made, its size and the time; write nothing.")
OVERWRITE = switch(False, panel=JOB, help="Replace another data set in the folder.")


@dataclass(frozen=True, slots=True)
class Opening:
    """Options of all commands that open a data set by its name."""

    revision: str | None = REVISION
    config_name: str | None = CONFIG
    allow_incomplete: bool = INCOMPLETE

    def open(self, sink: Sink, name: str, *, shows_all: bool = False) -> places.Place:
        """Open a data set by its name; print a note if an unfinished one is accepted.

        With ``shows_all``, the finished part of an unfinished data set is opened.
        """
        allow = self.allow_incomplete or shows_all
        place = places.open_place(
            name, revision=self.revision, config=self.config_name, allow_incomplete=allow
        )
        if allow and place.unfinished:
            sink.info(f"note: {place.name} is unfinished: {place.unfinished}")
        return place


@dataclass(frozen=True, slots=True)
class Work:
    """Options of all commands that write a data set folder: how the work is done."""

    workers: int = WORKERS
    runner: str = text(
        "processes",
        panel=JOB,
        metavar="processes|ray[=HOST:PORT]",
        read=_runner_name,
        help="Where the work is done: on this machine, or on a Ray cluster (--workers 0: all its cores).",
    )
    part: str | None = text(
        panel=JOB,
        metavar="K/N|auto[/N]",
        help="Make every N-th shard only, from the K-th on, as one job of an array; auto: as Slurm or "
        "Kubernetes number this job.",
    )
    finish: bool = switch(
        False, panel=JOB, help="Complete the data set that all parts have made, or name the missing shards."
    )
    check: bool = switch(
        False, panel=JOB, help="Check the content of finished shards, and make damaged ones again."
    )
    overwrite: bool = OVERWRITE

    def run_keywords(self) -> store.RunKeywords:
        """Return these options as keywords of the functions that write data sets."""
        name, _, address = self.runner.partition("=")
        runner: int | run.Runner = process_count(self.workers)
        if name == "ray":
            runner = run.RayRunner(address or None, self.workers)
        part = None if self.part is None else run.parse_part(self.part)
        return {
            "workers": runner,
            "part": part,
            "finish": self.finish,
            "check": self.check,
            "overwrite": self.overwrite,
        }


@dataclass(frozen=True, slots=True)
class Making(Work):
    """Options of all commands that make a data set from nothing or from one of another kind."""

    dry_run: bool = DRY_RUN


def process_count(workers: int) -> int:
    """Return the number of processes for ``--workers``; 0 means one per processor core."""
    return workers or run.usable_cores()


@dataclass(frozen=True, slots=True)
class Job:
    """Options of commands that write other files than data sets."""

    workers: int = WORKERS
    overwrite: bool = switch(False, panel=JOB, help="Replace files of an earlier run that differ.")
    dry_run: bool = DRY_RUN
