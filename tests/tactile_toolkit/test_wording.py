"""Texts: numbers with what they count, and text from data, which is shown literally and never interpreted."""

from __future__ import annotations

import json
import pickle
from io import StringIO

import pyarrow as pa
import pytest
import yaml
from hypothesis import example, given, strategies as st

from cli.output import Sink
from tactile_toolkit.cards.card import column_type_text, markdown_table
from tactile_toolkit.cards.yaml_head import head_text
from tactile_toolkit.errors import InputError, ItemError, UnfinishedError
from tactile_toolkit.read.schemas import yaml_features
from tactile_toolkit.wording import (
    class_name,
    markdown_code,
    markdown_text,
    printable,
    printable_json,
    with_count,
)

WILD = [
    *("[/b0]", "part[b]one.stl", "\x1b[2J\x07", "\u202egnp.exe"),
    *("\u2066x\u2069", "a\x9b31m", "\x85\u2028\x00", ":smile:"),
]
wild = st.text() | st.sampled_from(WILD)


@pytest.mark.parametrize("kind", [InputError, UnfinishedError])
def test_problem_and_next_step_stay_apart_for_any_path(kind):
    error = pickle.loads(pickle.dumps(kind("'a; next: b' is none", next="give another")))
    assert error.what == "'a; next: b' is none"
    assert str(error) == "'a; next: b' is none; next: give another"


@given(wild)
def test_escapes_show_which_characters_there_were(text):
    shown = printable(text)
    assert shown.isprintable()
    assert text.isprintable() is (shown == text)
    if "\\" not in text:
        assert shown.encode("ascii", "backslashreplace").decode("unicode_escape") == text
    kept = printable(text, keep="\n")
    assert kept.count("\n") == text.count("\n")
    assert kept.replace("\n", "").isprintable()


@given(st.recursive(wild | st.integers(), lambda inner: st.lists(inner) | st.dictionaries(wild, inner)))
def test_json_escapes_invisible_characters(values):
    text = printable_json(values)
    assert json.loads(text) == values
    assert text.replace("\n", "").isprintable()


@given(wild)
def test_messages_are_printable(text):
    for error in (InputError(text), ItemError("no-ink", text)):
        assert str(error) == printable(text)


@given(st.lists(wild, min_size=1, max_size=3))
@example(WILD[:3])
def test_the_command_line_prints_data_as_text(texts):
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdout", out)
        patch.setattr("sys.stderr", err)
        sink = Sink()
        sink.table(texts, [texts, texts], title=texts[0])
        sink.line(texts[0])
        sink.info(texts[0])
    for text in (out.getvalue(), err.getvalue()):
        assert text.replace("\n", "").isprintable()
    assert err.getvalue() == printable(texts[0], keep="\n") + "\n"
    assert out.getvalue().endswith(err.getvalue())


@pytest.mark.parametrize("text", WILD)
def test_cells_of_tables_are_shown_in_full(text, capsys):
    """A file called part[b]one.stl was reported as partone.stl, and a class called [/b0] was a traceback."""
    Sink().table(("name",), [(text,)], title=text)
    assert capsys.readouterr().out.count(printable(text).strip()) == 2


@given(wild)
def test_the_head_of_a_card_keeps_its_values(text):
    head = head_text({"pretty_name": text, "tags": ["日本", text]})
    assert head.replace("\n", "").isprintable()
    start, found, end = head.split("---\n")
    assert (start, end) == ("", "") or "---" in text
    if "---" not in text:
        assert yaml.safe_load(found) == {"pretty_name": text, "tags": ["日本", text]}


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("[x](javascript:y)", r"\[x\](javascript:y)"),
        ("<script>", r"\<script\>"),
        ("**a** `b` _c_ ~d~", r"\*\*a\*\* \`b\` \_c\_ \~d\~"),
        ("x_mm &amp; \\", r"x_mm \&amp; " + "\\\\"),
        ("$rows$", "&#36;rows&#36;"),
        ("\u202e\x1b", r"\\u202e\\x1b"),
    ],
)
def test_marks_of_markdown_are_text(text, shown):
    assert markdown_text(text) == shown


@given(wild)
def test_code_in_a_card_ends_where_it_should(text):
    code = markdown_code(text)
    fence = code[: len(code) - len(code.lstrip("`"))]
    inside = code[len(fence) : -len(fence)] if fence else ""
    assert code.isprintable()
    assert fence
    if text.strip("` ") == text and text:
        assert inside.strip() == printable(text)
        assert fence not in inside.replace("`" * (len(fence) + 1), "")


@pytest.mark.parametrize("name", WILD)
def test_classes_in_a_card_are_text(name):
    features = {"label": {"names": [name, "b|c"], "_type": "ClassLabel"}}
    schema = pa.schema([pa.field("label", pa.int64())])
    schema = schema.with_metadata({"huggingface": json.dumps({"info": {"features": features}})})
    (entry,) = yaml_features(schema)
    told = column_type_text(entry)
    assert told == f"ClassLabel: {markdown_text(name)}, b|c"
    assert told.isprintable()
    assert len(markdown_table(("type",), [(told,)]).splitlines()) == 3


@pytest.mark.parametrize(
    ("count", "things", "words"),
    [
        (1, "digits", "1 digit"),
        (1, "touches", "1 touch"),
        (1, "boxes", "1 box"),
        (1, "classes", "1 class"),
        (1, "other objects", "1 other object"),
        (1, "vertices", "1 vertex"),
        (1, "such entries", "1 such entry"),
        (1, "bodies", "1 body"),
        (0, "rounds", "0 rounds"),
        (2_000, "scenes", "2,000 scenes"),
    ],
)
def test_one_thing_is_one(count, things, words):
    assert with_count(count, things) == words


def test_a_class_without_a_name_is_its_number():
    assert [class_name(("zero", "one"), label) for label in (0, 1, 2, -1)] == ["zero", "one", "2", "-1"]
