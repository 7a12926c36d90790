"""The data card of a data set of digits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mnist3d.card_picture import PREVIEW_FILE, digit_sheet
from mnist3d.card_sources import SourceWords, words_of
from mnist3d.rows import REPORT_FILE, mesh_schema
from mnist3d.summary import SplitSummary, summarise
from tactile_toolkit.cards.card import (
    HWD_PLUS,
    MNIST,
    TACTILE_MNIST,
    Column,
    bibtex,
    field_table,
    json_block,
    markdown_table,
    megabytes,
    picture,
    render_card,
    write_card_text,
)
from tactile_toolkit.cards.facts import FolderFacts, recorded_facts
from tactile_toolkit.cards.head import card_head, head_text
from tactile_toolkit.cards.pictures import write_previews
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import read_report

__all__ = ["write_card"]

_COLUMNS: dict[str, Column] = {
    "id": ("", "number of the digit in its source, unique over all splits"),
    "label": ("", "the digit"),
    VERTICES: ("V x 3, m, frame below", "corner positions"),
    FACES: ("F x 3", "triangles: rows of the corners, counter-clockwise seen from outside"),
    "writer": ("", "number of the writer in the source, -1 where unknown"),
    "volume_m3": ("m³", "enclosed volume"),
    "source": ("", "digit source"),
}

_CAPTION = "The first digit of each class that is there, seen from above"


def write_card(folder: DataFolder, manifest: Manifest, report: Any = None) -> None:
    """Write ``README.md`` of a data set folder and the picture that it shows.

    A run that has just ended gives its printability ``report``, an Arrow table; it is read otherwise. Raises
    IntegrityError when a shard or the report is missing or damaged.
    """
    if report is None:
        report = read_report(folder, REPORT_FILE)
    facts = recorded_facts(folder, manifest, mesh_schema())
    sheet = digit_sheet(facts)
    if sheet is not None:
        write_previews(folder, {PREVIEW_FILE: sheet})
    words = words_of(str(manifest.spec["source"]["name"]))
    head = card_head(
        facts,
        license=words.licence,
        pretty_name="MNIST 3D",
        task_categories=["robotics", "reinforcement-learning"],
        task_ids=["task-planning"],
        tags=["tactile", "active-perception", "3d", "mesh", "mnist", "digits", "3d-printing"],
    )
    body = render_card("mnist3d.md", _values(manifest, report, facts, words, sheet is not None))
    write_card_text(folder, head_text(head) + "\n" + body)


def _values(
    manifest: Manifest, report: Any, facts: FolderFacts, words: SourceWords, drawn: bool
) -> dict[str, str]:
    summaries = summarise(manifest, report)
    profile = manifest.spec["print_profile"]
    return {
        "rows": f"{facts.rows:,}",
        "picture": picture(PREVIEW_FILE if drawn else None, _CAPTION),
        "version": manifest.toolkit_version,
        "schema_version": str(manifest.schema_version),
        "source_text": words.describe(manifest.spec["source"]),
        "split_rule": _split_rule(manifest.spec),
        "solid_text": _solid_text(manifest.spec["solid"]),
        "skipped": _skipped(manifest),
        "spec": json_block(manifest.spec),
        "split_table": _split_table(summaries, facts),
        "field_table": field_table(facts, _COLUMNS, {}),
        "print_table": _print_table(summaries),
        "report_columns": ", ".join(f"`{name}`" for name in report.schema.names),
        "nozzle_mm": f"{profile['nozzle_mm']:g}",
        "min_wall_mm": f"{profile['min_wall_mm']:g}",
        "overhang_deg": f"{profile['overhang_deg']:g}",
        "limits": _limits(manifest, summaries, words),
        "first_split": facts.splits[0].split,
        "licence_text": words.licence_text,
        "citation_text": words.citation_text,
        "bibtex": bibtex(TACTILE_MNIST, *((MNIST,) if words.name == "mnist" else ()), HWD_PLUS),
    }


def _split_rule(spec: Mapping[str, Any]) -> str:
    split = spec["split"]
    whole = {"digit": "digit by digit", "writer": "whole writers"}[split["by"]]
    cuts = [
        f"the first {spec[name]:,} {unit} only"
        for name, unit in (("per_class", "of each class of a split"), ("limit", "rows of a split"))
        if spec[name] is not None
    ]
    sizes = "published sizes" if split["sizes"] is None else f"digits per class: {_listed(split['sizes'])}"
    return ", ".join([whole, f"seed {split['seed']}", sizes, *cuts])


def _listed(sizes: Any) -> str:
    return ", ".join(f"{split} {size:,}" for split, size in dict(sizes).items())


def _solid_text(solid: Mapping[str, Any]) -> str:
    joined = ", separate pieces bridged" if solid["join_bodies"] else ""
    return (
        f"{solid['profile']} profile, {solid['half_thickness_mm']:g} mm half thickness, "
        f"{solid['pixel_pitch_mm']:g} mm per pixel, about {solid['target_vertices']:,} vertices, "
        f"{solid['smoothing_iterations']} rounds of smoothing{joined}"
    )


def _skipped(manifest: Manifest) -> str:
    reasons = manifest.skipped_reasons()
    if not reasons:
        return "none"
    listed = ", ".join(f"{count:,} for {reason}" for reason, count in reasons.items())
    return f"{listed}; `manifest.json` names each"


def _split_table(summaries: list[SplitSummary], facts: FolderFacts) -> str:
    header = ("split", "digits", "per class", "shards", "Parquet", "unpacked", "left out")
    rows = [
        (
            s.split,
            f"{s.rows:,}",
            _between(s.per_class),
            s.shards,
            megabytes(s.bytes),
            megabytes(split.unpacked_bytes),
            s.skipped,
        )
        for s, split in zip(summaries, facts.splits, strict=True)
    ]
    return markdown_table(header, rows)


def _between(counts: tuple[int, ...]) -> str:
    least, most = min(counts), max(counts)
    return f"{most:,}" if least == most else f"{least:,} to {most:,}"


def _print_table(summaries: list[SplitSummary]) -> str:
    header = ("split", "height, mm", "volume, mm³", "thinnest wall, mm", "digits x bodies", "print warnings")
    rows = [
        (
            s.split,
            _range(s.height_mm),
            _range(s.volume_mm3),
            _range(s.thinnest_wall_mm),
            ", ".join(f"{count:,} x {bodies}" for bodies, count in s.bodies.items()) or "-",
            ", ".join(f"{count:,} {word}" for word, count in s.warnings.items()) or "none",
        )
        for s in summaries
    ]
    return markdown_table(header, rows)


def _range(spread: tuple[float, ...]) -> str:
    return f"{spread[0]:,.1f} to {spread[2]:,.1f} (median {spread[1]:,.1f})" if spread else "-"


def _limits(manifest: Manifest, summaries: list[SplitSummary], words: SourceWords) -> str:
    rows = sum(s.rows for s in summaries)
    pieces = sum(count for s in summaries for bodies, count in s.bodies.items() if bodies > 1)
    warned = sum(count for s in summaries for count in s.warnings.values())
    in_one = "None of the digits is in several pieces"
    told = f"{pieces:,} of {rows:,} digits are in several pieces that print apart" if pieces else in_one
    cut = manifest.spec["per_class"] is not None or manifest.spec["limit"] is not None
    lines = [
        words.limit,
        f"{told}; `--join-bodies` makes bridges.",
        f"The print profile raises {warned:,} warnings; one says what to look at, not that it fails.",
        "Heights and shoulders are inferred from the published meshes: the erosion sizes were not published.",
        *(["This is a cut of the full splits; it is not meant for comparing results."] if cut else []),
    ]
    return "\n".join(f"- {line}" for line in lines)
