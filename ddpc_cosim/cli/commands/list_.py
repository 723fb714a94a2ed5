"""``ddpc-cosim list``."""

import json
from collections.abc import Iterator, Sequence
from typing import Literal, TypedDict, get_args

import click

from ddpc_cosim.cli.options import JSON, argument, command
from ddpc_cosim.cli.output import screen, terminal_table
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.files.tables import Cell, Heading, Row, Table

_BUILT_IN = "ddpc_cosim.metrics:METRICS"
Kind = Literal["plants", "controllers", "studies", "metrics", "conditions", "reports"]


class Entry(TypedDict):
    """What is told of a plug-in: the keys of ``--json``."""

    name: str
    what: str
    package: str
    target: str
    works: bool


@command
def list_(kind: Kind | None = argument(required=False), as_json: bool = JSON) -> int:
    """List what is installed, built-in and third-party; a broken plug-in is shown with its error."""
    listed: dict[str, list[Entry]] = {}
    for name in (kind,) if kind else get_args(Kind):
        with shown(f"loading {name}"):
            listed[name] = list(_entries(name))
    if as_json:
        click.echo(json.dumps(listed, indent=2))
    else:
        console = screen()
        for name, entries in listed.items():
            console.print(terminal_table(_table(name, entries)), "")
    return 0 if all(entry["works"] for entries in listed.values() for entry in entries) else 1


def _entries(kind: str) -> Iterator[Entry]:
    from ddpc_cosim.conditions import describe_condition
    from ddpc_cosim.metrics import METRICS, describe_metric
    from ddpc_cosim.plugins import describe, installed, package_version

    described = {"metrics": describe_metric, "conditions": describe_condition}
    package = f"ddpc-cosim {package_version()}"
    for name, metric in METRICS.items() if kind == "metrics" else ():
        yield Entry(name=name, what=str(metric), package=package, target=_BUILT_IN, works=True)
    for plugin in installed(kind):
        what, works = described.get(kind, describe)(plugin)
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
