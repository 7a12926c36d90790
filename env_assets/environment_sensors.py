"""Which sensors can run here: those whose packages are installed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from env_assets.environment_packages import published_package
from tactile_toolkit.errors import InputError, MissingExtraError

__all__ = ["BACKENDS", "require_sensor", "sensor_factories"]

BACKENDS = {"depth": ("numpy", "jax", "torch"), "taxim": ("jax", "torch"), "cycle_gan": ("jax", "torch")}
"""Sensors of tactile-mnist 0.13.0 and what may compute them; the weights of ``cycle_gan`` come with it."""

_EXTRAS = {"jax": "env", "taxim": "env", "torch": "torch", "torchvision": "torch"}
"""Which extra of this toolkit installs a package that a sensor needs."""


def require_sensor(sensor: str, backend: str, factories: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse a sensor whose packages are not installed.

    Parameters
    ----------
    sensor : str
        A key of :data:`BACKENDS`.
    backend : str
        One of its backends, or ``"auto"``.
    factories : mapping
        The package's table: for each sensor and backend, what makes it, or what stands there where an import
        failed; backends that are not installed at all are absent.

    Raises
    ------
    InputError
        No such sensor, or none with this backend.
    MissingExtraError
        A package that it needs is not installed.
    """
    if sensor not in BACKENDS or backend not in ("auto", *BACKENDS[sensor]):
        choice = "; ".join(f"{name}: auto, {', '.join(of)}" for name, of in BACKENDS.items())
        message = f"no sensor {sensor!r} with backend {backend!r}; expected one of these ({choice})"
        raise InputError(message)
    chosen = [name for name in BACKENDS[sensor] if backend in (name, "auto")]
    missing = [_missing_module(name, factories.get(sensor, {})) for name in chosen]
    if None not in missing:
        feature = f"the sensor {sensor!r} with backend {backend!r}"
        raise _lacking(feature, str(missing[0]))


def _missing_module(backend: str, makers: Mapping[str, Any]) -> str | None:
    if backend not in makers:
        return backend
    module: str | None = getattr(makers[backend], "missing_module", None)
    return module


def _lacking(feature: str, module: str) -> InputError:
    if module in _EXTRAS:
        return MissingExtraError(feature, module, _EXTRAS[module])
    return InputError(
        f"{feature} needs the package {module!r}, which is not installed and which no extra of this toolkit "
        "brings; next: install it, or choose another `sensor_backend` in `config`"
    )


def sensor_factories() -> Mapping[str, Mapping[str, Any]]:
    """Return the package's table of sensors, backends and what makes them."""
    published_package("tactile_mnist")
    factory: Any = published_package("tactile_mnist.tactile_renderer.factory")
    table: Mapping[str, Mapping[str, Any]] = factory.TACTILE_RENDERER_FACTORIES
    return table
