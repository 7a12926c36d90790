"""What sampling tells when a specification cannot be satisfied."""

from __future__ import annotations

from dataclasses import dataclass, fields

from dataset_store.errors import InputError

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
    """

    shape: str
    number: int
    objects: int
    attempts: int
    restarts: int
    area_mm: tuple[float, float]
    kept_in: str = ""

    def __post_init__(self) -> None:
        # The fields are the arguments, so that the error crosses process borders.
        Exception.__init__(self, *(getattr(self, entry.name) for entry in fields(self)))

    def __str__(self) -> str:
        kept = f"; shards finished before stay in {self.kept_in!r}" if self.kept_in else ""
        place = ", and choose another --out or --overwrite" if self.kept_in else ""
        return (
            f"no place for object {self.number} of {self.objects} (a {self.shape}): {self.attempts} attempts "
            f"failed, and the scene was started over {self.restarts} times (restarts); centres may lie in "
            f"{self.area_mm[0]:g} x {self.area_mm[1]:g} mm{kept}; next: lower the most --stars or "
            f"--distractors, --clearance-mm or --radius-mm, or raise --cell-mm{place}"
        )
