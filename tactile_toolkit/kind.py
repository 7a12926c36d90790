"""A kind of data set: all that the rest of the house must know of it, in one object.

Each kind has a room, a package of its own, whose ``kind.py`` says it in a ``KIND``. The entry points of the
group ``tactile_toolkit.kinds`` name these objects (``pyproject.toml``), also those of other distributions.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from operator import attrgetter
from typing import Any, Protocol

from tactile_toolkit.json_types import JsonObject

EXPORT, MERGE, SPLIT = "export", "merge", "split"
"""Operations, in a manifest, that made a copy: for other libraries, of several data sets, of some rows."""

SHARED_COMMANDS = (
    *(
        "info",
        "verify",
        "validate",
        "show",
        "preview",
        "card",
        "upload",
        "download",
        "list",
        "merge",
        "split",
    ),
    *("cache", "gallery", "export"),
)
"""Commands that all command lines have, but for those that a kind does not have."""

_PAPER = "Schneider et al., Tactile MNIST: Benchmarking Active Tactile Perception, 2025"
_HAND = "Beaulac & Rosenthal, doi 10.1007/s42979-022-01494-2, 2022"


class Specified(Protocol):
    """What has a specification, such as a manifest."""

    @property
    def spec(self) -> JsonObject:
        """JSON values that all rows follow from."""


def is_export(manifest: Specified | None) -> bool:
    """Return whether a manifest is that of a copy for other libraries, with columns of their own."""
    return manifest is not None and manifest.spec.get("operation") == EXPORT


def is_for_others(manifest: Specified | None) -> bool:
    """Return whether a manifest is that of files for other programs, without the rows of its kind."""
    return manifest is not None and manifest.spec.get("operation") in (EXPORT, "frames", "pairs")


def is_copy(manifest: Specified | None) -> bool:
    """Return whether a manifest is that of a copy: it states what that was made of, not how rows are made."""
    return manifest is not None and manifest.spec.get("operation") in (EXPORT, MERGE, SPLIT)


def lazy(path: str) -> Callable[..., Any]:
    """Return a function that is imported when it is called, by ``"package.module:name"``, or a method.

    ``--help`` and looking up a name load no library of a kind.
    """
    module, _, name = path.partition(":")

    def call(*args: Any, **options: Any) -> Any:
        return attrgetter(name)(import_module(module))(*args, **options)

    return call


@dataclass(frozen=True, slots=True)
class PublishedSet:
    """A published data set.

    Attributes
    ----------
    name : str
        Short name.
    repo_id : str
        Repository of the Hub.
    content : str
        What it holds, in a few words.
    citation : str
        Whom to cite.
    licence : str or None
        As its publishers state it; None where only the card on the Hub says.
    aliases : tuple of str
        Other short names.
    """

    name: str
    repo_id: str
    content: str
    citation: str
    licence: str | None = None
    aliases: tuple[str, ...] = ()


def tactile_mnist_set(
    name: str, repository: str, content: str, *, licence: str | None = None, aliases: tuple[str, ...] = ()
) -> PublishedSet:
    """Return a data set of the Tactile MNIST paper; sets of digits cite the makers of HWD+ too."""
    citation = f"{_PAPER}; {_HAND}" if "digits" in content else _PAPER
    repo_id = f"TimSchneider42/tactile-mnist-{repository}"
    return PublishedSet(name, repo_id, content, citation, licence, aliases)


def _not_offered(*_: Any, **__: Any) -> Any:
    raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class DatasetKind:
    """One kind of data set; what is heavy is imported when it is called (:func:`lazy`).

    Attributes
    ----------
    name : str
        As in ``manifest.json``.
    command : str
        Its command line.
    package : str
        Package whose ``load`` opens such data sets.
    noun, nouns : str
        What a row is called, and several: ``"digit"``, ``"digits"``.
    content : str
        What such a data set holds, in a word or two; ``nouns`` where that is enough.
    made_by : str
        Command that makes such folders, for messages.
    card_template : str
        File of ``data_cards`` that its cards are rendered from.
    write_card : callable
        Takes a ``DataFolder`` and its ``Manifest``; writes the card and the picture that it shows.
    schema : callable or None
        Returns the Arrow schema of every shard; None where it follows from a source.
    check : callable or None
        Takes a ``DataFolder`` and a number of threads, lists findings; None where checksums, schema, ids and
        card are all there is.
    needs_manifest : bool
        Whether a folder without ``manifest.json`` can be neither uploaded nor given a card.
    loader : callable or None
        Takes a ``Manifest`` or None, names the function that opens such a folder; ``package.load`` if None.
    class_names : tuple of str
        Classes of the published data set, in order.
    columns : tuple of str
        Columns that only rows of this kind have, by which they are recognised without a manifest.
    needs : tuple of str
        Columns of which every such data set has one.
    splits : tuple of str
        Splits that such data sets have, in order.
    missing_commands : tuple of str
        Shared commands that its command line does not have.
    published : tuple of PublishedSet
        The published data sets of this kind.
    extra_files : tuple of str
        Patterns of the files that such data sets may have next to the usual ones, such as ``images/*.png``;
        of all others in these places ``--overwrite`` knows that they are a user's.
    plan_previews, plan_gallery : callable
        Plan pictures, or a page, of a data set, where the command line offers that.
    recipe : callable
        Takes a seed and a number per class, returns the :class:`tactile_toolkit.generation.Recipe` of
        what needs no input, if any does.
    """

    name: str
    command: str
    package: str
    noun: str
    nouns: str
    made_by: str
    card_template: str
    write_card: Callable[[Any, Any], None]
    content: str = ""
    schema: Callable[[], Any] | None = None
    check: Callable[[Any, int], Iterable[Any]] | None = None
    needs_manifest: bool = True
    loader: Callable[[Any], str] | None = None
    class_names: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    needs: tuple[str, ...] = ("mesh.faces",)
    splits: tuple[str, ...] = ()
    missing_commands: tuple[str, ...] = ()
    published: tuple[PublishedSet, ...] = ()
    extra_files: tuple[str, ...] = ()
    plan_previews: Callable[..., Any] = _not_offered
    plan_gallery: Callable[..., Any] = _not_offered
    recipe: Callable[[int, int | None], Any] = _not_offered

    def __post_init__(self) -> None:
        if not self.content:
            object.__setattr__(self, "content", self.nouns)

    def load(self, name: Any, split: str) -> Any:
        """Open a split as the kind's package does."""
        return import_module(self.package).load(name, split)

    def command_of(self, manifest: Specified | None) -> str:
        """Return the command that made a data set: that of the kind, unless it is a copy or converted."""
        operation = None if manifest is None else manifest.spec.get("operation")
        return f"{self.command} {operation}" if operation else self.made_by

    def command_like(self, command: str) -> str:
        """Return a command of this kind by its name, or the one that prints rows where it has none such."""
        return command if command in SHARED_COMMANDS and command not in self.missing_commands else "show"

    def schema_of(self, manifest: Specified | None) -> Any:
        """Return the Arrow schema of every shard of a data set; None where it follows from a source."""
        return None if self.schema is None or is_export(manifest) else self.schema()

    def loading_lines(
        self, manifest: Specified | None, name: str, split: str, revision: str | None = None
    ) -> tuple[str, str]:
        """Return an import and a call that open a split of a data set of this kind in Python."""
        function = f"{self.package}.load" if self.loader is None else self.loader(manifest)
        if is_export(manifest):
            function = "datasets.load_dataset"
        further = f", revision={_quoted(revision)}" if revision else ""
        call = f"{function}({_quoted(name)}, split={_quoted(split)}{further})"
        return f"import {function.partition('.')[0]}", call


@cache
def kinds() -> tuple[DatasetKind, ...]:
    """Return all kinds that are installed, by name; takes 30 ms once, so ask a known kind where you can."""
    # Here and not above: every command line starts with this file, and few ask.
    from importlib.metadata import entry_points

    found = [entry.load() for entry in entry_points(group="tactile_toolkit.kinds")]
    return tuple(sorted(found, key=lambda kind: kind.name))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a JSON string is one of Python too
