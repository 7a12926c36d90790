"""``gallery``: a page of thumbnails and views that opens without a network or a server."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cli.application import EXIT_INTERRUPTED, command
from cli.options import JOB, AnySet, Chosen, DryRun, Revision, TouchSet, Workers, local_place, process_count
from cli.output import Sink, bytes_text, duration_text
from tactile_toolkit.checked_fields import integer, switch, text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.gallery.items import Gallery


@dataclass(frozen=True, slots=True)
class Page:
    """Where a page goes, and how it is made."""

    out: Path = text(
        Path("gallery"),
        name="--out -o",
        metavar="SITE",
        shown="gallery",
        read=local_place,
        help="Folder of the page; it appears complete or not at all.",
    )
    workers: Workers = 0
    overwrite: bool = switch(False, panel=JOB, help="Replace a gallery that is there; nothing else ever is.")
    dry_run: DryRun = False

    def make(self, sink: Sink, gallery: Gallery) -> None:
        """Make a gallery with progress and print what was made, or only what would be made."""
        from tactile_toolkit.gallery.site import build_site, forecast_site

        out, nouns, workers = self.out, gallery.nouns[1], process_count(self.workers)
        if self.dry_run:
            view = forecast_site(gallery, str(out), workers, overwrite=self.overwrite)
            sink.document(view.to_dict())
            sink.table(("split", nouns), list(view.splits.items()))
            sink.line(
                f"would make {out}: {counted(view.files, 'files')}, about {bytes_text(view.bytes)}, about "
                f"{duration_text(view.seconds)} with {counted(workers, 'workers')} (measured on "
                f"{counted(view.sampled, nouns)}); nothing was written"
            )
            if not view.fits:
                sink.info("that is too large and would be refused; choose fewer with --limit or --split")
            return
        start_s = time.monotonic()
        try:
            with sink.progress("making the gallery", nouns) as update:
                site = build_site(gallery, str(out), workers, overwrite=self.overwrite, on_progress=update)
        except KeyboardInterrupt as error:
            # The usual words promise that finished work is kept, but half a page would be of no use.
            sys.stderr.write(f"interrupted; nothing was left behind, {out} is as it was before\n")
            raise typer.Exit(EXIT_INTERRUPTED) from error
        index = str(Path(site.path) / "index.html")
        made = {"items": site.items, "files": site.files, "bytes": site.bytes, "splits": site.splits}
        sink.document({"page": index, **made})
        sink.table(("split", nouns), list(site.splits.items()))
        took = duration_text(time.monotonic() - start_s)
        items, files = counted(site.items, nouns), counted(site.files, "files")
        sink.line(f"made {out} in {took}: {items}, {files}, {bytes_text(site.bytes)}")
        sink.line(f"next: open {index} in a browser")


def add_mesh_gallery(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``gallery`` to the command line of a kind of meshes."""

    @command(app)
    def gallery(
        *,
        name: AnySet,
        chosen: Chosen,
        page: Page,
        sink: Sink,
    ) -> None:
        """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

        Takes about 40 kB per digit, 8 kB per scene; at most 20,000 items and 2 GB.

        Examples: gallery DIR --out site --split test;  gallery DIR --per-class 1
        """
        from tactile_toolkit.catalog.choose import Choice

        page.make(sink, kind.plan_gallery(Choice(name, **chosen.given())))


def add_touch_gallery(app: typer.Typer) -> None:
    """Add ``gallery`` to the command line of touches."""
    command(app, "gallery")(_touches)


def _touches(
    *,
    name: TouchSet,
    chosen: Chosen,
    touches: int = integer(64, 1, help="Most touches of a round, evenly spaced."),
    revision: Revision = None,
    page: Page,
    sink: Sink,
) -> None:
    """Make a page of rounds: touches as a grid, clips frame by frame; no network or server is needed.

    At most 20,000 rounds and 2 GB.

    Example: realtouch gallery real-single-64x64 --out site --split test
    """
    from realtouch.show.gallery import RoundChoice, plan_gallery

    choice = RoundChoice(name, **chosen.given(), touches=touches, revision=revision)
    page.make(sink, plan_gallery(choice))
