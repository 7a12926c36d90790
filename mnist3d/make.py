"""From a source of digit images to a finished data set folder."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Unpack

from mnist3d.columns import PARQUET_STYLE, REPORT_FILE, DigitRow, digit_schema, report_table
from mnist3d.kind import KIND
from mnist3d.solid import solidify
from mnist3d.sources import DigitSource
from mnist3d.sources.folder import FolderSource
from mnist3d.spec import SPLITS, SolidSpec, SplitSpec
from mnist3d.splits import plan_splits
from tactile_toolkit import making, store
from tactile_toolkit.checked_fields import check_fields, integer
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import PrintProfile, inspect


@dataclass(frozen=True)
class GenerateSpec:
    """Everything that decides which rows a data set holds.

    Attributes
    ----------
    source : DigitSource
        Where the images come from.
    solid : SolidSpec
        How an image becomes a solid.
    split : SplitSpec
        Which digit goes into which split.
    profile : PrintProfile
        What counts as printable.
    per_class : int or None
        Make only the first ``per_class`` digits of each class of a split.
    limit : int or None
        Then make only the first ``limit`` rows of a split.

    Notes
    -----
    The splits made in one call and the number of workers are not part of it: a folder can be filled split by
    split, on any machine.
    """

    source: DigitSource
    solid: SolidSpec = field(default_factory=SolidSpec)
    split: SplitSpec = field(default_factory=SplitSpec)
    profile: PrintProfile = field(default_factory=PrintProfile)
    per_class: int | None = integer(None, 1, optional=True)
    limit: int | None = integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        check_fields(self, "the data set's specification")

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that identify the rows; two equal values give equal Parquet."""
        return {
            "source": self.source.fingerprint(),
            "solid": self.solid.to_dict(),
            "split": self.split.to_dict(),
            "print_profile": asdict(self.profile),
            "per_class": self.per_class,
            "limit": self.limit,
        }


@dataclass(frozen=True)
class DigitMaking(making.Making):
    """How digits are made: the source is divided into splits, and each image becomes a proved solid."""

    spec: GenerateSpec
    kind = KIND

    @classmethod
    def of(cls, spec: GenerateSpec, splits: Sequence[str] | None) -> DigitMaking:
        """Leave pictures of one's own undivided unless the specification or the splits ask for it."""
        is_asked_for = splits is not None or spec.split.by is not None or spec.split.sizes is not None
        if is_asked_for or not isinstance(spec.source, FolderSource):
            return cls(spec)
        return cls(replace(spec, split=replace(spec.split, by="none")))

    def items(self) -> Mapping[str, Any]:
        """Return the ids of each split; reads only the source's catalog."""
        plan = plan_splits(self.spec.source.catalog(), self.spec.split)
        return {split: plan.rows(split, self.spec.per_class, self.spec.limit) for split in SPLITS}

    def layout(self) -> making.Layout:
        """Return how rows are stored."""
        return making.Layout(
            PARQUET_STYLE,
            libraries=("manifold3d", "numpy", "pillow", "pyarrow", "scikit-image", "scipy"),
            smallest=50,
            largest=128,  # at 52.6 kB a mesh 7 MB: what a kill loses is seconds of work
            wanted=16,
            sampled=8,
            report_file=REPORT_FILE,
        )

    def schema(self, split: str) -> Any:
        """Return the Arrow schema of a shard."""
        return digit_schema()

    def make(self, split: str, items: Any) -> Iterator[DigitRow | store.Skipped]:
        """Yield the row of each digit, or why it gives no solid."""
        for digit_id in items.tolist():
            try:
                yield make_row(digit_id, self.spec)
            except ItemError as error:
                yield store.Skipped(digit_id, error.reason, error.message)

    def report(self, shard: store.ShardName, rows: Sequence[Any]) -> Any:
        """Return what was found about each mesh."""
        return report_table(shard, rows)


def make_row(digit_id: int, spec: GenerateSpec) -> DigitRow:
    """Read one digit, make its solid and inspect it.

    Raises ItemError when the image cannot be used, or the mesh does not bound a solid (the reason is one of
    :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`).
    """
    digit, where = spec.source.image(digit_id), f"digit {digit_id} of source {spec.source.name!r}"
    try:
        mesh = solidify(digit.pixels, spec.solid, ink="dark")
    except ItemError as error:
        raise ItemError(error.reason, f"{where}: {error.message}") from error
    report = inspect(mesh, spec.profile)
    # An image gives no row unless its mesh was proved: what is stored are solids.
    if report.problem is not None:
        raise ItemError(report.problem, f"{where} gives no valid solid: {report.detail}")
    return DigitRow(
        id=digit.id,
        label=digit.label,
        vertices_m=mesh.vertices_m,
        faces=mesh.faces,
        writer=digit.writer,
        volume_m3=report.volume_mm3 * 1e-9,
        source=spec.source.name,
        report=report,
    )


def generate(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of printable 3D digits.

    A folder that holds a finished or interrupted run of the same specification is completed: finished shards
    are kept. The same specification gives byte-identical Parquet whatever the number of workers and however
    often the run was interrupted.

    Parameters
    ----------
    spec : GenerateSpec
        What to make.
    out : str or path-like
        Folder to write.
    splits : sequence of str, optional
        Splits to make; others that the folder holds already stay. By default all; for a folder of images only
        ``train``, unless ``spec.split`` divides them.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        What the folder holds now.

    Raises
    ------
    InputError
        The source or an option cannot be used.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    return making.generate(DigitMaking.of(spec, splits), out, splits, **run)


# The options that each source needs, and those that it takes.
_OPTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "synthetic": ((), ("digits",)),
    "hwdplus": (("images", "writer_info"), ("writer_column",)),
    "mnist": (("images",), ("download",)),
    "folder": (("images",), ("foreground", "threshold")),
}


def chosen_source(name: str, given: Mapping[str, Any], seed: int) -> DigitSource:
    """Return the source that options ask for; InputError for options that are missing or of another one."""
    needed, taken = _OPTIONS[name]
    for option in (*given, *needed):
        if option not in given:
            raise InputError(f"--source {name} needs --{option.replace('_', '-')}, which was not given")
        if option not in needed + taken:
            owners = " or ".join(each for each, (first, more) in _OPTIONS.items() if option in first + more)
            raise InputError(
                f"--{option.replace('_', '-')} does not belong to --source {name}",
                next=f"leave it out, or name its source (--source {owners})",
            )
    # Here: most runs need one of them, and the packages of none.
    from mnist3d.sources.hwdplus import HwdPlusSource
    from mnist3d.sources.mnist import MnistSource, download_mnist
    from mnist3d.sources.synthetic import HWD_PLUS_COUNT, SyntheticSource

    if name == "synthetic":
        return SyntheticSource(seed, given.get("digits", HWD_PLUS_COUNT))
    if name == "hwdplus":
        return HwdPlusSource(**given)
    if name == "folder":
        return FolderSource(given["images"], given.get("foreground", "auto"), given.get("threshold", "auto"))
    if given.get("download"):
        download_mnist(given["images"])
    return MnistSource(given["images"])


def source_again(described: Mapping[str, Any], **files: str | None) -> DigitSource:
    """Return the source of a data set by its fingerprint; ``files`` are where its files are now.

    InputError where they are needed and not given, or are others than those the data set was made from.
    """
    name = described["name"]
    if name not in _OPTIONS:
        raise InputError(f"the data set was made from source {name!r}, which is not known")
    needed, taken = _OPTIONS[name]
    known = {
        **files,
        "digits": described.get("count"),
        "foreground": described.get("ink"),
        "threshold": described.get("threshold"),
    }
    given = {option: known[option] for option in (*needed, *taken) if known.get(option) is not None}
    source = chosen_source(name, given, int(described.get("seed", 0)))
    # Who wrote a digit decides no solid, and the column of writers is not asked for; nor do other files.
    unasked = {key: described.get(key) for key in ("writers_sha256", "left_out")}
    if {**source.fingerprint(), **unasked} != {**described, **unasked}:
        raise InputError(
            f"--images {files['images']!r} holds other images than the data set was made from",
            next="give the same files as when it was made",
        )
    return source


def digit_recipe(seed: int, per_class: int | None) -> making.Recipe:
    """Return how digits are made without any input: from the embedded synthetic source."""
    spec = GenerateSpec(chosen_source("synthetic", {}, seed), split=SplitSpec(seed=seed), per_class=per_class)
    return making.Recipe(DigitMaking(spec), {"per-class": per_class, "seed": seed})
