"""Words of messages: numbers with what they count, names of classes, and names that were probably meant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

# Touches, meshes, classes and boxes; in all other plurals, the e is part of the singular.
_LONG_PLURALS = ("ches", "shes", "sses", "xes")
_IRREGULAR = {"vertices": "vertex", "entries": "entry", "bodies": "body", "copies": "copy"}


def with_count(count: int, nouns: str) -> str:
    """Return a number with its noun: ``1 file``, ``2,000 files``, ``1 touch``."""
    if count == 1:
        before, space, noun = nouns.rpartition(" ")
        noun = _IRREGULAR.get(noun, noun.removesuffix("es" if noun.endswith(_LONG_PLURALS) else "s"))
        nouns = f"{before}{space}{noun}"
    return f"{count:,} {nouns}"


def shortened(text: str, length: int) -> str:
    """Return a text, cut with ``...`` if it has more than ``length`` characters."""
    if len(text) <= length:
        return text
    return f"{text[:length]}..."


def class_name(names: Sequence[str], label: int) -> str:
    """Return the name of a class, or its number if it has no name."""
    if 0 <= label < len(names):
        return names[label]
    return str(label)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of a message with the most similar name: ``"; did you mean 'test'?"``, or ``""``."""
    import difflib  # takes 4 ms, and few commands need it

    lowered = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), lowered, n=1)
    if close:
        return f"; did you mean {lowered[close[0]]!r}?"
    return ""
