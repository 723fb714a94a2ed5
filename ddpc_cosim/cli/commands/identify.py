"""``ddpc-cosim identify``: a plant from logged data, as an FMU."""

import json
from pathlib import Path

import click

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import argument, command, option
from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError


@command
def identify(
    logs: tuple[Path, ...] = argument(
        type=options.PathType(exists=True, dir_okay=False), metavar="LOG.csv [LOG2.csv ...]"
    ),
    inputs: tuple[str, ...] = option(
        (), "A column that controllers drive; may be repeated.", name="--input", metavar="NAME"
    ),
    outputs: tuple[str, ...] = option(
        (), "A column that they control; may be repeated.", name="--output", metavar="NAME"
    ),
    disturbances: tuple[str, ...] = option(
        (), "A column that acts besides; may be repeated.", name="--disturbance", metavar="NAME"
    ),
    sampling_time: float | None = option(
        None, "Of the model, in s, or such as `1 min` [that of the log].", type=options.DURATION, metavar="H"
    ),
    method: str = option(
        "auto",
        "arx, armax, subspace, hammerstein-wiener, koopman; auto: as predicts best.",
        show_default=True,
    ),
    order: int = option(0, "Past samples, or states [by the data].", type=click.IntRange(0, 200)),
    members: int = option(
        30,
        "Models of data that might have been recorded as well.",
        type=options.AT_LEAST_1,
        show_default=True,
    ),
    time_column: str | None = option(None, "Header of the time; empty: there is none [what is called so]."),
    out: Path | None = option(None, "The FMU.", metavar="FILE.fmu"),
    fmi: options.FMIVersion = options.FMI_VERSION,
    platforms: str | None = options.PLATFORMS,
    as_json: bool = options.JSON,
) -> int:
    """Identify a plant from logs, say how sure it is, and write it as an FMU."""
    from ddpc_cosim.codec import read
    from ddpc_cosim.files.csv_files import PARQUET
    from ddpc_cosim.files.log_cells import encoding_of
    from ddpc_cosim.identification.export import export_identified
    from ddpc_cosim.identification.identification import Identification
    from ddpc_cosim.identification.specification import IdentifiedSpec
    from ddpc_cosim.identification.summary import identified_data, identified_lines
    from ddpc_cosim.inspection.log_files import time_column_of

    if out is not None and out.suffix.lower() != ".fmu":
        raise ConfigError(f"--out {out}: must end in .fmu")
    encoding = encoding_of(*(path for path in logs if path.suffix != PARQUET))
    if encoding != "utf-8":
        say(f"{', '.join(path.name for path in logs)}: not UTF-8 text, read as {encoding}", err=True)
    given = {
        "file": [str(path.absolute()) for path in logs],
        "disturbances": list(disturbances),
        "method": method,
        "order": order,
        "members": members,
        "time_column": time_column_of(logs[0]) if time_column is None else time_column,
        "encoding": encoding,
    }
    identification = read(
        Identification, given | ({} if sampling_time is None else {"sampling_time": sampling_time})
    )
    with shown(f"identify {' '.join(path.name for path in logs)}") as progress:
        spec = IdentifiedSpec(identification, tuple(inputs), tuple(outputs)).built()
        data = identified_data(spec)
        ensemble = spec.ensemble
        if out is not None and ensemble is not None:
            progress(f"writing {out}")
            words = f"Identified from {spec.label} by {data['model']}"
            signals = ensemble.inputs, ensemble.outputs
            export_identified(ensemble.models[0], *signals, out, fmi, words=words, platforms=platforms)
            data["fmu"] = str(out)
    if as_json:
        click.echo(json.dumps(data, indent=2))
        return 0
    for line in identified_lines(spec, data):
        say(line)
    if out is not None:
        say(str(out))
    return 0
