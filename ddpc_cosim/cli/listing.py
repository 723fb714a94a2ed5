"""``ddpc-cosim list``."""

import json
from collections.abc import Iterator, Sequence
from typing import TypedDict

import click
from rich.table import Table
from rich.text import Text

from ddpc_cosim.cli.output import screen
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.conditions import describe_condition
from ddpc_cosim.metrics import METRICS, describe_metric
from ddpc_cosim.plugins import describe, installed, package_version
from ddpc_cosim.texts import printable

_BUILT_IN = "ddpc_cosim.metrics:METRICS"


class Entry(TypedDict):
    """What is told of a plug-in: the keys of ``--json``."""

    name: str
    what: str
    package: str
    target: str
    works: bool


def list_command(kinds: Sequence[str], *, as_json: bool) -> int:
    """Print the plug-ins of some kinds; return 1 if one is broken."""
    listed: dict[str, list[Entry]] = {}
    for kind in kinds:
        with shown(f"loading {kind}"):
            listed[kind] = list(_entries(kind))
    if as_json:
        click.echo(json.dumps(listed, indent=2))
    else:
        console = screen()
        for kind, entries in listed.items():
            console.print(_table(kind, entries), "")
    return 0 if all(entry["works"] for entries in listed.values() for entry in entries) else 1


_DESCRIBED = {"metrics": describe_metric, "conditions": describe_condition}


def _entries(kind: str) -> Iterator[Entry]:
    own = f"ddpc-cosim {package_version()}"
    for name, metric in METRICS.items() if kind == "metrics" else ():
        yield Entry(name=name, what=str(metric), package=own, target=_BUILT_IN, works=True)
    for plugin in installed(kind):
        what, works = _DESCRIBED.get(kind, describe)(plugin)
        yield Entry(name=plugin.name, what=what, package=plugin.package, target=plugin.target, works=works)


def _table(kind: str, entries: Sequence[Entry]) -> Table:
    table = Table(title=kind, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("name", no_wrap=True)
    table.add_column("what")
    table.add_column("from", overflow="ellipsis")
    for entry in entries:
        origin = (
            f"{entry['package']} ({entry['target']})" if entry["target"] != _BUILT_IN else entry["package"]
        )
        what = Text(printable(entry["what"]), style="" if entry["works"] else "red")
        table.add_row(Text(printable(entry["name"])), what, Text(printable(origin)))
    return table
