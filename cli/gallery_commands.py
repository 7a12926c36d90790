"""``mnist3d gallery``, ``starstruck gallery`` and ``realtouch gallery``."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.failures import EXIT_INTERRUPTED, reports_errors
from cli.options import DryRun, Json, Limit, Quiet, Split, Workers, local_place
from cli.output import Sink, bytes_text, counted, duration_text
from cli.touch_options import Revision, TouchSet
from tactile_toolkit.kind import DatasetKind

if TYPE_CHECKING:
    from tactile_toolkit.gallery.items import Gallery

__all__ = ["add_mesh_gallery", "add_touch_gallery"]

_TOUCHES = 64

Name = Annotated[
    str, typer.Argument(metavar="DIR", help="Data set folder, Parquet file, or Hub data set (USER/NAME).")
]
SiteOut = Annotated[
    Path,
    typer.Option(
        "--out",
        "-o",
        metavar="SITE",
        help="Folder of the page; it appears whole or not at all.",
        parser=local_place,
    ),
]
PerClass = Annotated[
    int | None,
    typer.Option("--per-class", min=1, metavar="N", help="Only the first N items of each class of a split."),
]
Replace = Annotated[
    bool, typer.Option("--overwrite", help="Replace a gallery that stands there; nothing else ever is.")
]


def add_mesh_gallery(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``gallery`` to the command line of a room of meshes.

    Parameters
    ----------
    app : typer.Typer
        The room's commands.
    kind : DatasetKind
        The kind of data set that it is for.
    """

    @app.command()
    @reports_errors
    def gallery(
        name: Name,
        out: SiteOut = Path("gallery"),
        split: Split = None,
        per_class: PerClass = None,
        limit: Limit = None,
        workers: Workers = 0,
        overwrite: Replace = False,
        dry_run: DryRun = False,
        as_json: Json = False,
        quiet: Quiet = False,
    ) -> None:
        """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

        Takes about 40 kB per digit, 8 kB per scene; at most 20,000 items and 2 GB.

        Example: gallery DIR --out site --split test
        """
        from tactile_toolkit.catalog.choose import Choice

        run = _Run(Sink(as_json, quiet), kind.nouns, out, workers or os.cpu_count() or 1, overwrite)
        run.go(kind.plan_gallery(Choice(name, split, limit, per_class)), dry_run)


def add_touch_gallery(app: typer.Typer) -> None:
    """Add ``gallery`` to the command line of touches."""
    app.command("gallery")(_touches)


@reports_errors
def _touches(
    name: TouchSet,
    out: SiteOut = Path("gallery"),
    split: Split = None,
    per_class: PerClass = None,
    limit: Limit = None,
    touches: Annotated[
        int, typer.Option("--touches", min=1, metavar="N", help="Most touches of a round, evenly spaced.")
    ] = _TOUCHES,
    revision: Revision = None,
    workers: Workers = 0,
    overwrite: Replace = False,
    dry_run: DryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a page of rounds: touches as a grid, clips frame by frame; no network or server is needed.

    At most 20,000 rounds and 2 GB.

    Example: realtouch gallery real-single-64x64 --out site --split test
    """
    from realtouch.show.gallery import RoundChoice, plan_gallery

    run = _Run(Sink(as_json, quiet), "rounds", out, workers or os.cpu_count() or 1, overwrite)
    run.go(plan_gallery(RoundChoice(name, split, limit, per_class, touches, revision)), dry_run)


class _Run:
    """What the three commands share: progress while a site is made, then what was made."""

    def __init__(self, sink: Sink, nouns: str, out: Path, workers: int, overwrite: bool) -> None:
        self.sink, self.nouns, self.out, self.workers = sink, nouns, out, workers
        self.overwrite = overwrite

    def go(self, gallery: Gallery, dry_run: bool) -> None:
        """Make the gallery, or only say what would be made."""
        if dry_run:
            self._forecast(gallery)
        else:
            self._make(gallery)

    def _forecast(self, gallery: Gallery) -> None:
        from tactile_toolkit.gallery.site import forecast_site

        view = forecast_site(gallery, str(self.out), self.workers, overwrite=self.overwrite)
        self.sink.document(view.to_dict())
        self._table(view.splits)
        self.sink.line(
            f"would make {self.out}: {counted(view.files, 'files')}, about {bytes_text(view.bytes)}, about "
            f"{duration_text(view.seconds)} with {counted(self.workers, 'workers')} (measured on "
            f"{counted(view.sampled, self.nouns)}); nothing was written"
        )
        if not view.fits:
            self.sink.talk("that is too large and would be refused; choose fewer with --limit or --split")

    def _make(self, gallery: Gallery) -> None:
        from tactile_toolkit.gallery.site import build_site

        start_s = time.monotonic()
        try:
            with self.sink.progress("making the gallery", self.nouns) as update:
                site = build_site(
                    gallery, str(self.out), self.workers, overwrite=self.overwrite, on_progress=update
                )
        except KeyboardInterrupt as error:
            sys.stderr.write(f"interrupted; nothing was left behind, {self.out} is as it was before\n")
            raise typer.Exit(EXIT_INTERRUPTED) from error
        page = str(Path(site.path) / "index.html")
        self.sink.document(
            {
                "page": page,
                "items": site.items,
                "files": site.files,
                "bytes": site.bytes,
                "splits": site.splits,
            }
        )
        self._table(site.splits)
        took = duration_text(time.monotonic() - start_s)
        self.sink.line(
            f"made {self.out} in {took}: {counted(site.items, self.nouns)}, {counted(site.files, 'files')}, "
            f"{bytes_text(site.bytes)}"
        )
        self.sink.line(f"next: open {page} in a browser")

    def _table(self, splits: dict[str, int]) -> None:
        self.sink.table(("split", self.nouns), list(splits.items()))
