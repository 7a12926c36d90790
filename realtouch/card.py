"""The data card of a data set of touches, converted or published."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from dataset_store.cards.card import render_card, write_card_text
from dataset_store.cards.citations import HWD_PLUS, TACTILE_MNIST, bibtex
from dataset_store.cards.facts import FolderFacts, folder_facts
from dataset_store.cards.head import card_head, head_text
from dataset_store.cards.parts import field_table, json_block, markdown_table, megabytes, picture
from dataset_store.cards.pictures import write_previews
from dataset_store.manifest import Manifest
from dataset_store.storage import DataFolder
from realtouch.card_figures import (
    PREVIEW_FILE,
    SplitFigures,
    index_sheet,
    picture_size,
    split_figures,
    touch_sheet,
)
from realtouch.card_words import (
    COLUMNS,
    FAMILIES,
    FRAMES,
    INDEX_COLUMNS,
    LIMITS,
    PRINTABILITY,
    SYNTHETIC_COLUMNS,
)
from realtouch.contact import MIN_CONTACT_HEIGHT_M
from realtouch.nested import list_depth
from realtouch.schema import column_type, kind_of

__all__ = ["SYNTHETIC", "CardKind", "card_kind", "is_synthetic", "write_card"]

CardKind = Literal["seq", "single", "synthetic", "frames"]
SYNTHETIC = "synthetic"
"""What the option ``touches`` of plain pictures says of touches that were rendered."""

_TITLES: dict[CardKind, str] = {
    "seq": "Real touches: clips",
    "single": "Real touches: single images",
    "synthetic": "Synthetic touches: single images",
    "frames": "Touches as plain pictures",
}
_RENDERED_PICTURES = "Synthetic touches as plain pictures"
_LICENCE = (
    "cc-by-2.0",
    "CC BY 2.0, as the published touches: name their authors, and say what was changed.",
)
_SYNTHETIC_LICENCE = (
    "other",
    "The terms of the published set that the touches come from; see its page on the Hub.",
)


def write_card(
    folder: DataFolder,
    manifest: Manifest | None = None,
    kind: Literal["seq", "single", "frames"] | None = None,
) -> None:
    """Write ``README.md`` of a folder of touches and the picture that it shows.

    Parameters
    ----------
    folder : DataFolder
        A converted data set, or a copy of a published one.
    manifest : Manifest, optional
        Its manifest; a copy of a published set has none, and its card says so.
    kind : "seq", "single", "frames" or None
        What it holds; told from manifest and columns where None.

    Raises
    ------
    InputError
        When the folder holds no touches.
    IntegrityError
        When a file is missing or damaged.
    StorageError
        When the folder cannot be written.
    """
    facts = folder_facts(folder)
    told = card_kind(facts, manifest, folder.address(), kind)
    sheet = index_sheet(facts, folder) if told == "frames" else touch_sheet(facts, _stored_kind(told))
    if sheet is not None:
        write_previews(folder, {PREVIEW_FILE: sheet})
    rendered = _is_rendered(told, manifest)
    values = _values(facts, manifest, told, sheet is not None, rendered=rendered)
    head = card_head(
        facts,
        license=_licence(told, rendered)[0],
        pretty_name=values["title"],
        task_categories=["robotics", "image-classification"],
        task_ids=["multi-class-image-classification"],
        tags=["tactile", "active-perception", "gelsight", "touch", *_tags(told, rendered)],
    )
    write_card_text(folder, head_text(head) + "\n" + render_card(f"touch_{told}.md", values))


def card_kind(facts: FolderFacts, manifest: Manifest | None, where: str, kind: str | None = None) -> CardKind:
    """Tell which card a folder gets.

    Raises
    ------
    InputError
        When the folder holds no touches.
    """
    if kind == "frames" or (manifest is not None and manifest.spec.get("operation") == "frames"):
        return "frames"
    stored = kind_of(facts.schema, where)
    return "synthetic" if stored == "single" and is_synthetic(facts.schema) else stored


def is_synthetic(schema: Any) -> bool:
    """Tell rendered touches from recorded ones: they have a pose of the object for each touch."""
    pose = column_type(schema, "info.object_pose.position")
    return pose is not None and list_depth(pose)[0] == 2


def _is_rendered(kind: CardKind, manifest: Manifest | None) -> bool:
    """Tell whether the touches were rendered; of plain pictures the manifest alone knows."""
    options = {} if manifest is None else manifest.spec.get("options", {})
    return kind == "synthetic" or (kind == "frames" and options.get("touches") == SYNTHETIC)


def _stored_kind(kind: CardKind) -> Literal["seq", "single"]:
    return "seq" if kind == "seq" else "single"


def _values(
    facts: FolderFacts, manifest: Manifest | None, kind: CardKind, drawn: bool, *, rendered: bool
) -> dict[str, str]:
    figures = [] if kind == "frames" else [split_figures(split, _stored_kind(kind)) for split in facts.splits]
    size = None if kind == "frames" else picture_size(facts, _stored_kind(kind))
    columns = INDEX_COLUMNS if kind == "frames" else SYNTHETIC_COLUMNS if rendered else COLUMNS
    return {
        "title": _RENDERED_PICTURES if rendered and kind == "frames" else _TITLES[kind],
        "rows": f"{facts.rows:,}",
        "rounds": f"{facts.rows:,}",
        "touches": _total([figure.touches for figure in figures]),
        "size_text": f", {size[0]} x {size[1]} pixels" if size else "",
        "picture": picture(PREVIEW_FILE if drawn else None, "Some touches, each at contact"),
        "made": _made(manifest),
        "split_table": _split_table(facts, figures, manifest),
        "contact_mm": f"{1e3 * MIN_CONTACT_HEIGHT_M:g}",
        "field_table": field_table(facts, columns, FAMILIES),
        "frames": FRAMES,
        "limits": "\n".join(f"- {line}" for line in LIMITS["synthetic" if rendered else kind]),
        "printability": PRINTABILITY["synthetic" if rendered else "real"],
        "first_split": facts.splits[0].split,
        "licence_text": _licence(kind, rendered)[1],
        "citation_text": _citation_text(rendered),
        "bibtex": bibtex(TACTILE_MNIST, *(() if rendered else (HWD_PLUS,))),
    }


def _licence(kind: CardKind, rendered: bool) -> tuple[str, str]:
    if rendered:
        return _SYNTHETIC_LICENCE
    if kind == "frames":
        return _LICENCE[0], "That of the touches: CC BY 2.0 for the published real ones; name their authors."
    return _LICENCE


def _tags(kind: CardKind, rendered: bool) -> list[str]:
    if rendered:
        return ["synthetic"]
    return ["mnist", "digits", "video"] if kind == "seq" else ["mnist", "digits"]


def _total(counts: list[int | None]) -> str:
    known = [count for count in counts if count is not None]
    return f"{sum(known):,}" if len(known) == len(counts) else "an unknown number of"


def _made(manifest: Manifest | None) -> str:
    if manifest is None:
        return (
            "Not made by this toolkit: the folder has no `manifest.json`, and its files are described as "
            "they are. The schema is that of the data sets that the authors of the paper published."
        )
    source = manifest.spec["source"]
    files = ", ".join(f"{split}: {len(names)}" for split, names in source.items())
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in names):,}" for split, names in source.items())
    lines = [
        ("made by", f"tactile-toolkit {manifest.toolkit_version} (schema {manifest.schema_version})"),
        ("command", f"`realtouch {manifest.spec['operation']}`"),
        ("source", f"files {files}; rounds {rows}; `manifest.json` names and fingerprints each file"),
        ("rounds left out", _skipped(manifest)),
    ]
    return markdown_table(("", ""), lines) + "\n\nOptions:\n\n" + json_block(manifest.spec["options"])


def _skipped(manifest: Manifest) -> str:
    reasons = manifest.skipped_reasons()
    listed = ", ".join(f"{count:,} {reason}" for reason, count in reasons.items())
    return f"{listed}; `manifest.json` names each" if reasons else "none"


def _split_table(facts: FolderFacts, figures: list[SplitFigures], manifest: Manifest | None) -> str:
    left_out = {} if manifest is None else manifest.split_table()
    sizes = [
        (len(split.paths), megabytes(split.file_bytes), megabytes(split.unpacked_bytes))
        for split in facts.splits
    ]
    if not figures:
        rows = [(s.split, f"{s.rows:,}", *size) for s, size in zip(facts.splits, sizes, strict=True)]
        return markdown_table(("split", "pictures", "shards", "Parquet", "unpacked"), rows)
    header = ("split", "rounds", "touches", "per round", "objects", "contact", "left out")
    counted = [
        (s.split, f"{s.rows:,}", *_figures(figure), _left_out(left_out, s.split), *size)
        for s, figure, size in zip(facts.splits, figures, sizes, strict=True)
    ]
    return markdown_table((*header, "shards", "Parquet", "unpacked"), counted)


def _left_out(table: Mapping[str, Mapping[str, Any]], split: str) -> str:
    return str(table[split]["skipped"]) if split in table else "-"


def _figures(figures: SplitFigures) -> tuple[str, str, str, str]:
    least, most = figures.per_round or (0, 0)
    return (
        _counted(figures.touches),
        "-" if figures.per_round is None else f"{most:,}" if least == most else f"{least:,} to {most:,}",
        _counted(figures.objects),
        "-" if figures.contact_share is None else f"{100 * figures.contact_share:.1f} %",
    )


def _counted(count: int | None) -> str:
    return "-" if count is None else f"{count:,}"


def _citation_text(rendered: bool) -> str:
    if rendered:
        return "The touches: Schneider et al. 2025."
    return (
        "The touches and the digits: Schneider et al. 2025. The digits were made from the handwriting of "
        "HWD+ (Beaulac and Rosenthal 2022)."
    )
