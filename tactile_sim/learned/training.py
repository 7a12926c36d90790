"""Training: from a set of ``tactile-sim pairs`` to the weights of both directions.

::

    training.json              settings, and which pairs
    checkpoint.pt              a SHA-256 digest and the state of everything; intact or absent
    depth_to_touch.npz         weights of both generators, in the published format
    touch_to_depth.npz
    losses.parquet             the log
    samples/step-0001000.png   sheets of pictures
    tensorboard/               the log again, if asked for
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import torch

from tactile_sim.card import sheet_png
from tactile_sim.learned.cyclegan import LOSSES, Batches, CycleGan, by_taxim
from tactile_sim.learned.networks import (
    depth_channels,
    picture_channels,
    pictures_of,
    shades_of,
    weights_of,
    write_weights,
)
from tactile_sim.pairs import SPLITS, Pairs
from tactile_sim.plan import generator
from tactile_sim.spec import TrainConfig
from tactile_toolkit.errors import (
    InputError,
    IntegrityError,
    MissingExtraError,
    SpecMismatchError,
    ToolkitError,
)
from tactile_toolkit.store import DataFolder, ParquetStyle, decode, encode_parquet, is_hidden, open_folder
from tactile_toolkit.touch import decode_image

TOUCH_WEIGHTS = "depth_to_touch.npz"
DEPTH_WEIGHTS = "touch_to_depth.npz"
_SETTINGS = "training.json"
_CHECKPOINT = "checkpoint.pt"
_DIGEST_BYTES = 32
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

    def wait(self) -> None:
        """Wait for the other processes."""
        if self.count > 1:
            torch.distributed.barrier()


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

    Raises
    ------
    InputError
        What was given cannot be used, or a package is missing that it needs.
    SpecMismatchError, IntegrityError, StorageError, ToolkitError
        The folder holds a training with other settings; checkpoint or training set are damaged; the folder
        cannot be written; the losses are not finite any more. The last checkpoint stays.
    """
    config, data, folder = config or TrainConfig(), Pairs.open(pairs), open_folder(os.fspath(out))
    _require_trainable(pairs, data, config)
    if tensorboard:
        _require_tensorboard(folder)
    with _processes(device, deterministic=deterministic) as place, _locked(folder, place):
        if place.rank == 0:
            _claim(folder, {"config": config.to_dict(), "pairs": data.identity}, resume=resume)
        place.wait()
        # After the folder is claimed: a refusal should not wait for networks to be built.
        model = CycleGan(config, place.device, compiled=compiled)
        run = _Run(config, data, folder, place, model, on_progress)
        first, log = run.restored()
        is_logged = tensorboard and place.rank == 0
        with closing(_Events(folder, first)) if is_logged else nullcontext() as run.events:
            return run.to_the_end(first, log)


def _require_trainable(pairs: str, data: Pairs, config: TrainConfig) -> None:
    config.crop_px(data.size_px)
    for split, domain in zip(SPLITS, (data.depth, data.real), strict=True):
        if not domain.contact.any():
            raise InputError(
                f"split {split!r} of {pairs!r} holds no picture with contact, so that nothing can be learned "
                "of it",
                next="a larger --count or a smaller --without-contact of `tactile-sim pairs`",
            )
    if config.pretrain_steps:
        try:
            by_taxim(data)
        except MissingExtraError as error:
            raise InputError(
                f"{error}, or leave out the pairs of the first steps: pretrain_steps = 0"
            ) from error


def _require_tensorboard(folder: DataFolder) -> None:
    if find_spec("tensorboard") is None:
        raise InputError(
            "--tensorboard needs the package 'tensorboard', which is not installed",
            next="pip install tensorboard, or leave it away: losses.parquet and samples/ hold the same",
        )
    if not folder.is_local:
        raise InputError(f"--tensorboard writes to local folders only, not to {folder.address()!r}")


class _Events:
    """Writes for TensorBoard what checkpoints hold; what a stopped run wrote after its own is taken back."""

    def __init__(self, folder: DataFolder, first: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._written = first
        self._writer: Any = SummaryWriter(folder.address("tensorboard"), purge_step=first + 1)

    def add(self, log: Any, sheet: bytes) -> None:
        """Write the lines of the log that are new, and the sheet of its last step."""
        for step, *losses in log.tolist():
            for name, loss in zip(LOSSES, losses, strict=True) if step > self._written else ():
                self._writer.add_scalar(f"losses/{name}", loss, int(step))
        self._written = int(log[-1, 0])
        self._writer.add_image("samples", decode_image(sheet), self._written, dataformats="HWC")
        self._writer.flush()

    def close(self) -> None:
        """End the file."""
        self._writer.close()


class _Settings(msgspec.Struct):
    config: dict[str, Any]
    pairs: str


def _claim(folder: DataFolder, settings: Mapping[str, Any], *, resume: bool) -> None:
    """Make a folder that of a training, or take up the one that is there, of the same settings."""
    folder.require_folder()
    if folder.exists(_SETTINGS):
        there = decode(folder.read_bytes(_SETTINGS), _Settings, folder.address(_SETTINGS))
        # As they would be read back: tuples become lists.
        wanted = json.loads(json.dumps(settings))
        found = {**there.config, "pairs": there.pairs}
        for name, value in {**wanted["config"], "pairs": wanted["pairs"]}.items():
            if found.get(name) != value:
                raise SpecMismatchError(
                    f"{folder.address()!r} holds a training with other settings: {name} is "
                    f"{found.get(name)!r:.60} there, {value!r:.60} was asked for; nothing was changed",
                    next="choose another folder (--out)",
                )
        folder.remove_temporaries()
        return
    others = [name for name in folder.names() if not is_hidden(name)]
    if resume or others:
        held = f" (found {others[0]!r})" if others else ""
        raise InputError(
            f"{folder.address()!r} holds no training to continue with{held}; nothing was changed",
            next="leave --resume away, and choose an empty or new folder (--out)",
        )
    folder.write_bytes(_SETTINGS, (json.dumps(settings, indent=1) + "\n").encode())


@dataclass(eq=False)
class _Run:
    """One process of a training from where it stands to its end."""

    config: TrainConfig
    data: Pairs
    folder: DataFolder
    place: _Place
    model: CycleGan
    on_progress: Callable[[int, int], None]
    events: _Events | None = None

    def to_the_end(self, first: int, log: list[list[float]]) -> Trained:
        """Take the steps from the first that is left."""
        config = self.config
        self.on_progress(first, config.steps)
        sums, losses = np.zeros(len(LOSSES)), dict.fromkeys(LOSSES, math.nan)
        since = first
        batches = Batches(self.data, config, self.place.rank)
        for step, batch in enumerate(batches.since(first), first):
            rng = generator(config.seed, step, self.place.rank, "pool")
            losses = self.model.step(step, batch, rng)
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
        if not self.folder.exists(_CHECKPOINT):
            return 0, []
        stored, where = self.folder.read_bytes(_CHECKPOINT), self.folder.address(_CHECKPOINT)
        digest, content = stored[:_DIGEST_BYTES], stored[_DIGEST_BYTES:]
        again = "train again in another folder"
        if hashlib.sha256(content).digest() != digest:
            raise IntegrityError(f"{where!r} is damaged: its content does not match its checksum", next=again)
        try:
            # weights_only: a checkpoint is data, and unpickling it must run no code.
            state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
            pools, step, log = state["pools"], int(state["step"]), state["log"].tolist()
            if len(pools) == self.place.count:
                self.model.load_state(state, pools[self.place.rank])
        except torch.OutOfMemoryError:
            raise
        except Exception as error:  # whatever the file of another program runs into
            # The first sentence: torch continues with advice to run the code of the file.
            problem = str(error).partition(".")[0] or type(error).__name__
            raise IntegrityError(
                f"{where!r} is not a checkpoint of this training ({problem}); expected one that "
                "`tactile-sim train` wrote with these settings",
                next=again,
            ) from error
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
        pools: list[Any] = [self.model.pool_state()]
        if self.place.count > 1:
            own, pools = pools[0], [None] * self.place.count
            torch.distributed.all_gather_object(pools, own)
        if self.place.rank == 0:
            lines, stream = torch.tensor(log, dtype=torch.float64), io.BytesIO()
            torch.save({**self.model.state(), "pools": pools, "step": done, "log": lines}, stream)
            content = stream.getvalue()
            self.folder.write_bytes(_CHECKPOINT, hashlib.sha256(content).digest() + content)
            self._publish(done, lines)
        self.place.wait()

    def _publish(self, done: int, log: Any) -> None:
        """Write what follows from a checkpoint: weights, log and a sheet."""
        for name, direction in ((TOUCH_WEIGHTS, "touch"), (DEPTH_WEIGHTS, "depth")):
            network: Any = self.model.networks[direction]
            write_weights(self.folder, name, weights_of(network, self.data.size_px))
        steps, *losses = log.numpy().T
        table = pa.table([pa.array(steps.astype(np.int64)), *map(pa.array, losses)], names=["step", *LOSSES])
        self.folder.write_bytes("losses.parquet", encode_parquet(table, ParquetStyle(65_536)))
        sheet = self._sheet()
        self.folder.write_bytes(f"samples/step-{done:07d}.png", sheet)
        if self.events is not None:
            self.events.add(log, sheet)

    def _sheet(self) -> bytes:
        """Draw the first pictures with contact of both kinds, what becomes of them, and what comes back."""
        depth, touch = (
            domain.images(np.flatnonzero(domain.contact)[: 8 * _SAMPLES : 8][:_SAMPLES])
            for domain in (self.data.depth, self.data.real)
        )
        networks, device = self.model.networks, self.place.device
        where = depth_channels(np.ones(touch.shape[:3], np.float32))[:, :2].to(device)
        with torch.inference_mode():
            made_touch = networks["touch"](depth_channels(depth).to(device))
            depth_again = networks["depth"](made_touch)
            made_depth = networks["depth"](picture_channels(touch).to(device))
            made_depth = torch.cat([where, made_depth[:, 2:]], dim=1)
            touch_again = networks["touch"](made_depth)
        columns = [("depth", depth), ("made touch", self._touches(made_touch))]
        columns += [("depth again", self._depths(depth_again)), ("touch", touch)]
        columns += [("made depth", self._depths(made_depth)), ("touch again", self._touches(touch_again))]
        return sheet_png(columns)

    def _touches(self, channels: Any) -> Any:
        return pictures_of(channels.float().cpu(), self.data.size_px)

    def _depths(self, channels: Any) -> Any:
        return shades_of(channels.float().cpu(), self.data.size_px)[:, 2].numpy()

    def _require_finite(self, losses: dict[str, float], done: int) -> None:
        wrong = [name for name, loss in losses.items() if not math.isfinite(loss)]
        if wrong:
            raise ToolkitError(
                f"the loss {wrong[0]} is {losses[wrong[0]]} at step {done:,}: the loss diverged; the "
                "last checkpoint stays",
                next="a smaller learning rate in another folder",
            )


@contextmanager
def _locked(folder: DataFolder, place: _Place) -> Iterator[None]:
    """Hold the folder, so that no other training writes there; BusyError where one is at work."""
    # Object stores know no locks; the other processes of torchrun belong to the first.
    if place.rank or not folder.is_local:
        yield
        return
    folder.require_folder()
    with folder.locked(patience_s=0):
        yield


@contextmanager
def _processes(device: str, *, deterministic: bool) -> Iterator[_Place]:
    """Find out where to compute, and join the other processes of ``torchrun`` where there are any."""
    # torchrun names each process by these variables.
    rank, count = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    chosen = chosen_device(device)
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


def chosen_device(name: str) -> str:
    """Return ``"cpu"`` or ``"cuda"``; InputError for other words, and where there is no GPU."""
    available = torch.cuda.is_available()
    if name == "auto":
        return "cuda" if available else "cpu"
    if name not in ("cpu", "cuda"):
        raise InputError(f"device is {name!r}; expected auto, cpu or cuda")
    if name == "cuda" and not available:
        raise InputError("device is 'cuda', but PyTorch finds no GPU here", next="--device cpu")
    return name
