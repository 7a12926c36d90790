"""The commands ``card`` and ``cache``."""

from __future__ import annotations

from pathlib import Path

from cli import options, output
from tactile_toolkit import cards, checked_fields, places, store, wording
from tactile_toolkit.cache import cache_folder, cached_files, prune_cache
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import with_count


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
        0.0, 0, metavar="DAYS", help="prune: only files not used for this many days."
    ),
    sink: output.Sink,
) -> None:
    """List or remove cached files, which are made again when needed.

    Files from the Hub are in the Hub's own cache: see `hf cache`.

    Examples: cache ls;  cache prune --unused-days 30
    """
    before = cached_files()
    removed = list[Path]()
    if action == "prune":
        removed = prune_cache(unused_days)
    rows = [(name, len(files), sum(size for _, size, _ in files)) for name, files in before.items()]
    document = {name: {"files": count, "bytes": size} for name, count, size in rows}
    sink.document({"folder": str(cache_folder()), "held": document, "removed": list(map(str, removed))})
    if action == "prune":
        sink.line(f"removed {with_count(len(removed), 'files')} of {cache_folder()}")
        return
    sink.table(
        ("what", "files", "size"), [(name, count, wording.bytes_text(size)) for name, count, size in rows]
    )
    sink.line(f"these files are in {cache_folder()}; next: `cache prune` removes them")
