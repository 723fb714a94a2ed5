"""``ddpc-cosim diff``: whether two folders of results say the same, as a gate for changes."""

from pathlib import Path

from ddpc_cosim.cli.options import FiniteRange, PathType, argument, command, option
from ddpc_cosim.cli.output import say

_MOST_LISTED = 20
_TOLERANCE = FiniteRange(min=0)
_FILE = PathType(dir_okay=False)


@command
def diff(
    folders: tuple[Path, Path] = argument(type=PathType(), metavar="DIR_A DIR_B"),
    absolute: float = option(1e-9, "Allowed difference.", name="--abs", type=_TOLERANCE, show_default=True),
    relative: float = option(
        1e-6,
        "Allowed difference, relative to the larger value.",
        name="--rel",
        type=_TOLERANCE,
        show_default=True,
    ),
    page: Path | None = option(
        None,
        "Also write a page: before, after, and what changed.",
        name="--html",
        type=_FILE,
        metavar="FILE",
    ),
) -> int:
    """Compare two runs case by case; exit with 1 if one differs by more than both allow."""
    from ddpc_cosim.study.agreement import compared, loaded

    results = loaded(folders[0]), loaded(folders[1])
    total, lines = compared(results, absolute, relative)
    agreeing = total - len(lines)
    verdict = f"{agreeing} of {total} cases agree within max({absolute:g}, {relative:g} of the larger value)"
    print(verdict)
    for line in lines[:_MOST_LISTED]:
        say(line)
    if len(lines) > _MOST_LISTED:
        print(f"and {len(lines) - _MOST_LISTED} more")
    if page is not None:
        from ddpc_cosim.cli.results import write_page

        write_page("differences", page, *results, verdict, lines)
    return 1 if lines else 0
