"""The data card of a data set of digits, and summaries of its splits by the roles of columns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mnist3d.digit_records import REPORT_FILE, SUMMED_UP, DigitRow, classes_of
from mnist3d.kind import KIND
from mnist3d.sources.picture_folder import FolderSource
from tactile_toolkit import cards, mesh, read, store, wording
from tactile_toolkit.kind import Facts
from tactile_toolkit.rows import Column
from tactile_toolkit.value_types import JsonDict, JsonObject

_MAX_LISTED = 12
COLUMNS = DigitRow.meanings()
_USUAL_SIZES = {FolderSource.name: "four fifths in `train`, one fifth in `test`"}


@dataclass(frozen=True, slots=True)
class SplitSummary:
    """One split: counts of the manifest, and figures of its columns by name.

    Attributes
    ----------
    split : str
        Name of the split.
    counts : mapping of str to int
        Rows, shards, bytes and skipped items.
    facets : mapping
        Number of rows with each value.
    measures : mapping
        Minimum, median and maximum; empty without rows.
    """

    split: str
    counts: Mapping[str, int]
    facets: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    measures: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Return JSON values."""
        return {"split": self.split, **self.counts, **self.facets, **self.measures}

    def text(self, column: Column) -> str:
        """Return the figures of a column as text."""
        if column.role == "measure":
            spread = self.measures[column.name]
            if not spread:
                return "-"
            return "{0} to {2} (median {1})".format(*(figure_text(column, figure) for figure in spread))
        counts = self.facets[column.name]
        # A row has one class, but any number of warnings, of which each is named.
        is_even = len(counts) > 1 and len(set(counts.values())) == 1
        if is_even and not pa.types.is_list(column.data_type):
            return f"{next(iter(counts.values())):,} of each of {len(counts):,}"
        if len(counts) > _MAX_LISTED:
            return wording.with_count(len(counts), "values")
        return ", ".join(f"{value}: {count:,}" for value, count in counts.items()) or "none"


def heading(column: Column) -> str:
    """Return title and unit of a column, for headers of tables."""
    return ", ".join(filter(None, (column.title, column.unit)))


def figure_text(column: Column, number: float) -> str:
    """Format a value of a column with its decimals; an unknown value, NaN, is a dash."""
    return "-" if math.isnan(number) else f"{number:,.{column.decimals}f}"


def summarise_columns(
    manifest: store.Manifest, table: pa.Table, declared: Sequence[Column]
) -> list[SplitSummary]:
    """Summarise the columns of a table for each split; ``table`` has a column ``split``."""
    summaries = []
    for split, counts in manifest.split_table().items():
        rows = table.filter(pc.equal(table["split"], split))
        summaries.append(
            SplitSummary(
                split,
                counts,
                {column.name: _counts(rows[column.name]) for column in declared if column.role == "facet"},
                {column.name: _spread(rows[column.name]) for column in declared if column.role == "measure"},
            )
        )
    return summaries


def _counts(values: pa.ChunkedArray) -> dict[str, int]:
    flat = values.combine_chunks()
    if pa.types.is_list(flat.type):
        flat = flat.flatten()
    counts = {str(entry["values"]): entry["counts"] for entry in flat.value_counts().to_pylist()}
    return {value: counts[value] for value in sorted(counts, key=wording.natural_key)}


def _spread(values: pa.ChunkedArray) -> tuple[float, ...]:
    numbers = values.to_numpy()
    if not len(numbers):
        return ()
    return tuple(round(float(figure(numbers)), 3) for figure in (np.min, np.median, np.max))


def facts_table(
    summaries: Sequence[SplitSummary], declared: Sequence[Column]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return header and lines of a table of figures: a line for each column, a column for each split."""
    lines = [(heading(column), *(summary.text(column) for summary in summaries)) for column in declared]
    return ("", *(summary.split for summary in summaries)), lines


def facts(folder: store.DataFolder, manifest: store.Manifest) -> Facts:
    """Return the figures of a finished data set and advice on printing it; raises as :func:`summarise`."""
    summaries = summarise(folder, manifest)
    header, rows = facts_table(summaries, SUMMED_UP)
    words = (word for summary in summaries for word in summary.facets["warnings"])
    advice = mesh.PrintReport.advice(words, mesh.PrintReport.DATASET_OPTIONS)
    document: JsonDict = {"splits": [summary.to_dict() for summary in summaries]}
    return Facts(header, tuple(rows), tuple(advice), document)


def summarise(folder: store.DataFolder, manifest: store.Manifest) -> list[SplitSummary]:
    """Summarise each split of a data set from its manifest and its printability report.

    Raises IntegrityError if the report is missing or damaged.
    """
    columns = ["split", *(column.name for column in SUMMED_UP)]
    return _summaries(manifest, read.Shard(folder.address(REPORT_FILE)).read(columns))


def _summaries(manifest: store.Manifest, report: pa.Table) -> list[SplitSummary]:
    names = classes_of(manifest)
    summaries = []
    for summary in summarise_columns(manifest, report, SUMMED_UP):
        labels = {
            wording.class_name(names, int(label)): count for label, count in summary.facets["label"].items()
        }
        summaries.append(replace(summary, facets={**summary.facets, "label": labels}))
    return summaries


def write_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a data set folder, and the picture in it.

    Raises IntegrityError if a shard or the printability report is missing or damaged.
    """
    # From the manifest, never from defaults: the card may be written again by a later version.
    spec = manifest.made_by
    words = source_words(str(spec["source"]["name"]) if spec else "copy")
    # Digits of a folder of pictures are not MNIST 3D.
    is_own = words["name"] == FolderSource.name
    if manifest.is_copy:
        title = "3D digits" if is_own else "MNIST 3D"
        card = cards.Card.of_copy(
            manifest, KIND, title, COLUMNS, words["licence"], _cited(words), **_terms(words)
        )
        card.write(folder, manifest, KIND)
        return
    report = read.Shard(folder.address(REPORT_FILE)).read()
    summaries = _summaries(manifest, report)
    profile = spec["print_profile"]
    solid = spec["solid"]
    things = "handwritten digits"
    if classes_of(manifest) != KIND.class_names:
        things = "drawings"
    joined = ", separate pieces bridged" if solid["join_bodies"] else ""
    title = wording.printable(store.split_uri(folder.address())[1]) if is_own else "MNIST 3D"
    cards.Card(
        template=KIND.card_template,
        title=title,
        columns=COLUMNS,
        picture=("digits.png", "The first digits of each class, seen from above"),
        licence=words["licence"],
        tags=["tactile", "active-perception", "3d", "mesh", "mnist", "digits", "3d-printing"],
        figures={
            "left out": [s.counts["skipped"] for s in summaries],
        },
        limits=_limits(manifest, summaries, words),
        values={
            "source_text": source_description(words, spec["source"]),
            "split_rule": _split_rule(spec),
            "solid_text": (
                f"{solid['profile']} profile, {solid['half_thickness_mm']:g} mm half thickness, "
                f"{solid['pixel_pitch_mm']:g} mm per pixel, about {solid['target_vertices']:,} vertices, "
                f"{solid['smoothing_iterations']} rounds of smoothing{joined}"
            ),
            "print_table": cards.markdown_table(*facts_table(summaries, SUMMED_UP)),
            "report_columns": ", ".join(f"`{name}`" for name in report.column_names),
            **{name: f"{profile[name]:g}" for name in ("nozzle_mm", "min_wall_mm", "overhang_deg")},
            "things": things,
            **_terms(words),
        },
        cited=_cited(words),
    ).write(folder, manifest, KIND)


def _split_rule(spec: JsonObject) -> str:
    split = spec["split"]
    unit = {"digit": "digit by digit", "writer": "whole writers", "none": "not divided"}[split["by"]]
    cuts = [
        f"the first {spec[name]:,} {of} only"
        for name, of in (("per_class", "of each class of a split"), ("limit", "rows of a split"))
        if spec[name] is not None
    ]
    sizes = _USUAL_SIZES.get(spec["source"]["name"], "published sizes")
    if split["by"] == "none":
        sizes = "all digits in `train`"
    if split["sizes"] is not None:
        sizes = "digits per class: " + ", ".join(f"{name} {size:,}" for name, size in split["sizes"].items())
    return ", ".join([unit, f"seed {split['seed']}", sizes, *cuts])


def _limits(manifest: store.Manifest, summaries: list[SplitSummary], words: Mapping[str, str]) -> list[str]:
    rows = sum(s.counts["rows"] for s in summaries)
    pieces = rows - sum(s.facets["bodies"].get("1", 0) for s in summaries)
    warned = sum(sum(s.facets["warnings"].values()) for s in summaries)
    in_pieces = "None of the digits is in several pieces"
    if pieces:
        in_pieces = f"{pieces:,} of {rows:,} digits are in several pieces that print apart"
    lines = [
        words["limit"],
        f"{in_pieces}; `--join-bodies` makes bridges.",
        f"The print profile raises {wording.with_count(warned, 'warnings')}; a digit with a warning may "
        "still print.",
        "Heights and shoulders are inferred from the published meshes: the erosion sizes were not published.",
    ]
    if manifest.spec["per_class"] is not None or manifest.spec["limit"] is not None:
        lines.append("This is a cut of the full splits; it is not meant for comparing results.")
    return lines


def source_words(name: str) -> dict[str, str]:
    """Return the texts about a source of digits; an unknown source has neutral ones."""
    known = cards.Card.words("digit_words.toml")
    return {"name": name, **(known.get(name) or known["other"])}


def source_description(words: Mapping[str, str], fingerprint: JsonObject) -> str:
    """Describe a source with its fingerprint."""
    fields = dict(fingerprint)
    if "parts" in fields:
        fields["images"] = sum(part["images"] for part in fields["parts"])
        fields["marks"] = ", ".join(f"`{part['images_sha256']:.12}`" for part in fields["parts"])
    return f"`{words['name']}`: {words['text'].format(**fields)}"


def _terms(words: Mapping[str, str]) -> dict[str, str]:
    """Return licence and citation of the meshes."""
    citation = (
        "Algorithm and splits: Schneider et al. 2025. The published MNIST 3D was made from the "
        f"handwriting of HWD+ (Beaulac and Rosenthal 2022){words['citation_end']}."
    )
    return {"licence_text": words["licence_text"], "citation_text": citation}


def _cited(words: Mapping[str, str]) -> list[str]:
    """Return the publications to cite."""
    if words["name"] == "mnist":
        return ["tactile_mnist", "mnist", "hwd_plus"]
    return ["tactile_mnist", "hwd_plus"]
