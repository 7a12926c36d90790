"""Real touches: typed, lazy, fast loaders, and the work that every user of them does by hand.

``realtouch.load`` opens a data set; ``dataset[0]`` is a round of touches, ``dataset.touches()`` the flat view
of single touches with its filters. ``to_single``, ``resize``, ``select`` and ``frames`` write new ones. Names
are imported on first use, so that ``import realtouch`` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from realtouch.convert.api import frames, resize, select, to_single
    from realtouch.dataset import TouchDataset, TouchSeqDataset, TouchSingleDataset, TouchStream
    from realtouch.exchange.api import export
    from realtouch.exchange.importing import import_images
    from realtouch.exchange.items import ImportColumns
    from realtouch.integrity.verify import verify
    from realtouch.media.clips import TouchClip
    from realtouch.names import SHORT_NAMES
    from realtouch.opening import load
    from realtouch.poses import Poses, PoseSequences
    from realtouch.preprocess import (
        ContactRule,
        Contacts,
        ContactScore,
        background,
        best_frame,
        contact_score,
        difference,
        find_contacts,
    )
    from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
    from realtouch.summary import Summary, summarise
    from realtouch.touch import Touch
    from realtouch.touches import Touches

__all__ = [
    "SHORT_NAMES",
    "ContactRule",
    "ContactScore",
    "Contacts",
    "ImportColumns",
    "PoseSequences",
    "Poses",
    "Summary",
    "Touch",
    "TouchClip",
    "TouchDataset",
    "TouchRound",
    "TouchSeqDataset",
    "TouchSeqRound",
    "TouchSingleDataset",
    "TouchSingleRound",
    "TouchStream",
    "Touches",
    "background",
    "best_frame",
    "contact_score",
    "difference",
    "export",
    "find_contacts",
    "frames",
    "import_images",
    "load",
    "resize",
    "select",
    "summarise",
    "to_single",
    "verify",
]

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "realtouch.convert.api": ("frames", "resize", "select", "to_single"),
        "realtouch.exchange.api": ("export",),
        "realtouch.exchange.importing": ("import_images",),
        "realtouch.exchange.items": ("ImportColumns",),
        "realtouch.dataset": ("TouchDataset", "TouchSeqDataset", "TouchSingleDataset", "TouchStream"),
        "realtouch.integrity.verify": ("verify",),
        "realtouch.opening": ("load",),
        "realtouch.media.clips": ("TouchClip",),
        "realtouch.names": ("SHORT_NAMES",),
        "realtouch.poses": ("PoseSequences", "Poses"),
        "realtouch.preprocess": (
            "ContactRule",
            "ContactScore",
            "Contacts",
            "background",
            "best_frame",
            "contact_score",
            "difference",
            "find_contacts",
        ),
        "realtouch.rounds": ("TouchRound", "TouchSeqRound", "TouchSingleRound"),
        "realtouch.summary": ("Summary", "summarise"),
        "realtouch.touch": ("Touch",),
        "realtouch.touches": ("Touches",),
    },
)
