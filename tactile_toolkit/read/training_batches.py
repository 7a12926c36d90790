"""Batches for training with torch (extra ``torch``), in one order for all ranks and workers, resumable.

The order itself is :mod:`tactile_toolkit.read.order`.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tactile_toolkit import checked_fields, errors
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.read.order import GlobalOrder, Prefetcher, RankSampler
from tactile_toolkit.value_types import JsonDict, JsonObject

if TYPE_CHECKING:
    import torch
else:
    with errors.needs_extra("training on a data set", "torch", "torch"):
        import torch


_FORMAT = "tactile_toolkit_training"
_VERSION = 1
# Name in torchdata 0.11 of the number of batches since a StatefulDataLoader asked its workers.
_SINCE = "_steps_since_snapshot"
# State of a pass in one process: epoch, first item, and number of batches since.
_POSITION = ("epoch", "start", "batches")
# The table that workers share is created before their number is known.
_MAX_WORKERS = 255


def shared_zeros(*shape: int) -> torch.Tensor:
    """Return zeros, int64, shared by the workers of a loader."""
    zeros = torch.zeros(shape, dtype=torch.int64)
    # Without shared memory, loaders with workers fail; others do not need it.
    with contextlib.suppress(RuntimeError):
        zeros.share_memory_()
    return zeros


class TrainingBatches(torch.utils.data.IterableDataset):  # type: ignore[misc]
    """Batches of a data set for a training job, in one order for all ranks and workers, resumable.

    Each pass is one epoch: all items once, shards in random order, and items in random order within a few
    shards at a time. The order depends only on the seed, the number of the epoch and the data set. Rank r of
    n takes every n-th item, and all ranks get equally many. The batches of a rank do not depend on its number
    of workers. The state of any rank can therefore be resumed on any number of ranks and workers, within an
    epoch, without omitting or repeating an item.

    Pass it to ``DataLoader`` of torch or ``StatefulDataLoader`` of torchdata with ``batch_size=None``.

    Parameters
    ----------
    data : TouchTensors, SolidTensors, or a data set
        Source of the items. Records (rounds, touches, digits, scenes) need a ``collate_fn``.
    batch_size : int
        Items in a batch of each rank.
    seed : int or None
        Seed of the order; None for the stored order.
    window : int
        Number of shards that are shuffled together. Twice as many, those of this window and the next, are
        unpacked on disk at a time; see Notes.
    drop_last : bool
        Leave out items that do not make a complete batch for every rank. Otherwise the last batch is smaller,
        and some ranks may get one of the first items of the epoch again, so that all have equally many steps.
    collate_fn : callable, optional
        Makes a batch from a list of items: ``torch.utils.data.default_collate`` by default,
        ``collate_meshes`` for meshes.
    rank, world_size : int, optional
        Rank of this process and number of ranks; by default those of ``torch.distributed``, else of the
        environment variables ``RANK`` and ``WORLD_SIZE``, else 0 and 1.

    Raises
    ------
    InputError
        A number is impossible, or ``data`` is not a data set of the toolkit.

    Notes
    -----
    A process holds one batch, the positions of two windows (16 bytes an item), and maps of unpacked rows,
    which the system evicts from memory when needed. The row groups of a window are unpacked into the cache
    folder before its first item is returned, and those of the next window meanwhile, each by one process of
    the machine. Each machine reads each shard once in an epoch, or only in the first epoch if the cache holds
    the entire set (``$TACTILE_TOOLKIT_CACHE_MIB``).

    The generator of torch in each worker, which random transforms use, is not resumed.

    Examples
    --------
    ::

        batches = TrainingBatches(TouchTensors(touches), batch_size=64, seed=0)
        loader = StatefulDataLoader(batches, batch_size=None, num_workers=8)
        if checkpoint.exists():
            batches.load_state_dict(torch.load(checkpoint)["data"])  # of any rank, any number of workers
        for epoch in range(batches.epoch, epochs):
            for images, labels in loader:
                ...
                torch.save({"data": loader.state_dict(), ...}, checkpoint)
    """

    def __init__(
        self,
        data: Any,
        batch_size: int,
        *,
        seed: int | None = 0,
        window: int = 16,
        drop_last: bool = False,
        collate_fn: Callable[[list[Any]], Any] | None = None,
        rank: int | None = None,
        world_size: int | None = None,
    ) -> None:
        sequence = getattr(data, "sequence", data)
        if not isinstance(sequence, RecordDataset):
            raise errors.InputError(
                f"{type(data).__name__} was given; expected a data set of the toolkit, or tensors of one "
                "such as realtouch.touch_tensors.TouchTensors"
            )
        self.data = data
        self.batch_size = checked_fields.checked_integer(batch_size, "batch_size", 1)
        self.drop_last = drop_last
        self.collate_fn = collate_fn
        distributed = torch.distributed
        if rank is not None or world_size is not None:
            numbers = checked_fields.to_builtin_number(rank), checked_fields.to_builtin_number(world_size)
        elif distributed.is_available() and distributed.is_initialized():
            numbers = distributed.get_rank(), distributed.get_world_size()
        else:
            numbers = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        if not (checked_fields.is_integer(*numbers) and 0 <= numbers[0] < numbers[1]):
            raise errors.InputError(
                f"rank is {rank!r} of {world_size!r}; expected integers, the rank below the world size"
            )
        self.rank, self.world_size = numbers
        seed = None if seed is None else checked_fields.checked_integer(seed, "seed")
        self._sequence = sequence
        self._order = GlobalOrder(
            sequence.stored_parts(), seed, checked_fields.checked_integer(window, "window", 1)
        )
        self._resumed = (0, 0)
        self._current: dict[str, int] = {}  # empty before a pass
        # The next pass of this process and of each worker: epoch, start, number of batches already returned,
        # and the number of workers when it last began a pass plus 1 (0 if it has not). Shared, so that
        # persistent workers see changes, and new workers see what earlier ones began.
        self._next = shared_zeros(1 + _MAX_WORKERS, 4)

    @property
    def epoch(self) -> int:
        """The epoch of the next pass."""
        return int(self._next[:, 0].max())

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of the next pass; a resumed epoch continues where it stopped.

        Needed only to repeat or skip epochs, or when the number of workers changes.
        """
        number = checked_fields.checked_integer(epoch, "epoch")
        self._set(number, self._resumed[1] * (number == self._resumed[0]))

    def __len__(self) -> int:
        """Batches of a complete epoch on each rank."""
        return len(self._share(0))

    def __iter__(self) -> Iterator[Any]:
        """Begin a pass.

        Raises
        ------
        InputError
            The number of workers changed since the last pass, and :meth:`set_epoch` was not called.
        """
        worker = torch.utils.data.get_worker_info()
        if worker is None:
            epoch, start = (self.epoch, 0) if self._workers_began() else self._next[0, :2].tolist()
            # All rows, so that workers of a later pass begin there too.
            self._next[:] = torch.tensor([epoch + 1, 0, 0, 0])
            self._current = {"epoch": epoch, "start": start, "batches": 0}
            return self._batches(self._current, 0, 1)
        if worker.num_workers > _MAX_WORKERS:
            raise errors.InputError(f"{worker.num_workers} workers; expected at most {_MAX_WORKERS}")
        began = self._next[1:, 3]
        if ((began != 0) & (began != worker.num_workers + 1)).any():
            raise errors.InputError(
                f"{worker.num_workers} workers continue after {int(began.max()) - 1}",
                next="call set_epoch() in between, so that all begin the same epoch",
            )
        self._current = self._planned(1 + worker.id)
        following = [self._current["epoch"] + 1, 0, 0, worker.num_workers + 1]
        self._next[1 + worker.id] = torch.tensor(following)
        return self._batches(self._current, worker.id, worker.num_workers)

    def _batches(self, current: dict[str, int], worker: int, workers: int) -> Iterator[object]:
        share = self._share(current["start"])
        order = self._order.epoch(current["epoch"])
        turn = (self.rank * workers + worker) / (self.world_size * workers)
        ahead = Prefetcher(self._sequence, order, turn)
        collate = self.collate_fn or torch.utils.data.default_collate
        fetch = getattr(
            self.data, "__getitems__", lambda chosen: [self.data[item_index] for item_index in chosen]
        )
        make = None if self.collate_fn else getattr(self.data, "collated", None)
        # Points on surfaces differ between epochs.
        if hasattr(self.data, "set_epoch"):
            self.data.set_epoch(current["epoch"])
        try:
            for index in range(worker + workers * current["batches"], len(share), workers):
                numbers = share.batch(index)
                ahead.enter(order.window_of(int(numbers[0])))
                chosen = order.positions(numbers).tolist()
                batch = make(chosen) if make else collate(fetch(chosen))
                current["batches"] += 1
                yield batch
        finally:
            ahead.close()

    def state_dict(self) -> JsonDict:
        """Return the state of this process in its pass, for ``StatefulDataLoader``.

        A job saves ``state_dict()`` of the ``StatefulDataLoader``, because workers are ahead of the job;
        without workers it may save this state.

        Returns
        -------
        dict of str to int or str

        Raises
        ------
        InputError
            Called in the job itself while workers make the batches.
        """
        worker = torch.utils.data.get_worker_info()
        if worker is None and self._workers_began():
            raise errors.InputError(
                "workers make the batches and are ahead of the job",
                next="save the state_dict() of a torchdata.stateful_dataloader.StatefulDataLoader",
            )
        return {**self._identity, **(self._current or self._planned(0)), **self._division(worker)}

    def load_state_dict(self, state_dict: JsonObject) -> None:
        """Resume a pass, on any number of ranks and workers.

        Parameters
        ----------
        state_dict : dict
            State of a ``StatefulDataLoader`` of such batches, or of the batches without workers, of any rank.
            The batch size may differ.

        Raises
        ------
        InputError
            It is not such a state, or belongs to another data set, seed or window.
        """
        states = list(_holding(_FORMAT, state_dict))
        if not states:
            raise errors.InputError(
                "no state of TrainingBatches was given; expected state_dict() of the loader that gave them"
            )
        worker = torch.utils.data.get_worker_info()
        expected = {**self._identity}
        if worker is not None:
            expected.update(self._division(worker))
        for state in states:
            for name, value in expected.items():
                if state[name] != value:
                    raise errors.InputError(
                        f"a state of {name} {state[name]!r}; expected {value!r}",
                        next="take data, seed and window as when it was saved, and give the state to "
                        "load_state_dict() of the TrainingBatches",
                    )
        if worker is not None:
            self._current = {}
            self._next[1 + worker.id] = torch.tensor([*map(states[0].get, _POSITION), 0])
            return
        # A loader that does not ask its workers for each batch counts the batches since.
        since = [state[_SINCE] for state in _holding(_SINCE, state_dict)]
        epoch, reached = self._reached(states, sum(since))
        if state_dict is not states[0] and not len(self._share(reached)):
            epoch, reached = epoch + 1, 0  # as a loader does
        self._resumed = epoch, reached
        self._set(epoch, reached)

    @property
    def _identity(self) -> JsonDict:
        return {_FORMAT: _VERSION, "order": self._order.fingerprint}

    def _planned(self, row: int) -> dict[str, int]:
        """Return the start of the next pass, of this process (row 0) or of worker row - 1."""
        return dict(zip(_POSITION, self._next[row, :3].tolist(), strict=True))

    def _division(self, worker: object) -> dict[str, int]:
        """Return the sizes by which items are divided."""
        workers = getattr(worker, "num_workers", 0)
        return {"batch_size": self.batch_size, "world_size": self.world_size, "workers": workers}

    def _reached(self, states: Sequence[JsonObject], further_batches: int) -> tuple[int, int]:
        """Return epoch and number of items that all ranks have received, from the states of all workers."""
        first = states[0]
        workers = max(first["workers"], 1)
        counts = [state["batches"] for state in states]
        batches = sum(counts)
        # Workers take turns in order, so other counts come from states of different times.
        in_turn = [batches // workers + (index < batches % workers) for index in range(workers)]
        if counts != in_turn or any(state["epoch"] != first["epoch"] for state in states):
            raise errors.InputError(
                f"states of {len(states)} workers that gave {', '.join(map(str, counts))} batches; expected "
                f"{workers} that took turns",
                next="save the state of one loader, with in_order=True",
            )
        items = (batches + further_batches) * first["batch_size"] * first["world_size"]
        return first["epoch"], min(first["start"] + items, len(self._order))

    def _set(self, epoch: int, start: int) -> None:
        self._current = {}
        self._next[:] = torch.tensor([epoch, start, 0, 0])

    def _workers_began(self) -> bool:
        return bool(self._next[1:, 3].any())

    def _share(self, start: int) -> RankSampler:
        return RankSampler(
            len(self._order), start, self.rank, self.world_size, self.batch_size, self.drop_last
        )


def _holding(key: str, state: object) -> Iterator[JsonObject]:
    """Yield nested mappings with a key, in order: loaders nest our states in theirs."""
    if isinstance(state, Mapping):
        if key in state:
            yield state
            return
        for value in state.values():
            yield from _holding(key, value)
