"""Statements of the owner of a data set about it: licence, authors, title and citation.

These words are kept in the head of the card, below ``owner``. So a card that is written again keeps them, and
so does a copy of the folder.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from tactile_toolkit import shown_text, store
from tactile_toolkit.cards.owner_options import (
    OwnerWords,
    read_author,
    read_citation,
    read_licence,
    read_title,
)
from tactile_toolkit.cards.yaml_head import CARD_FILE, head_text, parsed_head, with_head
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict, JsonObject
from tactile_toolkit.kind import DatasetKind

KEY = "owner"
"""Key of the head of a card."""

_SECTION = r"(?m)^## {}\n\n(?:.|\n)*?(?=^## |\Z)"


def read_owner(folder: store.DataFolder) -> OwnerWords:
    """Return the statements of the owner in the card of a folder; InputError if they are not valid.

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


def _checked(stated: JsonObject) -> OwnerWords:
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


def with_owner(head: JsonDict, body: str, words: OwnerWords) -> tuple[JsonDict, str]:
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
        body = re.sub(r"\A# .*", lambda _: f"# {shown_text.markdown_text(words.title or '')}", body, count=1)
    if words.author:
        names = ", ".join(map(shown_text.markdown_text, words.author))
        body = re.sub(r"\A# .*\n", lambda line: f"{line[0]}\nBy {names}.\n", body, count=1)
    if words.citation:
        body = _with_section(body, "Citation", _cited(words.citation), is_first=True)
    return changed, body


def _cited(citation: str) -> str:
    if citation.startswith("@"):
        return f"```bibtex\n{citation.replace('```', '')}\n```"
    return shown_text.markdown_text(citation)


def _with_section(body: str, heading: str, words: str, *, is_first: bool = False) -> str:
    """Replace the text of a section by ``words``; with ``is_first``, put them before it."""

    def changed(found: re.Match[str]) -> str:
        start = f"## {heading}\n\n"
        if not is_first:
            return f"{start}{words}\n\n"
        return f"{start}{words}\n\n{found[0].removeprefix(start)}"

    return re.sub(_SECTION.format(heading), changed, body, count=1)
