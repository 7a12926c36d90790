"""Text from data as it is shown to people.

Names of classes, files and splits may be any user's. A terminal obeys control characters, Markdown and pages
of a browser obey marks; some characters turn the direction of the text next to them. Here all of these become
visible and have no effect.
"""

from __future__ import annotations

import json
import re

_MARKS = re.compile(r"([\\`*\[\]<>~&]|(?<![^\W_])_|_(?![^\W_]))")  # a _ inside a word is not markup


def printable(text: str, keep: str = "") -> str:
    """Return a text in which all invisible characters are escaped, except those in ``keep``."""
    if text.isprintable():
        return text
    return "".join(
        each if each in keep or each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


def printable_json(values: object, indent: int = 2) -> str:
    """Return the JSON text of some values, with invisible characters in JSON's own escapes."""
    text = json.dumps(values, indent=indent, ensure_ascii=False)
    # Outside of strings, JSON has only visible characters and line breaks.
    odd = {each for each in set(text) if not each.isprintable()} - {"\n"}
    if odd:
        return text.translate({ord(each): json.dumps(each)[1:-1] for each in odd})
    return text


def markdown_text(text: str) -> str:
    """Return a text that Markdown, and HTML in it, shows literally."""
    # A backslash does not escape the dollars of a formula.
    return _MARKS.sub(r"\\\1", printable(text)).replace("$", "&#36;")


def markdown_code(text: str) -> str:
    """Return a text as inline code of Markdown."""
    shown = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", shown)), default=0))
    if len(fence) == 1:
        return f"{fence}{shown}{fence}"
    return f"{fence} {shown} {fence}"
