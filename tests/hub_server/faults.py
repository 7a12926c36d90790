"""What the server is to do wrong, and what it was asked."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any


@dataclass
class Request:
    """One request as it went over the wire."""

    method: str
    path: str
    query: str
    range: str | None
    user: str | None
    """Whose token came with it; ``"?"`` for an unknown token."""
    status: int = 0
    """Status of the answer; 0 while there is none."""
    sent: int = 0
    """Bytes of the answer's body that were sent."""

    @property
    def is_content(self) -> bool:
        """Whether it asks for the content of a file, wherever that lies."""
        return "/resolve/" in self.path or self.path.startswith("/cdn/")


@dataclass
class Fault:
    """Something that goes wrong with requests whose path matches a pattern, a number of times."""

    pattern: str
    times: int = 1
    status: int | None = None
    headers: dict[str, str] = field(default_factory=dict)
    corrupt_at: int | None = None
    stall_after: int | None = None
    lose_reply: bool = False
    value: Any = None
    """What is answered under ``status``: bytes as they are, anything else as JSON."""
    drip_s: float | None = None
    drips_head: bool = False
    endless: bool = False

    @property
    def touches_content(self) -> bool:
        """Whether it shows only where the bytes of a file are sent."""
        return self.endless or self.corrupt_at is not None or self.stall_after is not None


class Faults:
    """The faults still to come; each call adds one."""

    def __init__(self) -> None:
        self._faults: list[Fault] = []
        self._lock = threading.Lock()
        self.stalled = threading.Event()
        """Set when an answer stands still; see :meth:`stall`."""
        self.released = threading.Event()
        """Set it to let answers that stand still continue."""

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        with self._lock:
            self._faults.append(fault)

    def clear(self) -> None:
        """Forget the faults still to come."""
        with self._lock:
            self._faults.clear()

    def fail(self, pattern: str, status: int = 503, times: int = 1, **more: object) -> None:
        """Answer with an error, before anything is done."""
        self.add(Fault(pattern, times, status=status, **more))  # type: ignore[arg-type]

    def corrupt(self, pattern: str, at: int, times: int = 1) -> None:
        """Flip the bits of one byte of a file."""
        self.add(Fault(pattern, times, corrupt_at=at))

    def stall(self, pattern: str, after: int, times: int = 1) -> None:
        """Stand still after some bytes of a file, until ``released`` is set."""
        self.add(Fault(pattern, times, stall_after=after))

    def endless(self, pattern: str, times: int = 1) -> None:
        """Send a file in pieces that do not end, without a word about its size."""
        self.add(Fault(pattern, times, endless=True))

    def drip(self, pattern: str, pause_s: float, times: int = 1, *, head: bool = False) -> None:
        """Answer byte by byte, the head or what follows it."""
        self.add(Fault(pattern, times, drip_s=pause_s, drips_head=head))

    def lose_reply(self, pattern: str, times: int = 1) -> None:
        """Do what is asked and close the connection without an answer."""
        self.add(Fault(pattern, times, lose_reply=True))

    def take(self, path: str, *, content: bool) -> Fault | None:
        """Return the first fault that hits this request and count it."""
        with self._lock:
            for fault in self._faults:
                if fault.times and self._hits(fault, path, content):
                    fault.times -= 1
                    return fault
        return None

    @staticmethod
    def _hits(fault: Fault, path: str, content: bool) -> bool:
        return fnmatchcase(path, fault.pattern) and (content or not fault.touches_content)
