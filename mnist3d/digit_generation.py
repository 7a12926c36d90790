"""Generation of a data set folder from a source of digit images, and the choice of the source."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any, Unpack

import numpy as np
import pyarrow as pa

from mnist3d import digit_options, digit_records
from mnist3d.kind import KIND
from mnist3d.sources import digit_arrays, digit_source, digit_tables, picture_folder, synthetic
from tactile_toolkit import generation, mesh, store
from tactile_toolkit.checked_fields import check_fields, integer
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.value_types import Int64, JsonDict, JsonObject

_NEEDED = {
    "synthetic": (),
    "hwdplus": ("images", "writer_info"),
    "mnist": ("images",),
    "table": ("images",),
    "folder": ("images",),
}
"""Options without which a source cannot be made."""

_FIELDS = {
    "synthetic": {"digits": "count"},
    "hwdplus": {"images": "images", "writer_info": "writer_info", "writer_column": "writer_column"},
    "mnist": {"images": "root"},
    "table": {"images": "root"},
    "folder": {"images": "root", "foreground": "ink", "threshold": "threshold"},
}
"""Fields of each source, by option."""

_SOURCES: dict[str, Callable[..., digit_source.DigitSource]] = {
    "synthetic": synthetic.SyntheticSource,
    "hwdplus": digit_arrays.HwdPlusSource,
    "mnist": digit_arrays.MnistSource,
    "table": digit_tables.TableSource,
    "folder": picture_folder.FolderSource,
}

_UNCOMPARED = ("writers_sha256", "left_out")
"""Parts of a fingerprint that do not affect solids."""

# Time for a digit and its report on one core, seconds (AMD EPYC).
_ROW_S = 0.016
_ADD_PICTURES = (
    "to add pictures, put the new ones into a folder with the same classes, make another data set of it, and "
    "join both by `tactile merge OLD NEW --out BOTH`; to make all again, add --overwrite"
)


def chosen_source(name: str, options: JsonObject, seed: int) -> digit_source.DigitSource:
    """Return the source that options choose; InputError for a missing option, or one of another source."""
    for option in _NEEDED[name]:
        if option not in options:
            raise InputError(f"is needed by the source {name!r}, and was not given", field=option)
    if name == "mnist" and options.get("download"):
        digit_arrays.download_mnist(options["images"])
    values = {field: options[option] for option, field in _FIELDS[name].items() if option in options}
    if name == "synthetic":
        values["seed"] = seed
    return _SOURCES[name](**values)


def source_again(described: JsonObject, **files: str | None) -> digit_source.DigitSource:
    """Return the source that a fingerprint describes; ``files`` are the current paths of its files.

    Raises InputError if files are missing, or differ from those that the data set was made from.
    """
    name = described["name"]
    if name not in _SOURCES:
        raise InputError(
            f"the data set was made from the unknown source {name!r}", next="draw --draw sheet only"
        )
    for option, path in files.items():
        if path is not None and name == "synthetic":
            raise InputError("has no effect: these digits are synthetic", next="leave it out", field=option)
    # No file that a manifest names is opened.
    known = {
        **files,
        "digits": described.get("count"),
        "foreground": described.get("ink"),
        "threshold": described.get("threshold"),
    }
    options = {option: value for option, value in known.items() if value is not None}
    source = chosen_source(name, options, int(described.get("seed", 0)))
    current = {key: value for key, value in source.fingerprint().items() if key not in _UNCOMPARED}
    if current != {key: value for key, value in described.items() if key not in _UNCOMPARED}:
        if files.get("images") is None:
            raise InputError(
                f"source {name!r} now makes other images than the data set was made from",
                next="use the version of the toolkit that its manifest names",
            )
        raise InputError(
            f"{files.get('images')!r} holds other images than the data set was made from",
            next="give the same files as when it was made",
            field="images",
        )
    return source


@dataclass(frozen=True)
class DigitSetSpec:
    """Everything that decides the rows of a data set.

    Attributes
    ----------
    source : DigitSource
        Where the images come from.
    solid : SolidSpec
        How an image becomes a solid.
    split : SplitSpec
        How digits are divided into splits.
    profile : PrintProfile
        Printer and material of the print report.
    per_class : int or None
        Make only the first ``per_class`` digits of each class of a split.
    limit : int or None
        Of these, make only the first ``limit`` rows of a split.

    Notes
    -----
    The splits of a call and the number of workers are not part of it: a folder can be filled split by split,
    on any machine.
    """

    source: digit_source.DigitSource
    solid: digit_options.SolidSpec = field(default_factory=digit_options.SolidSpec)
    split: digit_options.SplitSpec = field(default_factory=digit_options.SplitSpec)
    profile: mesh.PrintProfile = field(default_factory=mesh.PrintProfile)
    per_class: int | None = integer(None, 1, optional=True)
    limit: int | None = integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        check_fields(self, "the data set's specification")

    def to_dict(self) -> JsonDict:
        """Return JSON values that identify the rows; two equal values give equal Parquet."""
        return {
            "source": self.source.fingerprint(),
            "solid": asdict(self.solid),
            "split": self.split.to_dict(),
            "print_profile": asdict(self.profile),
            "per_class": self.per_class,
            "limit": self.limit,
        }


@dataclass(frozen=True)
class DigitGenerator(generation.RowGenerator):
    """Generator of digits: divides the source into splits and makes a checked solid of each image."""

    spec: DigitSetSpec
    kind = KIND
    kernels = (
        "tactile_toolkit.mesh.box_tree",
        "tactile_toolkit.mesh.crossings",
        "mnist3d.compiled_loops",
        "tactile_toolkit.mesh.walls",
    )

    @classmethod
    def of(cls, spec: DigitSetSpec, splits: Sequence[str] | None) -> DigitGenerator:
        """Return a generator; a folder of pictures is divided only if ``spec`` or ``splits`` ask for it."""
        is_divided = splits is not None or spec.split.by is not None or spec.split.sizes is not None
        if is_divided or not spec.source.catalog().has_files:
            return cls(spec)
        return cls(replace(spec, split=replace(spec.split, by="none")))

    def items(self) -> Mapping[str, Int64]:
        """Return the ids of each split; reads the catalog of the source only."""
        sizes: Mapping[str, int] = digit_options.PUBLISHED_SIZES
        splits: tuple[str, ...] = digit_options.SPLITS
        catalog = self.spec.source.catalog()
        if catalog.has_files:
            sizes = digit_options.OWN_SIZES
            named = dict(self.spec.split.sizes or sizes)
            splits = tuple(split for split in digit_options.SPLITS if split in named)
        plan = digit_source.plan_splits(catalog, self.spec.split, sizes)
        return {split: plan.rows(split, self.spec.per_class, self.spec.limit) for split in splits}

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of rows."""
        return generation.StorageLayout(
            digit_records.PARQUET_STYLE,
            libraries=("manifold3d", "numpy", "pillow", "pyarrow", "scikit-image", "scipy"),
            smallest=50,
            largest=128,  # 7 MB at 52.6 kB per mesh: a kill loses seconds of work
            usual_shards=16,
            sampled=8,
            report_file=digit_records.REPORT_FILE,
        )

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard."""
        catalog = self.spec.source.catalog()
        return digit_records.stored_schema(catalog.class_names, has_files=catalog.has_files)

    def make(self, split: str, items: Any) -> Iterator[digit_records.DigitRow | store.Skipped]:
        """Yield the row of each digit, or the reason why it gives no solid."""
        is_drawing = _has_drawings(self.spec.source.catalog())
        for digit_id in items.tolist():
            try:
                yield make_row(digit_id, self.spec, is_drawing=is_drawing)
            except ItemError as error:
                yield store.Skipped(digit_id, error.reason, error.message)

    def report(self, shard: store.ShardName, rows: Sequence[digit_records.DigitRow]) -> pa.Table:
        """Return the printability report of the meshes."""
        return digit_records.report_table(shard, rows)

    def next_if_other(self) -> str:
        """Return the advice on adding pictures to a data set of a folder; empty for other sources."""
        if not self.spec.source.catalog().has_files:
            return ""
        return _ADD_PICTURES

    def plan_meshes(self, split: str) -> generation.PlannedMeshes:
        """Return the digits of a split, each of which is made by itself, without its report."""
        ids = self.items()[split]
        catalog = self.spec.source.catalog()
        labels = catalog.labels[np.searchsorted(catalog.ids, ids)]
        make = partial(_solid, self.spec, _has_drawings(catalog))
        return generation.PlannedMeshes(ids, labels, make, _ROW_S)


def _has_drawings(catalog: digit_source.DigitCatalog) -> bool:
    return catalog.class_names != digit_source.DIGITS


def _solid(spec: DigitSetSpec, is_drawing: bool, digit_id: int) -> mesh.Mesh:
    from mnist3d.solid import algorithm  # numba, which only workers need

    return algorithm.solid_of_sheet(spec.source.image(digit_id).pixels, spec.solid, is_drawing=is_drawing)


def make_row(digit_id: int, spec: DigitSetSpec, *, is_drawing: bool = False) -> digit_records.DigitRow:
    """Read one digit, make its solid and inspect it.

    ``is_drawing`` is as for :func:`mnist3d.solid.algorithm.solid_of_sheet`. Raises ItemError when the image
    cannot be used, or the mesh does not bound a solid; the reason is one of
    :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`.
    """
    from mnist3d.solid import algorithm  # numba, which only workers need

    digit = spec.source.image(digit_id)
    digit_name = f"digit {digit_id} of source {spec.source.name!r}"
    try:
        made = algorithm.solid_of_sheet(digit.pixels, spec.solid, is_drawing=is_drawing)
    except ItemError as error:
        raise ItemError(error.reason, f"{digit_name}: {error.message}") from error
    report = mesh.PrintReport.of(made, spec.profile)
    # Only meshes that bound a solid are stored.
    if report.problem is not None:
        raise ItemError(report.problem, f"{digit_name} gives no valid solid: {report.detail}")
    return digit_records.DigitRow(
        id=digit.id,
        label=digit.label,
        vertices_m=made.vertices_m,
        faces=made.faces,
        writer=digit.writer,
        volume_m3=report.volume_mm3 * 1e-9,
        source=spec.source.name,
        report=report,
        file=digit.file,
    )


def generate(
    spec: DigitSetSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of printable 3D digits.

    A folder with an interrupted run of the same specification is completed, and its finished shards are kept.
    The same specification gives byte-identical Parquet for any number of workers and interruptions.

    Parameters
    ----------
    spec : DigitSetSpec
        Specification of the data set.
    out : str or path-like
        Folder to write.
    splits : sequence of str, optional
        Splits to make; other splits in the folder stay. The default is all splits, or ``train`` for a folder
        of images that ``spec.split`` does not divide.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        Content of the folder.

    Raises
    ------
    InputError
        The source or an option cannot be used.
    SpecMismatchError
        The folder has a data set of another specification.
    StorageError
        The folder cannot be written. Finished shards stay.
    """
    return DigitGenerator.of(spec, splits).generate(out, splits, **run)


def default_set(seed: int, per_class: int | None) -> generation.DefaultSet:
    """Return the digits that need no input, of the embedded synthetic source."""
    spec = DigitSetSpec(
        chosen_source("synthetic", {}, seed),
        split=digit_options.SplitSpec(seed=seed),
        per_class=per_class,
    )
    generator = DigitGenerator(spec)
    return generation.DefaultSet(generator, {"per-class": per_class, "seed": seed}, generator.plan_meshes)
