"""The sensor `cycle_gan` of the published environments with weights of one's own."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from env_assets.published.ids import PublishedEnvironment
from env_assets.published.packages import published_package
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.files import expanded


def learned_sensor(
    weights: str | Path, environment: PublishedEnvironment, settings: Mapping[str, Any]
) -> str:
    """Enter weights into the package's table of sensors; return the name of the sensor.

    The package itself knows only the weights that it ships. InputError where the environment has another
    sensor, or the file holds no weights.
    """
    sensor, backend = settings.get("sensor_type", "taxim"), settings.get("sensor_backend", "auto")
    if sensor != "cycle_gan" or backend not in ("auto", "torch"):
        raise InputError(
            f"weights do not apply to {environment.spec.id!r}: its sensor is {sensor!r}, backend "
            f"{backend!r}; expected 'cycle_gan' with 'torch'",
            next="choose an environment with CycleGAN in its name",
        )
    from tactile_sim.learned.networks import generator_of, read_weights

    read = read_weights(weights)
    # Named by its content: environments of two files of one name must not share a sensor, which the package
    # looks up by its name alone.
    content = expanded(weights).read_bytes()
    name = f"cycle_gan-{hashlib.sha256(content).hexdigest()[:16]}"
    factory: Any = published_package("tactile_mnist.tactile_renderer.factory")
    if name not in factory.TACTILE_RENDERER_FACTORIES:
        kind = _renderer_class()
        factory.TACTILE_RENDERER_FACTORIES[name] = {
            "torch": lambda device: kind(generator_of(read), read.size_px, device)
        }
    return name


def _renderer_class() -> Any:
    """Return a renderer of the package, whose base class is imported with it."""
    base: Any = published_package("tactile_mnist.tactile_renderer.tactile_renderer_torch")

    class LearnedRenderer(base.TactileRendererTorch):  # type: ignore[misc]
        """Renders depth with a generator, in the size that it was trained with; the package does the rest."""

        def __init__(self, generator: Any, size_px: tuple[int, int], device: Any) -> None:
            super().__init__(channels=3, device=device)
            self._generator = generator.to(self.torch_device).eval()
            self._size_px = size_px

        def get_desired_depth_map_size(self, output_size: tuple[int, int]) -> tuple[int, int]:
            return self._size_px

        def _render_direct(self, depth: Any, output_size: tuple[int, int]) -> Any:
            import torch

            from tactile_sim.learned.networks import depth_channels
            from tactile_sim.pressing import depth_image
            from tactile_sim.sensor import as_environment

            shown = depth_image(depth.cpu().numpy(), as_environment(*self._size_px))
            with torch.inference_mode():
                # Generators end in tanh, -1 to 1; the package wants 0 to 1.
                return (self._generator(depth_channels(shown).to(self.torch_device)) + 1) / 2

    return LearnedRenderer
