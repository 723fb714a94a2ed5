"""``ddpc-cosim list``."""

import inspect
from typing import Any

from rich.console import Console
from rich.table import Table

from ddpc_cosim.plugins import installed

_KINDS = ("plants", "controllers", "studies")


def list_command(kind: str | None) -> int:
    """Print the installed plug-ins of one kind or of all; return 1 if one is broken."""
    console, broken = Console(), False
    for each in (kind,) if kind else _KINDS:
        table = Table(title=each, title_justify="left", title_style="bold", box=None, pad_edge=False)
        for column in ("name", "what", "from"):
            table.add_column(column, overflow="fold")
        for plugin in installed(each):
            broken = broken or bool(plugin.error)
            what = f"[red]broken: {plugin.error}[/red]" if plugin.error else _what(plugin.value)
            table.add_row(plugin.name, what, f"{plugin.package} ({plugin.target})")
        console.print(table, "")
    return 1 if broken else 0


def _what(value: Any) -> str:
    """Return one line about a plug-in: its description, or the first line of its documentation."""
    if inspect.isclass(value):
        return (inspect.getdoc(value) or "").partition("\n")[0]
    return str(getattr(value, "description", "") or _study_title(value))


def _study_title(value: Any) -> str:
    from ddpc_cosim.study_file import study_title

    return study_title(value)
