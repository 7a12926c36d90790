"""Every published environment, and what it needs to run on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from typing import Any

from env_assets.missing import FOREIGN
from env_assets.published.environments import SPARSE_SINGLE_BROKEN, TOUCHES, takes_recorded_noise
from env_assets.published.ids import FAMILIES, PublishedEnvironment, published_environments
from env_assets.published.packages import published_package, require_sensor, sensor_factories
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import did_you_mean


@dataclass(frozen=True, slots=True)
class EnvironmentState:
    """One registered id.

    ``state`` is ``ready`` where the toolkit makes the assets, ``touches`` where recorded ones are fetched,
    ``meshes`` where the user gives some, ``sensor`` where packages are missing; ``note`` explains it.
    """

    id: str
    task: str
    split: str
    sensor: str
    assets: str
    sparse: bool
    state: str
    note: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def overview(words: Sequence[str] = ()) -> list[EnvironmentState]:
    """List the registered ids that hold all of these words, in the package's order.

    InputError: none does. MissingExtraError: the package is not installed.
    """
    published = published_environments()
    found = [each for each in published if set(words) <= {*each.spec.id.split("-")}]
    if not found:
        known = {word for each in published for word in each.spec.id.split("-")}
        strange = [word for word in words if word not in known]
        near = did_you_mean(strange[0], known) if strange else ""
        raise InputError(
            f"no environment has {' and '.join(map(repr, strange or words))} in its id{near}",
            next=f"choose "
            f"fewer words, or others such as {', '.join(FAMILIES)}, Depth, CycleGAN, DR, train or test",
        )
    return [_state(each) for each in found]


def _state(environment: PublishedEnvironment) -> EnvironmentState:
    family = environment.family
    sensor = str(environment.settings.get("sensor_type", "taxim"))
    state, note = "ready", ""
    if family.assets in FOREIGN:
        state = "meshes"
        note = (
            f"meshes: {family.assets} are {FOREIGN[family.assets]}; give env_assets.make(ID, assets=FOLDER) "
            "meshes of your own, or a provider with a place for them"
        )
    elif family.recorded or takes_recorded_noise(environment.settings):
        state = "touches"
        note = f"touches: recorded ones are read, from places={{{TOUCHES!r}: ...}} of the provider"
    lacking = None if family.recorded and sensor == "direct" else _lacking(sensor)
    if lacking:
        state, note = "sensor", f"sensor: {lacking}"
    if environment.sparse and version("ap_gym") in SPARSE_SINGLE_BROKEN:
        note = note or "sparse: give num_envs, ap-gym cannot reset a single one"
    return EnvironmentState(
        environment.spec.id,
        family.task,
        environment.split,
        sensor,
        TOUCHES if family.recorded else family.assets,
        environment.sparse,
        state,
        note,
    )


# Hundreds of ids share three sensors, and a failing import is tried again each time.
@cache
def _lacking(sensor: str) -> str:
    """State what a sensor lacks on this machine; empty where nothing is missing."""
    published_package("tactile_mnist")
    try:
        require_sensor(sensor, "auto", sensor_factories())
    except InputError as error:
        return str(error)
    return ""
