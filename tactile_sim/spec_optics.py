"""The optics of a specification, kept from one round to the next."""

from __future__ import annotations

from functools import lru_cache

from tactile_sim.optics import Optics, make_optics
from tactile_sim.touch_spec import GenerateSpec
from tactile_toolkit import store


def optics_of(spec: GenerateSpec) -> Optics:
    """Return the optics of a specification, made once in a process and again when the weights change."""
    if spec.optics == "twin":
        return spec.sensor.optics
    if spec.weights is None:
        return _optics(spec.optics, None, ())
    file = store.expanded(spec.weights)
    if not file.is_file():  # refused with its name
        return make_optics(spec.optics, spec.weights)
    # A notebook may train into the same file again and again; the manifest has the checksum of the new one.
    facts = file.stat()
    return _optics(spec.optics, spec.weights, (facts.st_ino, facts.st_size, facts.st_mtime_ns))


@lru_cache(maxsize=2)
def _optics(name: str, weights: str | None, _stamp: tuple[int, ...]) -> Optics:
    # Tables and networks take longer to load than a round to render.
    return make_optics(name, weights)
