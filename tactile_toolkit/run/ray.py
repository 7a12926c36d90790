"""Tasks on the machines of a Ray cluster.

The cluster is somebody else's: it is joined, never started, and left as it was. What runs on its nodes is the
toolkit as installed there, so versions are compared before anything else is done; the few lines that compare
them travel with the question, because a node may lack the toolkit altogether.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import socket
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any, TypeVar

from tactile_toolkit.errors import InputError, MissingExtraError, ToolkitError
from tactile_toolkit.run.limits import prepare_batch_process

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
"""How old the count of the cluster's cores may be: nodes come and go."""
_TASKS_PER_CORE = 2  # one at work, one that waits: a core never waits for an answer to travel

# No prompt, no banner, no reports to the makers of Ray, and no word of Ray's inner life on the terminal.
_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
# What every gRPC server answers: HTTP/2's connection preface and an empty SETTINGS frame (RFC 9113, 3.4).
_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0\4\0\0\0\0\0"
_SETTINGS = 4


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
            nodes = _Nodes(ray, function)
            nodes.require_same_versions()
            running: dict[Any, tuple[T, int]] = {}
            try:
                while waiting or running:
                    while waiting and len(running) < (self.workers or nodes.room()):
                        task, attempt = waiting.popleft()
                        running[nodes.start(task)] = (task, attempt)
                    for reference in _finished(ray, list(running)):
                        task, attempt = running.pop(reference)
                        try:
                            outcome = ray.get(reference)
                        except ray.exceptions.RayTaskError as error:
                            message = f"Ray could not run {task}: {error}"
                            raise ToolkitError(message) from None
                        except ray.exceptions.RayError as error:
                            if attempt >= self.attempts:
                                raise _given_up(task, attempt, error) from None
                            waiting.appendleft((task, attempt + 1))
                            continue
                        yield nodes.result(outcome)
            finally:
                _cancel(ray, list(running))


class _Nodes:
    """The nodes of a cluster as one function meets them."""

    def __init__(self, ray: Any, function: Callable[..., Any]) -> None:
        self._ray = ray
        self._function = function
        self._confirm = getattr(function, "confirm", None)
        names = (_DISTRIBUTION, *getattr(function, "libraries", ()))
        versions, work = _travelling(names)
        self._versions_here = versions()
        # Repeating is ours: Ray's own repeats a task that ran out of memory without end.
        self._ask = ray.remote(num_cpus=0, max_retries=0)(versions)
        self._work = ray.remote(num_cpus=1, max_retries=0)(work)
        self._confirmed: set[str] = set()
        self._names: dict[str, str] = {}
        self._room, self._counted_s = 0, -_LOOK_AGAIN_S

    def require_same_versions(self) -> None:
        """Ask every node before any works. Raises InputError that names the first that differs."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        asked = {}
        for node in self._ray.nodes():
            if node["Alive"] and node["Resources"].get("CPU"):
                there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                asked[self._ask.options(scheduling_strategy=there).remote()] = _node_name(node)
        if not asked:
            return
        for reference in self._ray.wait(list(asked), num_returns=len(asked), timeout=_PROBE_S)[0]:
            # A node that died or answers too late is asked again with its first task.
            with contextlib.suppress(self._ray.exceptions.RayError):
                self._require_same(self._ray.get(reference), asked[reference])

    def room(self) -> int:
        """Return how many tasks the cluster should hold at a time."""
        if time.monotonic() - self._counted_s > _LOOK_AGAIN_S:
            cores = self._ray.cluster_resources().get("CPU", 0.0)
            self._room, self._counted_s = max(1, int(_TASKS_PER_CORE * cores)), time.monotonic()
        return self._room

    def start(self, task: Any) -> Any:
        """Give a task to the cluster and return its reference."""
        # Pickled here, not by Ray, so that what cannot be unpickled there is an error like any other.
        payload = self._ray.cloudpickle.dumps((self._function, task))
        return self._work.remote(payload, self._versions_here)

    def result(self, outcome: tuple[str, Mapping[str, str], bytes | None]) -> Any:
        """Return what a task returned, or raise what it raised, or what is wrong with its node."""
        node_id, versions, packed = outcome
        if node_id not in self._names:
            self._names |= {node["NodeID"]: _node_name(node) for node in self._ray.nodes()}
        name = self._names.get(node_id, node_id)
        self._require_same(versions, name)
        assert packed is not None
        value, error = pickle.loads(packed)
        if error is not None:
            error.add_note(f"(raised on node {name})")
            raise error
        if self._confirm is not None and node_id not in self._confirmed:
            self._confirm(value, name)
            self._confirmed.add(node_id)
        return value

    def _require_same(self, there: Mapping[str, str], node: str) -> None:
        differing = {name: here for name, here in self._versions_here.items() if there[name] != here}
        if differing:
            found = ", ".join(f"{name} {there[name]} (here: {here})" for name, here in differing.items())
            wanted = " ".join(f"{name}=={here}" for name, here in differing.items())
            message = (
                f"node {node} has {found}; other versions write other bytes, so nothing was made there; "
                f"next: pip install {wanted} on that node, or take it out of the cluster"
            )
            raise InputError(message)


def _travelling(names: Sequence[str]) -> tuple[Callable[[], dict[str, str]], Callable[..., Any]]:
    """Return what nodes run, as functions that carry their own code and need nothing of ours to be read."""
    known: dict[str, str] = {}  # to one worker process, which carries out many tasks

    def versions() -> dict[str, str]:
        from importlib.metadata import PackageNotFoundError, version

        found = {}
        for name in names:
            try:
                found[name] = version(name)
            except PackageNotFoundError:
                found[name] = "not installed"
        return found

    def work(payload: bytes, wanted: Mapping[str, str]) -> tuple[str, dict[str, str], bytes | None]:
        import ray

        if not known:
            known.update(versions())
        node_id = ray.get_runtime_context().get_node_id()
        if known != wanted:  # a node that came later, or had no time to answer
            return node_id, known, None
        from tactile_toolkit.run.ray import carry_out

        return node_id, known, carry_out(payload)

    return versions, work


def carry_out(payload: bytes) -> bytes:
    """Call a function with a task and return, pickled, what it returned and what it raised; one is None."""
    import ray

    pickler: Any = ray.cloudpickle  # as Ray does it: what a script defines itself travels too
    _prepare_worker()
    try:
        function, task = pickle.loads(payload)
        packed: bytes = pickler.dumps((function(task), None))
    except Exception as error:
        told = f"{type(error).__name__}: {error}"
        notes = traceback.format_exc()
        try:
            error.add_note(notes)
            packed = pickler.dumps((None, error))
            pickle.loads(packed)
        except Exception:  # an exception that cannot travel
            plain = ToolkitError(told)
            plain.add_note(notes)
            packed = pickler.dumps((None, plain))
    return packed


@cache
def _prepare_worker() -> None:
    """Keep a worker to its one core; once, since it carries out many tasks."""
    from threadpoolctl import threadpool_limits

    prepare_batch_process()
    threadpool_limits(limits=1, user_api="blas")  # numpy came with Ray, before the variables were set


@contextlib.contextmanager
def _connected(address: str | None) -> Iterator[Any]:
    """Join a cluster and leave it again. Raises InputError where none answers."""
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    import ray
    from ray._private import worker as ray_worker

    if ray.is_initialized():
        yield ray
        return
    found = _answering(address)
    # Whatever it is told of logs, Ray prints those of a dead node on stdout; its debugger silences them so.
    ray_worker._worker_logs_enabled = False
    try:
        _join(ray, found)
        yield ray
    finally:
        ray.shutdown()
        ray_worker._worker_logs_enabled = True


def _join(ray: Any, address: str) -> None:
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
    except Exception as error:  # of many types, RuntimeError for other versions of Ray or Python among them
        message = (
            f"the Ray cluster at {address!r} cannot be joined: {error}; nothing was written; next: run the "
            f"command on a machine of the cluster (ray start --address={address} makes this one such)"
        )
        raise InputError(message) from error


def _answering(address: str | None) -> str:
    """Return the address of a cluster that answers; Ray itself waits for minutes, then ends the process."""
    from ray._private.services import canonicalize_bootstrap_address

    found: str | None
    try:
        found = canonicalize_bootstrap_address(address or "auto")
    except (ConnectionError, OSError, ValueError):  # nobody knows its host, or nobody has started one
        found = address
    if found is None:
        message = (
            "no Ray cluster is known on this machine; nothing was written; next: give its address "
            "(--runner ray=HOST:PORT), start one (ray start --head), or use --runner processes"
        )
        raise InputError(message)
    problem = "something else than Ray answers there"
    try:
        with socket.create_connection(_host_and_port(found), _ANSWER_S) as connection:
            connection.settimeout(_ANSWER_S)
            connection.sendall(_HELLO)
            head = connection.recv(9)
            if len(head) > 3 and head[3] == _SETTINGS:
                return found
    except OSError as error:
        problem = str(error.strerror or error)
    message = (
        f"no Ray cluster answers at {address or found!r}: {problem}; nothing was written; next: give the "
        "address that `ray start --head` printed (HOST:PORT), or use --runner processes"
    )
    raise InputError(message)


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


def _finished(ray: Any, references: list[Any]) -> list[Any]:
    """Wait for a while, and return the tasks that have finished, which may be none."""
    if not ray.wait(references, num_returns=1, timeout=_LOOK_AGAIN_S)[0]:
        return []
    finished: list[Any] = ray.wait(references, num_returns=len(references), timeout=0)[0]
    return finished


def _cancel(ray: Any, references: list[Any]) -> None:
    """Interrupt tasks, so that they remove what is half-written, then kill the workers of those left."""
    for force in (False, True):
        for reference in references:
            ray.cancel(reference, force=force)
        if references:
            _, references = ray.wait(references, num_returns=len(references), timeout=_CANCEL_S)


def _given_up(task: object, attempts: int, error: Exception) -> ToolkitError:
    cause = str(error).strip().partition("\n")[0]
    message = (
        f"the Ray worker died {attempts} times while it made {task} ({cause}); out of memory is the usual "
        "cause; next: run the same command again, on nodes with more memory or with fewer --workers "
        "(finished shards are kept)"
    )
    return ToolkitError(message)


def _node_name(node: Mapping[str, Any]) -> str:
    return f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']})"
