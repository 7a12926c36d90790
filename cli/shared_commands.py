"""Commands that all command lines share, registered for a kind of data set at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.application import command
from cli.export_commands import add_export
from cli.folders import Geometry, add_info, add_verify
from cli.gallery_commands import add_mesh_gallery, add_touch_gallery
from cli.hub_download import print_sets
from cli.hub_upload import add_hub_commands
from cli.making import PrintMade
from cli.options import AnySet, Json, Split, local_place
from cli.output import Sink, bytes_text, flat_lines
from tactile_toolkit.checked_fields import integer, real
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    pass


_SHOWN = 6
"""Values of a longer list that are named."""


def add_shared(
    app: typer.Typer,
    kind: DatasetKind,
    preview: Callable[..., None],
    *,
    print_folder: PrintMade | None = None,
    geometry: Geometry | None = None,
    has_meshes: bool = False,
) -> None:
    """Add all that data sets of a kind share; ``info`` and ``verify`` only with what prints a folder."""
    if print_folder is not None:
        add_info(app, kind, print_folder)
        add_verify(app, kind, geometry)
    add_show(app, kind)
    command(app, "preview")(preview)
    add_hub_commands(app, kind)
    _add_list(app, kind)
    add_cache(app)
    if has_meshes:
        add_mesh_gallery(app, kind)
        add_export(app, kind)
    else:
        add_touch_gallery(app)


def add_show(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``show``: a row of a data set, field by field."""

    @command(app)
    def show(
        *,
        name: AnySet,
        row: int = integer(0, help="Which row of the split, from 0."),
        split: Split = None,
        sink: Sink,
    ) -> None:
        """Show a row of a data set: each column, its type and its value, or how many values it has.

        Example: show DIR --row 3 --split test
        """
        from tactile_toolkit.catalog.locate import find_shards, splits_of
        from tactile_toolkit.errors import InputError
        from tactile_toolkit.read.parquet import ShardedTable

        chosen = splits_of(name)[0] if split is None else split
        rows = ShardedTable(tuple(find_shards(name, chosen)))
        if row >= len(rows):
            raise InputError(
                f"--row is {row}; expected less than the {counted(len(rows), 'rows')} of {chosen!r}"
            )
        group, index = rows.locate(row)
        stored = group.table.slice(index, 1)
        values = {name: _brief(_value(stored[name][0])) for name in stored.column_names}
        sink.document({"data_set": name, "split": chosen, "row": row, "values": values})
        sink.line(f"{name}: row {row:,} of the {counted(len(rows), kind.nouns)} in {chosen}")
        lines = []
        for field in stored.schema:
            kept = str(field.type).replace("element: ", "").replace("fixed_size_list", "list")
            for line in flat_lines({field.name: values[field.name]}):
                column, _, value = line.partition(" = ")
                lines.append((column, kept, value))
        sink.table(("column", "type", "value"), lines)


def _value(scalar: Any) -> Any:
    """Return a value of Arrow as one of Python, in Arrow's words where Python has none (nanoseconds)."""
    try:
        return scalar.as_py()
    except ValueError:
        return str(scalar)


def _brief(value: Any) -> Any:
    """Return a value of JSON, with how many there are in place of many, and sizes in place of bytes."""
    if isinstance(value, dict):
        return {name: _brief(each) for name, each in value.items()}
    if isinstance(value, bytes):
        return bytes_text(len(value))
    if isinstance(value, list) and len(value) > _SHOWN:
        return f"{len(value):,} values"
    if isinstance(value, list):
        return [_brief(each) for each in value]
    return value if isinstance(value, (bool, int, float, str, type(None))) else str(value)


def _add_list(app: typer.Typer, kind: DatasetKind) -> None:
    @command(app, "list")
    def list_sets(
        folder: Annotated[
            str | None, typer.Argument(metavar="DIR", help="Folder of data sets; without, published ones.")
        ] = None,
        as_json: Json = False,
    ) -> None:
        """List the published data sets and what is here of them, or the data sets in a folder.

        Examples: list;  list .
        """
        from tactile_toolkit.catalog.local import local_sets

        sink = Sink(as_json)
        if folder is None:
            print_sets(sink, kind)
            return
        found = local_sets(local_place(folder))
        sink.document([each.to_dict() for each in found])
        rows = [
            (each.name, each.kind, each.splits, each.rows, bytes_text(each.bytes), each.state)
            for each in found
        ]
        sink.table(("name", "kind", "splits", "rows", "Parquet", "state"), rows)
        sink.line(f"{counted(len(found), 'data sets')} in {folder}")


def add_cache(app: typer.Typer) -> None:
    """Add ``cache``: what is kept of earlier runs to save time."""

    @command(app)
    def cache(
        *,
        action: Annotated[
            str, typer.Argument(metavar="ls|prune", help="List what is kept, or remove it.", parser=_action)
        ] = "ls",
        unused_days: float = real(0.0, 0, metavar="DAYS", help="prune: only what was not used for so long."),
        sink: Sink,
    ) -> None:
        """List or remove what this program keeps to save time; all of it is made again where it is needed.

        Files of the Hub are in the Hub's own cache: `hf cache` lists and removes these.

        Examples: cache ls;  cache prune --unused-days 30
        """
        from tactile_toolkit.cache import cache_folder, cached_files, prune_cache

        before = cached_files()
        removed = prune_cache(unused_days) if action == "prune" else []
        held = {name: [size for _, size, _ in files] for name, files in before.items()}
        document = {name: {"files": len(sizes), "bytes": sum(sizes)} for name, sizes in held.items()}
        sink.document({"folder": str(cache_folder()), "held": document, "removed": list(map(str, removed))})
        if action == "prune":
            sink.line(f"removed {counted(len(removed), 'files')} of {cache_folder()}")
            return
        sink.table(
            ("what", "files", "size"),
            [(name, len(sizes), bytes_text(sum(sizes))) for name, sizes in held.items()],
        )
        sink.line(f"kept in {cache_folder()}; next: cache prune removes it")


def _action(word: str) -> str:
    if word not in ("ls", "prune"):
        raise typer.BadParameter(f"{word!r} is not one of ls, prune")
    return word
