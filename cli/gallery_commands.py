"""``mnist3d gallery``, ``starstruck gallery`` and ``realtouch gallery``."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.application import EXIT_INTERRUPTED, command
from cli.options import DryRun, Limit, Revision, Split, TouchSet, Workers, local_place, process_count
from cli.output import Sink, bytes_text, counted, duration_text
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


@dataclass(frozen=True, slots=True)
class Page:
    """How a page is made."""

    workers: Workers = 0
    overwrite: Replace = False
    dry_run: DryRun = False


def add_mesh_gallery(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``gallery`` to the command line of a kind of meshes."""

    @command(app)
    def gallery(
        *,
        name: Name,
        out: SiteOut = Path("gallery"),
        split: Split = None,
        per_class: PerClass = None,
        limit: Limit = None,
        page: Page,
        sink: Sink,
    ) -> None:
        """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

        Takes about 40 kB per digit, 8 kB per scene; at most 20,000 items and 2 GB.

        Example: gallery DIR --out site --split test
        """
        from tactile_toolkit.catalog.choose import Choice

        _make(sink, kind.plan_gallery(Choice(name, split, limit, per_class)), out, page)


def add_touch_gallery(app: typer.Typer) -> None:
    """Add ``gallery`` to the command line of touches."""
    command(app, "gallery")(_touches)


def _touches(
    *,
    name: TouchSet,
    out: SiteOut = Path("gallery"),
    split: Split = None,
    per_class: PerClass = None,
    limit: Limit = None,
    touches: Annotated[
        int, typer.Option("--touches", min=1, metavar="N", help="Most touches of a round, evenly spaced.")
    ] = _TOUCHES,
    revision: Revision = None,
    page: Page,
    sink: Sink,
) -> None:
    """Make a page of rounds: touches as a grid, clips frame by frame; no network or server is needed.

    At most 20,000 rounds and 2 GB.

    Example: realtouch gallery real-single-64x64 --out site --split test
    """
    from realtouch.show.gallery import RoundChoice, plan_gallery

    _make(sink, plan_gallery(RoundChoice(name, split, limit, per_class, touches, revision)), out, page)


def _make(sink: Sink, gallery: Gallery, out: Path, page: Page) -> None:
    """Make a gallery with progress and say what was made, or only say what would be made."""
    from tactile_toolkit.gallery.site import build_site, forecast_site

    nouns = gallery.nouns[1]
    workers = process_count(page.workers)
    if page.dry_run:
        view = forecast_site(gallery, str(out), workers, overwrite=page.overwrite)
        sink.document(view.to_dict())
        sink.table(("split", nouns), list(view.splits.items()))
        sink.line(
            f"would make {out}: {counted(view.files, 'files')}, about {bytes_text(view.bytes)}, about "
            f"{duration_text(view.seconds)} with {counted(workers, 'workers')} (measured on "
            f"{counted(view.sampled, nouns)}); nothing was written"
        )
        if not view.fits:
            sink.talk("that is too large and would be refused; choose fewer with --limit or --split")
        return
    start_s = time.monotonic()
    try:
        with sink.progress("making the gallery", nouns) as update:
            site = build_site(gallery, str(out), workers, overwrite=page.overwrite, on_progress=update)
    except KeyboardInterrupt as error:
        # The usual words promise that finished work is kept, but half a page would be of no use.
        sys.stderr.write(f"interrupted; nothing was left behind, {out} is as it was before\n")
        raise typer.Exit(EXIT_INTERRUPTED) from error
    index = str(Path(site.path) / "index.html")
    made = {"items": site.items, "files": site.files, "bytes": site.bytes, "splits": site.splits}
    sink.document({"page": index, **made})
    sink.table(("split", nouns), list(site.splits.items()))
    took = duration_text(time.monotonic() - start_s)
    sink.line(
        f"made {out} in {took}: {counted(site.items, nouns)}, {counted(site.files, 'files')}, "
        f"{bytes_text(site.bytes)}"
    )
    sink.line(f"next: open {index} in a browser")
