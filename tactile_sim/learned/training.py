"""Training: from a set of ``tactile-sim pairs`` to the weights of both directions."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tactile_sim.learned.batches import Batches, by_taxim
from tactile_sim.learned.channels import depth_channels, picture_channels, shades_of
from tactile_sim.learned.checkpoints import (
    DEPTH_WEIGHTS,
    TOUCH_WEIGHTS,
    claim_folder,
    foreign_checkpoint,
    read_checkpoint,
    write_checkpoint,
    write_log,
)
from tactile_sim.learned.cyclegan import LOSSES, CycleGan
from tactile_sim.learned.networks import weights_of
from tactile_sim.learned.tensorboard import Events, require_tensorboard
from tactile_sim.learned.weights import write_weights
from tactile_sim.pairs.reading import Pairs
from tactile_sim.pairs.rows import SPLITS
from tactile_sim.plan import generator
from tactile_sim.sheets import sheet_png
from tactile_sim.spec import TrainConfig
from tactile_toolkit.errors import InputError, MissingExtraError, SpecMismatchError, ToolkitError
from tactile_toolkit.run.system import locked
from tactile_toolkit.store.folder import DataFolder

_SAMPLES = 4


@dataclass(frozen=True)
class Trained:
    """A training that came to its end: the folder, steps in all and in this run, and the last losses."""

    folder: str
    steps: int
    taken: int
    losses: dict[str, float]


@dataclass(frozen=True)
class _Place:
    """Which of the processes of ``torchrun`` this is, and where it computes."""

    rank: int
    count: int
    device: str


def train(
    pairs: str,
    out: str | os.PathLike[str],
    config: TrainConfig | None = None,
    *,
    device: str = "auto",
    deterministic: bool = False,
    resume: bool = False,
    compiled: bool = False,
    tensorboard: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Trained:
    """Train both generators of a CycleGAN; the same call continues where a run was stopped.

    Parameters
    ----------
    pairs : str
        Folder of ``tactile-sim pairs``.
    out : str or path-like
        Folder for checkpoint, weights, log and sheets.
    config : TrainConfig, optional
        Settings; the defaults are for 256 x 256 pixels and a GPU.
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"``: a GPU where there is one. Under ``torchrun`` each process takes
        a GPU of its own.
    deterministic : bool
        On one thread of the CPU: the same weights from every run on one machine, stopped or not. Refused on
        a GPU.
    resume : bool
        Refuse to begin: there must be a training to continue with.
    compiled : bool
        Compile the generators first, for GPUs.
    tensorboard : bool
        Write losses and sheets for TensorBoard too, into ``tensorboard/``.
    on_progress : callable
        Called with steps done and in all.

    Returns
    -------
    Trained

    Raises
    ------
    InputError
        What was given cannot be used: no training set, no GPU, crops that are too small, a folder where
        another training is at work, TensorBoard is asked for and not installed, or Taxim is not, which the
        pairs of the first steps come from (``start_steps``).
    SpecMismatchError
        The folder holds a training with other settings, or of another number of processes.
    IntegrityError
        The checkpoint or the training set is damaged.
    StorageError
        The folder cannot be written. The last checkpoint stays.
    ToolkitError
        The losses are not finite any more. The last checkpoint stays.
    """
    config = config or TrainConfig()
    data = Pairs.open(pairs)
    config.crop_px(data.size_px)
    for split, domain in zip(SPLITS, (data.depth, data.real), strict=True):
        if not domain.contact.any():
            raise InputError(
                f"split {split!r} of {pairs!r} holds no picture with contact, so that nothing can be learned "
                "of it",
                next="a larger --count or a smaller --without-contact of `tactile-sim pairs`",
            )
    if config.start_steps:
        try:
            by_taxim(data)
        except MissingExtraError as error:
            raise InputError(
                f"{error}, or leave out the pairs of the first steps: --start-steps 0"
            ) from error
    folder = DataFolder(os.fspath(out))
    if tensorboard:
        require_tensorboard(folder)
    with _processes(device, deterministic=deterministic) as place, _alone(folder, place):
        if place.rank == 0:
            claim_folder(folder, {"config": config.to_dict(), "pairs": data.identity}, resume=resume)
        _wait()
        # After the folder is claimed: a refusal should not wait for networks to be built.
        model = CycleGan(config, place.device, compiled=compiled)
        run = _Run(config, data, folder, place, model, on_progress)
        first, log = run.restored()
        with ExitStack() as stack:
            if tensorboard and place.rank == 0:
                run.events = stack.enter_context(closing(Events(folder, LOSSES, first)))
            return run.to_the_end(first, log)


@dataclass(eq=False)
class _Run:
    """One process of a training from where it stands to its end."""

    config: TrainConfig
    data: Pairs
    folder: DataFolder
    place: _Place
    model: CycleGan
    on_progress: Callable[[int, int], None]
    events: Events | None = None

    def to_the_end(self, first: int, log: list[list[float]]) -> Trained:
        """Take the steps from the first that is left."""
        config = self.config
        self.on_progress(first, config.steps)
        sums, losses = np.zeros(len(LOSSES)), dict.fromkeys(LOSSES, math.nan)
        since = first
        with Batches(self.data, config, self.place.rank) as batches:
            for step in range(first, config.steps):
                rng = generator(config.seed, step, self.place.rank, "pool")
                losses = self.model.step(step, batches.of(step), rng)
                sums += list(losses.values())
                done = step + 1
                self._require_finite(losses, done)
                saving = done % config.checkpoint_every == 0 or done == config.steps
                if saving or done % config.log_every == 0:
                    log.append([done, *(sums / (done - since))])
                    sums[:], since = 0, done
                if saving:
                    self._save(done, log)
                self.on_progress(done, config.steps)
        return Trained(self.folder.address(), config.steps, config.steps - first, losses)

    def restored(self) -> tuple[int, list[list[float]]]:
        """Take up the checkpoint, if there is one; return how many steps were taken, and their log."""
        state = read_checkpoint(self.folder)
        if state is None:
            return 0, []
        try:
            pools, step, log = state["pools"], int(state["step"]), state["log"].tolist()
            if len(pools) == self.place.count:
                self.model.load_state(state)
                self.model.load_pools(pools[self.place.rank])
        except torch.OutOfMemoryError:
            raise
        except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise foreign_checkpoint(self.folder, error) from error
        if len(pools) != self.place.count:
            raise SpecMismatchError(
                f"{self.folder.address()!r} was trained by {len(pools)} processes, and now there "
                f"are {self.place.count}; nothing was changed",
                next="as many processes as before",
            )
        if self.place.rank == 0:
            # A kill may have come between the checkpoint and what follows from it.
            self._publish(step, state["log"])
        return step, log

    def _save(self, done: int, log: list[list[float]]) -> None:
        pools = _gathered(self.model.pool_state(), self.place)
        if self.place.rank == 0:
            lines = torch.tensor(log, dtype=torch.float64)
            write_checkpoint(self.folder, {**self.model.state(), "pools": pools, "step": done, "log": lines})
            self._publish(done, lines)
        _wait()

    def _publish(self, done: int, log: Any) -> None:
        """Write what follows from a checkpoint: weights, log and a sheet."""
        for name, direction in ((TOUCH_WEIGHTS, "touch"), (DEPTH_WEIGHTS, "depth")):
            network: Any = self.model.networks[direction]
            write_weights(self.folder, name, weights_of(network, self.data.size_px))
        write_log(self.folder, LOSSES, log)
        sheet = self._sheet()
        self.folder.write_bytes(f"samples/step-{done:07d}.png", sheet)
        if self.events is not None:
            self.events.add(log, sheet)

    def _sheet(self) -> bytes:
        """Draw the first pictures with contact of both kinds, what becomes of them, and what comes back."""
        shown = {
            name: domain.images(np.flatnonzero(domain.contact)[: 8 * _SAMPLES : 8][:_SAMPLES])
            for name, domain in (("depth", self.data.depth), ("touch", self.data.real))
        }
        size = self.data.size_px
        columns: list[tuple[str, Any]] = []
        networks = self.model.networks
        start = {"depth": depth_channels(shown["depth"]), "touch": picture_channels(shown["touch"])}
        with torch.inference_mode():
            for name, other in (("depth", "touch"), ("touch", "depth")):
                made = networks[other](start[name].to(self.place.device))
                if other == "depth":
                    made = torch.cat([start["depth"][:, :2].to(made.device), made[:, 2:]], dim=1)
                back = networks[name](made)
                columns.append((f"{name}", shown[name]))
                columns.append((f"made {other}", _pictures(made, other, size)))
                columns.append((f"{name} again", _pictures(back, name, size)))
        return sheet_png(columns)

    def _require_finite(self, losses: dict[str, float], done: int) -> None:
        wrong = [name for name, loss in losses.items() if not math.isfinite(loss)]
        if wrong:
            raise ToolkitError(
                f"the loss {wrong[0]} is {losses[wrong[0]]} at step {done:,}: the loss diverged; the "
                "last checkpoint stays",
                next="a smaller learning rate in another folder",
            )


def _pictures(channels: Any, name: str, size_px: tuple[int, int]) -> Any:
    shades = shades_of(channels.float().cpu(), size_px)
    if name == "depth":
        return shades[:, 2].numpy()
    return np.rint(shades.permute(0, 2, 3, 1).numpy() * 255).astype(np.uint8)


@contextmanager
def _alone(folder: DataFolder, place: _Place) -> Iterator[None]:
    """Hold the folder, so that no other training writes there; InputError where one is at work."""
    # Object stores know no locks; the other processes of torchrun belong to the first.
    if place.rank or not folder.is_local:
        yield
        return
    folder.require_folder()
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(Path(folder.address()), patience_s=0))
        except BlockingIOError as error:
            raise InputError(
                f"another training is at work in {folder.address()!r}; nothing was changed",
                next="wait for it, or choose another folder (--out)",
            ) from error
        yield


@contextmanager
def _processes(device: str, *, deterministic: bool) -> Iterator[_Place]:
    """Find out where to compute, and join the other processes of ``torchrun`` where there are any."""
    # torchrun tells each process who it is by these variables.
    rank, count = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    chosen = _device(device)
    if deterministic and chosen != "cpu":
        raise InputError(
            "deterministic training runs on the CPU", next="--device cpu, or leave --deterministic away"
        )
    if chosen == "cuda":
        chosen = f"cuda:{int(os.environ.get('LOCAL_RANK', '0'))}"
        torch.cuda.set_device(chosen)
    before, threads = torch.are_deterministic_algorithms_enabled(), torch.get_num_threads()
    fills = torch.utils.deterministic.fill_uninitialized_memory
    torch.use_deterministic_algorithms(deterministic)
    if deterministic:
        torch.utils.deterministic.fill_uninitialized_memory = False  # nothing reads it; an eighth of the time
        torch.set_num_threads(1)  # sums are divided among threads, and a run may continue on another machine
    if count > 1:
        torch.distributed.init_process_group("nccl" if chosen != "cpu" else "gloo")
    try:
        yield _Place(rank, count, chosen)
    finally:
        torch.use_deterministic_algorithms(before)
        torch.utils.deterministic.fill_uninitialized_memory = fills
        torch.set_num_threads(threads)
        if count > 1:
            torch.distributed.destroy_process_group()


def _device(name: str) -> str:
    available = torch.cuda.is_available()
    if name == "auto":
        return "cuda" if available else "cpu"
    if name not in ("cpu", "cuda"):
        raise InputError(f"device is {name!r}; expected auto, cpu or cuda")
    if name == "cuda" and not available:
        raise InputError("device is 'cuda', but PyTorch finds no GPU here", next="--device cpu")
    return name


def _gathered(pools: dict[str, list[Any]], place: _Place) -> list[Any]:
    if place.count == 1:
        return [pools]
    found: list[Any] = [None] * place.count
    torch.distributed.all_gather_object(found, pools)
    return found


def _wait() -> None:
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        torch.distributed.barrier()
