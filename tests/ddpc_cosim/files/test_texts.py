"""Texts of others, made harmless for what shows them."""

import unicodedata

import pytest
from hypothesis import given, strategies as st

from ddpc_cosim.files.texts import (
    DeepTablesError,
    clipped,
    encodable,
    printable,
    recorded,
    toml_tables,
    without_folders,
)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("10 \xb0C, \u03bc = 5\xa0%", "10 \xb0C, \u03bc = 5\xa0%"),
        ("\x1b[31mred\x07", "\\x1b[31mred\\x07"),
        ("\x9b31m", "\\x9b31m"),
        ("one\ntwo\r\tthree\u2028", "one\\ntwo\\r\\tthree\\u2028"),
        ("fmu.\u202exe", "fmu.\\u202exe"),
        ("half \ud800", "half \\ud800"),
        ("\x00", "\\x00"),
    ],
)
def test_what_acts_is_written_out_and_the_rest_is_left(text: str, shown: str) -> None:
    assert printable(text) == shown


@given(st.text(st.characters()), st.integers(40, 200))
def test_any_text_can_be_shown_and_stored(text: str, longest: int) -> None:
    shown = printable(text, longest)
    assert all(c.isprintable() or unicodedata.category(c) == "Zs" for c in shown)
    assert shown.encode().decode() == shown


def test_a_long_text_is_cut_and_says_so() -> None:
    shown = printable("x" * 50_000_000, 100)
    assert len(shown) == 100
    assert shown.endswith("x ... (50000000 characters)")


def test_characters_can_be_kept() -> None:
    assert printable("one\ntwo\x1b", keep="\n") == "one\ntwo\\x1b"


@given(st.text(st.characters()))
def test_any_text_can_be_encoded_and_those_that_can_are_left(text: str) -> None:
    assert encodable(text).encode().decode() == encodable(text)
    assert encodable(encodable(text)) == encodable(text)


def test_a_file_name_that_the_locale_cannot_say_is_taken_for_utf_8() -> None:
    assert encodable("größe/x".encode().decode("ascii", "surrogateescape")) == "größe/x"
    assert encodable("gr\udcf6sse") == "gr\ufffdsse"


def test_what_a_run_keeps_is_printable_and_short_whatever_it_is() -> None:
    class WordlessError(Exception):
        def __str__(self) -> str:
            raise KeyError

    assert recorded("one\ntwo\0") == "one\ntwo\\x00"
    assert len(recorded("x" * 131_073)) == 2000
    assert recorded(WordlessError()) == "WordlessError without words: they raise KeyError"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/jo/x/plant.fmu: cannot be read", "plant.fmu: cannot be read"),
        ("no file '/data/John Doe/a b.csv'", "no file 'a b.csv'"),
        ("/data/John Doe/my plant.fmu", "my plant.fmu"),
        ("files = [/home/x/y.fmu, ~/b.fmu]", "files = [y.fmu, b.fmu]"),
        (r"C:\Users\jo\a.fmu and \\host\share\b.fmu", "a.fmu and b.fmu"),
        ("run file:///home/x/y.toml --out=/tmp/z/o", "run y.toml --out=o"),
    ],
)
def test_files_are_named_without_their_folders(text: str, shown: str) -> None:
    assert without_folders(text) == shown


@pytest.mark.parametrize(
    "text",
    ["3 m/s and 2 /s", "see https://doi.org/10.1000/x and 1/2/3", r"\x1b[31m \u202e \n", "motor/speed/x"],
)
def test_what_is_no_path_is_left(text: str) -> None:
    assert without_folders(text) == text


def test_a_home_folder_with_a_blank_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/John Doe")
    monkeypatch.setenv("USERPROFILE", "/home/John Doe")
    assert without_folders("/home/John Doe/a.fmu: gone") == "a.fmu: gone"


def test_a_long_name_keeps_both_ends_and_knows_all_of_it() -> None:
    name = "first" + "x" * 10_000 + "last"
    short = clipped(clipped(name, 100), 30)
    assert len(short) == 30
    assert (short[:5], short[-4:], "…" in short) == ("first", "last", True)
    assert getattr(short, "full", "") == name
    assert clipped("short") == "short"


DOTS = ".".join(101 * "a")


@pytest.mark.parametrize(
    "text",
    [
        ".".join(20_000 * "a") + " = 1",
        f"b = 1\n[{DOTS}]",
        f"b = {{ {DOTS} = 1 }}",
        " . ".join(101 * ["a"]) + " = 1",
        ".".join(101 * ['"a b"']) + " = 1",
        ".".join(101 * ["'a.b'"]) + " = 1",
        f'b = "\\""\n{DOTS} = 1',
    ],
    ids=lambda text: text[-30:],
)
def test_a_key_of_very_many_parts_is_refused_before_it_is_read(
    text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What reads it takes the square of their number."""
    monkeypatch.delattr("tomllib.loads")
    with pytest.raises(DeepTablesError, match="tables within tables; allowed: 100 levels"):
        toml_tables(text)


@pytest.mark.parametrize(
    "value",
    [
        f'"{DOTS}"',
        f"'{DOTS}'",
        f'"""\n"{DOTS}\\""""',
        f"'''\n{DOTS}'''",
        f'"\\"{DOTS}"  # {DOTS}',
        f"1  # '{DOTS}'",
    ],
)
def test_texts_and_comments_may_have_dots(value: str) -> None:
    assert toml_tables(f"# it's\na.b = {value}\n")["a"].keys() == {"b"}
