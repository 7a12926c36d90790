"""Options that several commands share, declared once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tactile_toolkit.run.processes import Runner

__all__ = [
    "DryRun",
    "Folder",
    "Json",
    "Limit",
    "LocalOut",
    "Making",
    "MinHeight",
    "Out",
    "Overwrite",
    "Quiet",
    "Revision",
    "RunnerName",
    "Seed",
    "OneSplit",
    "Split",
    "TouchSet",
    "Work",
    "Workers",
    "is_count",
    "local_place",
    "parse_size",
    "place_of_data",
    "process_count",
]


_RUNNERS = ("processes", "ray")
_LONGEST_COUNT = 18
"""Digits of a count: more may not fit into 64 bits, and ``int`` itself fails from 4,301 digits on."""


def local_place(text: str | Path) -> Path:
    """Read a path of this machine: ``~`` is the home folder, addresses such as ``s3://...`` are refused.

    Paths of the type ``Path`` would come with ``//`` folded, so that such an address became a folder here.
    """
    if "://" in str(text):
        from tactile_toolkit.store.address import shown

        place = shown(str(text))
        message = f"{place!r} is a remote address; expected a local path; next: give a path of this machine"
        raise typer.BadParameter(message)
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.store.files import expanded

    try:
        return expanded(text)
    except InputError as error:
        raise typer.BadParameter(str(error)) from error


def is_count(text: str) -> bool:
    """Tell whether a text is a whole number of sensible length; a superscript is a digit, but no number."""
    return text.isdecimal() and len(text) <= _LONGEST_COUNT


def parse_size(text: str) -> tuple[int, int]:
    """Read ``--size``, such as ``64x64``: width and height, pixels. Raises InputError."""
    width, _, height = text.strip().lower().partition("x")
    if not (is_count(width) and is_count(height)):
        from tactile_toolkit.errors import InputError

        message = f"--size is {text!r}; expected WIDTHxHEIGHT in pixels, such as 64x64"
        raise InputError(message)
    return int(width), int(height)


def _runner_name(text: str) -> str:
    name, equals, address = text.partition("=")
    if name not in _RUNNERS or (equals and (name != "ray" or not address)):
        message = f"{text!r} is not a runner; expected processes, ray, or ray=HOST:PORT"
        raise typer.BadParameter(message)
    return text


def place_of_data(text: str | Path) -> str:
    """Read a folder or file, local (``~`` is the home folder) or in a store (``s3://BUCKET/FOLDER``)."""
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.store.address import is_remote
    from tactile_toolkit.store.address import place_of_data as read
    from tactile_toolkit.store.files import expanded

    try:
        place = read(str(text))
        return place if is_remote(place) else str(expanded(place))
    except InputError as error:
        raise typer.BadParameter(str(error)) from error


Folder = Annotated[
    str, typer.Argument(metavar="DIR", help="Folder of a generated data set.", parser=place_of_data)
]
Out = Annotated[
    str,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Folder to write.", show_default=True, parser=place_of_data
    ),
]
LocalOut = Annotated[
    Path,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Folder to write.", show_default=True, parser=local_place
    ),
]
Split = Annotated[
    str | None, typer.Option("--split", metavar="NAME", help="Only this split; all by default.")
]
OneSplit = Annotated[
    str | None, typer.Option("--split", metavar="NAME", help="Split to open; needed where there are several.")
]
TouchSet = Annotated[
    str, typer.Argument(metavar="NAME|DIR", help="Short name (real-single-64x64), Hub id, folder or file.")
]
Revision = Annotated[
    str | None, typer.Option("--revision", metavar="REV", help="Branch, tag or commit of a Hub data set.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of everything that is drawn at random.")]
Workers = Annotated[
    int, typer.Option("--workers", "-w", min=0, help="Worker processes; 0 means one per processor core.")
]
ReaderThreads = Annotated[
    int, typer.Option("--workers", "-w", min=0, help="Threads that read; 0 means one per processor core.")
]
RunnerName = Annotated[
    str,
    typer.Option(
        "--runner",
        metavar="processes|ray[=HOST:PORT]",
        help="Where shards are made: on this machine, or on a Ray cluster (--workers 0: all its cores).",
        parser=_runner_name,
    ),
]
PartText = Annotated[
    str | None,
    typer.Option(
        "--part",
        metavar="K/N|auto[/N]",
        help="Only every N-th shard from number K on, as one job of an array; auto: what Slurm or Kubernetes "
        "call this job.",
    ),
]
Finishing = Annotated[
    bool, typer.Option("--finish", help="Put together what all parts have made, or say which are missing.")
]
Limit = Annotated[
    int | None, typer.Option("--limit", min=1, metavar="N", help="Only the first N rows of each split.")
]
MinHeight = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        help="Height above the plate from which a touch counts as contact; 6 by default, and any height for "
        "touches of `tactile-sim generate`.",
    ),
]
Checking = Annotated[
    bool,
    typer.Option(
        "--check", help="Read all that is finished again, in stores too, and make what is damaged anew."
    ),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Start again in a folder that holds another data set.")
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Say what would be made, how large and how long; write nothing.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table; errors only.")]


@dataclass(frozen=True, slots=True)
class Work:
    """Options of all commands that fill a data set folder: who does the work."""

    workers: Workers = 0
    runner: RunnerName = _RUNNERS[0]
    part: PartText = None
    finish: Finishing = False
    check: Checking = False
    overwrite: Overwrite = False

    @property
    def processes(self) -> int:
        """Number of worker processes."""
        return process_count(self.workers)

    def chosen_runner(self) -> int | Runner:
        """Return what makes the shards, as functions take it."""
        if not self.check:
            return self._maker()
        from tactile_toolkit.run.parts import Check

        return Check(self._maker())

    def _maker(self) -> int | Runner:
        if self.finish:
            from tactile_toolkit.errors import InputError
            from tactile_toolkit.run.parts import Finish

            if self.part is None:
                return Finish()
            message = "--part and --finish were both given; expected --finish when all parts have ended"
            raise InputError(message)
        runner: int | Runner = self.processes
        name, _, address = self.runner.partition("=")
        if name == "ray":
            from tactile_toolkit.run.ray import RayRunner

            runner = RayRunner(address or None, self.workers)
        if self.part is None:
            return runner
        from tactile_toolkit.run.parts import part_of

        return part_of(self.part, runner)


@dataclass(frozen=True, slots=True)
class Making(Work):
    """Options of all commands that make a data set from nothing or from one of another kind."""

    dry_run: DryRun = False


def process_count(workers: int) -> int:
    """Return what ``--workers`` asks for: 0 means one process per processor core."""
    return workers or os.cpu_count() or 1
