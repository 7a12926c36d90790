"""Chromium without a screen, for tests of pages that open from a file system."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    # three.js needs WebGL; without a graphics card it is drawn by the processor.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
]


@dataclass
class Opened:
    """A page with its messages and requests."""

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def loaded_thumbnails(self) -> set[str]:
        return {url for url in self.requests if "/thumbs/" in url}

    def listen(self) -> None:
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._console)
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("requestfailed", lambda request: self.errors.append(f"failed: {request.url}"))

    def _console(self, message: Any) -> None:
        # Reading pixels back makes the drawing library warn about slowness; all other messages count.
        if message.type in ("error", "warning") and "GPU stall due to ReadPixels" not in message.text:
            self.errors.append(message.text)

    def drawn(self) -> int:
        """Return how often the 3D view has been drawn."""
        return int(self.page.evaluate("document.querySelector('.stage canvas')?.dataset.drawn ?? 0"))

    def stage(self) -> np.ndarray:
        """Return the pixels of the 3D view inside its focus ring, shape (H, W, 3)."""
        from PIL import Image

        self.page.wait_for_function("document.querySelector('.stage canvas')?.dataset.drawn >= 1")
        content = self.page.locator(".stage").screenshot()
        return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)[8:-8, 8:-8]


@contextmanager
def browser() -> Iterator[Any]:
    """Start Chromium; skips where it, or playwright, is not installed."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra `browser`")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=_ARGUMENTS)
        try:
            yield chromium
        finally:
            chromium.close()


@contextmanager
def opened(
    chromium: Any,
    site: Path | str,
    *,
    width: int = 1200,
    height: int = 800,
    dark: bool = False,
    link: str = "",
) -> Iterator[Opened]:
    """Open a site from the file system; at the end, check for errors and for requests to other places."""
    scheme = "dark" if dark else "light"
    context = chromium.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    try:
        found = Opened(context.new_page())
        found.listen()
        found.page.goto(f"{Path(site, 'index.html').absolute().as_uri()}{link}")
        found.page.wait_for_function("gallery.index !== null")
        yield found
        assert found.errors == []
        root = Path(site).absolute().as_uri()
        assert [url for url in found.requests if not url.startswith((root, "data:", "blob:"))] == []
    finally:
        context.close()
