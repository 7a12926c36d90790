"""Settings of the site: ``python -m sphinx -W -n --keep-going docs docs/_build/html``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

import generated  # noqa: E402
from numpydoc.xref import DEFAULT_LINKS  # noqa: E402

from tactile_toolkit import __version__  # noqa: E402

project = "tactile-toolkit"
author = "the authors of tactile-toolkit"
project_copyright = f"2026, {author}"
release = version = __version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = [
    "_build",
    "_generated/extra",
    "examples",
    "**/GALLERY_HEADER.rst",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
]
root_doc = "index"
nitpicky = True
# Docstrings that `tactile_envs` inherits name what its base classes have.
nitpick_ignore_regex = [
    ("py:.*", r"(gymnasium|ap_gym|gym)\..*|_?np_random\w*|set_np_random_through_seed|closed|\w+_space")
]
smartquotes = False  # they turn the two dashes of options into one long one

# Types stand in the parameter lists, in words; signatures show names and defaults.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = True
# Only names of the toolkit become links: those of Python and numpy would need their lists from the network.
numpydoc_xref_ignore = "all"
DEFAULT_LINKS.clear()
numpydoc_xref_aliases = generated.type_links()

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "_generated/gallery",
    "filename_pattern": r"/plot_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 10_000,
    "download_all_examples": False,
    "remove_config_comments": True,
}

html_theme = "pydata_sphinx_theme"
html_title = "tactile-toolkit"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["_generated/extra"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options: dict[str, Any] = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "header_links_before_dropdown": 6,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": [], "install": [], "tour": []}

# Written before any extension lists the sources.
generated.write(ROOT / "docs")


def setup(app: Any) -> None:
    """Let links say where a name is defined, too."""
    app.connect("missing-reference", generated.link_to_public_name)
