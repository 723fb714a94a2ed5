"""Texts of others: names, descriptions and errors that go to a terminal, a table or a file."""

import re
from pathlib import Path
from typing import Any

from ddpc_cosim.files.durations import in_words as in_words
from fmu_plants.texts import encodable as encodable, printable as printable

_LONGEST_RECORDED = 2000
_PATH = re.compile(r"""(?:(?:file://|~)?/|[A-Za-z]:[/\\]|\\\\)(?:(?!\s(?:[/\\~]|[A-Za-z]:))[^\n:;,"'])*""")
_FOLDER = r"""[^/\\\s"'<>|*?:;,()]+[/\\]"""
_FOLDERS = re.compile(
    r"""(?<=["'])(?:(?:file://|~)?/|[A-Za-z]:[/\\]|\\\\)[^"'\n]*[/\\](?=[^"'/\\\n]+["'])"""  # with blanks
    rf"""|(?<![^\s"'(\[{{=,;:])(?:(?:file://)?/{_FOLDER}|~/|[A-Za-z]:[/\\]|\\\\)(?:{_FOLDER})*(?=[^/\\\s])"""
)
"""Folders of an absolute path, up to the name of the file."""
_FORMULA = re.compile(r"[=@]|[+-](?![\d.]+(?:[eE][+-]?\d+)?$)")
DEEPEST = 100
"""How many tables within tables a TOML file may have."""
# Possessive, and from the beginning of a word only: the time is in proportion to the text.
_DOTTED = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST}}}")
# One that is not closed goes on to the end: otherwise it would be tried again from each of its letters.
_QUOTED = re.compile(
    r""""{3}(?:[^\\]|\\.)*?(?:"{3}|\\?\Z)|'{3}.*?(?:'{3}|\Z)|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?|#[^\n]*+""",
    re.DOTALL,
)
NUMBER = re.compile(r"(?<![A-Za-z_\d.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
"""A number in a text; those in names, such as ``level_1``, are none."""


def csv_text(text: str) -> str:
    """Return all of a text, printable, such that a spreadsheet does not take it for a formula."""
    text = printable(getattr(text, "full", text), keep="\n")
    return f"'{text}" if _FORMULA.match(text) else text


class Clipped(str):
    """The beginning and the end of a long text; ``full`` is all of it."""

    __slots__ = ("full",)
    full: str


def clipped(text: str, longest: int = 60) -> str:
    """Return a name as a line has room for it: its beginning and, as that may tell it apart, its end."""
    if len(text) <= longest:
        return text
    short = Clipped(f"{text[: longest - longest // 3 - 1]}\N{HORIZONTAL ELLIPSIS}{text[-(longest // 3) :]}")
    short.full = getattr(text, "full", text)
    return short


def without_folders(text: str) -> str:
    """Return a text with file names in place of absolute paths, which tell of a machine and its user."""
    if "/" not in text and "\\" not in text:
        return text
    home = Path.home()
    if len(home.parts) > 1:  # its name may have blanks
        text = text.replace(f"{home}/", "~/").replace(f"{home}\\", "~/")
    if _PATH.fullmatch(text):
        return re.split(r"[/\\]", text.rstrip("/\\"))[-1]
    return _FOLDERS.sub("", text)


def alike(text: str) -> str:
    """Return what is the same for texts that differ in their numbers only."""
    return NUMBER.sub("#", text)


class DeepTablesError(ValueError):
    """A TOML file has tables that are nested too deeply."""

    def __init__(self) -> None:
        super().__init__(f"tables within tables; allowed: {DEEPEST} levels")


def toml_tables(text: str) -> dict[str, Any]:
    """Return the tables of a TOML file of any origin, in a time in proportion to its length.

    Raises
    ------
    DeepTablesError
        There are more tables within tables than there may be, or a key has more dots than that: what reads
        TOML takes their square.
    ValueError, RecursionError
        It is not TOML.
    """
    import tomllib  # a worker does without

    if _DOTTED.search(_QUOTED.sub("q", text)):
        raise DeepTablesError
    tables = tomllib.loads(text)
    level: list[Any] = [tables]
    for _ in range(DEEPEST):
        entries = (entry for item in level for entry in (item.values() if isinstance(item, dict) else item))
        level = [entry for entry in entries if isinstance(entry, dict | list)]
    if level:
        raise DeepTablesError
    return tables


def recorded(text: object) -> str:
    """Return anyone's text, or the words of an error, as a run keeps them: printable, and not too long."""
    try:
        words = str(text)
    except (Exception, SystemExit) as error:
        words = f"{type(text).__name__} without words: they raise {type(error).__name__}"
    if words.isascii() and words.isprintable() and len(words) <= _LONGEST_RECORDED:  # as nearly all are
        return words
    return printable(encodable(words), _LONGEST_RECORDED, keep="\n")
