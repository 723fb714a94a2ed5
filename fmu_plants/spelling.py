"""What an unknown name probably stands for."""

from collections.abc import Iterable
from difflib import get_close_matches

_MOST_LISTED = 12


def nearest(name: str, options: Iterable[str]) -> str | None:
    """Return the option that an unknown name most probably stands for, if one is near."""
    close = get_close_matches(name, sorted(set(options)), n=1, cutoff=0.6)
    return close[0] if close else None


def did_you_mean(name: str, options: Iterable[str]) -> str:
    """Return the part of an error message that helps with an unknown name: the nearest one, or all."""
    known = sorted(set(options))
    close = nearest(name, known)
    if close:
        return f'did you mean "{close}"?'
    if not known:
        return "there are none"
    listed = ", ".join(known[:_MOST_LISTED])
    return f"there are: {listed}" + (
        f" and {len(known) - _MOST_LISTED} more" if len(known) > _MOST_LISTED else ""
    )
