"""``merge`` and ``split``: one data set of several, and several of one."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from cli.application import command
from cli.making import make_with_progress, print_converted
from cli.options import AnySet, Chosen, Out, Work
from cli.output import Sink
from tactile_toolkit.checked_fields import integer, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import listed


def _fractions(words: str) -> tuple[float, ...]:
    try:
        shares = tuple(map(float, listed(words)))
    except ValueError:
        shares = ()
    if not shares or not all(0 < share <= 1 for share in shares) or sum(shares) > 1 + 1e-9:
        raise InputError(
            f"--fractions is {words!r}; expected shares that add up to 1 or less, such as 0.8,0.2"
        )
    return shares


def add_subsets(app: typer.Typer, kind: DatasetKind) -> None:
    """Add the commands for a kind of data set to its command line."""
    print_made = partial(print_converted, nouns=kind.nouns)

    @command(app)
    def merge(
        *,
        names: Annotated[list[str], typer.Argument(metavar="DIR...", help="Data sets of one kind.")],
        out: Out = "merged",
        work: Work,
        sink: Sink,
    ) -> None:
        """Make one data set of several whose ids differ; shards are copied as they are.

        Example: merge DIR OTHER --out both
        """
        from tactile_toolkit.exchange.subsets import merge_sets

        make = partial(merge_sets, kind, names, out)
        make_with_progress(sink, "copying", kind.nouns, make, work, out, print_made)

    @command(app)
    def split(
        *,
        name: AnySet,
        out: Out = "parts",
        fractions: tuple[float, ...] = text(
            (), metavar="0.8,0.2", read=_fractions, help="Shares of the rows of each split, for a part each."
        ),
        seed: int = integer(0, help="Seed by which rows are drawn for --fractions."),
        chosen: Chosen,
        work: Work,
        sink: Sink,
    ) -> None:
        """Divide a data set into several of the same kind: OUT/part-1, OUT/part-2 and so on.

        At random by --fractions, or into the objects that --ids, --labels and the like choose and all others.

        Examples: split DIR --fractions 0.8,0.2 --out parts;  split DIR --ids 3,17,40-60 --out parts
        """
        from tactile_toolkit.exchange.subsets import divide, write_part

        given = {each: value for each, value in chosen.given().items() if value is not None}
        if bool(given) == bool(fractions):
            raise InputError(
                "expected either --fractions, or --ids and the like", next="add --fractions 0.8,0.2"
            )
        options = {"fractions": fractions, "seed": seed} if fractions else given
        for number, rows in enumerate(divide(kind, name, fractions, seed, given), 1):
            place = f"{out.rstrip('/')}/part-{number}"
            make = partial(write_part, kind, name, rows, {**options, "part": number}, place)
            make_with_progress(sink, "copying", kind.nouns, make, work, place, print_made)
