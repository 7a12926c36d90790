"""Options that several commands share, declared once."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_toolkit.checked_fields import switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import listed

if TYPE_CHECKING:
    from tactile_toolkit.run.processes import Runner


JOB = "Job options"
"""Panel of the help of all options that say who does the work, not what is made."""


def local_place(text: str | Path) -> Path:
    """Read a path of this machine: ``~`` is the home folder, addresses such as ``s3://...`` are refused.

    Paths of the type ``Path`` would come with ``//`` folded, so that such an address became a folder here.
    """
    from tactile_toolkit.store.files import expanded

    if "://" in str(text):
        from tactile_toolkit.store.names import redact

        raise InputError(
            f"{redact(str(text))!r} is a remote address; expected a local path",
            next="give a path of this machine",
        )
    return expanded(text)


def _runner_name(text: str) -> str:
    name, equals, address = text.partition("=")
    if name not in ("processes", "ray") or (equals and (name != "ray" or not address)):
        raise InputError(f"{text!r} is not a runner; expected processes, ray, or ray=HOST:PORT")
    return text


def parse_address(text: str | Path) -> str:
    """Read a folder or file, local (``~`` is the home folder) or in a store (``s3://BUCKET/FOLDER``)."""
    from tactile_toolkit.store.files import expanded
    from tactile_toolkit.store.names import is_remote
    from tactile_toolkit.store.names import normalize_uri as read

    place = read(str(text))
    return place if is_remote(place) else str(expanded(place))


def parse_ids(text: str) -> Any:
    """Read ids and ranges of them, such as ``3,17,40-60``."""
    from tactile_toolkit.catalog.choose import parse_ids as read

    return read(text)


def _out(help: str, parser: Any) -> Any:
    return typer.Option("--out", "-o", metavar="DIR", help=help, parser=parser)


Folder = Annotated[
    str, typer.Argument(metavar="DIR", help="Folder of a generated data set.", parser=parse_address)
]
Folders = Annotated[
    list[str],
    typer.Argument(parser=parse_address, metavar="DIR|FILE...", help="Data set folders, or files of meshes."),
]
AnySet = Annotated[
    str, typer.Argument(metavar="DIR", help="Data set: a folder, a Parquet file or a Hub repository.")
]
Out = Annotated[str, _out("Folder to write.", parse_address)]
LocalOut = Annotated[Path, _out("Folder to write.", local_place)]
Split = Annotated[
    str | None, typer.Option("--split", metavar="NAME", help="Only this split; all by default.")
]
OneSplit = Annotated[
    str | None, typer.Option("--split", metavar="NAME", help="Split to open; required if there are several.")
]
TouchSet = Annotated[
    str, typer.Argument(metavar="NAME|DIR", help="Short name (real-single-64x64), Hub id, folder or file.")
]
Revision = Annotated[
    str | None, typer.Option("--revision", metavar="REV", help="Branch, tag or commit of a Hub data set.")
]
Workers = Annotated[
    int,
    typer.Option(
        "--workers",
        "-w",
        min=0,
        metavar="N",
        rich_help_panel=JOB,
        help="Number of workers; 0 means one per processor core.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", rich_help_panel=JOB, help="Replace another data set in the folder."),
]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        rich_help_panel=JOB,
        help="Print what would be made, its size and the time; write nothing.",
    ),
]
Limit = Annotated[
    int | None, typer.Option("--limit", min=1, metavar="N", help="Only the first N rows of each split.")
]
PerClass = Annotated[
    int | None,
    typer.Option("--per-class", min=1, metavar="N", help="Only the first N of each class, in each split."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print neither progress nor tables, only errors.")]


@dataclass(frozen=True, slots=True)
class Chosen:
    """Options of all commands that take some of the objects of a data set."""

    split: Split = None
    ids: tuple[Any, ...] | None = text(
        metavar="3,17,40-60", read=parse_ids, help="Only the objects with these ids."
    )
    labels: tuple[str, ...] | None = text(
        metavar="3,7", read=listed, help="Only the objects of these classes."
    )
    per_class: PerClass = None
    limit: Limit = None

    def given(self) -> dict[str, Any]:
        """Return what was asked for, by name; a split only where it is not ``all``."""
        named = {each.name: getattr(self, each.name) for each in fields(self)}
        return {**named, "split": None if self.split == "all" else self.split}


@dataclass(frozen=True, slots=True)
class Work:
    """Options of all commands that fill a data set folder: who does the work."""

    workers: Workers = 0
    runner: str = text(
        "processes",
        panel=JOB,
        metavar="processes|ray[=HOST:PORT]",
        read=_runner_name,
        shown="processes",
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
    check: bool = switch(False, panel=JOB, help="Read finished shards again, and make damaged ones again.")
    overwrite: Overwrite = False

    def chosen_runner(self) -> int | Runner:
        """Return what makes the shards, as functions take it."""
        from tactile_toolkit.run.processes import Check, Finish, part_of

        if self.finish and self.part is not None:
            raise InputError(
                "--part and --finish were both given; expected --finish when all parts have ended"
            )
        runner: int | Runner = process_count(self.workers)
        name, _, address = self.runner.partition("=")
        if self.finish:
            runner = Finish()
        elif name == "ray":
            from tactile_toolkit.run.ray import RayRunner

            runner = RayRunner(address or None, self.workers)
        if self.part is not None:
            runner = part_of(self.part, runner)
        return Check(runner) if self.check else runner


@dataclass(frozen=True, slots=True)
class Making(Work):
    """Options of all commands that make a data set from nothing or from one of another kind."""

    dry_run: DryRun = False


def process_count(workers: int) -> int:
    """Return what ``--workers`` asks for: 0 means one process per processor core."""
    return workers or os.cpu_count() or 1
