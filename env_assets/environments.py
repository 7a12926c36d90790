"""Making the published environments on assets of the provider instead of the Hub's.

An environment is made from the package's own registration: its settings, classes and wrappers, of which only
the step that fetches data from the Hub is replaced. Nothing in the packages is patched.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from env_assets.environment_assets import assets_for
from env_assets.environment_checks import refuse_unknown_settings
from env_assets.environment_ids import PublishedEnvironment, published_environment
from env_assets.environment_packages import published_package, require_screenless_drawing
from env_assets.environment_sensors import require_sensor, sensor_factories
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from env_assets.source import AssetSource

__all__ = ["make"]

_SPARSE_SINGLE_BROKEN = ("0.7.1",)
"""Versions of ap-gym whose own wrapper for sparse rewards fails with a single environment."""


def make(
    env_id: str,
    *,
    provider: AssetSource,
    num_envs: int | None = None,
    config: Mapping[str, Any] | None = None,
    **options: Any,
) -> Any:
    """Make a published environment on the provider's assets.

    Parameters
    ----------
    env_id : str
        Id under which the package ``tactile-mnist`` registers it, such as ``"TactileMNIST-Depth-train-v0"``.
        ``train`` or ``test`` in it chooses the split, ``Depth``, ``CycleGAN`` or (for Taxim) neither the
        sensor.
    provider : AssetSource
        Gives ``"mnist3d"``, ``"starstruck"``, ``"wrench"`` and, for recorded touches, ``"real-single"``; the
        ``places`` of an :class:`env_assets.AssetProvider` say what these names stand for.
    num_envs : int, optional
        How many to run side by side as one vector environment; a single environment by default, which ids
        with ``-sparse-`` do not have in ap-gym 0.7.1 (its wrapper fails at the first reset): give 1.
    config : mapping, optional
        Settings that differ from those of the registration, by the names of ``TactilePerceptionConfig`` or
        ``TactileRealSnapConfig``, such as ``{"perturb_object_pose": False}``.
    **options
        Passed on to ``ap_gym.make`` or ``ap_gym.make_vec``, such as ``render_mode``.

    Returns
    -------
    ap_gym.BaseActivePerceptionEnv or ap_gym.BaseActivePerceptionVectorEnv
        The same object that ``ap_gym.make`` gives, with ``spec`` and wrappers.

    Raises
    ------
    InputError
        No such environment, number of them or setting; assets that are absent or do not fit it.
    MissingExtraError
        The packages of the extra ``env``, or those of the sensor asked for, are not installed.
    IntegrityError
        Assets are damaged.

    Examples
    --------
    >>> provider = env_assets.AssetProvider("assets", generate=True)  # doctest: +SKIP
    >>> env = env_assets.make("TactileMNIST-Depth-train-v0", provider=provider, num_envs=4)  # doctest: +SKIP
    >>> observation, info = env.reset(seed=0)  # doctest: +SKIP
    """
    environment = published_environment(env_id)
    _require_number(environment, num_envs)
    own = dict(config or {})
    settings = {**environment.settings, **own}
    _require_fitting_place(environment, own, settings)
    assets = assets_for(environment, provider, settings)
    spec = dataclasses.replace(
        environment.spec,
        entry_point=_creator(environment, assets, vector=False),
        vector_entry_point=_creator(environment, assets, vector=True),
    )
    ap_gym = published_package("ap_gym")
    if num_envs is None:
        return ap_gym.make(spec, config=own, **options)
    return ap_gym.make_vec(spec, num_envs=num_envs, config=own, **options)


def _require_number(environment: PublishedEnvironment, num_envs: int | None) -> None:
    """Refuse a number of environments that cannot be run."""
    if num_envs is not None:
        if not isinstance(num_envs, (int, np.integer)) or num_envs < 1:
            message = f"num_envs is {num_envs!r}; expected a whole number from 1 on, or None for a single one"
            raise InputError(message)
    elif environment.sparse and version("ap_gym") in _SPARSE_SINGLE_BROKEN:
        message = (
            f"a single environment {environment.spec.id!r} cannot be reset: the wrapper of ap-gym "
            f"{version('ap_gym')} around it asks for a prediction that is not there; next: give num_envs=1"
        )
        raise InputError(message)


def _require_fitting_place(
    environment: PublishedEnvironment, own: Mapping[str, Any], settings: Mapping[str, Any]
) -> None:
    """Refuse settings, sensors and a machine on which the environment could not start."""
    require_screenless_drawing()
    kind = getattr(published_package("tactile_mnist"), environment.family.config)
    refuse_unknown_settings(own, tuple(field.name for field in dataclasses.fields(kind)))
    sensor = settings.get("sensor_type", kind.sensor_type)
    # Recorded touches need no sensor; there is nothing else to be had directly.
    if not (environment.family.recorded and sensor == "direct"):
        require_sensor(sensor, settings.get("sensor_backend", "auto"), sensor_factories())


def _creator(
    environment: PublishedEnvironment, assets: Mapping[str, Any], *, vector: bool
) -> Callable[..., Any]:
    """Return what gymnasium calls in place of the registered entry point.

    A plain function: gymnasium copies registrations deeply, which would copy the assets of anything else.
    """
    # The module of the registrations is the one place of the package that names all of its environments.
    classes, ap_gym = published_package("tactile_mnist").registration, published_package("ap_gym")
    family, kind = environment.family, "Vector" if vector else ""
    settings_of = getattr(classes, family.config)
    run = getattr(classes, family.environment.format(kind))
    wrap = getattr(ap_gym, family.log_wrapper.format(kind))
    sparsify = getattr(ap_gym, f"Sparsify{kind}Wrapper")

    def create(*, default_config: Mapping[str, Any], config: Mapping[str, Any], **options: Any) -> Any:
        env = wrap(run(settings_of(**{**default_config, **assets, **config}), **options))
        return sparsify(env) if environment.sparse else env

    return create
