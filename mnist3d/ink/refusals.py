"""Messages for images that give no solid."""

from __future__ import annotations

from typing import NoReturn

from tactile_toolkit.errors import ItemError

_SENTENCES = {
    "bad-shape": "the image has shape {}; expected (H, W) with sides of {} px or more",
    "bad-dtype": "the image has dtype {}; expected grey levels (integers, floats or bool)",
    "not-finite": "{}: found NaN or infinity in {}, expected finite levels",
    "bad-pixels": "{}: found pixels from {:g} to {:g}, expected 0 to {:g}",
    "too-small": "the image has {} x {} px, so that the solid would be {:g} mm long; expected {} px or more",
    "unclear-ink": "{}: the ink cannot be distinguished from the paper, found {:.0%} of the margin light and "
    "the rest dark, expected nearly all of it to be paper",
    "one-level": "the image has one grey level only ({}); expected dark ink on light paper",
    "no-ink": "no pixel is dark enough to be ink; expected a digit",
    "all-ink": "ink covers {:.0%} of the margin of the image, which would make a slab; expected a digit on "
    "paper, with less than {:.0%} of the margin ink",
    "empty-page": "no part of the page is as dark as ink and has edges like ink; expected a digit",
    "half-ink": "ink covers {:.0%} of the image, which would make a slab; expected at most {:.0%} of it",
    "border": "ink touches {:.0%} of the border of the image; expected {:.0%} at most, and paper elsewhere",
    "several-digits": "the page shows {} digits or other pieces of ink; expected one digit",
    "cut-off": "the ink reaches the edge of the page; expected paper on all sides of the digit",
    "drawing-cut-off": "much ink, or something thicker than the strokes, reaches the edge of the page; "
    "expected paper there",
    "not-a-digit": "found {}; expected {} for a digit",
    "only-specks": "no piece of ink is as large as {} mm^2 (min_speck_mm2); expected a digit",
    "topology": "no lattice keeps the topology of the ink (bodies: {}, holes: {}); the finest has {} and {}",
    "layers": "the stack of layers has another topology than the ink (bodies: {}, holes: {}); the ink has {} "
    "and {}",
    "vertex-budget": "the digit needs {:,} vertices to keep its topology (bodies: {}, holes: {}); the budget "
    "is {:,}, and at most {:g} times as many are allowed",
}

_NEXT = {
    "bad-shape": "give one image of grey levels, at least as large",
    "bad-dtype": "convert the image to uint8, from 0 to 255",
    "not-finite": "repair or rescale this image in the file, or leave it out",
    "bad-pixels": "repair or rescale this image in the file, or leave it out",
    "too-small": "leave pixel_mm out, or give a larger image",
    "unclear-ink": "give dark or light (ink=, --foreground, --invert), or crop the image",
    "all-ink": "say that the ink is lighter (ink='light', --invert) if it is, or leave room around it",
    "several-digits": "cut the picture so that each digit has its own file, or cover the rest",
    "cut-off": "take the picture again with room around the digit, or cut away what surrounds the page",
    "drawing-cut-off": "take the picture again without fingers and with room around the page, or cut away "
    "what surrounds it",
    "not-a-digit": "leave the picture out, or photograph the digit from closer, in even light",
    "empty-page": "leave the picture out, or photograph the digit from closer, in even light",
    "only-specks": "make the solid larger, or draw with a thicker pen",
    "half-ink": "say that the ink is lighter (ink='light', --invert) if it is, or crop the image to its page",
    "border": "leave room around the digit, or crop the image to its page",
    "layers": "leave the digit out, or try method='fast'",
    "vertex-budget": "raise target_vertices (--vertices) to {5:,}",
}


def refuse(reason: str, *found: object, sentence: str = "") -> NoReturn:
    """Raise the ItemError of a reason; ``sentence`` chooses another message of the same reason."""
    key = sentence or reason
    raise ItemError(reason, _SENTENCES[key].format(*found), next=_NEXT.get(key, "").format(*found))
