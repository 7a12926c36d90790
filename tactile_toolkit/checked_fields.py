"""Fields of specifications that state their valid values, one check for all of them, and their options.

A frozen dataclass declares ``steps: int = integer(100, least=1, help="Total number of steps.")`` and calls
:func:`check_fields` in its ``__post_init__``, which also normalizes values to Python's own numbers and
tuples. A field with ``help`` is an option of the commands that take the specification.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, Unpack

from tactile_toolkit import errors, wording

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


_RULE = "rule"
_MAX_INTEGER = (1 << 63) - 1
_MAX_ENTRIES = 1 << 20  # of an iterator, which cannot state its length
_MAX_ARRAY = 1 << 24
_UNITS = {"_mm": "MM", "_mm2": "MM2", "_deg": "DEG", "_px": "PX", "_kg_m3": "KG/M3"}
_PLACEHOLDERS: dict[type, str] = {float: "X"}
Declared: TypeAlias = Any
"""A field of a dataclass as it is declared: of whatever type it is annotated with."""


class OptionText(TypedDict, total=False):
    """The option of a field on a command line; without ``help`` it has none.

    ``name`` replaces ``--NAME-OF-THE-FIELD``, ``shown`` is the text of a default that follows from others,
    ``panel`` is a section of the help, ``read`` converts the text to a value. An ``argument`` is positional;
    with ``several`` it may be repeated. Shells offer the words of ``complete``.

    ``needs`` names the field without which the option has no effect: ``"plate"``, or for some of its values
    ``"file_format=mjcf|urdf"``; the empty value in ``"kinds=|grid"`` is one that is not given. An object that
    ``read`` made of a text, such as a gel, meets the need whatever its text was.
    """

    argument: bool
    help: str
    name: str
    metavar: str
    panel: str
    several: bool
    shown: str
    read: Callable[[str], object]
    complete: tuple[str, ...]
    needs: str


@dataclass(frozen=True, slots=True)
class Rule:
    """The valid values of a field, in code and in words, and its option."""

    kind: type
    fits: Callable[[object], bool]
    expected: str
    option: OptionText
    choices: tuple[str, ...] = ()

    @staticmethod
    def of(declared: Field[object]) -> Rule | None:
        """Return the rule of a field; None if it was declared in another way."""
        rule: Rule | None = declared.metadata.get(_RULE)
        return rule

    def metavar(self, name: str) -> str:
        """Return the placeholder for the value of an option, such as the unit at the end of its name."""
        unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)
        return self.option.get("metavar") or unit or _PLACEHOLDERS.get(self.kind, "TEXT")

    def checked(self, value: object, name: str, of: str = "") -> Any:
        """Return a normalized value; InputError, which begins with ``name``, if it is not valid.

        ``of`` are the words between the name and the value.
        """
        spelled = to_builtin(value, self.kind)
        if not self.fits(spelled):
            raise errors.InputError(f"{of}is {value!r}; expected {self.expected}", field=name)
        return spelled


def integer(
    default: object = MISSING,
    least: int = 0,
    most: int | None = None,
    *,
    optional: bool = False,
    **option: Unpack[OptionText],
) -> Declared:
    """Declare an integer, or None if it is ``optional``."""
    return _field(default, _integer_rule(least, most, optional, {"metavar": "N", **option}))


def _integer_rule(least: int, most: int | None, optional: bool, option: OptionText) -> Rule:
    # Larger integers fit into no array, file or random number generator.
    limit = _MAX_INTEGER if most is None else most
    span = f"of at least {least:,}, below 2**63" if most is None else f"from {least:,} to {most:,}"

    def fits(value: object) -> bool:
        if value is None:
            return optional
        return isinstance(value, int) and is_integer(value) and least <= value <= limit

    return Rule(int, fits, f"an integer {span}", option)


def real(
    default: object = MISSING,
    least: float = -math.inf,
    most: float = math.inf,
    *,
    above: float = -math.inf,
    below: float = math.inf,
    many: int = 0,
    optional: bool = False,
    **option: Unpack[OptionText],
) -> Declared:
    """Declare a finite number, a tuple of ``many`` numbers, or None if it is ``optional``."""

    def fits_one(value: object) -> bool:
        return isinstance(value, float) and least <= value <= most and above < value < below

    def fits(value: object) -> bool:
        if many:
            return isinstance(value, tuple) and len(value) == many and all(map(fits_one, value))
        return fits_one(value) or (optional and value is None)

    ends = ((" from {:g}", least), (" above {:g}", above), (" to {:g}", most), (" and below {:g}", below))
    span = "".join(words.format(end) for words, end in ends if math.isfinite(end)) or ", finite"
    what = f"{many} numbers" if many else "a number"
    return _field(default, Rule(float, fits, f"{_or_none(optional)}{what}{span}", option))


def choice(
    default: object, known: Sequence[str], *, optional: bool = False, **option: Unpack[OptionText]
) -> Declared:
    """Declare one of several words, None if it is ``optional``, or several if the default is a tuple."""

    def fits(value: object) -> bool:
        if isinstance(default, tuple):
            return isinstance(value, tuple) and set(value) <= set(known)
        if isinstance(value, str):
            return value in known
        return optional and value is None

    expected = f"{_or_none(optional)}one of {', '.join(known)}"
    return _field(default, Rule(str, fits, expected, option, tuple(known)))


def switch(default: bool, **option: Unpack[OptionText]) -> Declared:
    """Declare True or False."""
    return _field(default, Rule(bool, lambda value: isinstance(value, bool), "True or False", option))


def text(default: object = None, **option: Unpack[OptionText]) -> Declared:
    """Declare a text, or the result of ``read``, which checks it."""
    return _field(default, Rule(str, lambda _: True, "", option))


def _or_none(optional: bool) -> str:
    return "None or " if optional else ""


def check_fields(spec: DataclassInstance, of: str) -> None:
    """Normalize the declared fields of a specification; InputError for the first that is not valid.

    ``of`` names the specification in the message, such as ``the plan of touches``.
    """
    for declared in fields(spec):
        rule = Rule.of(declared)
        if rule is not None:
            value = rule.checked(getattr(spec, declared.name), declared.name, f"of {of} ")
            object.__setattr__(spec, declared.name, value)


def _field(default: object, rule: Rule) -> Declared:
    return field(default=default, metadata={_RULE: rule})


def checked_integer(value: object, name: str, least: int = 0, most: int | None = None) -> int:
    """Return an integer within bounds; InputError, which begins with ``name``, for anything else."""
    return int(_integer_rule(least, most, False, {}).checked(value, name))


def split_counts(
    value: object, name: str, splits: Sequence[str], most: int = _MAX_INTEGER, of: str = ""
) -> tuple[tuple[str, int], ...]:
    """Return counts by split from a mapping, pairs, or a text such as ``train=8,test=2``.

    Raises InputError, as :class:`Rule` does, for anything else.
    """
    pairs = to_builtin(value.items() if isinstance(value, Mapping) else value)
    if isinstance(value, str):
        texts = [tuple(piece.strip() for piece in part.partition("=")) for part in value.split(",")]
        if not all(wording.counts(count) for _, _, count in texts):
            raise errors.InputError(
                f"{of}is {value!r}; expected SPLIT=N once per split, such as train=8,test=2", field=name
            )
        pairs = tuple((split, int(count)) for split, _, count in texts)
    fits = isinstance(pairs, tuple) and all(
        isinstance(pair, tuple) and len(pair) == 2 and pair[0] in splits and is_integer(pair[1])
        for pair in pairs
    )
    if not fits or len(dict(pairs)) < len(pairs) or not all(0 <= count <= most for _, count in pairs):
        raise errors.InputError(
            f"{of}is {value!r}; expected each of {', '.join(splits)} once at most, with an integer from 0 "
            f"to {most:,}, such as {{{splits[0]!r}: 8}}",
            field=name,
        )
    return tuple(pairs)


def to_builtin(value: object, kind: type[int] | type[float] = int) -> Any:
    """Return a value with tuples for iterables and Python's numbers for all numbers.

    With ``kind`` ``float``, integers become floats; with ``int`` numbers keep their kind. Texts,
    mappings, other objects and arrays of too many entries are returned unchanged, for the checks that follow.
    """
    too_many = math.prod(getattr(value, "shape", ())) > _MAX_ARRAY
    if too_many or isinstance(value, (str, bytes, Mapping)):
        return value
    if isinstance(value, Iterator):
        value = list(islice(value, _MAX_ENTRIES + 1))
        if len(value) > _MAX_ENTRIES:  # it may be endless
            raise errors.InputError(f"an iterator of more than {_MAX_ENTRIES:,} values", next="give a list")
    # An array without dimensions is a number, although its type is iterable.
    if isinstance(value, Iterable) and getattr(value, "ndim", None) != 0:
        return tuple(to_builtin(entry, kind) for entry in value)
    return to_builtin_number(value, kind)


def to_builtin_number(value: Any, kind: type[int] | type[float] = int) -> Any:
    """Return a number as Python's own; see :func:`to_builtin`."""
    if getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return value
    if kind is not float and isinstance(value, numbers.Integral):
        return int(value)
    try:
        return float(value)
    except OverflowError:
        return value


def is_integer(*values: object) -> bool:
    """Return whether all values are integers; True and False are not."""
    return all(isinstance(value, int) and not isinstance(value, bool) for value in values)
