"""Reports: one self-contained HTML page from the results of one or several studies.

Everything heavy is imported when a report is written, so that finding this plug-in costs nothing.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ddpc_cosim import StudyResults

__all__ = ["write_report"]


def write_report(results: "Sequence[StudyResults]", path: Path) -> Path:
    """Write one HTML page about the results of one or several studies.

    The page needs no other file and no network: style, figures, data and script are in it. The same results
    give the same bytes.

    Parameters
    ----------
    results : sequence of StudyResults
        One section of the page for each, in this order.
    path : Path
        The file to write; missing folders are made, an existing file is replaced.

    Returns
    -------
    path : Path
        The file written.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    from ddpc_reports.page import render_page

    page = render_page(results)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8", newline="\n")
    return path
