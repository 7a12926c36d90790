"""The options for what the owner of a data set states about it; imports nothing heavy."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass

from tactile_toolkit import shown_text, store
from tactile_toolkit.checked_fields import text
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

LICENCES = (
    *("cc0-1.0", "cc-by-2.0", "cc-by-2.5", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0"),
    *("cc-by-nc-2.0", "cc-by-nc-3.0", "cc-by-nc-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0"),
    *("cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0"),
    *("odc-by", "odbl", "pddl", "cdla-sharing-1.0", "cdla-permissive-1.0", "cdla-permissive-2.0", "c-uda"),
    *("etalab-2.0", "eupl-1.1", "eupl-1.2", "mit", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "isc"),
    *("mpl-2.0", "gpl-2.0", "gpl-3.0", "lgpl-3.0", "agpl-3.0", "gfdl", "unlicense", "other", "unknown"),
)
"""Identifiers of the Hub for licences that are given to data."""

_MAX_LINE, _MAX_CITATION = 200, 10_000  # characters
_BIBTEX = re.compile(r"\s*@\w+\s*\{")


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
    if not line or len(line) > _MAX_LINE or shown_text.printable(line) != line:
        raise InputError(f"{option} is {words[:80]!r}; expected one line of 1 to {_MAX_LINE} characters")
    return line


def read_title(words: str) -> str:
    """Return a title; InputError unless it is one line of text."""
    return _read_line("--title", words)


def read_author(words: str) -> str:
    """Return the name of an author; InputError unless it is one line of text."""
    return _read_line("--author", words)


def read_citation(words: str) -> str:
    """Return a citation: text, BibTeX, or the content of a file ``.bib``; InputError for another file."""
    if words.endswith(".bib"):
        try:
            with store.open_regular(store.expanded(words)) as stream:
                words = stream.read(4 * _MAX_CITATION).decode()
        except (OSError, UnicodeDecodeError) as error:
            problem = getattr(error, "strerror", None) or "it is not UTF-8 text"
            raise InputError(
                f"--citation {words!r} cannot be read ({problem})", next="check the file"
            ) from error
    found = words.strip()
    if not found or len(found) > _MAX_CITATION or shown_text.printable(found, keep="\n") != found:
        raise InputError(f"--citation has {len(found):,} characters; expected 1 to {_MAX_CITATION:,} of text")
    if found.startswith("@") and not (_BIBTEX.match(found) and found.count("{") == found.count("}")):
        raise InputError(
            "--citation begins as BibTeX, but its braces do not match",
            next="give a whole entry, or plain text",
        )
    return found


@dataclass(frozen=True, slots=True)
class OwnerWords:
    """Statements of the owner of a data set for its card."""

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

    def given(self) -> JsonDict:
        """Return the words that are stated."""
        return {name: value for name, value in asdict(self).items() if value}
