"""The data card of a data set of digits, and what it says of the source that they were made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

from mnist3d.kind import KIND
from mnist3d.rows import CLASS_NAMES, REPORT_FILE, mesh_schema
from mnist3d.sources.folder import FolderSource
from mnist3d.summary import SplitSummary, summarise
from tactile_toolkit.cards.card import (
    MESH_COLUMNS,
    MESH_TASKS,
    between,
    bibtex,
    field_table,
    first_rows,
    json_block,
    markdown_table,
    megabytes,
    skipped_text,
    write_card_files,
)
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.cards.table_card import Terms, write_table_card
from tactile_toolkit.catalog.choose import short_name
from tactile_toolkit.kind import is_export
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.pictures.relief import relief
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.printable import markdown_text, printable
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.reports import report_columns

__all__ = ["COLUMNS", "SourceWords", "words_of", "write_card"]

COLUMNS = {
    **MESH_COLUMNS,
    "id": ("", "number of the digit in its source, unique over all splits"),
    "label": ("", "the digit"),
    "writer": ("", "number of the writer in the source, -1 where unknown"),
    "volume_m3": ("m³", "enclosed volume"),
    "source": ("", "digit source"),
}

# Two pixels of the published scale: a digit is some 150 pixels tall.
_PITCH_M = 0.0004
# Rows mix the classes: that 200 of them lack one has a chance of 1 in 10^8.
_ROWS_SEEN = 200


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of a data set folder and the picture that it shows.

    Raises IntegrityError when a shard or the printability report is missing or damaged.
    """
    if is_export(manifest):
        made = manifest.spec["source_spec"]
        title = "3D digits" if made is not None and _is_own(made) else "MNIST 3D"
        write_table_card(folder, manifest, KIND, title, COLUMNS, _terms_of_tables(manifest))
        return
    facts = folder_facts(folder, manifest, mesh_schema())
    summaries = summarise(folder, manifest)
    spec = manifest.spec
    words = words_of(str(spec["source"]["name"]))
    # From the manifest, never from defaults: the card may be written anew by a later version.
    profile, solid = spec["print_profile"], spec["solid"]
    joined = ", separate pieces bridged" if solid["join_bodies"] else ""
    title = printable(short_name(folder.address())) if _is_own(spec) else "MNIST 3D"
    values = {
        "title": markdown_text(title),
        "source_text": words.describe(spec["source"]),
        "split_rule": _split_rule(spec),
        "solid_text": (
            f"{solid['profile']} profile, {solid['half_thickness_mm']:g} mm half thickness, "
            f"{solid['pixel_pitch_mm']:g} mm per pixel, about {solid['target_vertices']:,} vertices, "
            f"{solid['smoothing_iterations']} rounds of smoothing{joined}"
        ),
        "skipped": skipped_text(manifest, "for "),
        "spec": json_block(spec),
        "split_table": _split_table(summaries, facts),
        "field_table": field_table(facts, COLUMNS),
        "print_table": _print_table(summaries),
        "report_columns": ", ".join(f"`{name}`" for name in report_columns(folder, REPORT_FILE)),
        "nozzle_mm": f"{profile['nozzle_mm']:g}",
        "min_wall_mm": f"{profile['min_wall_mm']:g}",
        "overhang_deg": f"{profile['overhang_deg']:g}",
        "limits": _limits(manifest, summaries, words),
        "licence_text": words.licence_text,
        "citation_text": words.citation_text,
        "bibtex": bibtex("tactile_mnist", *(("mnist",) if words.name == "mnist" else ()), "hwd_plus"),
    }
    write_card_files(
        folder,
        facts,
        manifest,
        KIND.card_template,
        values,
        ("digits.png", _sheet(facts), "The first digit of each class that is there, seen from above"),
        license=words.licence,
        pretty_name=title,
        **MESH_TASKS,
        tags=["tactile", "active-perception", "3d", "mesh", "mnist", "digits", "3d-printing"],
    )


def _is_own(spec: Mapping[str, Any]) -> bool:
    """Return whether digits were made from a folder of pictures, which are not those of MNIST 3D."""
    return bool(spec["source"]["name"] == FolderSource.name)


def _terms_of_tables(manifest: Manifest) -> Terms:
    """Return the terms of the source of the digits; of copies of the published set none are known here."""
    made = manifest.spec["source_spec"]
    if made is None:
        text = "The terms of the data set that these rows come from: see its page."
        return Terms("other", text, f"{_PUBLISHED}.", bibtex("tactile_mnist", "hwd_plus"))
    words = words_of(str(made["source"]["name"]))
    cited = ("tactile_mnist", *(("mnist",) if words.name == "mnist" else ()), "hwd_plus")
    return Terms(words.licence, words.licence_text, words.citation_text, bibtex(*cited))


def _sheet(facts: FolderFacts) -> bytes | None:
    """Draw the first digit of each class in the first rows, as PNG at 0.4 mm per pixel; None without rows."""
    first: dict[int, Row] = {}
    for row in islice(first_rows(facts, ["label", VERTICES, FACES]), _ROWS_SEEN):
        first.setdefault(int(row.required("label")), row)
        if len(first) == len(CLASS_NAMES):
            break
    rows = [first[label] for label in sorted(first)]
    tiles = [Tile(relief(row.array(VERTICES), row.array(FACES), _PITCH_M)) for row in rows]
    return png_bytes(sheet(tiles, Sheet(5, margin_px=8))) if tiles else None


def _split_rule(spec: Mapping[str, Any]) -> str:
    split = spec["split"]
    whole = {"digit": "digit by digit", "writer": "whole writers", "none": "not divided"}[split["by"]]
    cuts = [
        f"the first {spec[name]:,} {unit} only"
        for name, unit in (("per_class", "of each class of a split"), ("limit", "rows of a split"))
        if spec[name] is not None
    ]
    sizes = "all digits in `train`" if split["by"] == "none" else "published sizes"
    if split["sizes"] is not None:
        listed = ", ".join(f"{split} {size:,}" for split, size in dict(split["sizes"]).items())
        sizes = f"digits per class: {listed}"
    return ", ".join([whole, f"seed {split['seed']}", sizes, *cuts])


def _split_table(summaries: list[SplitSummary], facts: FolderFacts) -> str:
    header = ("split", "digits", "per class", "shards", "Parquet", "unpacked", "left out")
    rows = [
        (
            s.split,
            f"{s.rows:,}",
            between(min(s.per_class), max(s.per_class)),
            s.shards,
            megabytes(s.bytes),
            megabytes(split.unpacked_bytes),
            s.skipped,
        )
        for s, split in zip(summaries, facts.splits, strict=True)
    ]
    return markdown_table(header, rows)


def _print_table(summaries: list[SplitSummary]) -> str:
    def spread(values: tuple[float, ...]) -> str:
        return f"{values[0]:,.1f} to {values[2]:,.1f} (median {values[1]:,.1f})" if values else "-"

    header = ("split", "height, mm", "volume, mm³", "thinnest wall, mm", "digits x bodies", "print warnings")
    rows = [
        (
            s.split,
            spread(s.height_mm),
            spread(s.volume_mm3),
            spread(s.thinnest_wall_mm),
            ", ".join(f"{count:,} x {bodies}" for bodies, count in s.bodies.items()) or "-",
            ", ".join(f"{count:,} {word}" for word, count in s.warnings.items()) or "none",
        )
        for s in summaries
    ]
    return markdown_table(header, rows)


def _limits(manifest: Manifest, summaries: list[SplitSummary], words: SourceWords) -> str:
    rows = sum(s.rows for s in summaries)
    pieces = sum(count for s in summaries for bodies, count in s.bodies.items() if bodies > 1)
    warned = sum(count for s in summaries for count in s.warnings.values())
    in_one = "None of the digits is in several pieces"
    in_pieces = f"{pieces:,} of {rows:,} digits are in several pieces that print apart" if pieces else in_one
    cut = manifest.spec["per_class"] is not None or manifest.spec["limit"] is not None
    lines = [
        words.limit,
        f"{in_pieces}; `--join-bodies` makes bridges.",
        f"The print profile raises {warned:,} warnings; one says what to look at, not that it fails.",
        "Heights and shoulders are inferred from the published meshes: the erosion sizes were not published.",
        *(["This is a cut of the full splits; it is not meant for comparing results."] if cut else []),
    ]
    return "\n".join(f"- {line}" for line in lines)


@dataclass(frozen=True)
class SourceWords:
    """What a card says about a source of digits: where it is from, its terms, its limits, whom to cite."""

    name: str  # as in the manifest
    text: str  # what it is; fields of its fingerprint in braces
    licence: str  # the Hub's word for the licence of meshes made of it
    licence_text: str
    limit: str
    citation_text: str

    def describe(self, fingerprint: Mapping[str, Any]) -> str:
        """Fill the text with the fingerprint of the source."""
        fields = dict(fingerprint)
        if self.name == "mnist":  # which comes in parts
            fields["images"] = sum(part["images"] for part in fields["parts"])
            fields["marks"] = ", ".join(f"`{part['images_sha256']:.12}`" for part in fields["parts"])
        return f"`{self.name}`: {self.text.format(**fields)}"


_PUBLISHED = (
    "Algorithm and splits: Schneider et al. 2025. The published MNIST 3D was made from the handwriting of "
    "HWD+ (Beaulac and Rosenthal 2022)"
)

_SOURCES = (
    SourceWords(
        "synthetic",
        "strokes drawn by the toolkit, seed {seed}, {count:,} digits, drawing version {drawing_version}",
        "mit",
        "MIT, as the toolkit: no one's handwriting is in it.",
        "The strokes are drawn by a program. They vary like handwriting, but nobody wrote them.",
        f"{_PUBLISHED}; this copy stands in for it with drawn digits.",
    ),
    SourceWords(
        "hwdplus",
        "the high-resolution digits of HWD+, array of shape {shape}, dtype `{dtype}`, fingerprint "
        "`{images_sample_sha256:.12}`",
        "other",
        "The digits carry the terms of HWD+: see its authors' page before passing the meshes on.",
        "97 writers, 14 images of each digit by each: the same hand returns, unless splits divide whole "
        "writers.",
        f"{_PUBLISHED}, as this copy was.",
    ),
    SourceWords(
        "mnist",
        "{images:,} images of 28 x 28 pixels, fingerprint {marks}",
        "cc-by-sa-3.0",
        "CC BY-SA 3.0, as MNIST.",
        "Images of 28 x 28 pixels are enlarged first: outlines are smoother than any pen draws.",
        f"{_PUBLISHED}; this copy is made from MNIST (LeCun et al. 1998).",
    ),
    SourceWords(
        "folder",
        "{images:,} pictures of a folder, ink {ink}, fingerprint `{sha256:.12}`",
        "other",
        "The meshes carry the terms of the pictures that they were made from.",
        "The pictures are a collection of their maker; nothing is known of how they were gathered.",
        f"{_PUBLISHED}; this copy is made from other pictures, whose makers want to be named too.",
    ),
)


def words_of(name: str) -> SourceWords:
    """Return the words about a source; those of one that a user brought along claim nothing."""
    known = {words.name: words for words in _SOURCES}
    return known.get(name) or SourceWords(
        name,
        "a source of its maker's own; its fingerprint is in the specification below",
        "other",
        "The meshes carry the terms of the images that they were made from.",
        "Nothing is known here of how the images were gathered.",
        f"{_PUBLISHED}; this copy is made from other images, whose makers want to be named too.",
    )
