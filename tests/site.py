"""Checks the built site: ``python -m tests.site docs/_build/html``.

Every internal link leads to a page and an anchor on it, no page fetches anything from other sites, and the
search finds a function, all from the file system.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from tests.gallery_browser import browser

__all__ = ["main"]

FETCHED = {("img", "src"), ("script", "src"), ("link", "href")}


class Page(HTMLParser):
    """The links of a page, its fetched files, and its anchors."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attributes}
        self.anchors |= {values.get("id", ""), values.get("name", "")}
        for name, value in values.items():
            if (tag, name) in FETCHED and values.get("rel") != "canonical":
                self.fetched.append(value)
            elif (tag, name) == ("a", "href"):
                self.links.append(value)


def broken(site: Path) -> list[str]:
    """List broken links, and files that are fetched from other sites."""
    pages = {path: Page(path) for path in site.rglob("*.html") if "_static" not in path.parts}
    problems = []
    for path, page in pages.items():
        problems += [f"{path}: fetches {url}" for url in page.fetched if urlsplit(url).netloc]
        for link in (*page.links, *page.fetched):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                problems.append(f"{path}: {link}: no such file")
            elif target in pages and parts.fragment and unquote(parts.fragment) not in pages[target].anchors:
                problems.append(f"{path}: {link}: no such anchor")
    return problems


def search(site: Path, words: str) -> list[str]:
    """Return the titles that the search of the site finds, opened from the file system."""
    with browser() as chromium:
        page = chromium.new_page()
        requests: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        page.goto(f"{(site / 'search.html').as_uri()}?q={words}")
        page.wait_for_selector("#search-results ul.search li a", timeout=60_000)
        outside = [url for url in requests if not url.startswith(("file:", "data:", "blob:"))]
        assert not outside, outside
        return page.locator("#search-results ul.search li a").all_inner_texts()


def main() -> None:
    """Check a site; end with a list of problems."""
    site = Path(sys.argv[1]).resolve()
    problems = broken(site)
    if not any("solidify" in title for title in search(site, "solidify")):
        problems.append("the search does not find solidify")
    if problems:
        sys.exit("\n".join(problems))


if __name__ == "__main__":
    main()
