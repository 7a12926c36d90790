"""Tasks on the machines of a Ray cluster.

The cluster is somebody else's: it is joined, never started, and left as it was. What runs on its nodes is the
toolkit as installed there, so versions are compared before anything else is done; the few lines that compare
them travel with the question, because a node may lack the toolkit altogether.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, TypeVar

from tactile_toolkit.errors import InputError, MissingExtraError, ToolkitError
from tactile_toolkit.run.work import given_up, outcome

__all__ = ["RayRunner"]

T = TypeVar("T")
R = TypeVar("R")

_DISTRIBUTION = "tactile-toolkit"
_ANSWER_S = 5.0
"""How long a cluster may take to answer at all."""
_PROBE_S = 60.0
"""How long a node may take to tell its versions; one that takes longer is asked with its first task."""
_CANCEL_S = 3.0
"""How long a cancelled task may take to clean up before its worker is killed."""
_LOOK_AGAIN_S = 5.0
"""How often the cores of the cluster are counted while nothing finishes: nodes come and go."""
_TASKS_PER_CORE = 2  # one at work, one that waits: a core never waits for an answer to travel

_SETTINGS = {
    # No prompt, no banner, no reports to the makers of Ray, and no word of Ray's inner life on the terminal:
    # whatever its logging settings, it prints those of a dead node on stdout.
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",
    # Where something else answers, Ray tries for 40 s; by itself it would 20 times.
    "RAY_NUM_REDIS_GET_RETRIES": "1",
}


@dataclass(frozen=True)
class RayRunner:
    """Runs tasks on a Ray cluster that is running already, one processor core for each.

    A task is tried ``attempts`` times when its worker or its node dies before the run gives up. An exception
    raised by the task itself is raised here as it is, and never tried again. A connection to Ray that the
    calling process has already is used, and stays.

    Parameters
    ----------
    address : str or None
        ``"HOST:PORT"`` of the head of the cluster, of which this machine must be a node. None means
        ``$RAY_ADDRESS``, else the cluster that was started on this machine.
    workers : int
        Most tasks at once; 0 means as many as the cluster has cores, also when nodes come and go.
    attempts : int
        How often a task is tried.

    Raises
    ------
    MissingExtraError
        Ray is not installed.
    InputError
        The address is not one of this form.
    """

    address: str | None = None
    workers: int = 0
    attempts: int = 3

    def __post_init__(self) -> None:
        if find_spec("ray") is None:
            raise MissingExtraError(feature="a Ray cluster", package="ray", extra="ray")
        if self.address is not None:
            _host_and_port(self.address)

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield results as they finish.

        Raises InputError where no cluster answers or a node has other versions, ToolkitError when one task's
        worker died ``attempts`` times.
        """
        waiting = deque((task, 1) for task in tasks)
        if not waiting:
            return
        with _connected(self.address) as ray:
            wanted, there = _travelling((_DISTRIBUTION, *getattr(function, "libraries", ())))
            # Repeating is ours: Ray's own repeats a task that ran out of memory without end.
            work = ray.remote(num_cpus=1, max_retries=0)(there)
            _ask_all_nodes(ray, work, wanted)
            # Pickled here, not by Ray, so that what cannot be unpickled there is an error like any other.
            dumps, called = ray.cloudpickle.dumps, ray.put(ray.cloudpickle.dumps(function))
            confirm, confirmed = getattr(function, "confirm", None), set[str]()
            running: dict[Any, tuple[T, int]] = {}
            try:
                while waiting or running:
                    room = self.workers or _TASKS_PER_CORE * int(ray.cluster_resources().get("CPU", 1))
                    while waiting and len(running) < max(1, room):
                        task, attempt = waiting.popleft()
                        running[work.remote(called, dumps(task))] = (task, attempt)
                    for reference in ray.wait(list(running), timeout=_LOOK_AGAIN_S)[0]:
                        task, attempt = running.pop(reference)
                        try:
                            node, versions, answer = ray.get(reference)
                        except ray.exceptions.RayTaskError as error:
                            message = f"Ray could not run {task}: {error}"
                            raise ToolkitError(message) from None
                        except ray.exceptions.RayError as error:
                            if attempt >= self.attempts:
                                again = "on nodes with more memory or with fewer --workers"
                                raise given_up(task, attempt, "Ray worker", again) from error
                            waiting.appendleft((task, attempt + 1))
                            continue
                        _require_same(node, versions, wanted)
                        result = outcome(answer, f"raised on node {node}")
                        if confirm is not None and node not in confirmed:
                            confirm(result, node)
                            confirmed.add(node)
                        yield result
            finally:
                # Interrupted, tasks remove what is half-written; then the workers of those left are killed.
                left = list(running)
                for force in (False, True):
                    for reference in left:
                        ray.cancel(reference, force=force)
                    left = left and ray.wait(left, num_returns=len(left), timeout=_CANCEL_S)[1]


def _travelling(names: Sequence[str]) -> tuple[dict[str, str], Callable[..., Any]]:
    """Return versions of this machine, and what nodes run: it carries its own code and needs nothing of ours.

    It returns the name of its machine, the versions there, and, where they are those of this machine, the
    answer of a task, if it was given one.
    """
    known: dict[str, str] = {}  # to one worker process, which carries out many tasks

    def versions() -> dict[str, str]:
        from importlib.metadata import distributions

        return {name: next((d.version for d in distributions(name=name)), "not installed") for name in names}

    wanted = versions()

    def work(function: bytes = b"", task: bytes = b"") -> tuple[str, dict[str, str], bytes]:
        import socket

        import ray

        known.update(known or versions())
        node = ray.get_runtime_context().get_node_id()[:8]  # containers may have all else in common
        machine = f"{socket.gethostname()} ({ray.util.get_node_ip_address()}, {node})"
        if known != wanted or not function:
            return machine, known, b""
        from tactile_toolkit.run.work import carry_out

        return machine, known, carry_out(function, task, ray.cloudpickle.dumps)

    return wanted, work


def _ask_all_nodes(ray: Any, work: Any, wanted: Mapping[str, str]) -> None:
    """Ask every node for its versions before any works. Raises InputError that names one that differs."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    nodes = [node["NodeID"] for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU")]
    strategies = [NodeAffinitySchedulingStrategy(node, soft=False) for node in nodes]
    asked = [work.options(num_cpus=0, scheduling_strategy=strategy).remote() for strategy in strategies]
    for reference in asked and ray.wait(asked, num_returns=len(asked), timeout=_PROBE_S)[0]:
        # A node that died or answers too late is asked again with its first task.
        with contextlib.suppress(ray.exceptions.RayError):
            machine, versions, _ = ray.get(reference)
            _require_same(machine, versions, wanted)


def _require_same(machine: str, there: Mapping[str, str], wanted: Mapping[str, str]) -> None:
    differing = {name: here for name, here in wanted.items() if there[name] != here}
    if differing:
        found = ", ".join(f"{name} {there[name]} (here: {here})" for name, here in differing.items())
        pins = " ".join(f"{name}=={here}" for name, here in differing.items())
        message = (
            f"node {machine} has {found}; other versions write other bytes, so nothing was made there; "
            f"next: pip install {pins} on that node, or take it out of the cluster"
        )
        raise InputError(message)


@contextlib.contextmanager
def _connected(address: str | None) -> Iterator[Any]:
    """Join a cluster and leave it again. Raises InputError where none answers."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    import ray

    if ray.is_initialized():
        yield ray
        return
    address = address or os.environ.get("RAY_ADDRESS") or "auto"
    place = None if address == "auto" else _host_and_port(address)
    try:
        if place is not None:  # Ray itself waits for long where nothing listens
            socket.create_connection(place, _ANSWER_S).close()
        ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
    except Exception as error:  # of many types, RuntimeError for other versions of Ray or Python among them
        message = (
            f"no Ray cluster can be joined {f'at {address}' if place else 'here'}: {error}; "
            "nothing was written; next: start one (ray start --head), run the command on a machine of it "
            "with the HOST:PORT that this printed (--runner ray=HOST:PORT), or use --runner processes"
        )
        raise InputError(message) from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _host_and_port(address: str) -> tuple[str, int]:
    host, colon, port = address.rpartition(":")
    if "://" in address or not (colon and host and port.isdecimal() and len(port) <= 5):
        message = (
            f"{address!r} is not the address of a Ray cluster; expected HOST:PORT, which `ray start --head` "
            "prints, such as 10.0.0.5:6379 (ray:// addresses are another protocol); next: run the command on "
            "a machine of the cluster with that address"
        )
        raise InputError(message)
    return host.strip("[]"), int(port)
