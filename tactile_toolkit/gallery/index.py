"""The index of a gallery: what the page knows of every item before one is opened."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from tactile_toolkit.gallery.items import SPLIT, Facet, Gallery, Item, Measure
from tactile_toolkit.versions import toolkit_version

__all__ = ["IndexBuilder", "natural_order"]


@dataclass
class IndexBuilder:
    """Collects items one after another, keeping of each only what the page filters and sorts by."""

    gallery: Gallery
    _ids: list[str] = field(default_factory=list)
    _titles: list[str] = field(default_factory=list)
    _facets: dict[str, list[tuple[str, ...]]] = field(default_factory=dict)
    _measures: dict[str, list[float | None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._facets = {facet.name: [] for facet in self.gallery.facets}
        self._measures = {measure.name: [] for measure in self.gallery.measures}

    def add(self, item: Item) -> int:
        """Take an item and return its number on the page."""
        self._ids.append(item.id)
        self._titles.append(item.title)
        for name, values in self._facets.items():
            values.append(tuple(item.facets.get(name, ())))
        for measure in self.gallery.measures:
            self._measures[measure.name].append(_rounded(item.measures.get(measure.name), measure))
        return len(self._ids) - 1

    def __len__(self) -> int:
        return len(self._ids)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values: columns, one entry per item."""
        return {
            "kind": self.gallery.kind,
            "title": self.gallery.title,
            "nouns": list(self.gallery.nouns),
            "version": toolkit_version(),
            "ids": self._ids,
            "titles": self._titles,
            "facets": [
                _facet_column(facet, self._order(facet), self._facets[facet.name])
                for facet in self.gallery.facets
            ],
            "measures": [
                {
                    "title": measure.title,
                    "unit": measure.unit,
                    "decimals": measure.decimals,
                    "values": self._measures[measure.name],
                }
                for measure in self.gallery.measures
            ],
        }

    def _order(self, facet: Facet) -> tuple[str, ...]:
        return tuple(self.gallery.splits) if facet.name == SPLIT else facet.values


def natural_order(values: Iterable[str]) -> list[str]:
    """Sort texts so that numbers in them count as numbers: ``["2", "10", "a"]``; each once."""
    return sorted(set(values), key=_natural_key)


def _natural_key(text: str) -> tuple[list[tuple[int, float, str]], str]:
    parts = re.findall(r"\d+|\D+", text)
    return [(0, float(part), "") if part.isdecimal() else (1, 0.0, part) for part in parts], text


def _facet_column(facet: Facet, order: Sequence[str], rows: Sequence[tuple[str, ...]]) -> dict[str, Any]:
    found = {value for row in rows for value in row}
    known = [value for value in order if value in found]
    values = known + natural_order(found.difference(known))
    places = {value: place for place, value in enumerate(values)}
    return {
        "title": facet.title,
        "values": values,
        "rows": [[places[value] for value in row] for row in rows],
    }


def _rounded(value: float | None, measure: Measure) -> float | None:
    # NaN stands for "not measured" in reports, and JSON has none.
    if value is None or value != value:
        return None
    number = round(float(value), measure.decimals)
    return int(number) if measure.decimals == 0 else number
