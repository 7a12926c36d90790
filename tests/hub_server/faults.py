"""Faults that the server simulates, and requests that it received."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any


@dataclass
class Request:
    """One request as it was received."""

    method: str
    path: str
    query: str
    range: str | None
    user: str | None
    """Account of its token; ``"?"`` for an unknown token."""
    status: int = 0
    """Status of the reply; 0 before there is one."""
    sent: int = 0
    """Bytes of the body of the reply that were sent."""

    @property
    def is_content(self) -> bool:
        """Whether it asks for the content of a file, from any address."""
        return "/resolve/" in self.path or self.path.startswith("/cdn/")


@dataclass
class Fault:
    """A fault of requests whose path matches a pattern, for a number of times."""

    pattern: str
    times: int = 1
    status: int | None = None
    headers: dict[str, str] = field(default_factory=dict)
    corrupt_at: int | None = None
    stall_after: int | None = None
    lose_reply: bool = False
    value: Any = None
    """Body of the reply with ``status``: bytes, or JSON values."""
    drip_s: float | None = None
    drips_head: bool = False
    endless: bool = False

    @property
    def touches_content(self) -> bool:
        """Whether it affects only requests by which the bytes of a file are sent."""
        return self.endless or self.corrupt_at is not None or self.stall_after is not None


class Faults:
    """The faults that remain; each call adds one."""

    def __init__(self) -> None:
        self._faults: list[Fault] = []
        self._lock = threading.Lock()
        self.stalled = threading.Event()
        """Set when a reply pauses; see :meth:`stall`."""
        self.released = threading.Event()
        """Set it to let replies that pause continue."""

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        with self._lock:
            self._faults.append(fault)

    def clear(self) -> None:
        """Remove the faults that remain."""
        with self._lock:
            self._faults.clear()

    def fail(self, pattern: str, status: int = 503, times: int = 1, **more: object) -> None:
        """Reply with an error, and do nothing."""
        self.add(Fault(pattern, times, status=status, **more))  # type: ignore[arg-type]

    def corrupt(self, pattern: str, at: int, times: int = 1) -> None:
        """Flip the bits of one byte of a file."""
        self.add(Fault(pattern, times, corrupt_at=at))

    def stall(self, pattern: str, after: int, times: int = 1) -> None:
        """Pause after some bytes of a file, until ``released`` is set."""
        self.add(Fault(pattern, times, stall_after=after))

    def endless(self, pattern: str, times: int = 1) -> None:
        """Send a file in pieces without end, and without its size."""
        self.add(Fault(pattern, times, endless=True))

    def drip(self, pattern: str, pause_s: float, times: int = 1, *, head: bool = False) -> None:
        """Send the head or the body of a reply byte by byte."""
        self.add(Fault(pattern, times, drip_s=pause_s, drips_head=head))

    def lose_reply(self, pattern: str, times: int = 1) -> None:
        """Execute the request, and close the connection without a reply."""
        self.add(Fault(pattern, times, lose_reply=True))

    def take(self, path: str, *, content: bool) -> Fault | None:
        """Return the first fault that applies to this request, and count it."""
        with self._lock:
            for fault in self._faults:
                if fault.times and self._hits(fault, path, content):
                    fault.times -= 1
                    return fault
        return None

    @staticmethod
    def _hits(fault: Fault, path: str, content: bool) -> bool:
        return fnmatchcase(path, fault.pattern) and (content or not fault.touches_content)
