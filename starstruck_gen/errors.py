"""What sampling tells when a specification cannot be satisfied."""

from __future__ import annotations

from dataclasses import dataclass, fields

from tactile_toolkit.errors import InputError

__all__ = ["SamplingExhausted"]


@dataclass(eq=False)
class SamplingExhausted(InputError):  # noqa: N818
    """No place was found for one object of a scene, however often the scene was started over.

    Attributes
    ----------
    shape : str
        Shape of the object that found no place in the last layout.
    number, objects : int
        Which object of the scene it is, from 1, and how many the scene was to hold.
    attempts, restarts : int
        Positions tried for it in one layout, and how often the scene was started over.
    area_mm : tuple of float
        Width and height of the area in which centres may lie.
    kept_in : str
        Folder in which shards finished before stay; empty where there are none.
    most : int
        How many objects can stand that far apart in that area at most, where that was computed beforehand
        and nothing was tried; 0 where positions were tried.
    hopeless : bool
        Whether trying ended before all restarts were used, because no layout came near.
    """

    shape: str
    number: int
    objects: int
    attempts: int
    restarts: int
    area_mm: tuple[float, float]
    kept_in: str = ""
    most: int = 0
    hopeless: bool = False

    def __post_init__(self) -> None:
        # The fields are the arguments, so that the error crosses process borders.
        Exception.__init__(self, *(getattr(self, entry.name) for entry in fields(self)))

    def __str__(self) -> str:
        kept = f"; shards finished before stay in {self.kept_in!r}" if self.kept_in else ""
        place = ", and choose another --out or --overwrite" if self.kept_in else ""
        return (
            f"no place for object {self.number} of {self.objects} (a {self.shape}): {self._story()}; centres "
            f"may lie in {self.area_mm[0]:g} x {self.area_mm[1]:g} mm{kept}; next: lower the most --stars or "
            "--distractors (stars, distractors), --clearance-mm (clearance_m) or --radius-mm (radius_m of a "
            f"shape), or raise --cell-mm (cell_m){self._patience()}{place}"
        )

    def _story(self) -> str:
        if self.most:
            return f"there is room for at most {self.most} of that size, however they are placed"
        again = f"the scene was started over {self.restarts} times (restarts)"
        near = "; no layout came near" if self.hopeless else ""
        return f"{self.attempts} attempts failed, and {again}{near}"

    def _patience(self) -> str:
        helps = not (self.most or self.hopeless)
        return ", or in Python raise attempts or restarts of SceneSpec" if helps else ""
