"""The signals of a study that take part, and what its sections say of them, in their units."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from ddpc_cosim.codec import InvalidFieldError, ValidationErrors, independent
from ddpc_cosim.description import PlantDescription
from ddpc_cosim.distributions import Distribution
from ddpc_cosim.errors import ConfigError, DataError, Place
from ddpc_cosim.loop.setup import excitation_table
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.signals.excitations import Excitation, MixedExcitation, excitation_of, excited_together
from ddpc_cosim.signals.signals import Product, Reference, SignalFromResource, Sum, level_in_unit
from ddpc_cosim.study.file_format.sections import RecordingSection, Study
from ddpc_cosim.study.plants import PlantTables
from ddpc_cosim.variables import Variable, converter
from fmu_plants.spelling import did_you_mean, nearest

K = TypeVar("K", str, int)

_INPUTS, _OUTPUTS, _MEASUREMENTS = (("plant", key) for key in ("inputs", "outputs", "measurements"))


class Selection(NamedTuple):
    """The signals of one kind that take part.

    Where it is not known which, they are all that could, and ``size`` is the number of names given (0: none).
    """

    variables: tuple[Variable, ...]
    is_known: bool
    size: int

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(variable.name for variable in self.variables)


class SelectedSignals:
    """What a study says of its signals; what does not fit is reported.

    Parameters
    ----------
    study : Study
        Its sections.
    variables : PlantDescription
        All variables of its plant.
    errors : ValidationErrors
        What was found before; what is found here is added.
    tables : PlantTables
        Those in the plant's resources.
    is_free : bool
        Nothing is controlled: outputs are measured only.
    """

    def __init__(
        self,
        study: Study,
        variables: PlantDescription,
        errors: ValidationErrors,
        tables: PlantTables,
        is_free: bool = False,
    ) -> None:
        self.study, self.variables, self.errors, self.tables = study, variables, errors, tables
        plant = study.plant
        inputs = variables.default_inputs or tuple(variables.inputs)
        # What a wrong name probably stands for is not driven either.
        known = {name if name in inputs else nearest(name, inputs) for name in study.disturbances}
        driven = [name for name in inputs if name not in known]
        self.inputs = self._select(_INPUTS, "input", plant.inputs, variables.inputs, driven)
        self.outputs = self._select(
            *(_OUTPUTS, "output", plant.outputs, variables.outputs),
            variables.default_outputs or tuple(variables.outputs),
        )
        self.measurements = self._select(
            *(_MEASUREMENTS, "output", plant.measurements, variables.outputs), tuple(variables.outputs)
        )
        if not plant.measurements and not errors.in_doubt(_MEASUREMENTS):
            self.measurements = self.outputs
        if is_free:
            self.outputs = Selection((), self.outputs.is_known, 0)

    def _select(
        self,
        place: Place,
        what: str,
        given: list[str],
        known: Mapping[str, Variable],
        default: Sequence[str],
    ) -> Selection:
        self.errors.require_known(place, what, given, known)
        for name in sorted({name for name in given if given.count(name) > 1}):
            self.errors.add(place, f'"{name}" is listed more than once')
        if self.errors.in_doubt(place):
            return Selection(tuple(known.values()), False, len(given))
        chosen = tuple(known[name] for name in given or default)
        return Selection(chosen, True, len(chosen))

    def require_each(self, place: Place, what: str, given: Iterable[str], wanted: Selection) -> None:
        """Check that a table has an entry for each signal, and no others."""
        self.errors.require_known(place, what, given, wanted.names)
        for name in wanted.names if wanted.is_known else ():
            if name not in given:
                self.errors.add(place, f"none for the {what} {name}", (*place, name))

    def build(
        self,
        place: Place,
        sections: Mapping[K, Any],
        variables: Mapping[K, Variable],
        *,
        difference: bool = False,
    ) -> dict[K, Reference]:
        """Return the signals of sections in their variables' units, where they can be built."""
        signals = {}
        for name in self.converters(place, sections, variables, difference=difference):
            try:
                signal = self._with_tables((*place, name), sections[name])
                if signal is not None:
                    signals[name] = signal.in_unit(variables[name], difference=difference)
            except DataError as error:
                for fault in error.faults:
                    self.errors.add((*place, name, "file"), fault)
            except (InvalidFieldError, ConfigError):  # reported before
                continue
        return signals

    def level(
        self, place: Place, level: float | Reference, variable: Variable, unit: str = "", of_unit: Place = ()
    ) -> Reference | None:
        """Return a number or a signal as a signal in a variable's own unit; what is wrong is reported.

        ``unit`` is that of what has none of its own, and stands at a place ``of_unit``.
        """
        try:
            tabled = self._with_tables(place, level)
            return None if tabled is None else level_in_unit(variable, tabled, unit)
        except DataError as error:
            for fault in error.faults:
                self.errors.add((*place, "file"), fault)
        except InvalidFieldError:  # reported before
            return None
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add((*place, "unit") if getattr(level, "unit", "") else of_unit, fault)
        return None

    def _with_tables(self, place: Place, level: Any) -> Any:
        """Return a number or a signal with what the plant's resources hold of it; None: that is reported."""
        if isinstance(level, Sum | Product):
            parts = [self._with_tables((*place, "parts", i), part) for i, part in enumerate(level.parts)]
            return None if None in parts else replace(level, parts=tuple(parts))
        if not isinstance(level, SignalFromResource):
            return level
        if level.file not in self.tables.names:
            what = f'the plant has no "{level.file}" in its resources'
            self.errors.add((*place, "file"), f"{what}; {did_you_mean(level.file, self.tables.names)}")
            return None
        tabled = self.tabled(level)
        if tabled.table is not None and level.column not in tabled.table.columns:
            hint = did_you_mean(level.column, tabled.table.columns)
            self.errors.add((*place, "column"), f'{level.file} has no column "{level.column}"; {hint}')
            return None
        return tabled

    def span_at(self, place: Place) -> tuple[float, float]:
        """Return when what stands at a place begins to count and when it ends [s], warm-up included.

        What stands in a scenario counts in its run, all else in those of all scenarios.
        """
        if place[:1] != ("scenarios",):
            return self.study.span
        loop = self.study.loop.of(self.study.scenarios[str(place[1])])
        return loop.start_time - loop.warm_up, loop.end

    def tabled(self, signal: SignalFromResource) -> SignalFromResource:
        """Return a signal with its table; DataError: the plant has none of that name that can be read."""
        return replace(signal, table=self.tables.table(signal.file))

    def converters(
        self,
        place: Place,
        sections: Mapping[K, Any],
        variables: Mapping[K, Variable],
        *,
        difference: bool = False,
    ) -> dict[K, Callable[[float], float]]:
        """Return the conversion of each section's values to its variable's unit, where there is one."""
        converters = {}
        for name, section in sections.items():
            try:
                if name in variables:
                    converters[name] = converter(variables[name], section.unit, difference=difference)
            except ConfigError as error:
                self.errors.add((*place, name, "unit"), str(error))
        return converters

    def experiment(self, recording: RecordingSection, place: Place) -> Excitation | None:
        """Return the excitation of all inputs, in their units; what is wrong with it is reported there."""
        sections, is_added = recording.excitation, recording.controller is not None
        converters = self.converters(place, sections, self.variables.inputs, difference=is_added)
        groups: dict[object, list[str]] = {}
        for name in (name for name in self.inputs.names if name in converters):
            try:
                groups.setdefault(excited_together(sections[name], name), []).append(name)
            except InvalidFieldError:
                groups[name] = [name]
        parts = [self._excitation_part(recording, place, group) for group in groups.values()]
        if None in parts or not self.inputs.names or not converters.keys() >= set(self.inputs.names):
            return None
        numbers = [tuple(map(self.inputs.names.index, group)) for group in groups.values()]
        served = [(part, group) for part, group in zip(parts, numbers, strict=True) if part is not None]
        return served[0][0] if len(served) == 1 else MixedExcitation(tuple(served))

    @independent
    def _excitation_part(
        self,
        recording: RecordingSection,
        place: Place,
        group: Sequence[str],
    ) -> Excitation | None:
        """Return the excitation of inputs that are excited together."""
        place = (*place, group[0])
        if recording.samples is None or place in self.errors.found:
            return None
        entries = [(recording.excitation[name], self.variables.inputs[name]) for name in group]
        is_added = recording.controller is not None
        try:
            excitation = excitation_of(
                entries, recording.samples, self.study.loop.sampling_time, is_added=is_added
            )
            excitation_table(excitation, len(group))
        except DataError as error:
            for fault in error.faults:
                self.errors.add((*place, "file"), fault)
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add(place, fault)
        else:
            return excitation
        return None


def check_parameters(
    errors: ValidationErrors,
    place: Place,
    what: str,
    values: Mapping[str, ParameterValue | Distribution],
    known: Mapping[str, Variable],
) -> None:
    """Report parameters that are not known, and values outside their limits."""
    errors.require_known(place, what, values, known)
    for name, value in values.items():
        if isinstance(value, Distribution):
            _check_distribution(errors, (*place, name), value, known.get(name))
        elif not isinstance(value, str):  # a string, or the name of an enumeration's value: the plant knows
            check_value(errors, (*place, name), value, known.get(name))


@independent
def _check_distribution(
    errors: ValidationErrors, place: Place, distribution: Distribution, parameter: Variable | None
) -> None:
    """Report a distribution that reaches beyond its parameter's limits."""
    if parameter is None or distribution.has_faults:
        return
    low, high = distribution.support
    if low < parameter.min:
        reaches = f"draws below {parameter.min:g}, which {parameter.name} must not be"
        errors.add(place, f"{reaches}; set low = {parameter.min:g} or higher")
    if high > parameter.max:
        reaches = f"draws above {parameter.max:g}, which {parameter.name} must not be"
        errors.add(place, f"{reaches}; set high = {parameter.max:g} or lower")


def check_value(errors: ValidationErrors, place: Place, value: float, parameter: Variable | None) -> None:
    """Report a value outside its parameter's limits."""
    if parameter is not None and not parameter.min <= value <= parameter.max:
        errors.add(place, f"{value:g} is outside [{parameter.min:g}, {parameter.max:g}]")
