"""``ddpc-cosim export`` and ``ddpc-cosim export-controller``."""

from pathlib import Path
from typing import Any

from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.cli.run import warnings_in_one_line
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.plugins import find_modules_in, load_plugin
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.texts import printable

_MATRICES = ("A", "B", "C", "D")


def export_command(target: str, fmi_version: str, out: Path | None, platforms: str | None = None) -> None:
    """Export a plant's equations as an FMU and print its path; tell on stderr how far the compilers are.

    Parameters
    ----------
    target : str
        Name of an installed plant, ``module:MODEL`` (modules of the current folder count), or
        ``file.py:MODEL``. The model is a `PlantModel` or a state-space model.
    fmi_version : str
        ``"2.0"`` or ``"3.0"``.
    out : Path or None
        The file; by default the plant's name with the extension fmu, in the current folder.
    platforms : str or None
        ``"all"`` or names separated by commas; None is this platform.

    Raises
    ------
    ConfigError
        The plant is not given by equations, or they contradict themselves.
    PluginError
        There is no such plant, or it cannot be loaded.
    CosimError
        The FMU could not be built.
    """
    from fmu_plants import ExportError, ModelError, PlantModel, export_fmu
    from fmu_plants.model import ExportUsageError

    find_modules_in(Path.cwd())
    with shown(f"loading {target}"):
        model = load_plugin("plants", target)
    if not isinstance(model, PlantModel) and not all(hasattr(model, matrix) for matrix in _MATRICES):
        raise ConfigError(
            f'plant "{target}" is not given by equations (a PlantModel or a state-space model), '
            "so it cannot be exported"
        )
    name = model.name if isinstance(model, PlantModel) else target.rpartition(":")[2].lower()
    try:
        path = export_fmu(
            model,
            out or Path(f"{name}.fmu"),
            fmi_version,
            platforms=platforms,
            progress=None if platforms is None else _say,
        )
    except (ModelError, ExportUsageError) as error:
        raise ConfigError(str(error)) from error
    except ExportError as error:
        raise CosimError(str(error)) from error
    print(printable(str(path)))


def export_controller_command(
    study: str, controller: str, out: Path | None, fmi_version: str, platforms: str | None, **case: Any
) -> None:
    """Export a controller of a study as an FMU and print its path.

    ``case`` says which of its cases: parameters and errors as of
    :func:`ddpc_cosim.exporting.of_study.export_from_study`.
    """
    from ddpc_cosim.exporting.of_study import export_from_study

    with shown(f"reading {study}") as progress, warnings_in_one_line():
        resolved = read_study(study)
        path = export_from_study(resolved, controller, out, fmi_version, platforms, progress, **case)
    print(printable(str(path)))


def _say(line: str) -> None:
    say(line, err=True)
