"""``ddpc-cosim schema``."""

import json

import click

from ddpc_cosim.cli.options import command


@command
def schema() -> int:
    """Print the JSON Schema of study files, for editors; it knows what is installed here."""
    from ddpc_cosim.study.file_format.schema import study_schema

    click.echo(json.dumps(study_schema(), indent=2))
    return 0
