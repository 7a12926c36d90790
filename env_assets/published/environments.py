"""Making the published environments on assets of the provider instead of the Hub's.

An environment is made from the package's own registration: its settings, classes and wrappers, of which only
the step that fetches data from the Hub is replaced. Nothing in the packages is patched. What an environment
consumes is fetched from the provider, and checked before the environment starts.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from importlib.metadata import version
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from env_assets.meshes import LazyMesh, MeshView, require_fitting_meshes
from env_assets.provider import FOREIGN, KINDS, AssetSource, meshes_at
from env_assets.published.packages import (
    CLASSES,
    SPARSE_SINGLE_BROKEN,
    TOUCHES,
    PublishedEnvironment,
    published_environment,
    published_package,
    require_drawing,
    require_sensor,
    takes_recorded_noise,
)
from tactile_sim import Pressable, center_view, render_touch
from tactile_toolkit import store
from tactile_toolkit.array_types import Float64
from tactile_toolkit.cache import cache_folder
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import refuse_unit


def make(
    env_id: str,
    *,
    provider: AssetSource | None = None,
    assets: Any = None,
    unit: str | None = None,
    num_envs: int | None = None,
    config: Mapping[str, Any] | None = None,
    renderer: str = "opengl",
    weights: str | Path | None = None,
    **options: Any,
) -> Any:
    """Make a published environment on the provider's assets, or on meshes of your own.

    Parameters
    ----------
    env_id : str
        Id of the package ``tactile-mnist``, such as ``"TactileMNIST-Depth-train-v0"``; see `env-assets list`.
    provider : AssetSource, optional
        Gives digits, scenes, the wrench and recorded touches, such as :class:`env_assets.AssetProvider`.
    assets : path, str or data set, optional
        Objects instead of the provider's: a folder of mesh files, one such file, a data set of meshes by
        folder or name on the Hub, an opened one, a list of records, or any ``tactile_mnist.MeshDataset``.
    unit : "mm", "cm", "m" or "in", optional
        Of mesh files that state none (STL, PLY, OBJ); millimetres by default.
    num_envs : int, optional
        How many to run side by side as one vector environment; a single environment by default.
    config : mapping, optional
        Settings that differ from those of the registration, such as ``{"perturb_object_pose": False}``.
    renderer : "opengl" or "fast"
        ``"fast"`` renders the touches of depth environments by :func:`tactile_sim.render_touch`.
    weights : str or path, optional
        Weights for the sensor of CycleGAN environments: ``depth_to_touch.npz`` of ``tactile-sim train``.
    **options
        Passed on to ``ap_gym.make`` or ``ap_gym.make_vec``, such as ``render_mode``.

    Returns
    -------
    ap_gym.BaseActivePerceptionEnv or ap_gym.BaseActivePerceptionVectorEnv

    Raises
    ------
    InputError, MissingExtraError, IntegrityError
        Something given does not fit the environment; packages are not installed; assets are damaged.
    """
    environment = published_environment(env_id)
    _require_number(environment, num_envs)
    own = dict(config or {})
    settings = {**environment.settings, **own}
    require_renderer(renderer, environment, settings, options)
    require_drawing()
    _require_settings(environment, own, settings)
    if weights is not None:
        own["sensor_type"] = learned_sensor(weights, environment, settings)
    fetch = _recorded if environment.family.recorded else _simulated
    spec = _registration(environment, fetch(environment, provider, settings, assets, unit), renderer)
    ap_gym = published_package("ap_gym")
    if num_envs is None:
        return ap_gym.make(spec, config=own, **options)
    return ap_gym.make_vec(spec, num_envs=num_envs, config=own, **options)


def _require_number(environment: PublishedEnvironment, num_envs: int | None) -> None:
    """Refuse a number of environments that cannot be run."""
    if num_envs is not None:
        if not isinstance(num_envs, (int, np.integer)) or num_envs < 1:
            raise InputError(
                f"num_envs is {num_envs!r}; expected an integer from 1 on, or None for a single one"
            )
    elif environment.sparse and version("ap_gym") in SPARSE_SINGLE_BROKEN:
        raise InputError(
            f"a single environment {environment.spec.id!r} cannot be reset: the wrapper of ap-gym "
            f"{version('ap_gym')} around it asks for a prediction that is not there",
            next="give num_envs=1",
        )


def _require_settings(
    environment: PublishedEnvironment, own: Mapping[str, Any], settings: Mapping[str, Any]
) -> None:
    """Refuse settings that the package's config class does not have, and a sensor that cannot run here."""
    kind = getattr(published_package("tactile_mnist"), environment.family.config)
    known = {field.name for field in dataclasses.fields(kind)} - {"dataset"}  # that is ours to give
    for name in own:
        if name not in known:
            raise InputError(f"no setting {name!r} in `config`; expected one of {', '.join(sorted(known))}")
    sensor = settings.get("sensor_type", kind.sensor_type)
    # Recorded touches need no sensor; there is nothing else to be had directly.
    if not (environment.family.recorded and sensor == "direct"):
        require_sensor(sensor, settings.get("sensor_backend", "auto"))


def _registration(environment: PublishedEnvironment, assets: Mapping[str, Any], renderer: str) -> Any:
    """Return the registration of an environment, with assets in place of those of the Hub."""
    # The module of the registrations is the one place of the package that names all of its environments.
    classes, ap_gym = published_package("tactile_mnist").registration, published_package("ap_gym")
    family = environment.family
    task, measured = CLASSES[family.task]

    # Plain functions: gymnasium copies registrations deeply, which would copy the assets of anything else.
    def creator(kind: str) -> Callable[..., Any]:
        settings_of = getattr(classes, family.config)
        run = getattr(classes, f"Tactile{'RealSnap' if family.recorded else ''}{task}{kind}Env")
        wrap = getattr(ap_gym, f"Active{measured}{kind}LogWrapper")
        sparsify = getattr(ap_gym, f"Sparsify{kind}Wrapper")

        def create(*, default_config: Mapping[str, Any], config: Mapping[str, Any], **options: Any) -> Any:
            made = run(settings_of(**{**default_config, **config, **assets}), **options)
            if renderer == "fast":
                render_fast(made)
            env = wrap(made)
            return sparsify(env) if environment.sparse else env

        return create

    return dataclasses.replace(
        environment.spec, entry_point=creator(""), vector_entry_point=creator("Vector")
    )


def _simulated(
    environment: PublishedEnvironment,
    provider: AssetSource | None,
    settings: dict[str, Any],
    own: Any,
    unit: str | None,
) -> dict[str, Any]:
    """Return the settings that hold the objects of an environment: the provider's, or the user's ``own``."""
    split = environment.split
    if not isinstance(own, (str, PathLike)):
        refuse_unit(unit, "what was given")
    if own is None:
        meshes = _meshes(environment, provider, split, settings)
    else:
        where = f"the given {type(own).__name__}"
        if isinstance(own, (str, PathLike)):
            where = f"{fspath(own)!r}, split {split!r},"
            own = meshes_at(own, split, unit)
        # Its points are read by its own code: what it does to a mesh is known to it alone. Ids there may be
        # text, so that the number of a point is its id here.
        if isinstance(own, published_package("tactile_mnist").MeshDataset):
            points = [
                LazyMesh(row, int(own[row].label), partial(_mesh_of_point, own, row))
                for row in range(len(own))
            ]
            own = MeshView(points, tuple(own.label_names))
        meshes = _fitting(environment, MeshView.of(own), None, where, settings)
    found = {"dataset": meshes, "smallest_dimension_up": False}
    if takes_recorded_noise(settings):
        rounds = _required(provider, environment).touches(TOUCHES, "train")
        folder = noise_folder(rounds, f"{TOUCHES!r}, split 'train',")
        found["sensor_noise"] = dataclasses.replace(
            settings["sensor_noise"], real_base_depth_dataset=str(folder)
        )
    return found


def _mesh_of_point(points: Sequence[Any], row: int) -> Any:
    return points[row].mesh


def _recorded(
    environment: PublishedEnvironment,
    provider: AssetSource | None,
    settings: dict[str, Any],
    own: Any,
    unit: str | None,
) -> dict[str, Any]:
    """Return the settings that hold the recorded touches of an environment, and what was touched."""
    from env_assets.published.datasets import as_touch_dataset

    split = environment.split
    if own is not None or unit is not None:
        raise InputError(
            f"{environment.spec.id!r} plays recorded touches, no objects can be given for them",
            next="leave `assets` out, and name the place of the touches in `places` of the provider",
        )
    source = _required(provider, environment)
    rounds, where = source.touches(TOUCHES, split), f"{TOUCHES!r}, split {split!r},"
    found = {"dataset": as_touch_dataset(rounds)}
    if not len(rounds):
        raise InputError(f"{where} holds no round", next="choose another split")
    # One touch at the start of an episode, and one more that must remain after the last step.
    count, steps = int(rounds.touch_counts[0]), settings.get("step_limit", 16)
    if count < steps + 2:
        raise InputError(
            f"{where} has rounds of {count} touches, an episode of {steps} steps needs {steps + 2}",
            next="give a smaller `step_limit` in `config`, or another data set",
        )
    if "mesh_dataset" not in settings:
        printed = _meshes(environment, source, f"printed_{split}", settings)
        unknown = np.setdiff1d(rounds.column("object_id"), printed.records.column("id"))
        if len(unknown):
            raise InputError(
                f"{where} holds touches of {len(unknown)} objects without a mesh, such as object "
                f"{unknown[0]}",
                next="give the printed digits (splits printed_train and printed_test of MNIST 3D)",
            )
        found["mesh_dataset"] = printed
    return found


def _required(provider: AssetSource | None, environment: PublishedEnvironment) -> AssetSource:
    if provider is None:
        given = "" if environment.family.recorded else ", or `assets`: a folder of meshes"
        raise InputError(
            f"no assets were given for {environment.spec.id!r}",
            next=f"give `provider`, such as env_assets.AssetProvider(){given}",
        )
    return provider


def _meshes(
    environment: PublishedEnvironment, provider: AssetSource | None, split: str, settings: Mapping[str, Any]
) -> Any:
    """Ask a provider for meshes; of what is not made here the source is named."""
    name = environment.family.assets
    where = f"{name!r}, split {split!r},"
    try:
        given = _required(provider, environment).meshes(name, split)
    except InputError as error:
        if name in FOREIGN:
            raise InputError(
                f"{error.what}; {name!r} are {FOREIGN[name]}",
                next="give `assets`, a folder of meshes of your own, or a `provider` with a place for them",
            ) from error
        raise
    if name in FOREIGN:  # of any number of classes, in any order
        return _fitting(environment, MeshView.of(given), None, where, settings)
    # A source other than ours may give a plain sequence of records, without names of classes.
    return _fitting(environment, MeshView.of(given, KINDS[name].class_names), name, where, settings)


def _fitting(
    environment: PublishedEnvironment,
    view: MeshView,
    kind: str | None,
    where: str,
    settings: Mapping[str, Any],
) -> Any:
    """Hand meshes that fit an environment to the package; those of a ``kind`` must be what its name says."""
    from env_assets.published.datasets import CELL_SIZE_M, as_mesh_dataset

    # The registration wants some objects turned: they arrive so, as its own turn fails.
    view = dataclasses.replace(view, flat=bool(settings.get("smallest_dimension_up", False)))
    require_fitting_meshes(view, KINDS.get(kind or ""), where, settings.get("cell_size", CELL_SIZE_M))
    # The package can scale no reward where all answers are the same.
    task, found = environment.family.task, ""
    if task == "classification" and len(view.label_names) < 2:
        found = "one class"
    elif task == "volume" and kind is None and len(np.unique(view.volumes_m3)) < 2:
        found = "meshes of one volume"
    if found:
        raise InputError(f"{where} has {found}; expected at least two", next="give more meshes")
    # The registration keeps the one mesh of a tool; all others are read again for each episode.
    return as_mesh_dataset(view, cache_size="full" if environment.family.assets == "wrench" else 0)


def noise_folder(rounds: Any, where: str) -> Path:
    """Return a folder with links to the files of touches, as the shards of a split ``train``.

    The noise of a ``-DR`` environment comes from touches by a name that ``datasets.load_dataset`` knows. The
    folder lies in the cache folder and is the same one for the same files, so that a program that remembers
    what it has read of it (as ``datasets`` does) need not read it again.
    """
    what = "touches with one image each in files on this machine"
    files = [shard.path for shard in rounds._table.shards]
    remote = [file for file in files if "://" in file]
    if remote or not len(rounds) or not hasattr(rounds.record_class, "sensor_image"):
        found = repr(remote[0]) if remote else "clips" if len(rounds) else "no round"
        raise InputError(
            f"{where} holds {found}; the noise of a -DR environment needs {what}",
            next="download such a data set and give its folder",
        )
    targets = [Path(file).resolve() for file in files]
    # Size and time as well: a link does not show that its file was written again.
    facts = [(str(target), target.stat().st_size, target.stat().st_mtime_ns) for target in targets]
    folder = cache_folder() / "linked" / hashlib.sha256(repr(facts).encode()).hexdigest()[:32]
    with store.named_failures(str(folder)):
        for number, target in enumerate(targets):
            link = folder / store.ShardName("train", number, len(targets)).data_path
            link.parent.mkdir(parents=True, exist_ok=True)
            # One folder for each list of files, so a link that is there is the right one.
            with contextlib.suppress(FileExistsError):
                link.symlink_to(target)
    return folder


def require_renderer(
    renderer: str, environment: PublishedEnvironment, settings: Mapping[str, Any], options: Mapping[str, Any]
) -> None:
    """Refuse a renderer that is unknown, or does not fit the environment (InputError)."""
    if renderer not in ("opengl", "fast"):
        raise InputError(f"renderer is {renderer!r}; expected one of opengl, fast")
    if renderer == "fast":
        _require_sensor("renderer 'fast' does", environment, settings, "depth", "numpy")
        if environment.family.recorded or options.get("render_mode") == "human":
            raise InputError(
                "renderer 'fast' does not apply to recorded touches, nor to a viewer", next="leave it away"
            )


def _require_sensor(
    what: str, environment: PublishedEnvironment, settings: Mapping[str, Any], sensor: str, backend: str
) -> None:
    """Refuse what applies to environments with one sensor only (InputError)."""
    found = settings.get("sensor_type", "taxim"), settings.get("sensor_backend", "auto")
    if found not in ((sensor, "auto"), (sensor, backend)):
        raise InputError(
            f"{what} not apply to {environment.spec.id!r}: its sensor is {found[0]!r}, backend {found[1]!r}; "
            f"expected {sensor!r} with {backend!r}",
            next="leave it away, or choose another environment",
        )


def render_fast(env: Any) -> None:
    """Give an environment that was just made the fast renderer."""
    inner = getattr(env, "vector_env", env).unwrapped  # a single environment is one of several
    inner._renderer.__class__ = _fast_renderer()
    width, height = inner.single_observation_space["sensor_img"].shape[1::-1]
    across_m, up_m = map(float, inner.config.cell_size)
    inner._renderer.press_instead(inner.num_envs, center_view(width, height), (across_m, up_m))


@cache
def _fast_renderer() -> Any:
    """Return the package's renderer with `press` for touches; imports the package."""
    base: Any = published_package("tactile_mnist.tactile_perception_renderer").TactilePerceptionRenderer

    class FastRenderer(base):  # type: ignore[misc]
        """Draws the scene with OpenGL, and renders touches without.

        The scene hears of objects and poses when a picture of it is asked for, since keeping it up to date
        takes longer than rendering a touch.
        """

        def press_instead(self, count: int, sensor: Any, cell_m: tuple[float, float]) -> None:
            self._sensor, self._cell_m = sensor, cell_m
            self._poses = np.tile(np.eye(4), (count, 1, 1))
            self._points: tuple[Any, ...] = ()
            self._solids: dict[int, tuple[Any, Pressable]] = {}
            self._shadows: Any = None

        @property
        def objects(self) -> tuple[Any, ...]:
            return self._points

        @objects.setter
        def objects(self, points: Iterable[Any]) -> None:
            self._points = tuple(points)
            # One environment that resets gives the objects of all next to it again, which are prepared
            # already. Whether meshes are closed was found out before the environment started.
            held, meshes = self._solids, [point.mesh for point in self._points]
            self._solids = {
                id(mesh): held.get(id(mesh)) or (mesh, Pressable.of(mesh, check=False)) for mesh in meshes
            }

        def set_object_poses(self, new_object_poses: Any, mask: Sequence[bool] | None = None) -> None:
            chosen = np.ones(len(self._poses), bool) if mask is None else np.asarray(mask, bool)
            self._poses = np.where(chosen[:, None, None], new_object_poses.matrix, self._poses)

        def update_shadow_objects(self, *poses: Any, **looks: Any) -> None:
            self._shadows = poses, looks

        def render_sensor_depths(self, virtual_sensor_poses: Any = None) -> Float64:
            """Return the distance of the surface from the target of each sensor, (n, H, W), metres."""
            targets = (self.sensor_poses if virtual_sensor_poses is None else virtual_sensor_poses).matrix
            solids = [self._solids[id(point.mesh)][1] for point in self._points]
            pressed = render_touch(solids, self._poses, targets, self._sensor, cell_m=self._cell_m)
            # `press` measures from where the sensor stopped, the package from where it was to go.
            travel_m = (pressed.sensor_z_m - targets[:, 2, 3]) / targets[:, 2, 2]
            return np.asarray(pressed.depth_m - travel_m[:, None, None])

        def render_external_cameras(self) -> Any:
            if self._points is not super().objects:
                base.objects.fset(self, self._points)
            transformation = published_package("transformation").Transformation
            super().set_object_poses(transformation.from_matrix(self._poses))
            if self._shadows is not None:
                super().update_shadow_objects(*self._shadows[0], **self._shadows[1])
            return super().render_external_cameras()

    return FastRenderer


def learned_sensor(
    weights: str | Path, environment: PublishedEnvironment, settings: Mapping[str, Any]
) -> str:
    """Enter weights into the package's table of sensors; return the name of the sensor.

    The package itself knows only the weights that it ships. InputError where the environment has another
    sensor, or the file holds no weights.
    """
    _require_sensor("weights do", environment, settings, "cycle_gan", "torch")
    from tactile_sim.learned.weights import generator_of, read_weights

    read = read_weights(weights)
    # Named by its content: environments of two files of one name must not share a sensor, which the package
    # looks up by its name alone.
    name = f"cycle_gan-{hashlib.sha256(store.expanded(weights).read_bytes()).hexdigest()[:16]}"
    kind = _learned_renderer()
    factory: Any = published_package("tactile_mnist.tactile_renderer.factory")
    factory.TACTILE_RENDERER_FACTORIES[name] = {
        "torch": lambda device: kind(generator_of(read), read.size_px, device)
    }
    return name


@cache
def _learned_renderer() -> Any:
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

            from tactile_sim.learned.channels import depth_channels
            from tactile_sim.pressing import depth_image

            shown = depth_image(depth.cpu().numpy(), center_view(*self._size_px))
            with torch.inference_mode():
                # Generators end in tanh, -1 to 1; the package wants 0 to 1.
                return (self._generator(depth_channels(shown).to(self.torch_device)) + 1) / 2

    return LearnedRenderer
