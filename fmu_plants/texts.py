"""Texts of others, in which nothing acts on what shows or holds them."""

import unicodedata


def printable(text: str, longest: int | None = None, *, keep: str = "") -> str:
    """Return a text in which nothing acts on what shows it.

    Control characters (escape sequences, U+009B, line breaks), direction controls and other invisible
    letters, lone surrogates and what is not assigned are written out as Python does; blanks are left.

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
    if text.isprintable():  # as nearly all are, and a page has half a million of them
        return text
    acting = {ord(c): repr(c)[1:-1] for c in set(text) if c not in keep and not _is_seen(c)}
    return text.translate(acting) if acting else text


def encodable(text: str) -> str:
    """Return a text that a file can hold.

    Bytes of file names that the locale cannot say are taken for UTF-8; other lone surrogates are replaced.
    """
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    except UnicodeEncodeError:
        return text.encode("utf-8", "replace").decode()


def _is_seen(letter: str) -> bool:
    return letter.isprintable() or unicodedata.category(letter) == "Zs"
