"""Statements of the owner of a data set about it: licence, authors, title and citation.

These words are kept in the head of the card, below ``owner``. So a card that is written again keeps them, and
so does a copy of the folder. Options of commands are declared here, so nothing heavy is imported at the top.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial

from tactile_toolkit import store, wording
from tactile_toolkit.checked_fields import text
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import JsonDict, JsonObject

KEY = "owner"
"""Key of the head of a card."""
LICENCES = (
    *("cc0-1.0", "cc-by-2.0", "cc-by-2.5", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0"),
    *("cc-by-nc-2.0", "cc-by-nc-3.0", "cc-by-nc-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0"),
    *("cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0"),
    *("odc-by", "odbl", "pddl", "cdla-sharing-1.0", "cdla-permissive-1.0", "cdla-permissive-2.0", "c-uda"),
    *("etalab-2.0", "eupl-1.1", "eupl-1.2", "mit", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "isc"),
    *("mpl-2.0", "gpl-2.0", "gpl-3.0", "lgpl-3.0", "agpl-3.0", "gfdl", "unlicense", "other", "unknown"),
)
"""Identifiers of the Hub for licences that are given to data."""

_MAX_LINE = 200
_MAX_CITATION = 10_000  # characters
_BIBTEX = re.compile(r"\s*@\w+\s*\{")
_SECTION = r"(?m)^## {}\n\n(?:.|\n)*?(?=^## |\Z)"


def read_licence(word: str) -> str:
    """Return the identifier of a licence, in lower case; InputError for an unknown one."""
    if word.lower() not in LICENCES:
        near = [name for name in LICENCES if name.startswith(word.lower()[:5])]
        raise InputError(
            f"is {word!r}; expected one of {', '.join(near or LICENCES)}",
            next="give an identifier of the Hub, or other",
            field="license",
        )
    return word.lower()


def _read_line(name: str, words: str) -> str:
    line = words.strip()
    if not line or len(line) > _MAX_LINE or wording.printable(line) != line:
        raise InputError(f"is {words[:80]!r}; expected one line of 1 to {_MAX_LINE} characters", field=name)
    return line


def read_citation(words: str) -> str:
    """Return a citation: text, BibTeX, or the content of a file ``.bib``; InputError for another file."""
    if words.endswith(".bib"):
        try:
            with store.open_regular(store.expanded(words)) as stream:
                words = stream.read(4 * _MAX_CITATION).decode()
        except (OSError, UnicodeDecodeError) as error:
            problem = getattr(error, "strerror", None) or "it is not UTF-8 text"
            raise InputError(
                f"{words!r} cannot be read ({problem})", next="check the file", field="citation"
            ) from error
    citation = words.strip()
    if not citation or len(citation) > _MAX_CITATION or wording.printable(citation, keep="\n") != citation:
        raise InputError(
            f"has {len(citation):,} characters; expected 1 to {_MAX_CITATION:,} of text", field="citation"
        )
    is_closed = citation.count("{") == citation.count("}")
    if citation.startswith("@") and not (_BIBTEX.match(citation) and is_closed):
        raise InputError(
            "begins as BibTeX, but its braces do not match",
            next="give a whole entry, or plain text",
            field="citation",
        )
    return citation


_READERS: dict[str, Callable[[str], str]] = {
    "license": read_licence,
    "author": partial(_read_line, "author"),
    "title": partial(_read_line, "title"),
    "citation": read_citation,
}


@dataclass(frozen=True, slots=True)
class OwnerWords:
    """Statements of the owner of a data set for its card."""

    license: str | None = text(
        metavar="ID",
        read=_READERS["license"],
        panel="Card",
        help="Licence of the data, such as cc-by-4.0 (identifier of the Hub).",
    )
    author: list[str] | None = text(
        metavar="NAME",
        read=_READERS["author"],
        several=True,
        panel="Card",
        help="Author of the data; may be repeated.",
    )
    title: str | None = text(
        metavar="TEXT", read=_READERS["title"], panel="Card", help="Title of the data set."
    )
    citation: str | None = text(
        metavar="TEXT|FILE.bib",
        read=_READERS["citation"],
        panel="Card",
        help="How to cite the data set: text, BibTeX or a file.",
    )

    def given(self) -> JsonDict:
        """Return the words that are stated."""
        return {name: value for name, value in asdict(self).items() if value}


def read_owner(head: JsonObject, address: str) -> OwnerWords:
    """Return the statements of the owner in the head of a card; InputError if they are not valid."""
    stated = head.get(KEY)
    if not isinstance(stated, Mapping):
        return OwnerWords()
    words: JsonDict = {}
    try:
        for name, read in _READERS.items():
            value = stated.get(name)
            if value and name == "author":
                authors = [value] if isinstance(value, str) else value
                words[name] = [read(author) for author in authors]
            elif value:
                words[name] = read(value)
    except (InputError, TypeError, AttributeError) as error:
        raise InputError(
            f"the card of {address!r}: its {KEY!r} cannot be used ({error})",
            next=f"correct {KEY!r} in its head, or remove it there",
        ) from error
    return OwnerWords(**words)


def with_owner(head: JsonDict, body: str, words: OwnerWords, licence_text: str = "") -> tuple[JsonDict, str]:
    """Return head and text of a card with the words of an owner; ``licence_text`` stays after the licence."""
    stated = words.given()
    if not stated:
        return head, body
    changed = {**head, KEY: stated}
    if words.license:
        changed["license"] = words.license
        section = f"{words.license}, as the owner of the data set states. {licence_text}".strip()
        body = _with_section(body, "Licence", f"{section}\n\n")
    if words.title:
        changed["pretty_name"] = words.title
        title = f"# {wording.markdown_text(words.title)}"
        body = re.sub(r"\A# .*", lambda _: title, body, count=1)
    if words.author:
        names = ", ".join(map(wording.markdown_text, words.author))
        body = re.sub(r"\A# .*\n", lambda line: f"{line[0]}\nBy {names}.\n", body, count=1)
    if words.citation:
        citation = wording.markdown_text(words.citation)
        if words.citation.startswith("@"):
            citation = f"```bibtex\n{words.citation.replace('```', '')}\n```"
        former = re.search(_SECTION.format("Citation"), body)
        others = former[0].removeprefix("## Citation\n\n") if former else ""
        body = _with_section(body, "Citation", f"{citation}\n\n{others}")
    return changed, body


def _with_section(body: str, heading: str, words: str) -> str:
    """Replace the text of a section."""
    return re.sub(_SECTION.format(heading), lambda _: f"## {heading}\n\n{words}", body, count=1)
