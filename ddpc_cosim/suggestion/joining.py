"""Several FMUs as one plant: which output may feed which input, going by names and units."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from ddpc_cosim.coupling.wiring import Connection
from ddpc_cosim.description import DefaultExperiment, PlantDescription, default_signals, switches_of
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.inspection.words import (
    SURROUNDINGS,
    Wording,
    command,
    exponents_of,
    listed,
    measurement,
    setpoint,
    vocabulary,
)
from ddpc_cosim.study.file_format.sections import PartSection, PlantSection
from ddpc_cosim.variables import Variable
from fmu_plants.model import identifier

_DIRECTIONS = vocabulary("in out inlet outlet input output inp outp u y from to meas measured act actual cmd")
_SAME, _ALIKE, _SHARED, _BY_ROLE, _BY_UNIT = 5.0, 4.0, 2.5, 2.0, 1.0
_PATH_TOO = 0.5
_SURE = 4.0
_BEGINNING = 3  # letters that say what a word is
_UNIT_KNOWN = 0.5
_LISTED = 8
_ABBREVIATED = {
    "f": "force",
    "v": "velocity",
    "w": "speed",
    "t": "temperature",
    "temp": "temperature",
    "p": "pressure",
    "q": "flow",
    "i": "current",
    "m": "mass",
    "tau": "torque",
    "h": "level",
    "x": "position",
    "phi": "angle",
}


@dataclass(frozen=True, slots=True)
class _Fit:
    """How well an output fits an input, and why."""

    source: str
    target: str
    points: float
    why: str
    is_forward: bool

    @property
    def ends(self) -> tuple[str, str]:
        """The parts that it is between."""
        return self.source.partition(".")[0], self.target.partition(".")[0]


@dataclass(frozen=True, slots=True)
class Joined:
    """FMUs as one plant.

    Parameters
    ----------
    section : PlantSection
        The plant of a study.
    title : str
        What they model.
    reasons : tuple of str
        Why each connection is proposed, in the order of the connections.
    remarks : tuple of str
        What is to be said of them as a whole.
    experiment : DefaultExperiment
        The longest that an author of theirs had in mind.
    """

    section: PlantSection
    title: str
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]
    experiment: DefaultExperiment


def part_names(paths: Sequence[Path]) -> list[str]:
    """Return names for parts: those of the files, told apart by a number where they are the same."""
    names = list[str]()
    for path in paths:
        name, number = identifier(path.stem), 2
        while name in names:
            name, number = f"{identifier(path.stem)}_{number}", number + 1
        names.append(name)
    return names


def join(paths: Sequence[Path], descriptions: Sequence[PlantDescription], title: str) -> Joined:
    """Propose which outputs of FMUs feed which inputs of the others.

    Every input is fed by the output that fits it best: of the same name, of the same name but for ``in`` and
    ``out``, of names that share words, of what a controller is and its plant, or the only one of its unit.
    Units that cannot be converted never fit. A setpoint is fed by a signal that is called so alone, and the
    weather by a unit never.

    Parameters
    ----------
    paths : sequence of Path
        The FMUs.
    descriptions : sequence of PlantDescription
        What they say about themselves.
    title : str
        What they model.

    Raises
    ------
    ConfigError
        Nothing fits, or nothing is left to drive.
    """
    parts = dict(zip(part_names(paths), descriptions, strict=True))
    fits = _without_returns([*_best_fits(parts)])
    files = ", ".join(path.name for path in paths)
    if not fits:
        raise ConfigError(f"{files}: {_nothing_fits(parts)}")
    connected = {fit.target for fit in fits}
    free = [
        f"{part}.{v.name}"
        for part, described in parts.items()
        for v in _inputs(described)
        if f"{part}.{v.name}" not in connected
    ]
    remarks = list[str]()
    if not free:
        weakest = min(fits, key=lambda fit: fit.points)
        fits.remove(weakest)
        free = [weakest.target]
        remarks.append(
            "Every input could be fed, which leaves nothing to drive. Left out for that: "
            f"{weakest.source} -> {weakest.target} ({weakest.why})."
        )
    doubted = [f"{fit.source} -> {fit.target} ({fit.why})" for fit in fits if fit.points < _SURE]
    sure = [f"{fit.source} -> {fit.target}" for fit in fits if fit.points >= _SURE]
    if sure:
        remarks.append(f"Connected by name and unit: {listed(sure, _LISTED, 'connections')}.")
    if doubted:
        remarks.append(
            f"Doubtful, check them in plant.connections: {listed(doubted, _LISTED, 'connections')}."
        )
    remarks.append(f"Not fed by another part: {listed(free, _LISTED, 'inputs')}.")
    section = PlantSection(
        parts=[
            PartSection(name=part, fmu=str(path.resolve())) for part, path in zip(parts, paths, strict=True)
        ],
        connections=[Connection(fit.source, fit.target) for fit in fits],
    )
    reasons = tuple(fit.why if fit.points >= _SURE else f"doubtful: {fit.why}" for fit in fits)
    return Joined(section, title, reasons, tuple(remarks), _longest(descriptions))


def _longest(descriptions: Sequence[PlantDescription]) -> DefaultExperiment:
    """Return the longest of the default experiments, from 0 on; in what steps is found out."""
    experiments = (described.default_experiment for described in descriptions)
    longest = max((e.stop_time or 0.0) - (e.start_time or 0.0) for e in experiments)
    return DefaultExperiment(stop_time=longest if longest > 0.0 else None)


def _inputs(described: PlantDescription) -> list[Variable]:
    switches = set(switches_of(described).values())
    signals = default_signals(described, "input")
    return [signal.variable for signal in signals if signal.variable.name not in switches]


def _outputs(described: PlantDescription) -> list[Variable]:
    return [signal.variable for signal in default_signals(described, "output")]


def _best_fits(parts: Mapping[str, PlantDescription]) -> Iterator[_Fit]:
    """Yield the best fit for every input that has one."""
    order = [*parts]
    for part, described in parts.items():
        for fed in _inputs(described):
            fits = [
                _Fit(
                    f"{other}.{v.name}",
                    f"{part}.{fed.name}",
                    points,
                    why,
                    order.index(other) < order.index(part),
                )
                for other in order
                if other != part
                for v in _outputs(parts[other])
                for points, why in (_fit(v, fed, _are_only_ones(v, fed, parts[other], described)),)
                if points
            ]
            fits.sort(key=lambda fit: (-fit.points, not fit.is_forward))
            if not fits:
                continue
            best = fits[0]
            as_good = [fit.source for fit in fits[1:] if fit.points == best.points]
            if as_good:
                why = f"{best.why}, as {listed(as_good, 3, 'outputs')}"
                best = _Fit(best.source, best.target, min(best.points, _SURE - 1), why, best.is_forward)
            yield best


def _without_returns(fits: Sequence[_Fit]) -> list[_Fit]:
    """Return the fits without what leads back where the same leads on: of two tanks the second is last."""
    onward = {(_core_of(fit.source), *fit.ends) for fit in fits if fit.is_forward and fit.points < _SAME}
    backward = {(core, target, source) for core, source, target in onward if core}
    return [fit for fit in fits if fit.is_forward or (_core_of(fit.source), *fit.ends) not in backward]


def _core_of(name: str) -> frozenset[str]:
    return _core(Wording(Variable(name.partition(".")[2])))


def _core(wording: Wording) -> frozenset[str]:
    """Return what a name says besides where its signal goes."""
    return frozenset(word for word in wording.labels if word not in _DIRECTIONS)


def _fit(source: Variable, target: Variable, are_only_ones: bool) -> tuple[float, str]:
    """Return how well an output fits an input, and why; 0: not at all."""
    units = exponents_of(source.unit), exponents_of(target.unit)
    if None not in units and units[0] != units[1]:
        return 0.0, ""
    of_unit = _UNIT_KNOWN if None not in units else 0.0
    in_unit = f" and in {target.unit}" if of_unit else ""
    given, fed = Wording(source), Wording(target)
    if source.name.lower() == target.name.lower():
        return _SAME + _PATH_TOO + of_unit, f"same name{in_unit}"
    if given.labels == fed.labels:
        return _SAME + of_unit, f"same name{in_unit}"
    if setpoint(fed) and not (setpoint(given) or command(given)):
        return 0.0, ""
    core, wanted = _core(given), _core(fed)
    if core and core == wanted:
        return _ALIKE + of_unit, f"same name but for its direction{in_unit}"
    numbers = {word for word in core if word.isdigit()}, {word for word in wanted if word.isdigit()}
    differ = bool(all(numbers) and numbers[0] != numbers[1])
    shared = _shared(core - numbers[0], wanted - numbers[1])
    if len(shared) > 1 or (shared and not (differ or fed.all & SURROUNDINGS)):
        points = _BY_ROLE if differ else _SHARED
        return points + of_unit, f"both names speak of {shared}{in_unit}"
    if fed.all & SURROUNDINGS:
        return 0.0, ""
    if are_only_ones and command(given) and fed.looks_driven:
        return _BY_ROLE + of_unit, f"a command to an actuator{in_unit}"
    if are_only_ones and measurement(fed):
        return _BY_ROLE + of_unit, f"what is measured{in_unit}"
    if are_only_ones and not core and not wanted:
        return _BY_ROLE + of_unit, f"an output and an input without other names{in_unit}"
    if are_only_ones and of_unit:
        return _BY_UNIT + of_unit, f"the only ones in {target.unit}"
    return 0.0, ""


def _shared(some: frozenset[str], others: frozenset[str]) -> str:
    """Return the longest word that two names have in common, if only by its beginning or first letter."""
    common = list[str]()
    for one in some:
        for other in others:
            if one == _ABBREVIATED.get(other) or other == _ABBREVIATED.get(one):
                common.append(max(one, other, key=len))
            elif one == other or (
                min(len(one), len(other)) >= _BEGINNING and (one.startswith(other) or other.startswith(one))
            ):
                common.append(min(one, other, key=len))
    return max(common, key=lambda word: (len(word), word), default="")


def _are_only_ones(
    source: Variable, target: Variable, giving: PlantDescription, fed: PlantDescription
) -> bool:
    """Whether nothing else in the two parts has the unit of both, setpoints and the weather apart."""
    outputs = [v for v in _outputs(giving) if v.unit == source.unit]
    inputs = [
        v
        for v in _inputs(fed)
        if v.unit == target.unit and not setpoint(Wording(v)) and not Wording(v).all & SURROUNDINGS
    ]
    return len(outputs) == 1 and inputs == [target]


def _nothing_fits(parts: Mapping[str, PlantDescription]) -> str:
    """Return that nothing fits, with what there is, and what to do."""

    def signals(which: str) -> str:
        return (
            listed(
                chain.from_iterable(
                    (
                        f"{part}.{v.name}{f' [{v.unit}]' if v.unit else ''}"
                        for v in (_outputs(d) if which == "outputs" else _inputs(d))
                    )
                    for part, d in parts.items()
                ),
                _LISTED,
                which,
            )
            or "none"
        )

    return (
        "no output of one fits an input of another by name or unit, so there is nothing to connect; outputs: "
        f"{signals('outputs')}; inputs: {signals('inputs')}; write plant.parts and plant.connections in a "
        "study by hand (docs: Couple several FMUs), or give `init` each FMU by itself"
    )
