"""Kinds of data sets: everything other packages need to know about a kind.

The ``kind.py`` of the package of each kind defines a ``KIND``. The entry points of the group
``tactile_toolkit.kinds`` name these objects, also those of other distributions.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from tactile_toolkit.value_types import JsonDict, JsonObject

if TYPE_CHECKING:
    import pyarrow as pa

EXPORT = "export"
MERGE = "merge"
SPLIT = "split"
SELECT = "select"
"""Operations of a manifest that made a copy: for other libraries, of several data sets, of some rows."""

_COMMANDS = {
    EXPORT: "tactile export",
    MERGE: "tactile merge",
    SPLIT: "tactile split",
    SELECT: "tactile select",
    "import": "realtouch import",
    "resize": "realtouch resize",
    "to-single": "realtouch stills",
    "depth": "tactile-sim depth",
    "grasp": "tactile-sim grasp",
    "pairs": "tactile-sim pairs",
}
"""Command of each operation that a manifest names."""

_PAPER = "Schneider et al., Tactile MNIST: Benchmarking Active Tactile Perception, 2025"
_HAND = "Beaulac & Rosenthal, doi 10.1007/s42979-022-01494-2, 2022"


class Specified(Protocol):
    """A value with a specification, such as a manifest."""

    @property
    def spec(self) -> JsonObject:
        """JSON values that decide all rows."""


def is_export(manifest: Specified | None) -> bool:
    """Return whether a manifest is that of an export for other libraries, with other columns."""
    return manifest is not None and manifest.spec.get("operation") == EXPORT


def is_for_others(manifest: Specified | None) -> bool:
    """Return whether a manifest is that of files for other programs, without rows of its kind."""
    return manifest is not None and manifest.spec.get("operation") in (EXPORT, "pairs")


def is_copy(manifest: Specified | None) -> bool:
    """Return whether a manifest is that of a copy, which states its source, not how rows are made."""
    return manifest is not None and manifest.spec.get("operation") in (EXPORT, MERGE, SPLIT, SELECT)


AnyCall: TypeAlias = Callable[..., Any]
"""A function that only its kind of data set knows, or that is imported when it is called."""


def lazy(path: str) -> AnyCall:
    """Return a function, or method, that is imported when it is called, by ``"package.module:name"``.

    So ``--help`` and looking up a name import no library of a kind.
    """

    def call(*args: object, **options: object) -> Any:
        return _imported(path)(*args, **options)

    return call


def _imported(path: str) -> Any:
    module, _, name = path.partition(":")
    return attrgetter(name)(import_module(module))


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
        Short description.
    citation : str
        Publications to cite.
    licence : str or None
        Licence that the publishers state; None if only the card on the Hub states it.
    aliases : tuple of str
        Other short names.
    """

    name: str
    repo_id: str
    content: str
    citation: str
    licence: str | None = None
    aliases: tuple[str, ...] = ()

    @staticmethod
    def named(name: str) -> PublishedSet | None:
        """Return a published set by its short name or its repository; None for any other name."""
        entries = (entry for kind in DatasetKind.installed() for entry in kind.published)
        return next((entry for entry in entries if name in (entry.name, entry.repo_id, *entry.aliases)), None)


def tactile_mnist_set(
    name: str, repository: str, content: str, *, licence: str | None = None, aliases: tuple[str, ...] = ()
) -> PublishedSet:
    """Return a data set of the Tactile MNIST paper; those of digits cite the authors of HWD+, too."""
    citation = f"{_PAPER}; {_HAND}" if "digits" in content else _PAPER
    repo_id = f"TimSchneider42/tactile-mnist-{repository}"
    return PublishedSet(name, repo_id, content, citation, licence, aliases)


_SOLIDS = lazy("tactile_toolkit.mesh:SolidDataset")
_SHEETS = lazy("tactile_toolkit.pictures.previews:plan_sheets")


@dataclass(frozen=True, slots=True)
class Facts:
    """What a kind tells about a data set beyond its splits: a table, sentences, and values for JSON."""

    header: tuple[str, ...] = ()
    rows: tuple[tuple[object, ...], ...] = ()
    lines: tuple[str, ...] = ()
    document: JsonObject = field(default_factory=dict)


class Checked(Protocol):
    """Findings in a data set or a file."""

    @property
    def checked(self) -> int:
        """Number of checked objects."""

    @property
    def failed(self) -> int:
        """Number of objects that are not valid."""

    @property
    def unreadable(self) -> Sequence[str]:
        """Reasons why files or rows could not be read."""

    def to_dict(self) -> JsonDict:
        """Return JSON values."""

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table."""

    def advice(self) -> Sequence[str]:
        """Return advice on warnings, one line for each."""


def _not_offered(*_: object, **__: object) -> Any:
    raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class DatasetKind:
    """One kind of data set; heavy functions are imported when they are called (:func:`lazy`).

    Attributes
    ----------
    name : str
        Name in ``manifest.json``.
    package : str
        Package whose ``load`` opens such data sets.
    noun, nouns : str
        Name of a row, singular and plural: ``"digit"``, ``"digits"``.
    content : str
        Content of such a data set in a word or two; ``nouns`` by default.
    made_by : str
        Command that makes such folders, for messages.
    card_template : str
        Template of its cards in ``data_cards``.
    write_card : callable
        Takes a ``DataFolder`` and its ``Manifest``, if it has one; writes the card and its picture.
    schema : callable or None
        Takes a ``Manifest`` or None, returns the Arrow schema of every shard; None if it follows from a
        source.
    check : callable or None
        Takes a ``DataFolder`` and a number of threads, returns findings; None if checksums, schema, ids and
        card are all there is to check.
    needs_manifest : bool
        Whether a folder without ``manifest.json`` can be neither uploaded nor given a card.
    class_names : tuple of str
        Classes of the published data set, in order.
    columns : tuple of str
        Columns that only rows of this kind have, by which they are recognised without a manifest.
    needs : tuple of str
        Columns; every such data set has at least one of them.
    splits : tuple of str
        Splits that such data sets have, in order.
    published : tuple of PublishedSet
        The published data sets of this kind.
    extra_files : tuple of str
        Patterns of further files of such data sets, such as ``images/*.png``. All other files in these
        folders are a user's to ``--overwrite``.
    plan_previews, plan_gallery : callable
        Plan pictures, or a page, of a data set; sheets of solids by default.
    preview_spec : str
        Path, as of :func:`lazy`, of the dataclass of the options of ``plan_previews``.
    facts : callable or None
        Takes a ``DataFolder`` and the ``Manifest`` of a finished data set, returns its :class:`Facts`.
    check_content : callable or None
        Checks each row: takes an opened data set, a split or None, a limit or None and a number of workers,
        returns a :class:`Checked`; None if rows hold nothing to check beyond their files.
    dataset : callable
        Class that opens the shards of a split: takes a ``ShardedTable`` and ``label_names``.
    default_set : callable or None
        Takes a seed and a number per class, returns the :class:`tactile_toolkit.generation.DefaultSet` of
        what needs no input; None if all need some.
    """

    name: str
    package: str
    noun: str
    nouns: str
    made_by: str
    card_template: str
    write_card: AnyCall
    content: str = ""
    schema: Callable[[Specified | None], pa.Schema | None] | None = None
    check: AnyCall | None = None
    needs_manifest: bool = True
    class_names: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    needs: tuple[str, ...] = ("mesh.faces",)
    splits: tuple[str, ...] = ()
    published: tuple[PublishedSet, ...] = ()
    extra_files: tuple[str, ...] = ()
    plan_previews: AnyCall = _not_offered
    preview_spec: str = "tactile_toolkit.catalog:PreviewSpec"
    plan_gallery: AnyCall = _not_offered
    facts: AnyCall | None = None
    check_content: Callable[..., Checked] | None = None
    dataset: AnyCall = _SOLIDS
    default_set: AnyCall | None = None

    def __post_init__(self) -> None:
        if not self.content:
            object.__setattr__(self, "content", self.nouns)
        if self.plan_previews is _not_offered:
            object.__setattr__(self, "plan_previews", partial(_SHEETS, self))

    @classmethod
    @cache
    def installed(cls) -> tuple[DatasetKind, ...]:
        """Return all kinds, sorted by name; the first call takes 30 ms."""
        # Imported here: every command line starts with this file, and few need it.
        from importlib.metadata import entry_points

        kinds = [entry.load() for entry in entry_points(group="tactile_toolkit.kinds")]
        return tuple(sorted(kinds, key=lambda kind: kind.name))

    @classmethod
    def named(cls, name: str | None) -> DatasetKind | None:
        """Return the kind of a name in manifests; None if it is not installed."""
        return next((kind for kind in cls.installed() if kind.name == name), None)

    @classmethod
    def of_published(cls, name: str) -> DatasetKind | None:
        """Return the kind of a published set by its short name or its repository; None for others."""
        known = PublishedSet.named(name)
        return next((kind for kind in cls.installed() if known in kind.published), None)

    @classmethod
    def of_columns(
        cls, names: Collection[str], class_names: Callable[[], tuple[str, ...]]
    ) -> DatasetKind | None:
        """Return the kind of rows by a column that only it has, or of meshes by the published classes.

        ``names`` are dotted names of columns. ``class_names`` gives those that are stored with the rows; they
        may be damaged, and are read only if no column decides.
        """
        own = {name.partition(".")[0] for name in names}
        for kind in cls.installed():
            if own.intersection(kind.columns):
                return kind
        if cls.needs[0] not in names:
            return None
        known = (kind for kind in cls.installed() if kind.published and kind.class_names)
        stored = class_names()
        return next((kind for kind in known if kind.class_names == stored), None)

    def load(self, name: object, split: str) -> Any:
        """Open a split as the kind's package does."""
        return import_module(self.package).load(name, split)

    @property
    def preview_class(self) -> type[Any]:
        """Class of the options of previews, imported on first use."""
        options: type[Any] = _imported(self.preview_spec)
        return options

    @property
    def has_touches(self) -> bool:
        """Whether rows are rounds of touches; other rows are meshes."""
        return "sensor_image" in self.needs

    def is_told_by(self, manifest: Specified) -> bool:
        """Return whether the specification of a manifest tells how its rows were made, or touches chosen."""
        operation = manifest.spec.get("operation")
        is_selected = self.has_touches and operation == SELECT
        return not is_for_others(manifest) and (is_selected or not is_copy(manifest))

    def command_of(self, manifest: Specified | None) -> str:
        """Return the command that made a data set: that of the kind, or of a copy or conversion."""
        operation = manifest.spec.get("operation") if manifest is not None else None
        return _COMMANDS.get(operation or "", self.made_by)

    def schema_of(self, manifest: Specified | None) -> pa.Schema | None:
        """Return the Arrow schema of every shard of a data set; None if it follows from a source."""
        if self.schema is None or is_copy(manifest):
            return None
        return self.schema(manifest)

    def loading_lines(
        self, manifest: Specified | None, name: str, split: str, revision: str | None = None
    ) -> tuple[str, str]:
        """Return an import and a call that open a split of a data set of this kind in Python."""
        function = f"{self.package}.load"
        if is_for_others(manifest):
            function = "datasets.load_dataset"
        further = f", revision={_quoted(revision)}" if revision else ""
        call = f"{function}({_quoted(name)}, split={_quoted(split)}{further})"
        return f"import {function.partition('.')[0]}", call


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a JSON string is one of Python too
