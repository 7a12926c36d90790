"""Registration of further kinds of shapes."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from starstruck_gen import placement, prisms, shapes
from starstruck_gen.shape_kinds import KINDS, TOOLKIT_KINDS, Proportions
from tactile_toolkit.errors import InputError

K = TypeVar("K", bound=type[Proportions])
_REACH_TOLERANCE = 1e-9


def register_shape(kind: K) -> K:
    """Register a kind of shape, so that :class:`starstruck_gen.Shape` accepts its name.

    Parameters
    ----------
    kind : type
        A frozen dataclass with slots, derived from :class:`starstruck_gen.Proportions`: ``name``, ``rings()``
        of the outline, and fields that are numbers with a default, within ``least`` and ``most`` of their
        metadata.

    Returns
    -------
    type
        The same class, so that this function is a decorator.

    Raises
    ------
    InputError
        The name is taken or not a plain word, a field is not a number, or the default outline bounds no area
        or has another reach than 1.

    Notes
    -----
    Pickled specifications and shapes register the class in the process that unpickles them. JSON and stored
    data sets need a registered kind. The command line has the shapes of the toolkit only.

    Examples
    --------
    >>> from dataclasses import dataclass, field
    >>> import numpy as np
    >>> from starstruck_gen import Proportions, Shape
    >>> @register_shape
    ... @dataclass(frozen=True, slots=True)
    ... class Kite(Proportions):
    ...     name = "kite"
    ...     width: float = field(default=0.6, metadata={"least": 0.1, "most": 1.0})
    ...
    ...     def rings(self):
    ...         return (np.array([(1.0, 0.0), (0.0, self.width), (-0.5, 0.0), (0.0, -self.width)]),)
    >>> Shape("kite", 0.012, Kite(width=0.4)).key
    'kite(width=0.4)'
    """
    _require_valid_kind(kind)
    former = KINDS.get(kind.name)
    if former is kind:
        return kind
    # A notebook cell that is run again defines its class again; the new class replaces the former one.
    if former is not None and (former in TOOLKIT_KINDS or former.__qualname__ != kind.__qualname__):
        raise InputError(f"the name {kind.name!r} is taken by {former.__qualname__}; expected another name")
    made = prisms.checked_prism(kind.name, shapes.read_only(kind().rings()))
    reach = float(np.linalg.norm(made.corners, axis=1).max())
    if abs(reach - 1.0) > _REACH_TOLERANCE:
        raise InputError(
            f"the outline of shape {kind.name!r} reaches distance {reach:g} from the origin; expected 1"
        )
    KINDS[kind.name] = kind
    # Caches may hold outlines of the former kind of the same name.
    for kept in (shapes.outline, prisms.prism, prisms.prisms, placement.prism_solid):
        kept.cache_clear()
    return kind


def _require_valid_kind(kind: Any) -> None:
    is_kind = isinstance(kind, type) and issubclass(kind, Proportions) and is_dataclass(kind)
    if not (is_kind and isinstance(kind.name, str) and re.fullmatch(r"[A-Za-z_]\w*", kind.name)):
        raise InputError(
            f"{kind!r} is not a kind of shape; expected a frozen dataclass derived from Proportions, with a "
            "plain word as its name"
        )
    for entry in fields(kind):
        if type(entry.default) not in (int, float):
            raise InputError(
                f"field {entry.name!r} of shape {kind.name!r} has the default {entry.default!r}; expected a "
                "number"
            )
