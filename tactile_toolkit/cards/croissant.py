"""``croissant.json``: a data set folder as machines read it, in Croissant 1.1 with its responsible-AI terms.

All of it follows from the card and the columns. A split is one set of files and one set of records, however
many shards it has; what proves the shards is the manifest.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from tactile_toolkit.cards.facts import FolderFacts, configs
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.shards import Finding
from tactile_toolkit.wording import counted, printable_json

CROISSANT_FILE = "croissant.json"

_PARQUET = "application/x-parquet"
_NUMBERS = re.compile(r"(?:u?int(?:8|16|32|64)|float(?:16|32|64))")
_TIMES = re.compile(r"(?:duration|timestamp)\[.*\]")
_PLAIN_TYPES = {
    "bool": "sc:Boolean",
    "image": "sc:ImageObject",
    "video": "sc:VideoObject",
    "mesh": "sc:Text",
}
_LINK = re.compile(r"\[([^\]]+)\]\([^)]*\)")
_CODE = re.compile(r"```.*?```", re.DOTALL)
_BIBTEX = re.compile(r"```bibtex\n(.*?)```", re.DOTALL)
# Words of the Hub that are not licences of SPDX.
_UNNAMED_LICENCES = ("other", "unknown")
_REPOSITORY = "repository"
# What stands, by agreement of those who keep the format, for the digest of a repository.
_GIT_HAS_NO_DIGEST = "https://github.com/mlcommons/croissant/issues/80"


def croissant_text(facts: FolderFacts, manifest: Manifest | None, head: Mapping[str, Any], body: str) -> str:
    """Return the text for a folder; ``head`` and ``body`` are those of its card, which people read."""
    citation = _BIBTEX.search(body)
    licence = str(head["license"])
    # As Croissant 1.1 prints it: readers warn of any other.
    context = files("data_cards").joinpath("croissant_context.json").read_text(encoding="utf-8")
    values = {
        "@context": json.loads(context),
        "@type": "sc:Dataset",
        "conformsTo": ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"],
        "name": head["pretty_name"],
        "description": " ".join(_section(body, "What it is")),
        # SPDX writes CC-BY-2.0, the Hub cc-by-2.0.
        "license": " ".join(_section(body, "Licence"))
        if licence in _UNNAMED_LICENCES
        else f"https://spdx.org/licenses/{licence.upper()}.html",
        "keywords": list(head["tags"]),
        "rai:dataCollection": " ".join(_section(body, "How it was made")),
        "rai:dataUseCases": list(head["task_categories"]),
        "rai:dataLimitations": _section(body, "Known limits"),
        **({"citeAs": citation[1].strip()} if citation else {}),
        **({"version": manifest.toolkit_version} if manifest is not None else {}),
        **_structure(facts),
    }
    return printable_json(values) + "\n"


def _section(body: str, title: str) -> list[str]:
    """Return paragraphs, list items and lines of tables of a section as plain text, without code."""
    section = _CODE.sub("", body.partition(f"\n## {title}\n")[2].partition("\n## ")[0])
    blocks = re.split(r"\n\n|\n(?=- |\|)", _LINK.sub(r"\1", section))
    plain = (re.sub(r"^- |[`\\]|---", "", block.strip("| \n")).replace(" | ", ": ") for block in blocks)
    return [" ".join(line.split()) for line in plain if line.strip(": ")]


def _structure(facts: FolderFacts, page: str | None = None, others: Sequence[str] = ()) -> dict[str, Any]:
    """Return what follows from files and columns alone; a repository has a ``page``, and ``others`` in it."""
    includes = {entry["split"]: entry["path"] for entry in configs(facts, others)[0]["data_files"]}
    files: list[dict[str, Any]] = [
        {
            "@type": "cr:FileSet",
            "@id": f"files-{split.split}",
            "description": f"{counted(split.rows, 'rows')} in {counted(len(split.paths), 'files')}",
            "encodingFormat": _PARQUET,
            "includes": includes[split.split],
        }
        for split in facts.splits
    ]
    if page is not None:
        repository = {
            "@type": "cr:FileObject",
            "@id": _REPOSITORY,
            "contentUrl": page,
            "encodingFormat": "git+https",
            "sha256": _GIT_HAS_NO_DIGEST,
        }
        files = [repository, *({**each, "containedIn": {"@id": _REPOSITORY}} for each in files)]
    has_id = any(entry["name"] == "id" for entry in facts.features)
    record_sets = [
        {
            "@type": "cr:RecordSet",
            "@id": split.split,
            **({"key": {"@id": f"{split.split}/id"}} if has_id else {}),
            "field": [_field(split.split, entry) for entry in facts.features],
        }
        for split in facts.splits
    ]
    return {"distribution": files, "recordSet": record_sets}


def _field(split: str, entry: Mapping[str, Any], column: str = "", path: str = "") -> dict[str, Any]:
    """Describe a column, or below ``column`` what its structs hold at a JSON path."""
    name = str(entry["name"])
    place = f"{column}/{path}" if column else name
    source: dict[str, Any] = {
        "fileSet": {"@id": f"files-{split}"},
        "extract": {"column": column or name},
        **({"transform": {"jsonPath": path}} if column else {}),
    }
    described = {"@type": "cr:Field", "@id": f"{split}/{place}"}
    shape: list[int] = []  # the lengths of nested lists, -1 where they differ
    inner: Any = entry
    while isinstance(inner, Mapping) and "list" in inner:
        shape.append(int(inner.get("length", -1)))
        inner = inner["list"]
    parts = inner if isinstance(inner, list) else entry.get("struct")
    if parts is not None:
        above = f"{path}." if path else ""
        below = [_field(split, each, column or name, f"{above}{each['name']}") for each in parts]
        # A path is looked up in each entry of a list, and records then have lists of structs again.
        return {**described, **({"repeated": True} if shape else {}), "subField": below}
    array = {"isArray": True, "arrayShape": ",".join(map(str, shape))} if shape else {}
    dtype = inner["dtype"] if isinstance(inner, Mapping) and "dtype" in inner else inner
    if dtype in ("image", "mesh"):
        source["transform"] = {"jsonPath": "bytes"}
        array = {"repeated": True} if shape else {}  # of pictures, readers take no other word for a list
    data_type, words = _data_type(dtype)
    meaning = {"description": words} if words else {}
    return {**described, **meaning, "dataType": data_type, **array, "source": source}


def _data_type(dtype: Any) -> tuple[str | list[str], str]:
    """Return the type of a value in words of Croissant, and what they do not say."""
    if isinstance(dtype, Mapping):
        names = dtype["class_label"]["names"].items()
        listed = ", ".join(f"{number} is {name!r}" for number, name in names)
        return ["cr:Int64", "cr:Label"], f"classes: {listed}"
    if _NUMBERS.fullmatch(str(dtype)):
        return f"cr:{dtype.replace('uint', 'UInt').replace('int', 'Int').replace('float', 'Float')}", ""
    # Spans of time and moments alike are stored as integers.
    if _TIMES.fullmatch(str(dtype)):
        return "cr:Int64", f"stored as {dtype}"
    return _PLAIN_TYPES.get(str(dtype), "sc:Text"), ""


def croissant_again(
    text: str, facts: FolderFacts, page: str | None = None, others: Sequence[str] = ()
) -> str:
    """Return the text again for a folder that has other files by now, or for the ``page`` of a repository.

    There ``others`` lie next to the files of the folder. ValueError where the text is not a JSON object.
    """
    values = json.loads(text)
    if not isinstance(values, dict):
        raise ValueError("not a JSON object")
    # That of the repository that a folder came from, of which it may be a part only.
    values.pop("url", None)
    url = {} if page is None else {"url": page}
    return printable_json({**values, **_structure(facts, page, others), **url}) + "\n"


def check_croissant(folder: DataFolder, facts: FolderFacts) -> list[Finding]:
    """List what of the file is not as the folder is; nothing without the file."""
    if not folder.exists(CROISSANT_FILE):
        return []  # data sets made before there was one
    try:
        stated = json.loads(folder.read_bytes(CROISSANT_FILE).decode())
        expected = _structure(facts, stated.get("url"))
        for each in (stated, expected):  # earlier versions listed single files too
            each["distribution"] = [entry for entry in each["distribution"] if "includes" in entry]
        differing = [name for name in expected if stated[name] != expected[name]]
        wrong = [f"its {name!r} is not that of the files here" for name in differing]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, ToolkitError) as error:
        wrong = [f"cannot be read as a JSON object ({error})"]
    return [
        Finding(CROISSANT_FILE, f"{each}; next: write it again with the command `card`") for each in wrong
    ]
