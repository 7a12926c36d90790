"""What a card says about each source of digits: where it is from, its terms, its limits, whom to cite."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["SOURCES", "SourceWords", "words_of"]

_PUBLISHED = (
    "Algorithm and splits: Schneider et al. 2025. The published MNIST 3D was made from the handwriting of "
    "HWD+ (Beaulac and Rosenthal 2022)"
)


@dataclass(frozen=True)
class SourceWords:
    """Words about one source.

    Attributes
    ----------
    name : str
        As in the manifest.
    text : str
        What it is; fields of its fingerprint in braces.
    licence : str
        The Hub's word for the licence of meshes made of it.
    licence_text, limit, citation_text : str
        The same for people, and what else to know.
    """

    name: str
    text: str
    licence: str
    licence_text: str
    limit: str
    citation_text: str

    def describe(self, fingerprint: Mapping[str, Any]) -> str:
        """Fill the text with the fingerprint of the source."""
        return f"`{self.name}`: {self.text.format(**fingerprint)}"


_SYNTHETIC = SourceWords(
    "synthetic",
    "strokes drawn by the toolkit, seed {seed}, {count:,} digits, drawing version {drawing_version}",
    "mit",
    "MIT, as the toolkit: no one's handwriting is in it.",
    "The strokes are drawn by a program. They vary like handwriting, but they are no one's.",
    f"{_PUBLISHED}; this copy stands in for it with drawn digits.",
)

_HWD_PLUS = SourceWords(
    "hwdplus",
    "the high-resolution digits of HWD+, array of shape {shape}, dtype `{dtype}`, fingerprint "
    "`{images_sample_sha256:.12}`",
    "other",
    "The digits carry the terms of HWD+: see its authors' page before passing the meshes on.",
    "97 writers, 14 images of each digit by each: the same hand returns, unless splits divide whole writers.",
    f"{_PUBLISHED}, as this copy was.",
)

_FOLDER = SourceWords(
    "folder",
    "{images:,} pictures of a folder, ink {ink}, fingerprint `{sha256:.12}`",
    "other",
    "The meshes carry the terms of the pictures that they were made from.",
    "The pictures are a collection of their maker; nothing is known of how they were gathered.",
    f"{_PUBLISHED}; this copy is made from other pictures, whose makers want to be named too.",
)


@dataclass(frozen=True)
class _MnistWords(SourceWords):
    """MNIST comes in parts."""

    def describe(self, fingerprint: Mapping[str, Any]) -> str:
        parts = fingerprint["parts"]
        images = sum(part["images"] for part in parts)
        marks = ", ".join(f"`{part['images_sha256']:.12}`" for part in parts)
        return f"`mnist`: {images:,} images of 28 x 28 pixels, fingerprint {marks}"


_MNIST = _MnistWords(
    "mnist",
    "",
    "cc-by-sa-3.0",
    "CC BY-SA 3.0, as MNIST.",
    "Images of 28 x 28 pixels are enlarged first: outlines are smoother than any pen draws.",
    f"{_PUBLISHED}; this copy is made from MNIST (LeCun et al. 1998).",
)

SOURCES = {words.name: words for words in (_SYNTHETIC, _HWD_PLUS, _MNIST, _FOLDER)}
"""Words by the name of the source."""


def words_of(name: str) -> SourceWords:
    """Return the words about a source; those of one that a user brought along claim nothing."""
    return SOURCES.get(name) or SourceWords(
        name,
        "a source of its maker's own; its fingerprint is in the specification below",
        "other",
        "The meshes carry the terms of the images that they were made from.",
        "Nothing is known here of how the images were gathered.",
        f"{_PUBLISHED}; this copy is made from other images, whose makers want to be named too.",
    )
