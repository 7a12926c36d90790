"""The formats from which touches are imported, each a module of this package."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from realtouch.exchange.found_touches import FoundTouch, ReadContents, contents_of
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.kind import lazy

ImportLayout = Literal["folder", "webdataset", "replay", "fota", "sparsh", "anytouch"]
_SIZES_SEEN = 32


@dataclass(frozen=True)
class ImportFormat:
    """How a format is read.

    ``find`` takes a folder, the columns and the path of a table, and yields the touches there. ``contents``
    reads their images. ``sizes_seen`` is from how many of them the size of all follows, if these agree.
    ``describe`` states how the images are converted; empty where they are taken as they are.
    """

    find: Callable[[store.DataFolder, ImportColumns, str | None], Iterator[FoundTouch]]
    contents: ReadContents = contents_of
    sizes_seen: int = _SIZES_SEEN
    describe: Callable[[Sequence[FoundTouch]], str] = lambda _touches: ""


IMPORTS: dict[str, ImportFormat] = {
    layout: ImportFormat(lazy(f"realtouch.exchange.{layout}:find_{layout}"))
    for layout in get_args(ImportLayout)
} | {
    "replay": ImportFormat(
        lazy("realtouch.exchange.replay:find_replay"),
        lazy("realtouch.exchange.replay:encoded_frames"),
        1,  # the pictures of one array are of one size
        lazy("realtouch.exchange.replay:describe_conversion"),
    )
}
