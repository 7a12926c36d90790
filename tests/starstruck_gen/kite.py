"""A kind of shape that is not the toolkit's own, in a module that workers can import."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from starstruck_gen.shape_kinds import Outline, Proportions


@dataclass(frozen=True, slots=True)
class Kite(Proportions):
    """A kite, its long corner on +x."""

    name: ClassVar[str] = "kite"
    width: float = field(default=0.6, metadata={"least": 0.1, "most": 1.0})

    def rings(self) -> Outline:
        return (np.array([(1.0, 0.0), (0.0, self.width), (-0.5, 0.0), (0.0, -self.width)]),)
