"""``ddpc-cosim export``."""

from pathlib import Path

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import argument, command, names_of, option
from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.files.texts import printable

_MATRICES = ("A", "B", "C", "D")


@command
def export(
    plant: str = argument(shell_complete=names_of("plants")),
    fmi: options.FMIVersion = options.FMI_VERSION,
    platforms: str | None = options.PLATFORMS,
    out: Path | None = option(None, "The FMU [PLANT.fmu]."),
) -> int:
    """Export PLANT (a name from `list plants`, module:MODEL or file.py:MODEL) as an FMU."""
    from ddpc_cosim.plugins import find_modules_in, load_plugin
    from fmu_plants import ExportError, ModelError, PlantModel, export_fmu
    from fmu_plants.model import ExportUsageError

    find_modules_in(Path.cwd())
    with shown(f"loading {plant}"):
        model = load_plugin("plants", plant)
    if not isinstance(model, PlantModel) and not all(hasattr(model, matrix) for matrix in _MATRICES):
        raise ConfigError(
            f'plant "{plant}" is not given by equations (a PlantModel or a state-space model), '
            "so it cannot be exported"
        )
    name = model.name if isinstance(model, PlantModel) else plant.rpartition(":")[2].lower()
    try:
        path = export_fmu(
            model,
            out or Path(f"{name}.fmu"),
            fmi,
            platforms=platforms,
            progress=None if platforms is None else _say,
        )
    except (ModelError, ExportUsageError) as error:
        raise ConfigError(str(error)) from error
    except ExportError as error:
        raise CosimError(str(error)) from error
    print(printable(str(path)))
    return 0


def _say(line: str) -> None:
    say(line, err=True)
