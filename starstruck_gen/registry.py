"""Shapes of your own: making a further kind known."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from starstruck_gen.proportions import DEFAULT_OUTLINES, REGISTRY, Proportions, remember
from starstruck_gen.shapes import outline, shape_key
from starstruck_gen.solid import prism, prism_solid
from tactile_toolkit.errors import InputError

__all__ = ["own_kinds", "register_shape"]

K = TypeVar("K", bound=type[Proportions])

_TOOLKIT = frozenset(REGISTRY)
_REACH_TOLERANCE = 1e-9


def register_shape(kind: K) -> K:
    """Make a kind of shape known, so that :class:`starstruck_gen.Shape` and all that follows take it.

    Parameters
    ----------
    kind : type
        A frozen dataclass with slots, derived from :class:`starstruck_gen.Proportions`: ``name`` names the
        shape, ``rings()`` gives its outline, and each field is a number with a default. A field's range is
        its metadata ``least`` and ``most``.

    Returns
    -------
    type
        The same, so that this serves as a decorator.

    Raises
    ------
    InputError
        The name is taken or no plain word, a field is no number, or the outline in its default proportions
        bounds no area or does not reach distance 1 from the origin.

    Notes
    -----
    Specifications and shapes carry the class with them when they are pickled, so that worker processes know
    the kind as well; they import it by its name, as all pickled classes. Reading JSON or a stored data set
    needs the kind registered first, with ``SceneSpec.from_dict`` too. The command line has the toolkit's own
    shapes alone.

    Examples
    --------
    >>> from dataclasses import dataclass, field
    >>> import numpy as np
    >>> @register_shape
    ... @dataclass(frozen=True, slots=True)
    ... class Kite(Proportions):
    ...     name = "kite"
    ...     width: float = field(default=0.6, metadata={"least": 0.1, "most": 1.0})
    ...
    ...     def rings(self):
    ...         return (np.array([(1.0, 0.0), (0.0, self.width), (-0.5, 0.0), (0.0, -self.width)]),)
    >>> from starstruck_gen import Shape
    >>> Shape("kite", 0.012, Kite(width=0.4)).key
    'kite(width=0.4)'
    """
    _require_described(kind)
    former = REGISTRY.get(kind.name)
    if former is kind:
        return kind
    # A cell of a notebook that is run again defines its class anew; that class takes the place of its former.
    if former is not None and (kind.name in _TOOLKIT or former.__qualname__ != kind.__qualname__):
        message = f"shape {kind.name!r} is taken by {former.__qualname__}; expected another name"
        raise InputError(message)
    _set(kind.name, kind)
    try:
        _require_outline(kind)
    except Exception:
        _set(kind.name, former)
        raise
    return kind


def own_kinds() -> tuple[type[Proportions], ...]:
    """Return the kinds that are not the toolkit's, for workers that must know them too."""
    return tuple(kind for name, kind in REGISTRY.items() if name not in _TOOLKIT)


def _set(name: str, kind: type[Proportions] | None) -> None:
    if kind is None:
        del REGISTRY[name], DEFAULT_OUTLINES[name]
    else:
        remember(kind)
    for kept in (outline, prism, prism_solid):  # what they keep may be of a former kind of that name
        kept.cache_clear()


def _require_described(kind: Any) -> None:
    if not (isinstance(kind, type) and issubclass(kind, Proportions) and is_dataclass(kind)):
        message = f"{kind!r} is no kind of shape; expected a frozen dataclass derived from Proportions"
        raise InputError(message)
    if not isinstance(kind.name, str) or not re.fullmatch(r"[A-Za-z_]\w*", kind.name):
        message = f"name of shape {kind.__qualname__} is {kind.name!r}; expected a plain word"
        raise InputError(message)
    for entry in fields(kind):
        if type(entry.default) not in (int, float):
            message = (
                f"field {entry.name!r} of shape {kind.name!r} has the default {entry.default!r}; expected a "
                "number"
            )
            raise InputError(message)


def _require_outline(kind: type[Proportions]) -> None:
    made = prism(shape_key(kind()))
    reach = float(np.linalg.norm(made.corners, axis=1).max())
    if abs(reach - 1.0) > _REACH_TOLERANCE:
        message = (
            f"the outline of shape {kind.name!r} reaches distance {reach:g} from the origin; expected 1, the "
            "circumscribed radius"
        )
        raise InputError(message)
