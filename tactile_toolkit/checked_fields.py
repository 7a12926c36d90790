"""Fields of specifications that say which values they take, and one check of them all.

A frozen dataclass declares ``steps: int = whole_number(100, least=1)`` and calls :func:`check_fields` in its
``__post_init__``, which also leaves one spelling of each value: Python's own numbers, and tuples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import is_whole, plain

__all__ = ["check_fields", "choice", "real_number", "switch", "whole_number"]

_RULE = "rule"


@dataclass(frozen=True, slots=True)
class _Rule:
    kind: type[int] | type[float]
    fits: Callable[[Any], bool]
    expected: str
    option: str | None = None


def whole_number(
    default: Any,
    least: int = 0,
    most: int | None = None,
    *,
    optional: bool = False,
    option: str | None = None,
) -> Any:
    """Declare a whole number, or None where it is ``optional``; ``option`` names it in place of the field."""

    def fits(value: Any) -> bool:
        if value is None:
            return optional
        return is_whole(value) and least <= value and (most is None or value <= most)

    span = f"of at least {least:,}" if most is None else f"from {least:,} to {most:,}"
    return _field(default, _Rule(int, fits, f"a whole number {span}", option))


def real_number(
    default: Any = MISSING,
    least: float = -math.inf,
    most: float = math.inf,
    *,
    above: float = -math.inf,
    below: float = math.inf,
    many: int = 0,
    optional: bool = False,
    option: str | None = None,
) -> Any:
    """Declare a finite number, a tuple of so ``many``, or None where it is ``optional``.

    ``option`` names it in place of the field.
    """

    def fits_one(value: Any) -> bool:
        return isinstance(value, float) and least <= value <= most and above < value < below

    def fits(value: Any) -> bool:
        if many:
            return isinstance(value, tuple) and len(value) == many and all(map(fits_one, value))
        return fits_one(value) or (optional and value is None)

    ends = ((" from {:g}", least), (" above {:g}", above), (" to {:g}", most), (" and below {:g}", below))
    span = "".join(words.format(end) for words, end in ends if math.isfinite(end)) or ", finite"
    what = f"{many} numbers" if many else "a number"
    return _field(default, _Rule(float, fits, f"{'None or ' if optional else ''}{what}{span}", option))


def choice(default: str | None, known: Sequence[str], *, optional: bool = False) -> Any:
    """Declare one of several words, or None where it is ``optional``."""

    def fits(value: Any) -> bool:
        return value in known if isinstance(value, str) else optional and value is None

    # As int, plain() leaves what is not a number as it was given.
    return _field(default, _Rule(int, fits, f"{'None or ' if optional else ''}one of {', '.join(known)}"))


def switch(default: bool) -> Any:
    """Declare True or False."""
    return _field(default, _Rule(int, lambda value: isinstance(value, bool), "True or False"))


def check_fields(spec: Any, of: str) -> None:
    """Give the declared fields of a specification one spelling; InputError for the first that does not fit.

    ``of`` is what the message calls the specification, such as ``the plan of touches``.
    """
    for each in fields(spec):
        rule: _Rule | None = each.metadata.get(_RULE)
        if rule is None:
            continue
        given = getattr(spec, each.name)
        value = plain(given, rule.kind)
        if not rule.fits(value):
            message = f"{rule.option or f'{each.name} of {of}'} is {given!r}; expected {rule.expected}"
            raise InputError(message)
        object.__setattr__(spec, each.name, value)


def _field(default: Any, rule: _Rule) -> Any:
    return field(default=default, metadata={_RULE: rule})
