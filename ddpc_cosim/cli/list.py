"""``ddpc-cosim list``."""

import inspect
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ddpc_cosim.plugins import Plugin, installed

BROKEN = "red"
_KINDS = ("plants", "controllers", "studies")


def list_command(kind: str | None) -> int:
    """Print the installed plug-ins of one kind or of all; return 1 if one is broken."""
    console, broken = Console(), False
    for each in (kind,) if kind else _KINDS:
        table = Table(title=each, title_justify="left", title_style="bold", box=None, pad_edge=False)
        for column in ("name", "what", "from"):
            table.add_column(column, overflow="fold")
        for plugin in installed(each):
            what = _what(plugin)
            broken = broken or what.style == BROKEN
            table.add_row(plugin.name, what, f"{plugin.package} ({plugin.target})")
        console.print(table, "")
    return 1 if broken else 0


def _what(plugin: Plugin) -> Text:
    """Return one line about a plug-in, or why it is broken."""
    try:
        return Text(f"broken: {plugin.error}", BROKEN) if plugin.error else Text(_describe(plugin.value))
    except Exception as error:  # a third party's object can be anything
        return Text(f"broken: {type(error).__name__}: {error}", BROKEN)


def _describe(value: Any) -> str:
    """Return a plug-in's description, or the first line of its documentation."""
    from ddpc_cosim.study.reading import study_title

    if inspect.isclass(value):
        return (inspect.getdoc(value) or "").partition("\n")[0]
    return str(getattr(value, "description", "") or study_title(Path(value)))
