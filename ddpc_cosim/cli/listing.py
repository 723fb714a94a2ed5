"""``ddpc-cosim list``."""

import json
from collections.abc import Iterator, Sequence
from typing import TypedDict

import click

from ddpc_cosim.cli.output import screen, terminal_table
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.metrics import METRICS, describe_metric
from ddpc_cosim.plugins import describe, installed, package_version
from ddpc_cosim.tables import Cell, Heading, Row, Table

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
            console.print(terminal_table(_table(kind, entries)), "")
    return 0 if all(entry["works"] for entries in listed.values() for entry in entries) else 1


def _entries(kind: str) -> Iterator[Entry]:
    own = f"ddpc-cosim {package_version()}"
    for name, metric in METRICS.items() if kind == "metrics" else ():
        yield Entry(name=name, what=str(metric), package=own, target=_BUILT_IN, works=True)
    for plugin in installed(kind):
        what, works = describe_metric(plugin) if kind == "metrics" else describe(plugin)
        yield Entry(name=plugin.name, what=what, package=plugin.package, target=plugin.target, works=works)


def _table(kind: str, entries: Sequence[Entry]) -> Table:
    headings = (
        Heading("name", numeric=False),
        Heading("what", numeric=False, wraps=True),
        Heading("from", numeric=False, wraps=True),
    )
    rows = []
    for entry in entries:
        target = f" ({entry['target']})" if entry["target"] != _BUILT_IN else ""
        what = Cell(entry["what"], failed=not entry["works"])
        rows.append(Row(entry["name"], (what, Cell(entry["package"] + target))))
    return Table("", kind, headings, tuple(rows))
