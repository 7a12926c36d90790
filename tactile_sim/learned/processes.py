"""Devices, and the processes of ``torchrun``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch

from tactile_toolkit.errors import InputError


def chosen_device(name: str) -> str:
    """Return ``"cpu"`` or ``"cuda"``; InputError for another name, and for CUDA without a GPU."""
    available = torch.cuda.is_available()
    if name not in ("auto", "cpu", "cuda"):
        raise InputError(f"is {name!r}; expected auto, cpu or cuda", field="device")
    if name == "cuda" and not available:
        raise InputError("is 'cuda', but PyTorch finds no GPU here", next="use --device cpu", field="device")
    if name == "cpu" or not available:
        return "cpu"
    return "cuda"


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
def joined_processes(device: str, *, deterministic: bool) -> Iterator[Process]:
    """Choose a device, and join the other processes of ``torchrun`` if there are any."""
    # torchrun names each process by these variables.
    rank = int(os.environ.get("RANK", "0"))
    count = int(os.environ.get("WORLD_SIZE", "1"))
    chosen = chosen_device(device)
    if deterministic and chosen != "cpu":
        raise InputError(
            "deterministic training runs on the CPU", next="use --device cpu, or leave out --deterministic"
        )
    if chosen == "cuda":
        chosen = f"cuda:{int(os.environ.get('LOCAL_RANK', '0'))}"
        torch.cuda.set_device(chosen)
    if count > 1:
        torch.distributed.init_process_group({"cpu": "gloo"}.get(chosen, "nccl"))
    process = Process(rank, count, chosen)
    try:
        with _determinism(deterministic=deterministic):
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
