"""Texts of others: names, descriptions and errors that go to a terminal, a table or a file."""

import unicodedata


def printable(text: str, longest: int | None = None, *, keep: str = "") -> str:
    """Return a text in which nothing acts on what shows it.

    Control characters (escape sequences, U+009B, line breaks), direction controls and other invisible
    letters, lone surrogates and what is not assigned are written out as Python does; any blank is a space.

    Parameters
    ----------
    text : str
        Of any origin.
    longest : int, optional
        How many characters are looked at; what is cut says at its end how many there were.
    keep : str
        Characters to be left as they are, for example line breaks.
    """
    if longest is not None and len(text) > longest:
        cut = f" ... ({len(text)} characters)"
        text = text[: max(longest - len(cut), 0)] + cut
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _written_out(c) for c in text)


def _written_out(letter: str) -> str:
    return " " if unicodedata.category(letter) == "Zs" else repr(letter)[1:-1]
