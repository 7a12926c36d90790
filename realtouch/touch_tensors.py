"""Touches as torch tensors for a ``DataLoader``, and for training at any size (extra ``torch``).

Images come as ``torchvision.tv_tensors.Image``, clips as ``tv_tensors.Video``, so that pipelines of
``torchvision.transforms.v2`` apply. Everything pickles, so that workers start by fork, spawn or forkserver.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from realtouch import contact
from realtouch.touches import datasets, media, schema
from realtouch.touches.datasets import AnyTouches, Touches
from realtouch.touches.rounds import Touch, TouchSingleRound
from tactile_toolkit import cache, errors, read
from tactile_toolkit.read import TrainingBatches
from tactile_toolkit.touch import decode_image
from tactile_toolkit.value_types import UInt8

if TYPE_CHECKING:
    import torch
else:
    with errors.needs_extra("realtouch.touch_tensors", "torch", "torch"):
        import torch

__all__ = ["TARGETS", "TouchTensors", "TrainingBatches"]

# Least recently used rounds are evicted; a training batch holds a touch or two of each.
_ROUNDS_KEPT = 1024

Transform = Callable[[Any], Any]
Target = str | Callable[[Touch], object] | None

TARGETS: dict[str, Callable[[Touch], object]] = {
    "label": lambda touch: touch.label,
    "object_id": lambda touch: touch.object_id,
    "pos_in_cell": lambda touch: torch.tensor(np.asarray(touch.pos_in_cell_m), dtype=torch.float32),
    "gel_position": lambda touch: torch.tensor(touch.gel_pose.translation, dtype=torch.float32),
    "round_id": lambda touch: touch.round_id,
}
"""Targets of images; positions are in metres, cell frame, float32.

``"gel_position"`` belongs to the frame of the item; for a whole clip, to the last frame of contact.
"""


class TouchTensors(torch.utils.data.Dataset):  # type: ignore[misc]
    """A map-style data set of touches.

    Item i is ``(image, target)``: a ``tv_tensors.Image`` (3, H, W) uint8, or a ``tv_tensors.Video``
    (N, 3, H, W) uint8 of a ``seq`` set; without a target it is only the image.

    Parameters
    ----------
    dataset : TouchDataset, TouchStream or Touches
        The touches: all touches of a data set or stream, or a selection.
    transform : callable, optional
        Applied to each image or clip, such as a pipeline of ``torchvision.transforms.v2``.
    target : str, callable or None
        One of :data:`TARGETS`; ``"extra.NAME"``, the numbers of a further column, float32, NaN where they are
        missing; or a function of a :class:`realtouch.Touch`. A column with an entry per frame gives all
        entries with a whole clip, and the entry of the frame with an image.
    frames : str or None
        For clips: give one contact frame as an image, chosen by this method (see
        :meth:`realtouch.TouchClip.contact_index`), instead of the whole clip. A function as ``target`` is
        given the touch, whose pose is that of the last frame of contact.
    channels_last : bool
        Lay out batches of images in torch's memory format ``channels_last``: the same values in a fifth less
        time, and the fastest format for convolutions. ``view`` cannot flatten them; ``flatten`` and
        ``reshape`` can.

    Raises
    ------
    InputError
        The target, or the way to choose a frame, is unknown or needs a column that is not there.
    """

    def __init__(
        self,
        dataset: datasets.AnyDataset | datasets.TouchStream | AnyTouches,
        transform: Transform | None = None,
        target: Target = "label",
        frames: str | None = None,
        *,
        channels_last: bool = False,
    ) -> None:
        self.touches = dataset if isinstance(dataset, Touches) else dataset.touches()
        self.transform = transform
        rounds = self.touches.dataset
        extras = _numbers_of(rounds)
        if isinstance(target, str) and target not in (*TARGETS, *extras):
            known = ", ".join([*TARGETS, *extras])
            raise errors.InputError(
                f"no target {target!r}; expected one of {known}, a function of a touch, or None"
            )
        self.target = target
        self.frames = None if frames is None else contact.require_method(frames)
        if self.frames is not None and rounds.kind == "seq":
            schema.require_poses_for(self.frames, rounds.column_names, ", ".join(rounds.description()))
        self.channels_last = channels_last
        self._rounds: cache.MemoryCache[int, TouchSingleRound] = cache.MemoryCache(_ROUNDS_KEPT)

    @property
    def sequence(self) -> AnyTouches:
        """The touches, in the order of the items."""
        return self.touches

    def __len__(self) -> int:
        return len(self.touches)

    def __getitem__(self, index: int) -> Any:
        """Return one item."""
        touch = self.touches[index]
        frame = None
        if isinstance(touch.round, TouchSingleRound):
            shown = _tensor("Image", touch.image)
        elif self.frames is None:
            shown = _tensor("Video", touch.clip.frames())
        else:
            clip = touch.clip
            frame = clip.contact_index(self.frames)
            shown = _tensor("Image", clip[frame])
        return self._given(shown, touch, frame)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Return the items of a batch; images of one size are decoded into one array."""
        decoded = self._decoded(indices)
        if decoded is None:
            return [self[index] for index in indices]
        image_type = _tv_tensors().Image
        shown = (image.as_subclass(image_type) for image in decoded[0])
        return [self._given(*pair) for pair in zip(shown, decoded[1], strict=True)]

    def _given(self, shown: torch.Tensor, touch: Touch, frame: int | None = None) -> object:
        """Return the item of a picture; ``frame`` is the chosen frame of a clip."""
        item = shown if self.transform is None else self.transform(shown)
        if self.target is None:
            return item
        return item, self._target_of(touch, frame)

    def _target_of(self, touch: Touch, frame: int | None = None) -> object:
        if frame is not None and self.target == "gel_position":
            return torch.tensor(touch.clip.poses[frame].translation, dtype=torch.float32)
        if isinstance(self.target, str) and self.target not in TARGETS:
            name = self.target.removeprefix("extra.")
            values = np.asarray(touch.extra[name], np.float32)
            if frame is not None and touch.round.row.has(f"{schema.EXTRA_PREFIX['frame']}{name}"):
                values = values[frame]
            return torch.tensor(values)
        # Names are looked up here and not kept as functions: a function without a name does not pickle.
        target: Any = TARGETS[self.target] if isinstance(self.target, str) else self.target
        return target(touch)

    def collated(self, indices: Sequence[int]) -> Any:
        """Return what torch's ``default_collate`` makes of some items, without a tensor for each of them.

        Parameters
        ----------
        indices : sequence of int
            Which items.

        Returns
        -------
        Tensor or list
            Images, shape (items, 3, H, W), uint8; with a target, a list of them and the targets.

        Raises
        ------
        IntegrityError
            Something is damaged; names file, row and touch.
        """
        collate = torch.utils.data.default_collate
        decoded = self._decoded(indices) if self.transform is None else None
        if decoded is None:
            return collate(self.__getitems__(indices))
        images, touches = decoded
        if self.target is None:
            return images
        targets = tuple(map(self._target_of, touches))
        return [images, collate(targets)]

    def _decoded(self, indices: Sequence[int]) -> tuple[torch.Tensor, list[Touch]] | None:
        """Decode images of one size, shape (n, 3, H, W), and their touches; None if sizes differ.

        It is None for a damaged image as well; the error is raised when the item is requested.
        """
        if self.touches.dataset.kind != "single" or not len(indices):
            return None
        located = sorted((*self.touches.locate(index), slot) for slot, index in enumerate(indices))
        touches: dict[int, Touch] = {}
        last = -1
        try:
            size = self._images(located[0][0])[1].size(located[0][1])
            # Decoders write colour by colour for each pixel. One picture stays in the processor's cache.
            pixels = media.images_array(len(located), size)
            planes = pixels.transpose(0, 3, 1, 2)
            if not self.channels_last:
                planes = pixels.reshape(planes.shape)
                picture = media.images_array(1, size)[0]
            for position, number, slot in located:
                if position != last:
                    last, (record, images) = position, self._images(position)
                touches[slot] = Touch(record, number)
                if self.channels_last:
                    decode_image(images.encoded(number), pixels[slot])
                else:
                    planes[slot] = decode_image(images.encoded(number), picture).transpose(2, 0, 1)
        except (errors.IntegrityError, ValueError):
            return None
        return torch.from_numpy(planes), [touches[slot] for slot in range(len(located))]

    def _images(self, position: int) -> tuple[TouchSingleRound, media.SensorImages]:
        """Return a round and its images; the rounds used last are cached."""
        record = self._rounds.get(position)
        if record is None:
            record = self.touches.dataset[position]
            self._rounds.put(position, record)
        return record, record.sensor_image


def _numbers_of(rounds: datasets.AnyDataset) -> list[str]:
    """Return the targets that are further columns of numbers."""
    types = read.column_types(rounds.table.schemas[0]) if rounds.table.schemas else {}
    columns = schema.extra_columns(rounds.column_names).items()
    leaves = {name: read.list_depth(types[stored])[1] for name, stored in columns}
    return [f"extra.{name}" for name, leaf in leaves.items() if not pa.types.is_string(leaf)]


def _tensor(kind: str, pixels: UInt8) -> torch.Tensor:
    """Return pixels, shape (..., H, W, 3), as a ``tv_tensors`` of shape (..., 3, H, W)."""
    return getattr(_tv_tensors(), kind)(torch.from_numpy(np.moveaxis(pixels, -1, -3)))


def _tv_tensors() -> ModuleType:
    with errors.needs_extra("realtouch.touch_tensors", "torchvision", "torch"):
        from torchvision import tv_tensors  # an extra
    module: ModuleType = tv_tensors
    return module
