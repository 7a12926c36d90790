"""Training: from a set of ``tactile-sim pairs`` to the weights of both directions.

::

    training.json              settings, and which pairs
    checkpoint.pt              a SHA-256 digest, and everything that training changes; intact or absent
    depth_to_touch.npz         weights of both generators, in the published format
    touch_to_depth.npz
    losses.parquet             the log
    samples/step-0001000.png   sheets of images
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import msgspec
import numpy as np
import pyarrow as pa
import torch

from tactile_sim.learned import cyclegan
from tactile_sim.learned.cyclegan import Batches, by_taxim
from tactile_sim.learned.generators import (
    chosen_device,
    depth_channels,
    picture_channels,
    pictures_from,
    shades_of,
    weights_of,
    write_weights,
)
from tactile_sim.sets.data_cards import sheet_png
from tactile_sim.sets.pairs import SPLITS, Pairs
from tactile_sim.sets.round_plan import keyed_rng
from tactile_sim.sets.set_options import TrainConfig, TrainRun
from tactile_toolkit import errors, store
from tactile_toolkit.value_types import Float32, JsonDict, UInt8
from tactile_toolkit.wording import with_count

SETTINGS = "training.json"
TOUCH_WEIGHTS = "depth_to_touch.npz"
DEPTH_WEIGHTS = "touch_to_depth.npz"
_CHECKPOINT = "checkpoint.pt"
_DIGEST_BYTES = 32
_SAMPLES = 4


class _Settings(msgspec.Struct):
    config: JsonDict
    pairs: str


def claim(folder: store.DataFolder, config: TrainConfig, pairs: str, *, resume: bool) -> None:
    """Begin a training in a folder, or continue an existing one with the same settings."""
    folder.require_folder()
    settings = {"config": config.to_dict(), "pairs": pairs}
    if folder.exists(SETTINGS):
        existing = store.decode(folder.read_bytes(SETTINGS), _Settings, folder.address(SETTINGS))
        # Compared as they would be read back: tuples become lists.
        requested = json.loads(json.dumps(settings))
        stored = {**existing.config, "pairs": existing.pairs}
        for name, value in {**requested["config"], "pairs": requested["pairs"]}.items():
            if stored.get(name) != value:
                raise errors.SpecMismatchError(
                    f"{folder.address()!r} holds a training with other settings: {name} is "
                    f"{stored.get(name)!r:.60} there, {value!r:.60} was asked for; nothing was changed",
                    next="choose another folder (--out)",
                )
        folder.remove_temporaries()
        return
    others = [name for name in folder.names() if not store.is_hidden(name)]
    if resume or others:
        example = "".join(f" (found {name!r})" for name in others[:1])
        raise errors.InputError(
            f"{folder.address()!r} holds no training to continue{example}; nothing was changed",
            next=f"{'leave out --resume, and ' if resume else ''}choose an empty or new folder (--out)",
        )
    folder.write_bytes(SETTINGS, (json.dumps(settings, indent=1) + "\n").encode())


@contextmanager
def held(folder: store.DataFolder, process: Process) -> Iterator[None]:
    """Lock the folder, so that no other training writes there; BusyError if one does."""
    # Object stores have no locks; the other processes of torchrun belong to the first.
    if process.rank or not folder.is_local:
        yield
        return
    folder.require_folder()
    with folder.locked(patience_s=0):
        yield


@dataclass(frozen=True)
class Trained:
    """A finished training: its folder, the total number of steps, those of this run, and the last losses."""

    folder: str
    steps: int
    taken: int
    losses: dict[str, float]


def train(
    pairs: str,
    out: str | os.PathLike[str],
    config: TrainConfig | None = None,
    run: TrainRun | None = None,
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Trained:
    """Train both generators of a CycleGAN; the same call continues where a run was stopped.

    Parameters
    ----------
    pairs : str
        Folder of ``tactile-sim pairs``.
    out : str or path-like
        Folder for checkpoint, weights, log and sheets of images.
    config : TrainConfig, optional
        Settings; the defaults are for 256 x 256 pixels and a GPU.
    run : TrainRun, optional
        Device, and how the training is computed.
    on_progress : callable
        Called with the number of finished steps and the total.

    Returns
    -------
    Trained
        The folder, and the last losses.

    Raises
    ------
    InputError
        An argument cannot be used, or a package is not installed.
    BusyError
        Another training writes to the folder.
    SpecMismatchError, IntegrityError, StorageError, ToolkitError
        The folder holds a training with other settings; checkpoint or training set are damaged; the folder
        cannot be written; a loss is no longer finite. The last checkpoint stays.
    """
    config = config or TrainConfig()
    run = run or TrainRun()
    data = _trainable(pairs, config)
    folder = store.open_folder(os.fspath(out))
    with joined_processes(run) as process, held(folder, process):
        if process.rank == 0:
            claim(folder, config, data.fingerprint, resume=run.resume)
        process.wait()
        # After the folder is claimed: a refusal should not wait for networks to be built.
        model = cyclegan.CycleGan(config, process.device, compiled=run.compiled)
        training = _Training(config, data, folder, process, model, on_progress)
        return training.to_the_end(*training.restored())


def _trainable(pairs: str, config: TrainConfig) -> Pairs:
    """Open a training set; InputError if nothing can be learned from it with these settings."""
    data = Pairs.open(pairs)
    config.crop_px(data.size_px)
    for split, domain in zip(SPLITS, (data.depth, data.real), strict=True):
        if not domain.contact.any():
            raise errors.InputError(
                f"split {split!r} of {pairs!r} holds no image with contact, so that nothing can be learned "
                "from it",
                next="make pairs with a larger --count or a smaller --without-contact (`tactile-sim pairs`)",
            )
    if config.pretrain_steps:
        try:
            by_taxim(data)
        except errors.MissingExtraError as error:
            raise errors.InputError(
                f"{error}, or train without paired first steps: pretrain_steps = 0"
            ) from error
    return data


@dataclass(eq=False)
class _Training:
    """One process of a training, from its last checkpoint to its end."""

    config: TrainConfig
    data: Pairs
    folder: store.DataFolder
    process: Process
    model: cyclegan.CycleGan
    on_progress: Callable[[int, int], None]

    def to_the_end(self, first: int, log: list[list[float]]) -> Trained:
        """Take the remaining steps, from ``first`` on."""
        config = self.config
        self.on_progress(first, config.steps)
        sums = np.zeros(len(cyclegan.LOSSES))
        losses = dict.fromkeys(cyclegan.LOSSES, math.nan)
        since = first
        batches = Batches(self.data, config, self.process.rank)
        for step, batch in enumerate(batches.since(first), first):
            rng = keyed_rng(config.seed, step, self.process.rank, "pool")
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
        """Restore the checkpoint, if there is one; return the number of steps taken, and their log."""
        if not self.folder.exists(_CHECKPOINT):
            return 0, []
        stored = self.folder.read_bytes(_CHECKPOINT)
        checkpoint = self.folder.address(_CHECKPOINT)
        digest = stored[:_DIGEST_BYTES]
        content = stored[_DIGEST_BYTES:]
        again = "train again in another folder"
        if hashlib.sha256(content).digest() != digest:
            raise errors.IntegrityError(
                f"{checkpoint!r} is damaged: its content does not match its checksum", next=again
            )
        try:
            # weights_only: a checkpoint is data, and unpickling it must run no code.
            state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
            pools = state["pools"]
            step = int(state["step"])
            log = state["log"].tolist()
            if len(pools) == self.process.count:
                self.model.load_state(state, pools[self.process.rank])
        except torch.OutOfMemoryError:
            raise
        except Exception as error:  # torch raises many types for files of other programs
            # Only the first sentence: torch goes on to recommend running the code of the file.
            problem = str(error).partition(".")[0] or type(error).__name__
            raise errors.IntegrityError(
                f"{checkpoint!r} is not a checkpoint of this training ({problem}); expected one that "
                "`tactile-sim train` wrote with these settings",
                next=again,
            ) from error
        if len(pools) != self.process.count:
            raise errors.SpecMismatchError(
                f"{self.folder.address()!r} was trained by {with_count(len(pools), 'processes')}, and now "
                f"there are {self.process.count}; nothing was changed",
                next="start as many processes as before",
            )
        if self.process.rank == 0:
            # A kill may have come between the checkpoint and the files that follow from it.
            self._publish(step, state["log"])
        return step, log

    def _save(self, done: int, log: list[list[float]]) -> None:
        pools = [self.model.pool_state()] * self.process.count
        if self.process.count > 1:
            own = pools[0]
            torch.distributed.all_gather_object(pools, own)
        if self.process.rank == 0:
            lines = torch.tensor(log, dtype=torch.float64)
            stream = io.BytesIO()
            torch.save({**self.model.state(), "pools": pools, "step": done, "log": lines}, stream)
            content = stream.getvalue()
            self.folder.write_bytes(_CHECKPOINT, hashlib.sha256(content).digest() + content)
            self._publish(done, lines)
        self.process.wait()

    def _publish(self, done: int, log: torch.Tensor) -> None:
        """Write the files that follow from a checkpoint: weights, log and a sheet of images."""
        for name, direction in ((TOUCH_WEIGHTS, "touch"), (DEPTH_WEIGHTS, "depth")):
            weights = weights_of(self.model.networks[direction], self.data.size_px)
            write_weights(self.folder, name, weights)
        steps, *losses = log.numpy().T
        table = pa.table(
            [pa.array(steps.astype(np.int64)), *map(pa.array, losses)], names=["step", *cyclegan.LOSSES]
        )
        self.folder.write_bytes("losses.parquet", store.ParquetStyle(65_536).encode(table))
        self.folder.write_bytes(f"samples/step-{done:07d}.png", self._sheet())

    def _sheet(self) -> bytes:
        """Draw some images with contact of both kinds, generated from each other and back."""
        depth, touch = (
            domain.images(np.flatnonzero(domain.contact)[: 8 * _SAMPLES : 8])
            for domain in (self.data.depth, self.data.real)
        )
        networks = self.model.networks
        device = self.process.device
        coordinates = depth_channels(np.ones(touch.shape[:3], np.float32))[:, :2].to(device)
        with torch.inference_mode():
            made_touch = networks["touch"](depth_channels(depth).to(device))
            depth_again = networks["depth"](made_touch)
            made_depth = networks["depth"](picture_channels(touch).to(device))
            made_depth = torch.cat([coordinates, made_depth[:, 2:]], dim=1)
            touch_again = networks["touch"](made_depth)
        columns = [("depth", depth), ("made touch", self._touches(made_touch))]
        columns += [("depth again", self._depths(depth_again)), ("touch", touch)]
        columns += [("made depth", self._depths(made_depth)), ("touch again", self._touches(touch_again))]
        return sheet_png(columns)

    def _touches(self, channels: torch.Tensor) -> UInt8:
        return pictures_from(channels.float().cpu(), self.data.size_px)

    def _depths(self, channels: torch.Tensor) -> Float32:
        return np.asarray(shades_of(channels.float().cpu(), self.data.size_px)[:, 2].numpy())

    def _require_finite(self, losses: dict[str, float], done: int) -> None:
        wrong = [name for name, loss in losses.items() if not math.isfinite(loss)]
        if wrong:
            raise errors.ToolkitError(
                f"the loss {wrong[0]} is {losses[wrong[0]]} at step {done:,}: the loss diverged; the "
                "last checkpoint stays",
                next="train with a smaller learning rate in another folder",
            )


@dataclass(frozen=True)
class Process:
    """One of the processes of ``torchrun``: its number, how many there are, and its device."""

    rank: int
    count: int
    device: str

    def wait(self) -> None:
        """Wait for the other processes."""
        if self.count > 1:
            torch.distributed.barrier()


@contextmanager
def joined_processes(run: TrainRun) -> Iterator[Process]:
    """Choose a device, and join the other processes of ``torchrun`` if there are any."""
    # torchrun names each process by these variables.
    rank = int(os.environ.get("RANK", "0"))
    count = int(os.environ.get("WORLD_SIZE", "1"))
    chosen = chosen_device(run.device)
    if run.deterministic and chosen != "cpu":
        raise errors.InputError(
            "deterministic training runs on the CPU", next="use --device cpu, or leave out --deterministic"
        )
    if chosen == "cuda":
        chosen = f"cuda:{int(os.environ.get('LOCAL_RANK', '0'))}"
        torch.cuda.set_device(chosen)
    if count > 1:
        torch.distributed.init_process_group({"cpu": "gloo"}.get(chosen, "nccl"))
    process = Process(rank, count, chosen)
    try:
        with _determinism(deterministic=run.deterministic):
            yield process
        # The first process serves the store that the others use until they leave.
        process.wait()
    finally:
        if count > 1:
            torch.distributed.destroy_process_group()


@contextmanager
def _determinism(*, deterministic: bool) -> Iterator[None]:
    """Make PyTorch deterministic on one thread if requested, and restore its settings afterwards."""
    before = torch.are_deterministic_algorithms_enabled()
    threads = torch.get_num_threads()
    fills = torch.utils.deterministic.fill_uninitialized_memory
    torch.use_deterministic_algorithms(deterministic)
    if deterministic:
        # Uninitialized memory is never read; not filling it saves an eighth of the time.
        torch.utils.deterministic.fill_uninitialized_memory = False
        torch.set_num_threads(1)  # sums are divided among threads, and a run may continue on another machine
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before)
        torch.utils.deterministic.fill_uninitialized_memory = fills
        torch.set_num_threads(threads)
