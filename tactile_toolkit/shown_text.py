"""Text from data as it is shown to people.

Names of classes, files and splits may be any user's. A terminal obeys control characters, Markdown and pages
of a browser obey marks; some characters turn the direction of the text next to them. Here all of these become
visible and have no effect.
"""

from __future__ import annotations

import json
import re

_MARKS = re.compile(r"([\\`*\[\]<>~&]|(?<![^\W_])_|_(?![^\W_]))")  # a _ inside of a word marks nothing


def printable(text: str, keep: str = "") -> str:
    """Return a text in which control characters, and all others that cannot be seen, are written as escapes.

    ``keep`` are some that may stay, such as the ends of lines.
    """
    if text.isprintable():
        return text
    return "".join(
        each if each in keep or each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


def printable_json(values: object, indent: int = 2) -> str:
    """Return JSON of some values; what cannot be seen stands there in JSON's own escapes."""
    text = json.dumps(values, indent=indent, ensure_ascii=False)
    # Outside of strings JSON has no other characters than those that can be seen, and ends of lines.
    odd = {each for each in set(text) if not each.isprintable()} - {"\n"}
    return text.translate({ord(each): json.dumps(each)[1:-1] for each in odd}) if odd else text


def markdown_text(text: str) -> str:
    """Return a text so that Markdown, and HTML in it, shows it as it is."""
    # Formulas stand between dollars, and a backslash does not stop them.
    return _MARKS.sub(r"\\\1", printable(text)).replace("$", "&#36;")


def markdown_code(text: str) -> str:
    """Return a text as a span of code in Markdown."""
    shown = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", shown)), default=0))
    return f"{fence}{shown}{fence}" if len(fence) == 1 else f"{fence} {shown} {fence}"
