"""The command ``gallery``, for meshes and for touches."""

from __future__ import annotations

import time
from pathlib import Path

from cli import options, output
from realtouch.kind import KIND
from tactile_toolkit import catalog, checked_fields, gallery, wording
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import with_count


def _make_page(sink: output.Sink, page: gallery.Gallery, out: Path, job: options.Job) -> None:
    """Make a gallery with progress and print what was made, or only what would be made."""
    nouns = page.nouns[1]
    start_s = time.monotonic()
    try:
        with sink.progress("making the gallery", nouns) as update:
            site = gallery.build_site(
                page,
                str(out),
                options.process_count(job.workers),
                overwrite=job.overwrite,
                dry_run=job.dry_run,
                on_progress=update,
            )
    except KeyboardInterrupt as error:
        # The default message says that finished work is kept; half a gallery is not.
        raise KeyboardInterrupt(f"interrupted; {out} is unchanged") from error
    items = with_count(site.items, nouns)
    content = {"items": site.items, "splits": site.splits}
    sink.table(("split", nouns), list(site.splits.items()))
    if job.dry_run:
        sink.document({"path": site.path, **content})
        verb = "replace the gallery in" if site.is_replaced else "make"
        sink.line(f"would {verb} {out}: {items}; nothing was written")
        return
    sink.document({"page": site.page, "files": site.files, "bytes": site.bytes, **content})
    took = wording.duration_text(time.monotonic() - start_s)
    size = f"{with_count(site.files, 'files')}, {wording.bytes_text(site.bytes)}"
    sink.line(f"made {out} in {took}: {items}, {size}")
    sink.line(f"next: open {site.page} in a browser")


def gallery_of_meshes(
    *,
    kind: DatasetKind,
    name: str = options.ANY_SET,
    opening: options.Opening,
    chosen: catalog.RowFilter,
    out: Path = options.local_out_folder("gallery"),
    job: options.Job,
    sink: output.Sink,
) -> None:
    """Make a page of thumbnails, filters and 3D views that opens without a network or a server.

    Takes about 40 kB per digit, 8 kB per scene; at most 20,000 items and 2 GB.

    Examples: gallery DIR --out site --split test;  gallery DIR --per-class 1
    """
    _make_page(sink, kind.plan_gallery(opening.open(sink, name), chosen), out, job)


def gallery_of_touches(
    *,
    kind: DatasetKind,
    name: str = options.TOUCH_SET,
    opening: options.Opening,
    chosen: catalog.RowFilter,
    touches: int = checked_fields.integer(64, 1, help="Maximum number of touches of a round, evenly spaced."),
    out: Path = options.local_out_folder("gallery"),
    job: options.Job,
    sink: output.Sink,
) -> None:
    """Make a page of rounds: touches as a grid, clips frame by frame; no network or server is needed.

    At most 20,000 rounds and 2 GB.

    Example: realtouch gallery real-single-64x64 --out site --split test
    """
    place = opening.open(sink, name).require(kind, "gallery")
    _make_page(sink, KIND.plan_gallery(place, chosen, touches=touches), out, job)
