"""Licence, authors, title and citation that the owner of a data set states for its card."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

import starstruck_gen
from tactile_toolkit.cards.owner import LICENCES, read_licence
from tests.command_line import call

BIBTEX = "@misc{mine, title={My digits}, author={Lovelace, Ada}}"
WORDS = (
    *("--license", "CC-BY-4.0", "--author", "Ada Lovelace"),
    *("--author", "É. *x* <b>", "--title", "My # digits"),
)


def card_of(folder: Path) -> tuple[dict[str, Any], str]:
    _, head, body = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    return yaml.safe_load(head), body


def section(body: str, heading: str) -> str:
    return body.partition(f"## {heading}\n\n")[2].partition("\n## ")[0]


@pytest.fixture
def digits(digits_set: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(digits_set, tmp_path / "set"))


def test_words_are_in_head_and_text_and_stay(digits: Path) -> None:
    before, plain = card_of(digits)
    assert call("tactile", "card", digits, *WORDS, "--citation", BIBTEX) == 0
    head, body = card_of(digits)
    assert (head["license"], head["pretty_name"]) == ("cc-by-4.0", "My # digits")
    assert head["owner"]["author"] == ["Ada Lovelace", "É. *x* <b>"]
    assert body.strip().startswith("# My # digits\n\nBy Ada Lovelace, É. \\*x\\* \\<b\\>.\n")
    assert section(body, "Licence").strip() == "cc-by-4.0, as the owner of the data set states."
    assert section(body, "Citation").startswith(
        f"```bibtex\n{BIBTEX}\n```\n\n{section(plain, 'Citation')[:40]}"
    )
    assert {name for name in head if head[name] != before.get(name)} == {"license", "pretty_name", "owner"}
    assert call("tactile", "verify", digits) == 0
    # The words stay when the card is written again, also by a run; each can be replaced.
    assert call("tactile", "card", digits) == 0
    assert card_of(digits) == (head, body)
    assert call("tactile", "card", digits, "--license", "cc0-1.0") == 0
    again, text = card_of(digits)
    assert again["owner"] == {**head["owner"], "license": "cc0-1.0"}
    assert "cc-by-4.0" not in text
    assert "cc-by-4.0" not in str(again)


def test_generate_takes_the_words_and_the_rows_do_not_depend_on_them(tmp_path: Path) -> None:
    options = ("--split", "test", "--limit", 1, "--vertices", 2_000)
    assert call("mnist3d", "generate", *options, "--out", tmp_path / "plain") == 0
    assert call("mnist3d", "generate", *options, *WORDS, "--out", tmp_path / "named") == 0
    for path in sorted((tmp_path / "plain").rglob("*")):
        if path.is_file() and path.name != "README.md":
            assert (
                tmp_path / "named" / path.relative_to(tmp_path / "plain")
            ).read_bytes() == path.read_bytes()
    plain, named = card_of(tmp_path / "plain"), card_of(tmp_path / "named")
    assert "owner" not in plain[0]
    assert named[0]["owner"]["license"] == "cc-by-4.0"
    # A run that has nothing to make keeps them.
    assert call("mnist3d", "generate", *options, "--out", tmp_path / "named") == 0
    assert card_of(tmp_path / "named") == named


def test_other_kinds_have_the_same_words(tmp_path: Path) -> None:
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 1),)), tmp_path / "scenes")
    assert call("tactile", "card", tmp_path / "scenes", *WORDS) == 0
    head, body = card_of(tmp_path / "scenes")
    assert head["license"] == "cc-by-4.0"
    assert section(body, "Licence").strip() == "cc-by-4.0, as the owner of the data set states."
    assert call("tactile", "verify", tmp_path / "scenes") == 0


@pytest.mark.parametrize("citation", ["Lovelace 1843, *Notes*", "bib"])
def test_a_citation_may_be_text_or_a_file(citation: str, digits: Path, tmp_path: Path) -> None:
    given, shown = citation, "Lovelace 1843, \\*Notes\\*"
    if citation == "bib":
        (tmp_path / "mine.bib").write_text(f"{BIBTEX}\n", encoding="utf-8")
        given, shown = str(tmp_path / "mine.bib"), f"```bibtex\n{BIBTEX}\n```"
    assert call("tactile", "card", digits, "--citation", given) == 0
    assert section(card_of(digits)[1], "Citation").startswith(f"{shown}\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--license", "cc-by-9"), "expected one of cc-by-2.0, cc-by-2.5"),
        (("--license", "mine"), "expected one of cc0-1.0"),
        (("--title", " "), "--title is ' '; expected one line"),
        (("--author", "a\nb"), "--author is"),
        (("--author", "a\u202eb"), "--author is"),
        (("--title", "x" * 201), "expected one line of 1 to 200 characters"),
        (("--citation", "@misc{a, title={b}"), "its braces do not match"),
        (("--citation", "none.bib"), "cannot be read (No such file or directory)"),
    ],
)
def test_invalid_words_are_named(words: tuple[str, str], message: str, digits: Path, capsys: Any) -> None:
    before = (digits / "README.md").read_bytes()
    assert call("tactile", "card", digits, *words) == 2
    assert message in capsys.readouterr().err
    assert (digits / "README.md").read_bytes() == before


def test_a_head_that_was_changed_by_hand_is_checked(digits: Path, capsys: Any) -> None:
    path = digits / "README.md"
    text = path.read_text(encoding="utf-8")
    for owner in ("owner: {license: mine}", "owner: {author: [3]}", "owner: {author: 3}"):
        path.write_text(text.replace("---\n", f"---\n{owner}\n", 1), encoding="utf-8")
        assert call("tactile", "card", digits) == 2
        assert "correct 'owner' in its head" in capsys.readouterr().err
    path.write_text(text.replace("---\n", "---\nowner: {author: Jane Doe}\n", 1), encoding="utf-8")
    assert call("tactile", "card", digits) == 0
    assert card_of(digits)[0]["owner"] == {"author": ["Jane Doe"]}
    # An unreadable card is written again.
    path.write_text("---\n: : :\n---\n", encoding="utf-8")
    assert call("tactile", "card", digits, "--license", "mit") == 0
    assert card_of(digits)[0]["owner"] == {"license": "mit"}


def test_licences_are_identifiers() -> None:
    assert len(set(LICENCES)) == len(LICENCES)
    assert all(read_licence(name.upper()) == name for name in LICENCES)
