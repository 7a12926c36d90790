"""What ``realtouch`` prints of data sets and damage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cli.output import Sink
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from realtouch.integrity.verify import TouchVerification
    from realtouch.summary import Summary


def announce_fetching(sink: Sink, name: str, split: str | None) -> None:
    """Print what of a data set on the Hub is about to be fetched: a published one may have many gigabytes."""
    from tactile_toolkit.catalog.published import place_of
    from tactile_toolkit.hub.repository import hub_name
    from tactile_toolkit.store.files import expanded

    place = place_of(name)
    # A folder called USER/NAME that is here comes before the repository of that name, as in `load`.
    if hub_name(place) is None or expanded(place).exists():
        return
    part = f"the files of split {split!r}" if split else "the files of all splits (--split takes one)"
    sink.info(f"{place}: fetching from the Hub what is not here yet of {part}")


def raise_findings(sink: Sink, result: TouchVerification, name: str) -> None:
    """Name all damage on stderr.

    Raises
    ------
    IntegrityError
        When there is any.
    """
    from tactile_toolkit.errors import IntegrityError

    if result.ok:
        return
    for finding in result.findings:
        sink.warn(f"damaged: {finding}")
    raise IntegrityError(
        f"{counted(len(result.findings), 'problems')} in {name!r}",
        next="download or convert it again, or open it with on_error='skip' to leave them out",
    )


def print_summary(sink: Sink, split: str, summary: Summary) -> None:
    """Print the figures of one split."""
    least, most = summary.touches_per_round
    each = str(most) if least == most else f"{least}-{most}"
    width, height = summary.image_size
    rows: list[tuple[str, Any]] = [
        ("rounds", summary.rounds),
        ("touches", f"{summary.touches:,} ({each} per round)"),
        ("objects", summary.objects),
        (
            "with contact",
            "unknown"
            if summary.contact_share is None
            else f"{summary.contact_share:.1%} ({summary.contact_rule})",
        ),
        ("labels", ", ".join(f"{name}: {count}" for name, count in summary.labels.items())),
        ("picture", f"{width} x {height} pixels"),
        (
            "gels",
            ", ".join(f"{gel}: {counted(n, 'rounds')}" for gel, n in summary.gel_ids.items()) or "unknown",
        ),
    ]
    if summary.clip_frames is not None:
        least, median, most = summary.clip_frames
        rows.append(("clips", f"{least} to {most} frames, median {median}, {summary.fps:g} per second"))
    sink.table(
        (split, summary.kind),
        [(name, f"{value:,}" if isinstance(value, int) else value) for name, value in rows],
    )
