"""Pages that are written from the code: every public name, every command, the columns of every kind.

``write`` makes them below ``docs/_generated``, which git does not keep, before Sphinx lists its sources.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import episodes
from sphinx.pycode import ModuleAnalyzer

API = (
    "mnist3d",
    "mnist3d.sources",
    "starstruck_gen",
    "realtouch",
    "realtouch.touch_tensors",
    "tactile_sim",
    "tactile_sim.learned",
    "tactile_sim.mujoco",
    "tactile_sim.optics.rendering",
    "env_assets",
    "tactile_envs",
    "tactile_envs.wrappers",
    "tactile_toolkit.run",
    "tactile_toolkit.errors",
)
"""Modules on whose public names users may rely."""

SHARED = (
    "realtouch.contact.CLOCK_TOLERANCE_S",
    "realtouch.contact.contact_heights_m",
    "realtouch.contact.contact_window",
    "starstruck_gen.sampling.COLLISION_RULES",
    "tactile_sim.press.sensors.MESA_SAMPLE_PX",
    "tactile_toolkit.mesh.MeshFile",
    "tactile_toolkit.mesh.printability.WARNINGS",
    "tactile_toolkit.mesh.RecordStream",
    "tactile_toolkit.read.RowStream",
    "tactile_toolkit.mesh.SolidRecord",
    "tactile_toolkit.mesh.solid_check.PROBLEMS",
    "tactile_toolkit.mesh.SolidTensors",
    "tactile_toolkit.mesh.MeshBatch",
    "tactile_toolkit.mesh.MeshItem",
    "tactile_toolkit.mesh.collate_meshes",
    "tactile_toolkit.read.Record",
    "tactile_toolkit.read.RecordDataset",
    "tactile_toolkit.store.Progress",
    "tactile_toolkit.store.RunOptions",
    "realtouch.touches.media.MAX_BATCH_PIXELS",
)
"""What users inherit from several packages, and what public names refer to."""

FOREIGN = (
    "Sequence",
    "dict",
    "tuple",
    "Exception",
    "Dataset",
    "IterableDataset",
    "Protocol",
    "Generic",
    "Wrapper",
    "VectorWrapper",
)
"""Base classes whose members their own packages describe."""


class Name(NamedTuple):
    """A public name: where users find it, and the object."""

    module: str
    name: str
    value: Any

    @property
    def path(self) -> str:
        """What users write."""
        return f"{self.module}.{self.name}"

    @property
    def role(self) -> str:
        """The role of a link to it."""
        if inspect.isclass(self.value):
            return "class"
        return "func" if inspect.isroutine(self.value) else "data"

    @property
    def home(self) -> str:
        """Where it is defined."""
        if self.role == "data":
            return f"{_assigned(self)[0]}.{self.name}"
        return f"{self.value.__module__}.{self.value.__qualname__}"

    @property
    def words(self) -> str:
        """Its docstring, or what stands below the assignment of a constant."""
        return _assigned(self)[1] if self.role == "data" else inspect.getdoc(self.value) or ""


def _assigned(name: Name) -> tuple[str, str]:
    """Return the module that assigns a constant, and the words below the assignment."""
    own = (name.module.partition(".")[0], "tactile_toolkit")
    for path, module in sorted(sys.modules.items()):
        if path.partition(".")[0] in own and vars(module).get(name.name) is name.value:
            analyzer = ModuleAnalyzer.for_module(path)
            analyzer.analyze()
            if words := analyzer.attr_docs.get(("", name.name)):
                return path, "\n".join(words).strip()
    message = f"{name.path} has no words below its assignment"
    raise ValueError(message)


def _names_of(module: Any) -> list[str]:
    """Return the public names that a module lists, or else defines or imports under their own name."""
    names: list[str] = list(getattr(module, "__all__", ()))
    for node in () if names else ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.ImportFrom):
            names += [alias.name for alias in node.names if alias.asname == alias.name]
        elif isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            names.append(node.name)
        elif isinstance(node, ast.Assign):
            names += [target.id for target in node.targets if isinstance(target, ast.Name)]
    return [
        name for name in names if not name.startswith("_") and not inspect.ismodule(getattr(module, name))
    ]


@cache
def public_names() -> tuple[Name, ...]:
    """Return every public name once; a name of two modules is listed under the first."""
    names: dict[Any, Name] = {}
    for module in API:
        loaded = import_module(module)
        for name in _names_of(loaded):
            item = Name(module, name, getattr(loaded, name))
            names.setdefault(item.home, item)
    for path in SHARED:
        module, _, name = path.rpartition(".")
        names[path] = Name(module, name, getattr(import_module(module), name))
    return tuple(names.values())


def type_links() -> dict[str, str]:
    """Return links to classes by the names that lists of parameters use; none for a name of two classes."""
    classes = [name for name in public_names() if inspect.isclass(name.value)]
    counts = Counter(name.name for name in classes)
    return {name.name: f":class:`{name.name} <{name.path}>`" for name in classes if counts[name.name] == 1}


def link_to_public_name(app: Any, env: Any, node: Any, content: Any) -> Any:
    """Resolve a link to the module that defines a name, or to the bare name, as one to the public name."""
    if node.get("refdomain") != "py":
        return None
    owner, _, member = node["reftarget"].lstrip("~.").rpartition(".")
    for target, end in ((node["reftarget"], ""), (owner, f".{member}")):
        for name in public_names():
            if target and target in (name.home, name.name, f"{name.module}.{name.name}"):
                domain = env.domains.python_domain
                role = "meth" if end else name.role
                link = domain.resolve_xref(
                    env, node["refdoc"], app.builder, role, name.path + end, node, content
                ) or domain.resolve_xref(
                    env, node["refdoc"], app.builder, "attr", name.path + end, node, content
                )
                if link is not None:
                    return link
    return None


def write(docs: Path) -> None:
    """Write all pages; unchanged files are not rewritten, so that Sphinx does not read them again."""
    folder = docs / "_generated"
    pages = {**_api_pages(), **_command_pages(), "formats.md": _formats_page()}
    episodes.write(folder / "episodes")
    notebooks = sorted((docs.parent / "notebooks").glob("*.ipynb"))
    pages |= {f"notebooks/{notebook.stem}.md": _notebook_page(notebook) for notebook in notebooks}
    pages |= _plain_pages(docs, pages)
    for path, text in pages.items():
        file = folder / path
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
    page_files = {folder / path for path in pages}
    for kind in ("api", "cli"):
        for file in (folder / kind).iterdir():
            if file not in page_files:
                file.unlink()


def _api_pages() -> dict[str, str]:
    pages = {f"api/{name.path}.rst": _object_page(name) for name in public_names()}
    for module in API:
        pages[f"api/{module}.rst"] = _module_page(module)
    shared = [name for name in public_names() if name.path in SHARED]
    about = "What data sets of all kinds share, and the rules and constants that public names refer to."
    pages["api/shared.rst"] = "\n".join([*_title("Shared names"), about, "", *_listed(shared)])
    lines = [f"   {module}" for module in (*API, "shared")]
    pages["api/index.rst"] = "\n".join(
        [
            *_title("Python"),
            "Every public name. Other names may change with any release.",
            "",
            ".. toctree::",
            "   :maxdepth: 1",
            "",
            *lines,
            "",
        ]
    )
    return pages


def _module_page(module: str) -> str:
    loaded = import_module(module)
    names = [name for name in public_names() if name.module == module and name.path not in SHARED]
    elsewhere = sorted(set(_names_of(loaded)) - {name.name for name in names})
    lines = [*_title(module), f".. py:module:: {module}", "", inspect.cleandoc(loaded.__doc__ or ""), ""]
    also = [name for name in public_names() for alias in elsewhere if getattr(loaded, alias) is name.value]
    if also:
        lines += ["", "Also here: " + ", ".join(f":{name.role}:`{name.path}`" for name in also) + "."]
    return "\n".join([*lines, "", *_listed(names)])


def _listed(names: Iterable[Name]) -> list[str]:
    """Return a table of names with what each is, and the tree of their pages."""
    ordered = sorted(names, key=lambda name: name.name.lower())
    lines = [".. list-table::", "   :widths: 30 70", ""]
    for name in ordered:
        first = " ".join(name.words.split("\n\n")[0].split())
        lines += [f"   * - :{name.role}:`~{name.path}`", f"     - {first}"]
    lines += ["", ".. toctree::", "   :hidden:", ""]
    return [*lines, *(f"   {name.name} <{name.path}>" for name in ordered), ""]


def _object_page(name: Name) -> str:
    lines = [*_title(name.name), f".. currentmodule:: {name.module}", ""]
    if name.role == "class":
        lines += [
            f".. autoclass:: {name.name}",
            "   :members:",
            f"   :inherited-members: {', '.join(FOREIGN)}",
        ]
    elif name.role == "func":
        lines += [f".. autofunction:: {name.name}"]
    else:
        value = repr(name.value)
        lines += [f".. py:data:: {name.name}"]
        lines += [f"   :value: {value}"] if len(value) < 200 and "0x" not in value else []
        lines += ["", *(f"   {line}" for line in name.words.splitlines())]
    return "\n".join(lines) + "\n"


def _notebook_page(notebook: Path) -> str:
    """Write a notebook as a page, with what its cells showed when they were recorded."""
    parts = []
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for shown in cell.get("outputs", ()):
            data = shown.get("data", {"text/plain": shown.get("text", "")})
            if "text/html" in data:
                parts.append("```{raw} html\n" + "".join(data["text/html"]) + "\n```")
            elif "image/png" in data:
                parts.append(
                    f'<img alt="output of the cell" src="data:image/png;base64,{data["image/png"]}">'
                )
            else:
                parts.append("```text\n" + "".join(data["text/plain"]).rstrip() + "\n```")
    return "\n\n".join(parts) + "\n"


def _plain_pages(docs: Path, written: Mapping[str, str]) -> dict[str, str]:
    """Return every page in Markdown, and ``llms.txt``, which lists them: for language models."""
    files = sorted(path for path in docs.rglob("*.md") if path.relative_to(docs).parts[0][0] != "_")
    pages = {path.relative_to(docs).as_posix(): path.read_text(encoding="utf-8") for path in files}
    pages |= {
        f"_generated/{path}": text
        for path, text in written.items()
        if path.endswith(".md") and not path.startswith("notebooks/")
    }
    lines = []
    for path, text in pages.items():
        heading, _, body = text.partition("\n\n")
        first = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", " ".join(body.partition("\n\n")[0].split()))
        if heading.startswith("# ") and not path.endswith("index.md"):
            lines.append(f"- [{heading[2:]}]({path}): {first}")
    about = " ".join(pages["index.md"].split("\n\n")[1].split())
    pages["llms.txt"] = "\n".join(["# tactile-toolkit", "", f"> {about}", "", "## Pages", "", *lines, ""])
    return {f"extra/{path}": text for path, text in pages.items()}


def _title(text: str) -> list[str]:
    return [text, "=" * len(text), ""]


def _command_pages() -> dict[str, str]:
    from importlib.metadata import entry_points

    names = [point.name for point in entry_points(group="console_scripts") if point.value.startswith("cli.")]
    pages = {f"cli/{name}.md": _command_page(name) for name in names}
    listed = "\n".join(sorted(names))
    pages["cli/index.md"] = (
        "# Command lines\n\n"
        "Every option of every command, as `--help` shows it. Exit codes: "
        "0 success, 1 validation failed, 2 wrong input, 3 damaged or missing data, 4 the Hub, a store or "
        "the network, 130 interrupted.\n\n"
        f"```{{toctree}}\n:maxdepth: 2\n\n{listed}\n```\n"
    )
    return pages


def _command_page(name: str) -> str:
    """Write a command line with all its commands, from the objects that Typer builds."""
    import typer
    from typer.cli import get_docs_for_click

    group: Any = typer.main.get_command(import_module(f"cli.{name.replace('-', '_')}").app)
    parts = [f"# {name}\n\n{group.help}\n"]
    for word, command in group.commands.items():
        text = get_docs_for_click(obj=command, ctx=typer.Context(command), name=f"{name} {word}", indent=1)
        text = re.sub(r"^## `.*`$", f"## {name} {word}", text, count=1, flags=re.MULTILINE)
        text = re.sub(r"^Example: (.*)$", r"```bash\n\1\n```", text, flags=re.MULTILINE)
        text = text.replace("**Usage**:", "").replace("**Options**:", "").replace("**Arguments**:", "")
        parts.append("".join(_outside_code(text)))
    return "\n".join(parts)


def _outside_code(text: str) -> Iterator[str]:
    """Keep ``<`` and ``*`` of plain text from being read as markup."""
    for index, part in enumerate(re.split(r"(```.*?```|`[^`\n]*`)", text, flags=re.DOTALL)):
        if index % 2:
            yield part
        else:
            yield re.sub(r"(?<!^)\*", r"\\*", part.replace("<", "&lt;"), flags=re.MULTILINE)


def _formats_page() -> str:
    """Write the columns of every kind of data set, from schemas and from the words of their cards."""
    import pyarrow as pa

    from env_assets.wrench.dataset import WrenchRow, wrench_schema
    from mnist3d.digit_records import DigitRow, digit_schema
    from realtouch.touch_card import WORDS
    from realtouch.touches.schema import KNOWN_COLUMNS
    from starstruck_gen.scene_dataset import SceneRow, scene_schema
    from tactile_sim import ElasticPress
    from tactile_sim.sets.generation import SyntheticRound, synthetic_schema
    from tactile_sim.sets.round_press import elastic_types
    from tactile_toolkit.cards import FolderSummary
    from tactile_toolkit.cards.card import Card, field_table, markdown_table

    def table(schema: Any, row_type: Any) -> str:
        return field_table(FolderSummary((), schema), row_type.meanings()).replace(
            "frame below", "frame of the mesh"
        )

    press = ElasticPress(markers=(7, 9), contact_maps=True)
    further = {"plate_z_m": pa.float64(), **elastic_types(press, (64, 64))}
    meant = Card.words(WORDS)["columns"]["rounds"]
    rows = [
        (f"`{column}`", words, *meant.get(column, ("", "")))
        for column, (_, _, words) in KNOWN_COLUMNS.items()
    ]
    parts = [
        "# Columns\n\nThis page lists the columns of every kind of data set. Names "
        "with a dot are flat columns, as in the published data sets. See also [the data set folder]"
        "(../concepts/folder.md) and [frames and units](../concepts/frames.md).",
        "## Digits (`mnist3d`)\n\n" + table(digit_schema(), DigitRow),
        "## Scenes (`starstruck`)\n\n" + table(scene_schema(), SceneRow),
        "## Real touches (`realtouch`)\n\nA row is a round: T touches of one object; N is the number of "
        "frames of the longest clip. A data set holds clips (`sensor_video`) or images (`sensor_image`). "
        "Other columns are kept unchanged.\n\n"
        + markdown_table(("column", "type", "shape, unit, frame", "meaning"), rows),
        "## Synthetic touches (`tactile-sim`)\n\nThe columns after those of the touched object exist only "
        "for gels of another thickness and for elastic gels, here with 7 x 9 markers and 64 x 64 pixels.\n\n"
        + table(synthetic_schema(tuple(map(str, range(10))), further), SyntheticRound),
        "## The wrench (`env-assets`)\n\n" + table(wrench_schema(), WrenchRow),
    ]
    return "\n\n".join(parts) + "\n"
