"""Which numbers of an FMU a run drives and reads."""

from collections.abc import Iterable, Sequence

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.model_description import REAL_TYPES, FMUDescription, Signal
from ddpc_cosim.suggest import did_you_mean

_READABLE = ("output", "local", "parameter", "calculatedParameter", "input")


def default_signals(description: FMUDescription, causality: str) -> list[Signal]:
    """Return the inputs or outputs that take part if none are named: the real numbers, or all if none are."""
    numbers = list(description.signals(causality))
    return [signal for signal in numbers if signal.source.type in REAL_TYPES] or numbers


def choose_signals(
    description: FMUDescription, label: str, inputs: Sequence[str] | None, outputs: Sequence[str] | None
) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    """Return the numbers to drive and to read.

    Parameters
    ----------
    description : FMUDescription
        The FMU.
    label : str
        The FMU's file name, for errors.
    inputs, outputs : sequence of str or None
        Their names; None for the default.

    Raises
    ------
    ConfigError
        A name does not fit; all faults at once.
    """
    faults: list[str] = []
    chosen = []
    for what, allowed, names in (("input", ("input",), inputs), ("output", _READABLE, outputs)):
        if names is None:
            chosen.append(tuple(default_signals(description, what)))
            continue
        found = []
        for name in names:
            fault = _fault(description, name, what, allowed)
            if fault:
                faults.append(f"{label}: {fault}")
                continue
            found.append(name)
        faults += [f'{label}: {what} "{name}" is chosen twice' for name in _repeated(found)]
        signals = (description.signal(name) for name in found)
        chosen.append(tuple(signal for signal in signals if signal is not None))
    if faults:
        raise ConfigError(faults)
    return chosen[0], chosen[1]


def _fault(description: FMUDescription, name: str, what: str, allowed: Sequence[str]) -> str:
    """Return why a name is not one of a number that can be an input, or an output; empty if it is."""
    signal, variable = description.signal(name), description.variables.get(name)
    if signal is not None and signal.source.is_numeric and signal.source.causality in allowed:
        return ""
    if variable is not None and variable.causality in allowed:
        if not variable.is_numeric:
            return f'"{name}" is a {variable.type} and cannot be an {what}; only numbers can'
        sizes = ",".join(map(str, variable.shape))
        first = ",".join("1" for _ in variable.shape)
        return f'"{name}" is an array of size [{sizes}]; name an element, for example "{name}[{first}]"'
    known = [s.variable.name for s in description.signals(*allowed)]
    return f'no {what} "{name}"; {did_you_mean(name, known)}'


def _repeated(names: Sequence[str]) -> Iterable[str]:
    return sorted({name for name in names if names.count(name) > 1})
