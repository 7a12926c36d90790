"""What the owner of a data set states about it: licence, authors, title and citation.

These words are kept in the head of the card, below ``owner``. So a card that is written again keeps them, and
so does a copy of the folder.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from tactile_toolkit import store
from tactile_toolkit.cards.yaml_head import CARD_FILE, head_text, parsed_head, with_head
from tactile_toolkit.checked_fields import text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.shown_text import markdown_text, printable

LICENCES = (
    *("cc0-1.0", "cc-by-2.0", "cc-by-2.5", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0"),
    *("cc-by-nc-2.0", "cc-by-nc-3.0", "cc-by-nc-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0"),
    *("cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0"),
    *("odc-by", "odbl", "pddl", "cdla-sharing-1.0", "cdla-permissive-1.0", "cdla-permissive-2.0", "c-uda"),
    *("etalab-2.0", "eupl-1.1", "eupl-1.2", "mit", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "isc"),
    *("mpl-2.0", "gpl-2.0", "gpl-3.0", "lgpl-3.0", "agpl-3.0", "gfdl", "unlicense", "other", "unknown"),
)
"""Identifiers of the Hub for licences that are given to data."""

KEY = "owner"
"""Key of the head of a card."""

_MOST_WORDS, _MOST_CITATION = 200, 10_000
_BIBTEX = re.compile(r"\s*@\w+\s*\{")
_SECTION = r"(?m)^## {}\n\n(?:.|\n)*?(?=^## |\Z)"


def read_licence(word: str) -> str:
    """Return the identifier of a licence, in lower case; InputError for an unknown one."""
    if word.lower() not in LICENCES:
        near = [name for name in LICENCES if name.startswith(word.lower()[:5])]
        raise InputError(
            f"--license is {word!r}; expected one of {', '.join(near or LICENCES)}",
            next="give an identifier of the Hub, or other",
        )
    return word.lower()


def _read_line(option: str, words: str) -> str:
    line = words.strip()
    if not line or len(line) > _MOST_WORDS or printable(line) != line:
        raise InputError(f"{option} is {words[:80]!r}; expected one line of 1 to {_MOST_WORDS} characters")
    return line


def read_title(words: str) -> str:
    """Return a title; InputError unless it is one line of text."""
    return _read_line("--title", words)


def read_author(words: str) -> str:
    """Return the name of an author; InputError unless it is one line of text."""
    return _read_line("--author", words)


def read_citation(words: str) -> str:
    """Return a citation: text, BibTeX, or the content of a file ``.bib``; InputError if it is none."""
    if words.endswith(".bib"):
        try:
            with store.open_regular(store.expanded(words)) as stream:
                words = stream.read(4 * _MOST_CITATION).decode()
        except (OSError, UnicodeDecodeError) as error:
            problem = getattr(error, "strerror", None) or "it is not UTF-8 text"
            raise InputError(
                f"--citation {words!r} cannot be read ({problem})", next="check the file"
            ) from error
    found = words.strip()
    if not found or len(found) > _MOST_CITATION or printable(found, keep="\n") != found:
        raise InputError(
            f"--citation has {len(found):,} characters; expected 1 to {_MOST_CITATION:,} of text"
        )
    if found.startswith("@") and not (_BIBTEX.match(found) and found.count("{") == found.count("}")):
        raise InputError(
            "--citation begins as BibTeX, but its braces do not match",
            next="give a whole entry, or plain text",
        )
    return found


@dataclass(frozen=True, slots=True)
class OwnerWords:
    """What the owner of a data set states for its card."""

    license: str | None = text(
        metavar="ID",
        read=read_licence,
        help="Licence of the data, such as cc-by-4.0 (identifier of the Hub).",
    )
    author: list[str] | None = text(
        metavar="NAME", read=read_author, several=True, help="Author of the data; may be repeated."
    )
    title: str | None = text(metavar="TEXT", read=read_title, help="Title of the data set.")
    citation: str | None = text(
        metavar="TEXT|FILE.bib", read=read_citation, help="How to cite the data set: text, BibTeX or a file."
    )

    def given(self) -> dict[str, Any]:
        """Return the words that are stated."""
        return {name: value for name, value in asdict(self).items() if value}


def read_owner(folder: store.DataFolder) -> OwnerWords:
    """Return what the card of a folder states of its owner; InputError if it is not valid.

    A card that is missing, or whose head cannot be read, states nothing.
    """
    if not folder.exists(CARD_FILE):
        return OwnerWords()
    try:
        head = parsed_head(folder.read_bytes(CARD_FILE).decode("utf-8", errors="replace"))
    except ValueError:
        return OwnerWords()
    stated = head.get(KEY)
    if not isinstance(stated, Mapping):
        return OwnerWords()
    try:
        return _checked(stated)
    except (InputError, TypeError, AttributeError) as error:
        raise InputError(
            f"{CARD_FILE} of {folder.address()!r}: its {KEY!r} cannot be used ({error})",
            next=f"correct {KEY!r} in its head, or remove it there",
        ) from error


def _checked(stated: Mapping[str, Any]) -> OwnerWords:
    readers = {"license": read_licence, "title": read_title, "citation": read_citation}
    known = {name: read(stated[name]) for name, read in readers.items() if stated.get(name)}
    authors = [read_author(name) for name in stated.get("author") or ()]
    return OwnerWords(author=authors or None, **known)


def state_owner(
    kind: DatasetKind, folder: store.DataFolder, manifest: store.Manifest | None, words: OwnerWords
) -> None:
    """Write the card of a folder again with words of its owner; those that it had before stay."""
    merged = {**read_owner(folder).given(), **words.given()}
    if words.given():
        card = ""
        if folder.exists(CARD_FILE):
            card = folder.read_bytes(CARD_FILE).decode("utf-8", errors="replace")
        try:
            card = with_head(card, lambda head: head.update({KEY: merged}))
        except ValueError:
            card = head_text({KEY: merged})
        folder.write_bytes(CARD_FILE, card.encode())
    kind.write_card(folder, manifest)


def with_owner(head: dict[str, Any], body: str, words: OwnerWords) -> tuple[dict[str, Any], str]:
    """Return head and text of a card with the words of an owner in their places."""
    given = words.given()
    if not given:
        return head, body
    changed = {**head, KEY: given}
    if words.license:
        changed["license"] = words.license
        body = _with_section(body, "Licence", f"{words.license}, as the owner of the data set states.")
    if words.title:
        changed["pretty_name"] = words.title
        body = re.sub(r"\A# .*", lambda _: f"# {markdown_text(words.title or '')}", body, count=1)
    if words.author:
        names = ", ".join(map(markdown_text, words.author))
        body = re.sub(r"\A# .*\n", lambda line: f"{line[0]}\nBy {names}.\n", body, count=1)
    if words.citation:
        body = _with_section(body, "Citation", _cited(words.citation), is_first=True)
    return changed, body


def _cited(citation: str) -> str:
    if citation.startswith("@"):
        return f"```bibtex\n{citation.replace('```', '')}\n```"
    return markdown_text(citation)


def _with_section(body: str, heading: str, words: str, *, is_first: bool = False) -> str:
    """Replace the text of a section, or put words before it."""

    def changed(found: re.Match[str]) -> str:
        start = f"## {heading}\n\n"
        rest = found[0].removeprefix(start) if is_first else ""
        return f"{start}{words}\n\n{rest}"

    return re.sub(_SECTION.format(heading), changed, body, count=1)
