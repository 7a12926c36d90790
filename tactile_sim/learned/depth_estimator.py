"""Depth of touches, estimated from their images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactile_sim.learned.channels import generated, picture_channels, shades_of
from tactile_sim.learned.generators import make_generator
from tactile_sim.learned.weights import published_weights, read_weights
from tactile_sim.sensor import center_view, checked_size_px
from tactile_toolkit.array_types import Float32, UInt8
from tactile_toolkit.errors import InputError


class DepthEstimator:
    """Estimates depth from images of touches with a generator that was trained on real ones.

    On the CPU, an estimate does not depend on its batch. Images of a GelSight Mini are expected.

    Parameters
    ----------
    weights : str or path, optional
        File of weights, ``touch_to_depth.npz`` of ``tactile-sim train``; by default the published ones, of
        the installed `tactile-mnist`.
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one.
    bfloat16 : bool
        Multiply in bfloat16: almost twice as fast on a CPU that has it, and less precise.

    Attributes
    ----------
    input_size_px : tuple of int
        Width and height that images are scaled to, pixels: those that the network was trained at.

    Raises
    ------
    InputError
        The weights cannot be read; there is no such device; the processor has no bfloat16.
    MissingExtraError
        The published weights are not installed.
    """

    def __init__(
        self, weights: str | Path | None = None, *, device: str = "cpu", bfloat16: bool = False
    ) -> None:
        read = read_weights(weights or published_weights("depth"))
        self.input_size_px = read.size_px
        self._generator = make_generator(read, device, bfloat16=bfloat16)
        self._sensor = center_view(*read.size_px)

    def estimate_m(self, images: UInt8, size_px: tuple[int, int]) -> Float32:
        """Estimate depth.

        Parameters
        ----------
        images : ndarray of uint8
            Touches, shape (n, H, W, 3).
        size_px : tuple of int
            Width and height of the depth maps, pixels.

        Returns
        -------
        ndarray of float32
            Depth below the camera's side of the gel, metres, shape (n, h, w): 0.002125 where the gel is
            pressed in deepest, 0.00425, its thickness, where nothing touches it.

        Raises
        ------
        InputError
            The images have another shape or type, or the size is not valid.
        """
        width, height = checked_size_px(size_px)
        if images.dtype != np.uint8 or images.ndim != 4 or images.shape[3] != 3 or not images.size:
            raise InputError(
                f"images are {images.dtype} of shape {images.shape}; expected uint8 (n, height, width, 3)"
            )
        made = generated(
            self._generator,
            lambda pictures: 2 * shades_of(picture_channels(pictures), self.input_size_px) - 1,
            images,
        )
        share = shades_of(made[:, 2:], (width, height))[:, 0].numpy()
        gel_m, press_m = self._sensor.gel_m, self._sensor.press_m
        return np.asarray(share * (gel_m - press_m) + press_m, np.float32)
