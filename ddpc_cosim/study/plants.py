"""From the plant section of a study to a plant: a plug-in's equations, an FMU file, or a Python class."""

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self, cast
from zipfile import is_zipfile

import numpy as np

from ddpc_cosim.codec import in_folder, plant_in_folder
from ddpc_cosim.coupling.specification import CoupledSpec
from ddpc_cosim.description import DefaultExperiment, PlantDescription, describe
from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning, DataError, FMUImportError
from ddpc_cosim.files.plain_data import from_bytes, to_bytes, understood
from ddpc_cosim.files.time_tables import TimeTable, read_time_table
from ddpc_cosim.identification.specification import IdentifiedSpec
from ddpc_cosim.loop.safe_calls import (
    close_plant,
    feedthrough_of_plant,
    make_plant,
    outputs_of_plant_at,
    plant_provenance,
    reset_plant,
    set_plant_parameters,
    step_plant,
)
from ddpc_cosim.plant import FMIType, ParameterValue, Plant, library_path_faults
from ddpc_cosim.plugins import hash_of_code, is_in_file, load_plugin, shown_name
from ddpc_cosim.processes.scratch import scratch_of_cases
from ddpc_cosim.settings import hash_of_file
from ddpc_cosim.variables import (
    FloatArray,
    Variable,
    names,
    with_display_units,
    with_nominal,
    with_start,
)
from fmu_plants.files import is_file
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:
    from ddpc_cosim.fmu.companions import Companions
    from ddpc_cosim.fmu.description import FMUDescription
    from ddpc_cosim.study.file_format.sections import PartSection, PlantSection
    from fmu_plants.model import InputTable


@dataclass(frozen=True, slots=True)
class PlantSpec:
    """The plant of a study: what it is, and how a worker opens it.

    Parameters
    ----------
    name : str
        The plug-in's name, ``module:attribute`` or ``file.py:attribute``; empty for a supplied FMU.
    fmu : str
        Absolute path of the FMU; empty for a Python class, and for equations until :meth:`built`.
    isolated : bool
        Whether each case has a worker process of its own; others share workers.
    fmi_type : str
        How the FMU is run.
    display_units : mapping of str to str
        Units to show variables in.
    nominal : mapping of str to float
        Nominal values in place of the plant's own.
    start : mapping of str to float
        Values that inputs start from and rest at, in place of the plant's own.
    content : str
        What decides the behaviour: SHA-256 of the FMU, or the Python class with a hash of its source; empty
        until :meth:`built`.
    trace_calls : str
        File that every FMI call is written to; empty: none.
    switches : mapping of str to str
        For inputs, the input that is 1 while something drives them, and 0 while the plant's own control does.
    coupled : CoupledSpec or None
        What a coupled plant consists of, which has no name and is not an FMU.
    isolation : mapping of str to object
        How the FMU, a part, lives in a process of its own within that of the case: further arguments of
        :class:`FMUPlant`.
    library_path : tuple of str
        Libraries that FMUs need, and folders of such; once it is :meth:`built`, those that are loaded.
    identified : IdentifiedSpec or None
        The logs that a plant is identified from, which has no name and is not an FMU.
    """

    name: str
    fmu: str
    isolated: bool = False
    fmi_type: FMIType = "auto"
    display_units: Mapping[str, str] = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    content: str = ""
    trace_calls: str = ""
    switches: Mapping[str, str] = field(default_factory=dict)
    coupled: CoupledSpec | None = None
    isolation: Mapping[str, Any] = field(default_factory=dict)
    library_path: tuple[str, ...] = ()
    identified: IdentifiedSpec | None = None

    @classmethod
    def of(cls, section: "PlantSection", folder: Path) -> Self:
        """Return the plant that a section names.

        Parameters
        ----------
        section : PlantSection
            The plant section.
        folder : Path
            Folder of the study file: FMU paths are relative to it.

        Raises
        ------
        CosimError
            There is no such plant, or it cannot be loaded.
        """
        spec = cls(
            name=plant_in_folder(folder, section.name),
            fmu=str(in_folder(folder, section.fmu)) if section.fmu else "",
            fmi_type=section.fmi_type,
            display_units=section.display_units,
            nominal=section.nominal,
            start=section.start,
            coupled=_coupled(section) if section.ssp or section.parts else None,
            library_path=tuple(section.library_path) if section.fmu else (),
            identified=_identified(section, folder) if section.identified else None,
        )
        # The project's own C code is trusted; what a supplied FMU does is not known.
        isolated = spec.is_supplied if section.isolated == "auto" else section.isolated
        return replace(spec, isolated=isolated)._checked()

    @classmethod
    def of_part(cls, section: "PartSection") -> Self:
        """Return the part of a coupled plant that a section names; errors as of :meth:`of`."""
        return cls(
            name=section.plant,
            fmu=section.fmu,
            isolation={"isolated": True} if section.isolated else {},
            fmi_type=section.fmi_type,
            start=section.start,
        )._checked()

    def _checked(self) -> Self:
        """Return the plant if its plug-in can be one."""
        plugin = None if self.fmu or self.coupled or self.identified else self._plugin()
        if plugin is not None and not (_is_model(plugin) or _is_plant_class(plugin)):
            raise ConfigError(f'plant "{self.name}" is neither a PlantModel nor a Plant class: {plugin!r}')
        if (self.isolated or self.isolation) and not (self.is_fmu or self.coupled):
            what = "is identified from data" if self.identified else "is a Python class"
            raise ConfigError(f'plant "{self.label}" {what}; only FMUs can be isolated')
        if faults := library_path_faults(self.library_path):
            raise ConfigError(faults)
        return self

    @property
    def is_fmu(self) -> bool:
        """Whether the plant runs as an FMU, supplied or built from equations."""
        is_python = self.coupled is None and self.identified is None
        return bool(self.fmu) or (is_python and _is_model(self._plugin()))

    @property
    def is_supplied(self) -> bool:
        """Whether an FMU of others is in it: what that does is not known."""
        parts = self.coupled.parts.values() if self.coupled else ()
        return bool(self.fmu) or any(part.is_supplied for part in parts)

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of its FMUs, and of the libraries that these need."""
        if self.coupled is None:
            return (self.fmu, *self.library_path) if self.fmu else ()
        return tuple(path for part in self.coupled.parts.values() for path in part.files)

    @property
    def plugins(self) -> tuple[str, ...]:
        """Names of the plug-ins that it is made of, FMUs excepted."""
        if self.coupled is None:
            return (self.name,) if self.name else ()
        return tuple(name for part in self.coupled.parts.values() for name in part.plugins)

    @property
    def label(self) -> str:
        """What it is called: a plug-in's name, an FMU's file, or those of its parts."""
        return (
            shown_name(self.name)
            or Path(self.fmu).name
            or (self.identified.label if self.identified else "")
            or ", ".join(self.coupled.parts if self.coupled else ())
        )

    def starting_at(self, start: Mapping[str, float]) -> Self:
        """Return the plant, which is built, with other start values of inputs, by name."""
        coupled = self.coupled.starting_at(start) if self.coupled else None
        return replace(self, start={**self.start, **start}, coupled=coupled)

    def isolating(self, how: Mapping[str, Any]) -> Self:
        """Return the plant with each of its FMUs in a process of its own."""
        coupled = self.coupled.isolating(how) if self.coupled else None
        return replace(self, isolation=how if self.fmu else {}, coupled=coupled)

    def moved(self, place: Callable[[str], str]) -> Self:
        """Return the plant with its files elsewhere: at ``place(path)``."""
        if self.coupled is None:
            libraries = tuple(map(place, self.library_path))
            return replace(self, name=place(self.name), fmu=place(self.fmu), library_path=libraries)
        parts = {name: part.moved(place) for name, part in self.coupled.parts.items()}
        return replace(self, coupled=replace(self.coupled, parts=parts))

    def _plugin(self) -> Any:
        return load_plugin("plants", self.name)

    def variables(self) -> PlantDescription:
        """Return what the plant says about itself, without building or running it.

        Raises
        ------
        CosimError
            The plant cannot be read.
        """
        if of_parts := self.coupled or self.identified:
            return of_parts.variables()
        if self.fmu:
            from ddpc_cosim.fmu.resources import ResourceFiles, key_figure_tags

            path = Path(self.fmu)
            described = _fmu_variables(read_fmu(path), path.name, self.fmi_type)
            return replace(described, key_figures=key_figure_tags(ResourceFiles(path)))
        plugin = self._plugin()
        if _is_model(plugin):
            return _model_variables(plugin)
        try:
            plant: Plant = plugin()
        except (Exception, SystemExit) as error:  # a third party's constructor can fail in any way
            raise ConfigError(f'plant "{self.name}": {type(error).__name__}: {error}') from error
        try:
            return describe(plant.inputs, plant.outputs)
        finally:
            plant.close()

    def tables(self) -> "PlantTables":
        """Return the tables in its resources; those of a part have its name and a slash before theirs."""
        if self.coupled:
            return PlantTables(
                {
                    f"{part}/{name}": partial(tables.table, name)
                    for part, spec in self.coupled.parts.items()
                    for tables in (cast("PlantSpec", spec).tables(),)
                    for name in tables.names
                }
            )
        if self.fmu:
            from ddpc_cosim.fmu.resources import ResourceFiles

            files = ResourceFiles(Path(self.fmu))
            return PlantTables({name: partial(files.table, name) for name in files.tables})
        if self.identified or not _is_model(plugin := self._plugin()):
            return PlantTables({})
        texts = {name: text for name, text in plugin.resources.items() if name.lower().endswith(".csv")}
        return PlantTables(
            {table.file: partial(_table_of_model, table) for table in plugin.tables}
            | {name: partial(_table_in_text, name, text) for name, text in texts.items()}
        )

    def built(self) -> Self:
        """Return the plant ready to run: equations are exported to an FMU, which is compiled if it is new."""
        if self.coupled:
            coupled = self.coupled.built().starting_at(self.start)
            return replace(self, coupled=coupled, content=coupled.content + self._shown())
        if self.identified:
            identified = self.identified.built()
            return replace(self, identified=identified, content=identified.content + self._shown())
        if not self.is_fmu:
            plugin = self._plugin()
            named = f"{plugin.__module__}:{plugin.__qualname__}"
            if is_in_file(self.name):  # wherever that stands
                named = shown_name(self.name)
            content = f"{named} {hash_of_code(self.name, plugin)}"
            return replace(self, content=content + self._shown())
        companions = self._check_library() if self.fmu else None
        fmu = Path(self.fmu) if self.fmu else _build(self._plugin()).resolve()
        kind = "" if self.fmi_type == "auto" else f" {self.fmi_type}"
        content = hashlib.sha256(fmu.read_bytes()).hexdigest() + kind + self._shown()
        if companions is None:
            return replace(self, fmu=str(fmu), content=content)
        content += "".join(f" {library} {what}" for library, what in companions.identity.items())
        libraries = tuple(map(str, companions.given))
        return replace(self, fmu=str(fmu), content=content, library_path=libraries)

    def _check_library(self) -> "Companions":
        """Check that a supplied FMU has a library for this platform, and can be unpacked by a case.

        Nothing of it is loaded; what is going to be loaded with it is returned.
        """
        from ddpc_cosim.fmu.archive import require_short_paths
        from ddpc_cosim.fmu.plant import FMUPlant

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CosimWarning)
            with FMUPlant(self.fmu, fmi_type=self.fmi_type, library_path=self.library_path) as plant:
                companions = plant.companions
                library_warnings = [text for text in plant.warnings if text not in plant.description.warnings]
        require_short_paths(Path(self.fmu), scratch_of_cases())
        for text in library_warnings:  # the others were told when the study was read
            warnings.warn(f"{Path(self.fmu).name}: {text}", CosimWarning, stacklevel=3)
        return companions

    def _shown(self) -> str:
        """Return what the study says of units, nominal and start values, and switches: they decide too."""
        units = [f" {name}[{unit}]" for name, unit in sorted(self.display_units.items())]
        nominal = [f" {name}~{value!r}" for name, value in sorted(self.nominal.items())]
        start = [f" {name}={value!r}" for name, value in sorted(self.start.items())]
        switches = [f" {name}|{switch}" for name, switch in sorted(self.switches.items())]
        return "".join(units + nominal + start + switches)

    def open(
        self, inputs: Sequence[str], outputs: Sequence[str], seed: int = 0, *, records: bool = False
    ) -> Plant:
        """Open the plant with the chosen inputs and outputs.

        Parameters
        ----------
        inputs, outputs : sequence of str
            Which take part.
        seed : int
            That of the case, which says which of its models a plant is that is identified from data.
        records : bool
            Whether an experiment comes before the run.
        """
        if self.coupled:
            plant = self.coupled.open(inputs, outputs)
        elif self.fmu:
            plant = self._open_fmu(inputs, outputs)
        else:
            plant = PythonPlant(self._maker(seed, records=records), inputs, self.start)
            plant.inputs = with_display_units(plant.inputs, self.display_units, {})
            plant.outputs = with_display_units(plant.outputs, self.display_units, {})
        plant.inputs = with_nominal(plant.inputs, self.nominal)
        plant.outputs = with_nominal(plant.outputs, self.nominal)
        plant.switches = {
            name: switch for name, switch in self.switches.items() if name in inputs and switch not in inputs
        }
        return plant

    def _maker(self, seed: int, *, records: bool) -> Callable[[], Plant]:
        """Return what makes the plant, by a name for errors: a class, or a model of an ensemble."""
        if not self.identified:
            plugin: Callable[[], Plant] = self._plugin()
            return plugin
        identified = self.identified

        def identified_plant() -> Plant:
            return identified.open(self.start, seed, records=records)

        return identified_plant

    def _open_fmu(self, inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
        from ddpc_cosim.fmu.plant import FMUPlant

        units = {name: unit for name, unit in self.display_units.items() if name in (*inputs, *outputs)}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CosimWarning)  # told when the study was read
            return FMUPlant(
                self.fmu,
                inputs=list(inputs),
                outputs=list(outputs),
                fmi_type=self.fmi_type,
                display_units=units,
                start=self.start,
                trace_calls=self.trace_calls or None,
                library_path=self.library_path,
                **self.isolation,
            )


class PlantTables:
    """The tables in the resources of a plant, each read when it is first asked for, and once.

    Parameters
    ----------
    tables : mapping of str to callable
        What reads each of them, by name.
    """

    def __init__(self, tables: Mapping[str, Callable[[], TimeTable]]) -> None:
        self._tables = tables
        self._read = dict[str, TimeTable]()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the tables."""
        return tuple(self._tables)

    def table(self, name: str) -> TimeTable:
        """Return a table by its name; DataError: there is none, or it cannot be read."""
        if name not in self._tables:
            raise DataError(f"{name}: no such table; {did_you_mean(name, self._tables)}")
        if name not in self._read:
            self._read[name] = self._tables[name]()
        return self._read[name]


def _table_of_model(table: "InputTable") -> TimeTable:
    """Return a table of a plant of equations, as its FMU has it in a file."""
    time, values = table.values()
    units = {column: v.unit for column, v in zip(table.heads, table.variables, strict=True) if v.unit}
    return TimeTable(table.file, time, values, table.heads, units)


def _table_in_text(name: str, text: str | Callable[[], str]) -> TimeTable:
    """Return a further file of a plant of equations as a table over time; DataError: it is none."""
    return read_time_table(name, (text() if callable(text) else text).encode())


def _identified(section: "PlantSection", folder: Path) -> IdentifiedSpec:
    """Return the logs of a plant section, and which of their signals are what."""
    identification = section.identified
    assert identification is not None
    files = [str(in_folder(folder, path)) for path in identification.file]
    outputs = tuple(dict.fromkeys((*section.outputs, *section.measurements)))
    return IdentifiedSpec(replace(identification, file=files), tuple(section.inputs), outputs)


def _coupled(section: "PlantSection") -> CoupledSpec:
    """Return what the parts, or the SSP, of a plant section consist of."""
    options = section.coupling.options if section.coupling else {}
    steps = {part.name: part.step for part in section.parts if part.step}
    given = {part.name: part for part in section.parts}
    parts, faults = dict[str, PlantSpec](), list[str]()
    parameters = dict[str, ParameterValue]()
    connections = list(section.connections)
    connectors: tuple[Variable, ...] = ()
    experiment, understood = DefaultExperiment(), tuple[str, ...]()
    if section.ssp:
        from ddpc_cosim.coupling.ssp import read_ssp

        system = read_ssp(Path(section.ssp))
        connections = [connection.connection for connection in system.connections]
        connectors = (*system.inputs, *system.outputs)
        experiment = system.default_experiment
        understood = system.warnings
        for warning in understood:
            warnings.warn(warning, CosimWarning, stacklevel=3)
        for part in system.parts:
            # The author's choice of Co-Simulation is one for an exchange in steps.
            fmi_type: FMIType = "auto" if options.get("algorithm") == "monolithic" else part.fmi_type
            parts[part.name] = PlantSpec("", part.fmu, fmi_type=fmi_type, start=part.start)
            parameters |= {f"{part.name}.{name}": value for name, value in part.parameters.items()}
        for name in given.keys() - parts.keys():
            faults.append(f'parts: no part "{name}" in the SSP; {did_you_mean(name, parts)}')
        for name in given.keys() & parts.keys():
            part_section = given[name]
            parts[name] = replace(
                parts[name],
                start={**parts[name].start, **part_section.start},
                isolation={"isolated": True} if part_section.isolated else {},
                fmi_type=parts[name].fmi_type if part_section.fmi_type == "auto" else part_section.fmi_type,
            )
    else:
        for name, part_section in given.items():
            try:
                parts[name] = PlantSpec.of_part(part_section)
            except CosimError as error:
                faults.append(f'part "{name}": {error}')
    if faults:
        raise ConfigError(faults)
    for name, part_section in given.items():
        parameters |= {f"{name}.{key}": value for key, value in part_section.parameters.items()}
    options |= {"steps": steps} if steps else {}
    libraries = tuple(section.library_path)
    parts = {
        name: replace(part, library_path=libraries)._checked() if part.fmu else part
        for name, part in parts.items()
    }
    return CoupledSpec(parts, tuple(connections), connectors, options, parameters, experiment, understood)


def content_of_plant(name: str) -> str:
    """Return what decides the behaviour of a plant that a setting names; why, where it cannot be told."""
    try:
        return PlantSpec(name, "").built().content
    except CosimError as error:
        return str(error)


def stand_ins_of_file(path: str) -> Mapping[str, str]:
    """Return what stands in for libraries that an FMU of a setting needs, by library; none of other files."""
    return _stand_ins(path, hash_of_file(path))


@lru_cache(maxsize=64)
def _stand_ins(path: str, _: str) -> Mapping[str, str]:
    """Return those of a file with this hash: one reading serves all cases."""
    if not is_zipfile(path):
        return {}
    from ddpc_cosim.fmu.library import stand_ins_of  # with all that runs FMUs

    return stand_ins_of(Path(path))


def _build(model: Any) -> Path:
    from fmu_plants import ExportError, ModelError, build_fmu

    try:
        return build_fmu(model)
    except (ExportError, ModelError) as error:
        raise CosimError(str(error)) from error


def _is_model(plugin: Any) -> bool:
    from fmu_plants import PlantModel

    return isinstance(plugin, PlantModel)


def _is_plant_class(plugin: Any) -> bool:
    return isinstance(plugin, type) and issubclass(plugin, Plant)


def read_fmu(path: Path) -> "FMUDescription":
    """Return what an FMU says about itself; nothing of it is run.

    Raises
    ------
    FMUImportError
        The file does not exist, or cannot be read as an FMU.
    """
    from ddpc_cosim.fmu.archive import unpack
    from ddpc_cosim.fmu.description.reader import read_description

    if not is_file(path):
        raise FMUImportError(f"{path}: no such file")
    with TemporaryDirectory() as folder:
        unpack(path, Path(folder))
        return read_description(Path(folder), path.name)


def _fmu_variables(description: "FMUDescription", label: str, fmi_type: FMIType) -> PlantDescription:
    from ddpc_cosim.fmu.description import describe_plant

    described = describe_plant(description, label, fmi_type)
    for warning in described.warnings:
        warnings.warn(f"{label}: {warning}", CosimWarning, stacklevel=3)
    return described


def _model_variables(model: Any) -> PlantDescription:
    tunable = frozenset(v.name for v in model.parameters if v.variability == "tunable")
    described = describe(
        model.all_inputs,
        model.outputs,
        model.parameters,
        tunable,
        DefaultExperiment(None, model.stop_time, None, model.step_size),
    )
    if not model.resources:
        return described
    from ddpc_cosim.fmu.resources import ModelFiles, key_figure_tags

    return replace(described, key_figures=key_figure_tags(ModelFiles(model.resources)))


class PythonPlant(Plant):
    """A plant of any class, of which some inputs are driven; the others rest at their start values.

    Parameters
    ----------
    make : callable
        Makes the plant.
    inputs : sequence of str
        Names of the inputs to drive, in this order.
    start : mapping of str to float, optional
        Start values of inputs in place of the plant's own.

    Raises
    ------
    FMUStepError
        The plant cannot be made, and why.
    """

    def __init__(
        self, make: Callable[[], Plant], inputs: Sequence[str], start: Mapping[str, float] | None = None
    ) -> None:
        self._plant = make_plant(make)
        every = with_start(self._plant.inputs, start or {})
        self._names = names(every)
        self._driven = [self._names.index(name) for name in inputs]
        self._at_rest = np.array([variable.start for variable in every], dtype=np.float64)
        self._u = self._at_rest
        self._held, self._y = self._at_rest, np.empty(0)
        self.inputs = tuple(every[index] for index in self._driven)
        self.outputs = tuple(self._plant.outputs)
        self.is_noisy = self._plant.is_noisy
        self.dependencies = {
            name: frozenset(inputs).intersection(on) for name, on in self._plant.dependencies.items()
        }
        self._t0, self._steps, self._h = 0.0, 0, 0.0

    @property
    def _time(self) -> float:
        return self._t0 + self._steps * self._h

    def _every(self, u: FloatArray) -> FloatArray:
        every = self._u.copy()
        every[self._driven] = u
        return every

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Announce sampling and stop time of the next runs."""
        self._plant.plan(sampling_time, stop_time)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the initial state and return the outputs there, shape (p,)."""
        self._t0, self._steps = t0, 0
        self._u = self._at_rest.copy()
        self._y = reset_plant(self._plant, self._at_inputs(parameters or {}), t0)
        self._held = self._u
        return self._y

    def _at_inputs(self, values: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
        """Take the values of inputs that are not driven, and return the others."""
        resting = {name: i for i, name in enumerate(self._names) if i not in self._driven}
        for name in resting.keys() & values.keys():
            self._u[resting[name]] = float(values[name])
        return {name: value for name, value in values.items() if name not in resting}

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the driven inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        held = self._every(u)
        y = step_plant(self._plant, held, h, self._time)
        self._steps, self._h = self._steps + 1, h
        self._held, self._y = held, y
        return y

    @property
    def can_give_outputs(self) -> bool:
        """Whether the plant's ``outputs_at`` works."""
        return self._plant.can_give_outputs

    def outputs_at(self, u: FloatArray) -> FloatArray:
        """Return the outputs now, shape (p,), at other driven inputs u, shape (m,)."""
        return outputs_of_plant_at(self._plant, self._every(u), self._time)

    def feedthrough(self, u: FloatArray) -> FloatArray | None:
        """Return the derivatives of the outputs by the driven inputs, shape (p, m); None: not known."""
        matrix = feedthrough_of_plant(self._plant, self._every(u), self._time)
        return None if matrix is None else matrix[:, self._driven]

    @property
    def can_save_state(self) -> bool:
        """Whether the plant's state can be saved."""
        return self._plant.can_save_state

    def save_state(self) -> object:
        """Return a copy of the plant's state, and of the time."""
        return self._plant.save_state(), self._t0, self._steps, self._h

    def restore_state(self, state: object) -> None:
        """Go back to a state."""
        saved, self._t0, self._steps, self._h = cast("tuple[object, float, int, float]", state)
        self._plant.restore_state(saved)

    @property
    def can_serialise_state(self) -> bool:
        """Whether the plant says that its state can be saved, and is data."""
        return self._plant.can_save_state and self._plant.state_is_data

    def serialise_state(self) -> bytes:
        """Return the plant's state, time, inputs and outputs as bytes."""
        if not self.can_serialise_state:
            lacking = "state_is_data" if self._plant.can_save_state else "can_save_state"
            reason = f"the plant does not say that its state can be saved as bytes ({lacking} is false)"
            raise ConfigError(f"{type(self._plant).__name__}: {reason}")
        clock, held = (self._t0, self._steps, self._h), dict(zip(self._names, self._held, strict=True))
        state = self._plant.save_state()
        return to_bytes({"state": state, "clock": clock, "inputs": held, "outputs": self._y})

    def deserialise_state(self, content: bytes) -> FloatArray:
        """Go on from the state of another run; return the outputs there, shape (p,)."""
        with understood(f"{type(self._plant).__name__}: the state"):
            saved = from_bytes(content)
            self._held = np.array([float(saved["inputs"][name]) for name in self._names])
            t0, steps, h = saved["clock"]
            self._t0, self._steps, self._h = float(t0), int(steps), float(h)
            self._y = np.array(saved["outputs"], dtype=np.float64)
        self._u = self._held.copy()
        self._plant.restore_state(saved["state"])
        return self._y

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters, and inputs that are not driven, from the next step on."""
        if parameters := self._at_inputs(parameters):
            set_plant_parameters(self._plant, parameters, self._time)

    def close(self) -> None:
        """Release everything that the plant holds."""
        close_plant(self._plant)

    def provenance(self) -> Mapping[str, str]:
        """Return the identifier of the plant."""
        return plant_provenance(self._plant)
