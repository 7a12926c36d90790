"""The clip of one touch: its frames, their times and poses, and which of them shows the contact."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import InputError, ItemError, MissingExtraError
from realtouch.clip_frames import ClipFrames
from realtouch.contact import (
    DEFAULT_MIN_AREA,
    DEFAULT_MIN_CHANGE,
    contact_window,
    deepest_frame,
    most_changed_frame,
    require_method,
)
from realtouch.fields import clip_poses, clip_times, touch_times
from realtouch.jpeg import Pixels
from realtouch.poses import Poses

if TYPE_CHECKING:
    from torchcodec.decoders import VideoDecoder

__all__ = ["TouchClip"]

NO_CONTACT = "no-contact"


class TouchClip(ClipFrames):
    """The clip of one touch.

    ``clip[i]`` gives (H, W, 3) uint8; a slice, ints or a boolean mask give (n, H, W, 3). No frame is kept.
    Iterating yields ``{"data": (3, H, W) uint8, "pts": seconds}`` per frame, as the ``VideoReader`` of
    torchvision did; use :meth:`frames`, or ``numpy.asarray``, for arrays. Safe to share between threads and
    to pickle.

    Parameters
    ----------
    row : Row
        The round.
    touch : int
        Number of the touch in it.
    decoder : "libjpeg" or "ffmpeg"
        Which decoder to use; see :mod:`realtouch.clip_frames`.
    """

    __slots__ = ()

    @property
    def timestamps_s(self) -> NDArray[np.float64]:
        """Time stamp of each frame, shape (N,), float64, seconds on the clock of the recording.

        Those stored with the round; the file's own clock in data sets without them.
        """
        times = clip_times(self._row, self.touch)
        return self.media_times_s if times is None else times

    def at(self, time_s: float) -> Pixels:
        """Decode the frame shown at a time: the last one stamped at or before it, (H, W, 3) uint8.

        Raises
        ------
        InputError
            The time lies before the first frame, or more than one frame's duration behind the last.
        """
        times = self.timestamps_s
        if not len(times) or not times[0] <= time_s <= times[-1] + 1.0 / self.fps:
            span = f"{times[0]:.3f} to {times[-1]:.3f} s" if len(times) else "no frames"
            message = f"no frame at {time_s} s; expected a time within the clip, {span}"
            raise InputError(message)
        return self[int(np.searchsorted(times, time_s, side="right")) - 1]

    @property
    def poses(self) -> Poses:
        """Pose of the gel in each frame, N poses, metres, cell frame."""
        return clip_poses(self._row, self.touch)

    @property
    def contact_window(self) -> slice:
        """Frames from first to last registered contact; see :func:`realtouch.contact.contact_window`."""
        start_s, end_s = touch_times(self._row, self.touch)
        return contact_window(self.timestamps_s, start_s, end_s)

    def contact_index(
        self,
        method: str = "contact_end",
        *,
        min_change: float = DEFAULT_MIN_CHANGE,
        min_area: float = DEFAULT_MIN_AREA,
    ) -> int:
        """Choose the frame that shows the contact.

        Parameters
        ----------
        method : str
            ``"contact_start"`` and ``"contact_end"``: first and last frame of :attr:`contact_window`;
            ``"peak"``: the frame of the window with the lowest gel, the earliest of equals; ``"median"``: the
            frame of the whole clip that differs most from its median, see
            :func:`realtouch.contact.most_changed_frame`.
        min_change, min_area : float
            Thresholds of ``"median"``: grey levels and share of the picture.

        Raises
        ------
        InputError
            No such method.
        ItemError
            ``"median"`` finds no frame that shows contact (reason ``"no-contact"``).
        """
        chosen = require_method(method)
        if chosen == "median":
            return self._most_changed(min_change, min_area)
        window = self.contact_window
        if chosen == "contact_start":
            return int(window.start)
        if chosen == "contact_end":
            return int(window.stop) - 1
        return int(window.start) + deepest_frame(self.poses.position_m[window, 2])

    def contact_frame(self, method: str = "contact_end", **thresholds: float) -> Pixels:
        """Decode the frame that shows the contact, (H, W, 3) uint8; see :meth:`contact_index`."""
        return self[self.contact_index(method, **thresholds)]

    def contact_into(self, out: Pixels, method: str = "contact_end", **thresholds: float) -> None:
        """Decode the frame that shows the contact into an array of its size, shape (H, W, 3), uint8."""
        self.decode_into(out, self.contact_index(method, **thresholds))

    def to_torchcodec(self) -> VideoDecoder:
        """Return a ``torchcodec`` decoder of the clip, as `datasets` hands them out.

        Raises
        ------
        MissingExtraError
            torchcodec is not installed.
        """
        try:
            from torchcodec.decoders import VideoDecoder
        except ImportError as error:
            feature = "TouchClip.to_torchcodec()"
            raise MissingExtraError(feature, "torchcodec", "torch") from error
        return VideoDecoder(bytes(self.data))

    def _most_changed(self, min_change: float, min_area: float) -> int:
        frame = most_changed_frame(self.frames(), min_change=min_change, min_area=min_area)
        if frame is None:
            message = (
                f"touch {self.touch} of {self._row.path!r}, row {self._row.number}, shows no contact: no "
                f"frame differs from the median by {min_change} levels on {min_area:.2%} of its pixels"
            )
            raise ItemError(NO_CONTACT, message)
        return frame

    def __repr__(self) -> str:
        return f"TouchClip(touch {self.touch}, {self._count} frames)"
