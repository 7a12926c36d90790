"""Tasks on the machines of a Ray cluster.

The cluster belongs to another user: this process joins it, never starts it, and leaves it as it was. Its
nodes run the toolkit that is installed there, so every worker compares versions before it works. The few
lines that compare them travel with the first task, because a node may not have the toolkit at all.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, TypeVar

from tactile_toolkit.errors import InputError, MissingExtraError, ToolkitError
from tactile_toolkit.run.processes import unpack_result, worker_died

T = TypeVar("T")
R = TypeVar("R")

_DISTRIBUTION = "tactile-toolkit"
# Longest time that a cluster may take to answer, seconds.
_ANSWER_S = 5.0
# Longest time that a cancelled task may clean up before its worker is killed, seconds.
_CANCEL_S = 3.0
# Seconds between counts of the cluster's cores while nothing finishes: nodes come and go.
_LOOK_AGAIN_S = 5.0
_TASKS_PER_CORE = 2  # one running and one waiting, so that no core waits for an answer to travel
_ADDRESS = re.compile(r"\[?(?P<host>[^/\[\]]+)\]?:(?P<port>[0-9]{1,5})")

_SETTINGS = {
    # No prompt, no banner, no usage reports, and no messages of Ray's own on the terminal: whatever its
    # logging settings, it prints those of a dead node on stdout.
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",
    # If something else answers at the address, one try takes 40 s; the default is 20 tries.
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
        ``"HOST:PORT"`` of the head of the cluster; this machine must be one of its nodes. None means
        ``$RAY_ADDRESS``, or else the cluster that was started on this machine.
    workers : int
        Largest number of tasks at once; 0 means one per core of the cluster, even if nodes come and go.
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

        Raises InputError if no cluster answers or a node has other versions, ToolkitError when one task's
        worker died ``attempts`` times.
        """
        waiting = deque((task, 1) for task in tasks)
        if not waiting:
            return
        with _connected(self.address) as ray:
            # Retried here: Ray itself repeats a task that ran out of memory without end.
            names = (_DISTRIBUTION, *getattr(function, "libraries", ()))
            remote_task = ray.remote(num_cpus=1, max_retries=0)(_travelling(names))
            # Pickled here, not by Ray, so that what cannot be unpickled there is an error like any other.
            dumps = ray.cloudpickle.dumps
            called = ray.put(ray.cloudpickle.dumps(function))
            running: dict[Any, tuple[T, int]] = {}
            try:
                while waiting or running:
                    most_tasks = self.workers or _TASKS_PER_CORE * int(ray.cluster_resources().get("CPU", 1))
                    while waiting and len(running) < max(1, most_tasks):
                        task, attempt = waiting.popleft()
                        running[remote_task.remote(called, dumps(task))] = (task, attempt)
                    for reference in ray.wait(list(running), timeout=_LOOK_AGAIN_S)[0]:
                        task, attempt = running.pop(reference)
                        try:
                            node, differing, answer = ray.get(reference)
                        except ray.exceptions.RayTaskError as error:
                            raise ToolkitError(f"Ray could not run {task}: {error}") from None
                        except ray.exceptions.RayError as error:
                            if attempt >= self.attempts:
                                again = "on nodes with more memory or with fewer --workers"
                                raise worker_died(task, attempt, "Ray worker", again) from error
                            waiting.appendleft((task, attempt + 1))
                            continue
                        if differing:
                            raise _other_versions(node, differing)
                        yield unpack_result(answer, f"raised on node {node}")
            finally:
                # Interrupted tasks remove partial files; then the workers of the others are killed.
                left = list(running)
                for force in (False, True):
                    for reference in left:
                        ray.cancel(reference, force=force)
                    if left:
                        _, left = ray.wait(left, num_returns=len(left), timeout=_CANCEL_S)


def _travelling(names: Iterable[str]) -> Callable[..., Any]:
    """Return the function that nodes run; it carries its own code and needs no package of this project.

    It returns the name of its machine, the versions that differ (there, here), and, if none differs, the
    packed result of a task.
    """

    def versions() -> dict[str, str]:
        from importlib.metadata import distributions

        return {name: next((d.version for d in distributions(name=name)), "not installed") for name in names}

    our_versions = versions()
    known: dict[str, str] = {}  # kept by a worker process, which runs many tasks

    def work(function: bytes, task: bytes) -> tuple[str, dict[str, tuple[str, str]], bytes]:
        import socket

        import ray

        known.update(known or versions())
        node = ray.get_runtime_context().get_node_id()[:8]  # containers may share host name and address
        machine = f"{socket.gethostname()} ({ray.util.get_node_ip_address()}, {node})"
        if known != our_versions:
            return (
                machine,
                {
                    name: (known[name], our_versions[name])
                    for name in names
                    if known[name] != our_versions[name]
                },
                b"",
            )
        from tactile_toolkit.run.processes import run_pickled

        return machine, {}, run_pickled(function, task, ray.cloudpickle.dumps)

    return work


def _other_versions(machine: str, differing: Mapping[str, tuple[str, str]]) -> InputError:
    differences = ", ".join(f"{name} {there} (here: {here})" for name, (there, here) in differing.items())
    pins = " ".join(f"{name}=={here}" for name, (_, here) in differing.items())
    return InputError(
        f"node {machine} has {differences}; other versions write other bytes, so nothing was made there",
        next=f"pip install {pins} on that node, or take it out of the cluster",
    )


@contextlib.contextmanager
def _connected(address: str | None) -> Iterator[Any]:
    """Join a cluster and leave it again; InputError if none answers."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    import ray

    if ray.is_initialized():
        yield ray
        return
    address = address or os.environ.get("RAY_ADDRESS") or "auto"
    endpoint = None if address == "auto" else _host_and_port(address)
    try:
        if endpoint is not None:  # Ray itself waits for long if nothing listens
            socket.create_connection(endpoint, _ANSWER_S).close()
        ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
    except Exception as error:  # of many types, RuntimeError for other versions of Ray or Python among them
        raise InputError(
            f"no Ray cluster can be joined {f'at {address}' if endpoint else 'here'}: {error}; "
            "nothing was written",
            next="start one (ray start --head), run the command on a machine of it "
            "with the HOST:PORT that this printed (--runner ray=HOST:PORT), or use --runner processes",
        ) from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _host_and_port(address: str) -> tuple[str, int]:
    match = _ADDRESS.fullmatch(address)
    if match is None:
        raise InputError(
            f"{address!r} is not the address of a Ray cluster; expected HOST:PORT, which `ray start --head` "
            "prints, such as 10.0.0.5:6379",
            next="run the command on a machine of the cluster with that",
        )
    return match["host"], int(match["port"])
