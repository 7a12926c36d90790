"""Shared parts of all command lines: groups of options, common options, errors, completion, closed pipes."""

from __future__ import annotations

import errno
import os
import re
import shlex
import subprocess
import sys
from dataclasses import MISSING, dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from cli.application import command, new_app, run
from cli.options import FOLDER, GenerateOptions
from cli.output import Sink
from tactile_toolkit.checked_fields import integer, switch
from tactile_toolkit.errors import InputError, IntegrityError, RemoteError, ToolkitError
from tests.command_line import call
from tests.processes import printed_by

PACKAGES = {
    "tactile_toolkit": "tactile",
    "mnist3d": "mnist3d",
    "starstruck_gen": "starstruck",
    "realtouch": "realtouch",
    "tactile_sim": "tactile-sim",
    "env_assets": "env-assets",
    "tactile_envs": "tactile-envs",
}
COMMAND = {
    "tactile-sim": "calibrate",
    "realtouch": "check",
    "env-assets": "wrench",
    "tactile-envs": "list",
    "tactile": "verify",
}
COMMAND_LINES = [name.replace("-", "_") for name in PACKAGES.values()]


@dataclass(frozen=True)
class Size:
    width: int = integer(MISSING, 1, help="Width.")
    height: int = integer(2, name="--tall", help="Height.")


def test_a_command_gets_the_objects_and_help_names_the_options(tmp_path):
    app, got = new_app("toy", "A toy."), {}

    @command(app)
    def make(
        *,
        folder: str = FOLDER,
        size: Size,
        seed: int = integer(0, help="Seed."),
        run_options: GenerateOptions,
        sink: Sink,
    ) -> None:
        """Make it."""
        got.update(locals())

    result = CliRunner().invoke(app, ["make", str(tmp_path), "--width", "3", "--tall", "4", "-w", "2", "-q"])
    assert result.exit_code == 0, result.output
    assert got["size"] == Size(3, 4)
    assert (got["folder"], got["seed"]) == (str(tmp_path), 0)
    assert got["run_options"] == GenerateOptions(workers=2)
    assert got["sink"] == Sink(quiet=True)
    text = CliRunner().invoke(app, ["make", "--help"], env={"TERMINAL_WIDTH": "100"}).output
    options = ["--width", "--tall", "--seed", "--workers", "--dry-run", "--json", "--quiet"]
    assert sorted(options, key=text.index) == options
    assert CliRunner().invoke(app, ["make", str(tmp_path)]).exit_code == 2, "--width has no default"
    assert CliRunner().invoke(app, ["make", str(tmp_path), "--width", "0"]).exit_code == 2


def failing(error: Exception) -> typer.Typer:
    """Return an application whose only command ``break`` raises an error."""
    app = new_app("toy", "A toy.")

    @command(app, "break")
    def broken(sink: Sink) -> None:
        raise error

    return app


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (IntegrityError("it is damaged"), 3, "error: it is damaged\n"),
        # A lack of file handles is not a wrong path.
        (OSError(errno.EMFILE, "Too many open files", "a.csv"), 2, "'a.csv': Too many open files; next: "),
        (MemoryError(), 2, "error: there is not enough memory; next: "),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), 2, "error: there is not enough memory; next: "),
        (ImportError("_path.so: failed to map segment"), 2, "error: there is not enough memory; next: "),
    ],
)
def test_errors_are_a_line_and_an_exit_code(error, code, line, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["toy", "break"])
    with pytest.raises(SystemExit) as caught:
        run(failing(error))
    assert caught.value.code == code
    told = capsys.readouterr().err
    assert line in told
    assert told.startswith("error: ")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        "starstruck generate --dry-run --out NAME",
        "env-assets wrench --out NAME",
    ],
)
def test_a_path_that_the_system_refuses_is_input(words, tmp_path, monkeypatch, capsys):
    """A traceback would end with 1, like failed validations."""
    monkeypatch.chdir(tmp_path)
    name = "a" * 300
    assert call(*words.replace("NAME", name).split()) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert name in said
    assert "name too long" in said.lower()
    assert said.count("\n") == 1
    with pytest.raises(Exception, match="name too long"):
        call(*words.replace("NAME", name).split(), "--debug")
    assert list(tmp_path.iterdir()) == []


def test_pandas_is_left_out_before_a_command_begins(monkeypatch):
    """It would swallow a Ctrl-C during its import by pyarrow."""
    app, order = new_app("toy", "A toy."), []
    monkeypatch.setattr("tactile_toolkit.run.this_process.skip_pandas", lambda: order.append("left out"))

    @command(app)
    def make(sink: Sink) -> None:
        order.append("begun")

    assert CliRunner().invoke(app, ["make"]).exit_code == 0
    assert order == ["left out", "begun"]


def test_two_options_of_one_name_are_a_mistake_of_ours():
    with pytest.raises(ValueError, match="duplicate parameter name: 'quiet'"):

        @command(new_app("toy", "A toy."))
        def twice(*, sink: Sink, quiet: bool = switch(False, help="Twice.")) -> None:
            """Take --quiet twice."""


HEAVY = (
    *("PIL", "av", "datasets", "httpx", "huggingface_hub", "manifold3d", "numpy", "pandas", "pyarrow"),
    *("markdown_it", "pydantic", "pygments", "rich", "scipy", "skimage", "tactile_mnist", "torch", "trimesh"),
    "yaml",
)
HELPS = """
import sys
from cli.{line} import app, main
from typer.main import get_command_name
names = [info.name or get_command_name(info.callback.__name__) for info in app.registered_commands]
for words in (["--version"], *([name, "--help"] for name in names), ["--help"]):
    sys.argv = [app.info.name, *words]
    try:
        main()
    except SystemExit as leave:
        assert not leave.code, words
    heavy = {heavy} & {{name.partition(".")[0] for name in sys.modules}}
    assert not heavy, (words, heavy)
"""


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("line", COMMAND_LINES)
def test_no_help_of_any_command_imports_a_heavy_library(line):
    said = printed_by(HELPS.format(line=line, heavy=set(HEAVY)))
    _, *helps, whole = said.split("Usage: ")
    assert f"{line.replace('_', '-')} [OPTIONS] COMMAND" in whole
    for text in helps:
        name = text.split()[1]
        assert f"\n  Example: {line.replace('_', '-')} {name} " in text, name
        # Users do not know the names of types in Click.
        assert not re.search(r"<(bool|str|int range|float( range)?)>|list\[|default: \(", text), name


def test_every_command_documents_version_and_debug():
    for line in COMMAND_LINES:
        module = import_module(f"cli.{line}")
        group = typer.main.get_command(module.app)
        assert {"--install-completion", "--show-completion"} <= _options(group)
        for name, each in {"": group, **group.commands}.items():
            assert {"--version", "--debug", "--help"} <= _options(each), (module.__name__, name)


def _options(command) -> set[str]:
    context = typer.Context(command)
    return {option for parameter in command.get_params(context) for option in parameter.opts}


@pytest.mark.parametrize("place", ["before", "after"])
def test_debug_lets_the_traceback_through(place, monkeypatch):
    monkeypatch.delenv("TACTILE_TOOLKIT_DEBUG", raising=False)
    monkeypatch.setattr("os.environ", dict(os.environ))
    words = ["--debug", "break"] if place == "before" else ["break", "--debug"]
    assert isinstance(
        CliRunner().invoke(failing(IntegrityError("it is damaged")), words).exception, IntegrityError
    )


def test_commands_run_without_being_on_the_path():
    def run(*words):
        return subprocess.run(
            [sys.executable, "-m", "cli", *words], capture_output=True, text=True, check=False
        )

    done = run("env-assets", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (
        0,
        f"tactile-toolkit {version('tactile-toolkit')}\n",
        "",
    )
    refused = run("cat")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("error: 'cat' is no command; expected one of ")
    assert all(program in refused.stderr for program in PACKAGES.values())


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_have_a_version(package, capsys):
    assert import_module(package).__version__ == version("tactile-toolkit")
    line = f"tactile-toolkit {version('tactile-toolkit')}\n"
    program = PACKAGES[package]
    command = COMMAND.get(program, "generate")
    assert call(program, command, "--version") == 0
    assert capsys.readouterr() == (line, "")
    assert call(program, command[:-1]) == 2
    said = capsys.readouterr().err
    assert f"Usage: {program} " in said
    assert f"Did you mean '{command}'?" in said


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("package", PACKAGES)
def test_shells_complete_commands_options_and_choices(package, monkeypatch, capsys):
    name = PACKAGES[package]
    with monkeypatch.context() as shell:
        shell.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
        assert call(name, "--show-completion", "bash") == 0
    script = capsys.readouterr()
    assert script.err == ""
    assert f"complete -o default -F _{name.replace('-', '_')}_completion {name}" in script.out
    monkeypatch.setenv(f"_{name.replace('-', '_').upper()}_COMPLETE", "complete_bash")
    command = COMMAND.get(name, "generate")
    lines = [(f"{name} {command[:-1]}", command), (f"{name} {command} --j", "--json")]
    lines += [(f"{name} export --plate prusa-mk", "prusa-mk4")] * (name == "tactile")
    for line, word in lines:
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
        assert call(name) == 0
        assert word in capsys.readouterr().out.split()


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("words", [["--help"], ["verify", "missing"], ["cache"]])
def test_a_closed_pipe_ends_a_command_as_it_ends_other_tools(tmp_path, words):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "cli", "tactile", *words],
            cwd=tmp_path,
            stdout=closed,
            stderr=closed if words[-1] == "missing" else subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr or "") == (141, "")


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("words", "redirected", "code", "why"),
    [
        (["cache"], ">/dev/full", 2, "No space left on device"),
        (["--help"], ">/dev/full", 2, "No space left on device"),
        (["--version"], ">&-", 0, ""),
    ],
)
def test_an_output_that_cannot_be_written_is_named(tmp_path, words, redirected, code, why):
    done = _redirected(tmp_path, words, redirected)
    message = f"error: the output cannot be written: {why}; next: redirect it to another place\n"
    assert (done.returncode, done.stderr) == (code, message if why else "")


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("redirected", ["<&- >&- 2>&-", "2>/dev/full"])
def test_the_exit_code_needs_no_stream(tmp_path, redirected):
    assert _redirected(tmp_path, ["verify", "missing"], redirected).returncode == 2


@pytest.mark.thorough
def test_a_file_does_not_take_the_number_of_a_closed_stream(tmp_path):
    """Output of a library there would end up in the file."""
    words = ["generate", "--scenes", "train=3", "--workers", "1", "--out", "scenes", "--quiet"]
    done = _shell(tmp_path, [sys.executable, "-m", "cli", "starstruck", *words], "<&- >&- 2>&-")
    assert done.returncode == 0
    assert call("tactile", "verify", tmp_path / "scenes") == 0
    code = (
        "import os, sys\n"
        "from cli.application import new_app, run, command\n"
        "app = new_app('toy', 'A toy.')\n"
        "@command(app)\n"
        "def write():\n"
        "    with open('made', 'w') as file:\n"
        "        os.system('echo printed')\n"
        "        file.write('data')\n"
        "sys.argv = ['toy', 'write']\n"
        "run(app)\n"
    )
    done = _shell(tmp_path, [sys.executable, "-c", code], ">&-")
    assert (done.returncode, done.stderr, (tmp_path / "made").read_text()) == (0, "", "data")


def _redirected(folder: Path, words: list[str], redirected: str) -> subprocess.CompletedProcess[str]:
    return _shell(folder, [sys.executable, "-m", "cli", "tactile", *words], redirected)


def _shell(folder: Path, words: list[str], redirected: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        f"{shlex.join(words)} {redirected}",
        shell=True,
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "words", ["mnist3d generate --dry-run --out NAME", "tactile info NAME", "tactile gallery NAME"]
)
def test_a_name_that_is_not_text_is_refused(words, tmp_path, monkeypatch, capsys):
    """As Python decodes bytes that are not UTF-8."""
    monkeypatch.chdir(tmp_path)
    assert call(*(word.replace("NAME", "caf\udce9") for word in words.split())) == 2
    said = capsys.readouterr().err
    assert said == "error: 'caf\\udce9' is not valid UTF-8; next: give another name\n"


@pytest.mark.thorough
def test_a_library_that_does_not_fit_into_memory_is_named(tmp_path):
    code = """
    import resource, sys
    from pathlib import Path
    from cli.tactile import main
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + 32_000_000
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    sys.argv = ["tactile", "info", sys.argv[1]]
    sys.stderr = sys.stdout
    try:
        main()
    except SystemExit as leave:
        print(leave.code)
    """
    said = printed_by(code, tmp_path).splitlines()
    assert said[-1] == "2"
    assert said[0].startswith("error: there is not enough memory; next: ")
    assert len(said) == 2


def test_messages_about_refused_values_are_plain(capsys):
    assert call("mnist3d", "generate", "--split-by", "foo", "--out", "never") == 2
    said = capsys.readouterr().err
    assert "'--split-by': 'foo' is not one of 'digit'" in said
    assert "Value error" not in said


def test_exit_codes_are_those_of_the_documentation() -> None:
    """By exit codes, scripts distinguish a wrong argument from a damaged file."""
    found = [each.exit_code for each in (ToolkitError, InputError, IntegrityError, RemoteError)]
    assert found == [1, 2, 3, 4]
