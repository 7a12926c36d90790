"""Commands that copy data sets, write their cards, and keep the cache."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from cli import options, output, runs
from cli.options import ANY_SET, Opening, Work, argument, out_folder
from tactile_toolkit import cards, catalog, checked_fields, exchange, places, store, wording
from tactile_toolkit.cache import CacheContents
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import with_count


def _given(chosen: catalog.RowFilter) -> JsonDict:
    return {each: value for each, value in chosen.given().items() if value is not None}


def _fractions(words: str) -> tuple[float, ...]:
    try:
        shares = tuple(map(float, wording.comma_separated(words)))
    except ValueError:
        shares = ()
    if not shares or not all(0 < share <= 1 for share in shares) or sum(shares) > 1 + 1e-9:
        raise InputError(
            f"is {words!r}; expected shares that add up to 1 or less, such as 0.8,0.2", field="fractions"
        )
    return shares


def merge(
    *,
    kind: DatasetKind,
    names: list[str] = argument("DIR...", "Data sets of one kind.", several=True),
    opening: Opening,
    source_column: str | None = checked_fields.text(
        metavar="NAME", read=str, help="Add a column with the name of the data set that each row is from."
    ),
    out: str = out_folder("merged"),
    work: Work,
    sink: output.Sink,
) -> None:
    """Merge data sets into one; shards are copied unchanged if no id changes and no column is added.

    Columns and classes must be the same. If an id occurs again, the later row gets a new one. References to
    other data sets, such as object_id, are not changed.

    Examples: merge DIR OTHER --out both;  merge DIR OTHER --source-column source --out both
    """
    places = [opening.open(sink, name) for name in names]
    make = partial(exchange.merge_sets, kind, places, out, source_column=source_column)
    manifest = runs.make_with_progress(sink, "copying", kind, make, work, out, runs.print_set)
    if manifest is None:
        return
    for entry in manifest.spec["options"].get("renumbered", ()):
        (old, new), *_ = pairs = entry["ids"]
        sink.line(
            f"{entry['source']}: {with_count(len(pairs), 'ids')} changed, the first from {old} to {new} "
            f"(manifest.json lists all)"
        )


def split(
    *,
    kind: DatasetKind,
    name: str = ANY_SET,
    opening: Opening,
    out: str = out_folder("parts"),
    fractions: tuple[float, ...] = checked_fields.text(
        (),
        metavar="0.8,0.2",
        read=_fractions,
        help="Fractions of the rows of each split, one for each part.",
    ),
    seed: int = checked_fields.integer(0, needs="fractions", help="Random seed."),
    chosen: catalog.RowFilter,
    work: Work,
    sink: output.Sink,
) -> None:
    """Divide a data set into several of the same kind: OUT/part-1, OUT/part-2 and so on.

    Rows are drawn at random (--fractions), or part-1 gets the objects that --ids, --labels and similar
    options choose, and part-2 all others.

    Examples: split DIR --fractions 0.8,0.2 --out parts;  split DIR --ids 3,17,40-60 --out parts
    """
    given = _given(chosen)
    if given and fractions:
        raise InputError(
            "was given with filters such as --ids; expected only one of them",
            next="leave out --fractions, or the filters",
            field="fractions",
        )
    if not given and not fractions:
        raise InputError("expected --fractions, or filters such as --ids", next="add --fractions 0.8,0.2")
    source = opening.open(sink, name)
    for folder, make in exchange.plan_parts(kind, source, out, fractions, seed, given):
        runs.make_with_progress(sink, "copying", kind, make, work, folder, runs.print_set)


def select(
    *,
    kind: DatasetKind,
    name: str = ANY_SET,
    opening: Opening,
    chosen: catalog.RowFilter,
    out: str = out_folder("selected"),
    work: Work,
    sink: output.Sink,
) -> None:
    """Write selected rows of a data set as a data set of the same kind.

    Example: select DIR --labels 3,5 --per-class 10 --out some
    """
    given = _given(chosen)
    if not given:
        raise InputError("expected filters such as --ids", next="add --ids, --labels, --per-class or --limit")
    source = opening.open(sink, name)
    make = partial(exchange.select_rows, kind, source, given, out)
    runs.make_with_progress(sink, "copying", kind, make, work, out, runs.print_set)


def card(
    *, kind: DatasetKind, folder: str = options.FOLDER, words: cards.OwnerWords, sink: output.Sink
) -> None:
    """Write the data card (README.md) of a folder again, with the picture that it shows, and check it.

    Numbers are computed from the data; examples name FOLDER until the folder is uploaded. Licence, authors,
    title and citation that were given before are kept.

    Examples: card FOLDER;  card FOLDER --license cc-by-4.0 --author "Ada Lovelace" --title "My digits"
    """
    opened = places.open_place(folder).require(kind, "card").require_complete(may_take=False)
    # The published touches have no manifest.
    kind = opened.kind or kind
    manifest = opened.manifest
    if kind.needs_manifest:
        manifest = opened.require_manifest(kind)
    files = cards.rewrite_card(kind, store.open_folder(folder), manifest, words)
    sink.document({"folder": folder, "card": files[0], "previews": files[1:]})
    sink.line(f"{folder}: wrote {', '.join(files)}; all of it matches the data")


def cache(
    *,
    action: str = checked_fields.choice(
        "ls", ("ls", "prune"), argument=True, help="List cached files, or remove them."
    ),
    unused_days: float = checked_fields.real(
        0.0, 0, metavar="DAYS", needs="action=prune", help="Only files not used for this many days."
    ),
    sink: output.Sink,
) -> None:
    """List or remove cached files, which are made again when needed.

    Files from the Hub are in the Hub's own cache: see `hf cache`.

    Examples: cache ls;  cache prune --unused-days 30
    """
    before = CacheContents.now()
    removed = list[Path]()
    if action == "prune":
        removed = before.prune(unused_days)
    rows = [(name, len(files), sum(size for _, size, _ in files)) for name, files in before.files.items()]
    document = {name: {"files": count, "bytes": size} for name, count, size in rows}
    sink.document({"folder": str(before.folder), "held": document, "removed": list(map(str, removed))})
    if action == "prune":
        sink.line(f"removed {with_count(len(removed), 'files')} of {before.folder}")
        return
    sink.table(
        ("what", "files", "size"), [(name, count, wording.bytes_text(size)) for name, count, size in rows]
    )
    sink.line(f"these files are in {before.folder}; next: `cache prune` removes them")
