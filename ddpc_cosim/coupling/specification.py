"""What a coupled plant consists of, before anything of it runs: its variables, and how a worker opens it."""

import hashlib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, Self

from ddpc_cosim.coupling.wiring import Connection, Wiring
from ddpc_cosim.description import DefaultExperiment, DescribedVariable, PlantDescription
from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning, FMUImportError, FMUStepError
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import Variable, names, with_start

Exchanged = tuple[tuple[str, ...], tuple[str, ...]]
"""The inputs of a part that connections feed, and its outputs that they start from."""


class PartSpec(Protocol):
    """A plant that is not open yet."""

    @property
    def content(self) -> str:
        """What decides its behaviour."""

    @property
    def is_supplied(self) -> bool:
        """Whether an FMU of others is in it."""

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of its FMUs."""

    @property
    def plugins(self) -> tuple[str, ...]:
        """Names of the plug-ins that it is made of."""

    def variables(self) -> PlantDescription:
        """Return what it says about itself."""

    def built(self) -> Self:
        """Return it ready to run."""

    def moved(self, place: Callable[[str], str]) -> Self:
        """Return it with its FMUs elsewhere."""

    def starting_at(self, start: Mapping[str, float]) -> Self:
        """Return it with other start values of inputs."""

    def isolating(self, how: Mapping[str, Any]) -> Self:
        """Return it with each of its FMUs in a process of its own."""

    def open(self, inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
        """Open it with the chosen signals."""


class PartSignals(NamedTuple):
    """The signals of a part, which its connections are checked against."""

    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    dependencies: Mapping[str, frozenset[str]] = MappingProxyType({})
    is_sampled: bool = False


@dataclass(frozen=True, slots=True)
class CoupledSpec:
    """What a coupled plant consists of.

    Parameters
    ----------
    parts : mapping of str to PartSpec
        Its parts.
    connections : tuple of Connection
        What they exchange.
    connectors : tuple of Variable
        What is known of the system's own inputs and outputs.
    options : mapping of str to object
        Further arguments of :class:`CoupledPlant`.
    parameters : mapping of str to float, int, bool or str
        Values that differ from the parts' own, as ``part.name``.
    experiment : DefaultExperiment
        What its author had in mind.
    warnings : tuple of str
        What is wrong with what describes it but was understood.
    exchanged : mapping of str to (tuple of str, tuple of str)
        By part the inputs that connections feed and the outputs that they start from; empty until
        :meth:`built`.
    """

    parts: Mapping[str, PartSpec]
    connections: tuple[Connection, ...]
    connectors: tuple[Variable, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    experiment: DefaultExperiment = field(default_factory=DefaultExperiment)
    warnings: tuple[str, ...] = ()
    exchanged: Mapping[str, Exchanged] = field(default_factory=dict)

    @property
    def content(self) -> str:
        """What decides its behaviour: that of the parts, their connections and options; once it is built."""
        parts = [f"{name}: {part.content}" for name, part in self.parts.items()]
        how = [repr(link) for link in (*self.connections, *self.connectors)]
        settings = [f"{k}={v!r}" for k, v in sorted({**self.options, **self.parameters}.items())]
        return "coupled " + hashlib.sha256("\n".join((*parts, *how, *settings)).encode()).hexdigest()

    def variables(self) -> PlantDescription:
        """Return what the whole says about itself, variables of the parts as ``part.variable``.

        Raises
        ------
        CosimError
            A part cannot be read, or a connection does not fit.
        """
        known = self._variables_of_parts()
        wiring = self._wiring(known)
        inputs, outputs = ({v.name: v for v in group} for group in (wiring.inputs, wiring.outputs))
        parameters = {
            f"{part}.{name}": replace(variable, name=f"{part}.{name}")
            for part, described in known.items()
            for name, variable in described.parameters.items()
        }
        tunable = {f"{part}.{name}" for part, described in known.items() for name in described.tunable}
        fed = {f"{part}.{name}" for part, (fed, _) in self._exchanged(known, ()).items() for name in fed}

        def usual(every: Mapping[str, Variable], of: Callable[[PlantDescription], Iterable[str]]) -> Any:
            """Return the system's own signals; of a system without any, those of its parts."""
            of_parts = [f"{part}.{name}" for part, described in known.items() for name in of(described)]
            return tuple(name for name in every if "." not in name) or tuple(
                name for name in of_parts if name in every
            )

        usual_inputs = usual(inputs, lambda described: described.default_inputs or described.inputs)
        of_parts = {name: described.switches for name, described in known.items()}
        switches = switches_of_parts(of_parts, _signals(known), wiring)
        usual_inputs = tuple(name for name in usual_inputs if name not in switches.values())
        usual_outputs = usual(outputs, lambda described: described.default_outputs or described.outputs)
        connectors = {
            name: DescribedVariable(variable, causality=causality, start_text=repr(variable.start))
            for causality, variables in (("input", inputs), ("output", outputs))
            for name, variable in variables.items()
            if "." not in name
        }
        return PlantDescription(
            inputs,
            outputs,
            {name: variable for name, variable in parameters.items() if name not in fed},
            frozenset(tunable - fed),
            usual_inputs,
            usual_outputs,
            {unit: shown for described in known.values() for unit, shown in described.display_units.items()},
            variables=connectors | dict(self._declared(known, {*usual_inputs, *usual_outputs})),
            default_experiment=self.experiment,
            variable_step=all(part.variable_step for part in known.values()),
            fixed_step=max((part.fixed_step for part in known.values() if part.fixed_step), default=None),
            warnings=self.warnings,
            switches=switches,
        )

    def _declared(
        self, known: Mapping[str, PlantDescription], usual: Set[str]
    ) -> Iterator[tuple[str, DescribedVariable]]:
        """Yield the variables of parts by their full names, with the values that the system gives them.

        Inputs and outputs of the whole are those that take part if none are named.
        """
        for part, described in known.items():
            for variable in described.variables.values():
                full = f"{part}.{variable.name}"
                given, text, causality = self.parameters.get(full), variable.start_text, variable.causality
                renamed = replace(variable.variable, name=full)
                if isinstance(given, int | float):
                    renamed, text = replace(renamed, start=float(given)), repr(given)
                if causality in ("input", "output") and full not in usual:
                    causality = "local"
                alias, state = (
                    f"{part}.{name}" if name else "" for name in (variable.alias_of, variable.derivative_of)
                )
                yield (
                    full,
                    replace(
                        variable,
                        variable=renamed,
                        start_text=text,
                        causality=causality,
                        alias_of=alias,
                        derivative_of=state,
                    ),
                )

    def _variables_of_parts(self) -> dict[str, PlantDescription]:
        descriptions, faults = dict[str, PlantDescription](), list[str]()
        for name, part in self.parts.items():
            try:
                descriptions[name] = part.variables()
            except CosimError as error:
                faults.append(f'part "{name}": {error}')
        if faults:
            raise ConfigError(faults)
        return descriptions

    def _wiring(self, known: Mapping[str, PlantDescription], outputs: Sequence[str] | None = None) -> Wiring:
        return Wiring(_signals(known), self.connections, outputs=outputs, connectors=self.connectors)

    def _exchanged(
        self, known: Mapping[str, PlantDescription], outputs: Sequence[str]
    ) -> dict[str, Exchanged]:
        """Return by part the inputs that connections feed, and the outputs that they start from."""
        wiring = self._wiring(known, outputs)
        sources = {part: wiring.input_maps[part].sources.tolist() for part in known}
        places = set(wiring.output_map.sources.tolist()).union(*sources.values())
        used = {wiring.values[place] for place in places}
        return {
            part: (
                tuple(
                    name
                    for name, place in zip(described.inputs, sources[part], strict=True)
                    if wiring.values[place] != f"{part}.{name}"
                ),
                tuple(name for name in described.outputs if f"{part}.{name}" in used),
            )
            for part, described in known.items()
        }

    def built(self) -> Self:
        """Return it ready to run: its parts are built."""
        known = self._variables_of_parts()
        parts = dict[str, PartSpec]()
        for name, part in self.parts.items():
            with _naming(name):
                parts[name] = part.built()
        wiring = self._wiring(known)
        connectors = tuple(v for v in (*wiring.inputs, *wiring.outputs) if "." not in v.name)
        exchanged = self._exchanged(known, [v.name for v in wiring.outputs if "." not in v.name])
        return replace(self, parts=parts, connectors=connectors, exchanged=exchanged)

    def check(self, sampling_time: float) -> None:
        """Check that it, built, can be opened and stepped so [s]; nothing of it runs.

        Raises
        ------
        ConfigError
            Steps do not divide each other, or a part cannot do what the coupling needs.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CosimWarning)
            plant = self.open((), ())
            try:
                plant.plan(sampling_time, sampling_time)
            finally:
                plant.close()

    def starting_at(self, start: Mapping[str, float]) -> Self:
        """Return it, built, with other start values of inputs, by full name."""
        parts = {
            name: part.starting_at({v: start[f"{name}.{v}"] for v in _within(name, start)})
            for name, part in self.parts.items()
        }
        return replace(self, parts=parts, connectors=with_start(self.connectors, start))

    def moved(self, place: Callable[[str], str]) -> Self:
        """Return it with its FMUs elsewhere."""
        return replace(self, parts={name: part.moved(place) for name, part in self.parts.items()})

    def isolating(self, how: Mapping[str, Any]) -> Self:
        """Return it with each of its FMUs in a process of its own."""
        return replace(self, parts={name: part.isolating(how) for name, part in self.parts.items()})

    def open(self, inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
        """Open all parts, each with the signals that are chosen or connected, and couple them."""
        from ddpc_cosim.coupling.plant import CoupledPlant

        parts = dict[str, Plant]()
        try:
            for name, spec in self.parts.items():
                fed, used = self.exchanged[name]
                with _naming(name):
                    parts[name] = spec.open(
                        list(dict.fromkeys((*fed, *_within(name, inputs)))),
                        list(dict.fromkeys((*used, *_within(name, outputs)))),
                    )
            return CoupledPlant(
                parts,
                self.connections,
                inputs=inputs,
                outputs=outputs,
                connectors=self.connectors,
                parameters=self.parameters,
                **self.options,
            )
        except BaseException:
            for plant in parts.values():
                plant.close()
            raise


def _signals(known: Mapping[str, PlantDescription]) -> dict[str, PartSignals]:
    return {
        name: PartSignals(tuple(described.inputs.values()), tuple(described.outputs.values()))
        for name, described in known.items()
    }


def switches_of_parts(
    switches: Mapping[str, Mapping[str, str]], parts: Mapping[str, PartSignals], wiring: Wiring
) -> dict[str, str]:
    """Return the switches of parts' inputs, where both are inputs of the whole, by their names there.

    Parameters
    ----------
    switches : mapping of str to mapping of str to str
        By part, the switches of its inputs.
    parts : mapping of str to PartSignals
        The parts.
    wiring : Wiring
        How they are connected.
    """
    whole, of_whole = {v.name for v in wiring.inputs}, dict[str, str]()
    for part, of_part in switches.items():
        sources = (wiring.values[place] for place in wiring.input_maps[part].sources)
        fed_by = dict(zip(names(parts[part].inputs), sources, strict=True))
        pairs = ((fed_by[name], fed_by[switch]) for name, switch in of_part.items())
        of_whole |= {name: switch for name, switch in pairs if {name, switch} <= whole}
    return of_whole


def _within(part: str, signals: Iterable[str]) -> list[str]:
    """Return the names of a part's variables among full names of signals."""
    divided = (signal.partition(".") for signal in signals)
    return [name for whose, dot, name in divided if dot and whose == part]


@contextmanager
def _naming(part: str) -> Iterator[None]:
    """Have errors say which part they are of."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError([f'part "{part}": {fault}' for fault in error.faults]) from error
    except FMUImportError as error:
        raise FMUImportError(f'part "{part}": {error}') from error
    except FMUStepError as error:
        raise FMUStepError(f'part "{part}": {error.message}', error.status, error.time) from error
