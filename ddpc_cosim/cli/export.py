"""``ddpc-cosim export``."""

from pathlib import Path

from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.plugins import load_plugin


def export_command(name: str, fmi_version: str, out: Path | None) -> None:
    """Export a plant's equations as an FMU and print its path.

    Raises
    ------
    ConfigError
        The plant is not given by equations.
    CosimError
        The FMU could not be built.
    """
    from fmu_plants import ExportError, PlantModel, export_fmu

    model = load_plugin("plants", name)
    if not isinstance(model, PlantModel):
        raise ConfigError(
            f'plant "{name}" is not given by equations (a PlantModel), so it cannot be exported'
        )
    try:
        print(export_fmu(model, out or Path(f"{model.name}.fmu"), fmi_version))
    except ExportError as error:
        raise CosimError(str(error)) from error
