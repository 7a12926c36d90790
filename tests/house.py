"""Print the figures by which the shape of the code is judged: `python -m tests.house [FOLDER]`.

They are read by people. No test and no check of a change depends on them.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

NOT_COUNTED = ("data_cards", "tests")
MANY_NAMES = 30
LATE_CONSTANTS = 3
# Documented names that begin with an underscore: of named tuples, and of `os`.
PUBLIC_UNDERSCORED = {"_replace", "_asdict", "_fields", "_exit"}

_ANY = re.compile(r"\bAny\b")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_DEFINITIONS = (ast.ClassDef, *_FUNCTIONS)
_SPACE = {"COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER"}


@dataclass(frozen=True)
class Module:
    """One file: its text and its syntax tree."""

    path: Path
    text: str
    tree: ast.Module

    def every(self, *kinds: type[ast.AST]) -> Iterator[ast.AST]:
        """Return all nodes of these kinds."""
        return (node for node in ast.walk(self.tree) if isinstance(node, kinds))

    def docstrings(self) -> list[ast.stmt]:
        """Return the docstrings of the module, its classes and its functions."""
        owners = [node for node in self.every(ast.Module, *_DEFINITIONS) if ast.get_docstring(node)]
        return [owner.body[0] for owner in owners]

    def statements(self) -> int:
        """Count statements without docstrings."""
        return sum(1 for _ in self.every(ast.stmt)) - len(self.docstrings())

    def code_lines(self) -> int:
        """Count lines that hold more than comments and docstrings."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        lines = {
            line
            for token in tokens
            if tokenize.tok_name[token.type] not in _SPACE
            for line in range(token.start[0], token.end[0] + 1)
        }
        return len(lines.difference(*(range(doc.lineno, doc.end_lineno + 1) for doc in self.docstrings())))

    def has_late_constants(self) -> bool:
        """Whether several constants follow the second definition."""
        starts = [number for number, node in enumerate(self.tree.body) if isinstance(node, _DEFINITIONS)]
        if len(starts) < 2:
            return False
        late = self.tree.body[starts[1] :]
        targets = [node.targets[0] for node in late if isinstance(node, ast.Assign)]
        targets += [node.target for node in late if isinstance(node, ast.AnnAssign)]
        names = [target.id for target in targets if isinstance(target, ast.Name)]
        return sum(name.strip("_").isupper() for name in names) >= LATE_CONSTANTS

    def imported_names(self) -> int:
        """Count the names that import statements bind, anywhere in the file."""
        imports = self.every(ast.Import, ast.ImportFrom)
        return sum(len(node.names) for node in imports if getattr(node, "module", "") != "__future__")

    def local_imports(self) -> int:
        """Count the import statements inside functions."""
        inside = {
            node
            for function in self.every(*_FUNCTIONS, ast.Lambda)
            for node in ast.walk(function)
            if isinstance(node, (ast.Import, ast.ImportFrom))
        }
        return len(inside)

    def private_access(self) -> int:
        """Count accesses to attributes of other objects with one leading underscore."""
        own = ("self", "cls")
        return sum(
            node.attr.startswith("_")
            and not node.attr.startswith("__")
            and node.attr not in PUBLIC_UNDERSCORED
            and not (isinstance(node.value, ast.Name) and node.value.id in own)
            for node in self.every(ast.Attribute)
        )

    def public(self, *kinds: type[ast.AST]) -> list[str]:
        """Return the public names that the module defines with these kinds of statement."""
        names = [node.name for node in self.tree.body if isinstance(node, kinds)]
        return [name for name in names if not name.startswith("_")]


def read(folder: Path) -> list[Module]:
    """Read all modules below a folder."""
    paths = sorted(folder.rglob("*.py"))
    return [Module(path, text := path.read_text(encoding="utf-8"), ast.parse(text)) for path in paths]


def _twice(modules: list[Module], *kinds: type[ast.AST]) -> str:
    uses = Counter(name for module in modules for name in module.public(*kinds))
    twice = [f"{name} x{count}" for name, count in sorted(uses.items()) if count > 1]
    return f"{len(twice)} ({', '.join(twice)})"


def _whole(modules: list[Module]) -> Iterator[str]:
    late = sum(module.has_late_constants() for module in modules)
    yield f"files with {LATE_CONSTANTS} constants after the second definition: {late} of {len(modules)}"
    yield f"imports inside functions: {sum(module.local_imports() for module in modules)}"
    names = sorted((module.imported_names(), module.path.as_posix()) for module in modules)
    counts = [count for count, _ in names]
    above = sum(count > MANY_NAMES for count in counts)
    yield f"names imported a file: median {median(counts):g}, most {names[-1]}, above {MANY_NAMES}: {above}"
    any_lines = sum(bool(_ANY.search(line)) for module in modules for line in module.text.splitlines())
    yield f"lines with Any: {any_lines}"
    yield f"access to private attributes of others: {sum(module.private_access() for module in modules)}"
    yield f"public class names used twice: {_twice(modules, ast.ClassDef)}"
    yield f"public function names used twice: {_twice(modules, *_FUNCTIONS)}"


def _size(name: str, modules: list[Module]) -> str:
    choices = sum(1 for module in modules for _ in module.every(ast.IfExp))
    functions = sum(1 for module in modules for _ in module.every(*_FUNCTIONS))
    statements = sum(module.statements() for module in modules)
    lines = sum(module.code_lines() for module in modules)
    return f"{name:16}{statements:12,}{lines:12,}{100 * choices / functions:16.0f}"


def main(root: Path) -> None:
    """Print all figures of the tree below `root`."""
    names = sorted(path.parent.name for path in root.glob("*/__init__.py"))
    packages = {name: read(root / name) for name in names if name not in NOT_COUNTED}
    modules = [module for package in packages.values() for module in package]
    sizes = [*packages.items(), ("all packages", modules), ("tests", read(root / "tests"))]
    head = f"{'':16}{'statements':>12}{'code lines':>12}{'x if y else z':>16} per 100 functions"
    print(*_whole(modules), head, *(_size(*size) for size in sizes), sep="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
