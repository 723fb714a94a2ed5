"""A suggested study as a commented file."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import tomli_w

from ddpc_cosim.diagnosis.proposal import Competitor, Proposal
from ddpc_cosim.variables import Variable

_WIDTH = 110


def study_text(proposal: Proposal, fmu: str) -> str:
    """Return the study file.

    Parameters
    ----------
    proposal : Proposal
        What to write.
    fmu : str
        Path of the FMU as the file is to say it.
    """
    sections = (
        _head(proposal),
        _plant(proposal, fmu),
        _loop(proposal),
        _references(proposal),
        _bounds(proposal),
        _recording(proposal),
        _controllers(proposal),
    )
    return "\n".join("\n".join(lines) + "\n" for lines in sections if lines)


def _head(proposal: Proposal) -> list[str]:
    return [
        f"title = {_value(f'Control of {proposal.plant}')}",
        "seeds = [0]",
    ]


def _plant(proposal: Proposal, fmu: str) -> list[str]:
    return [
        *_remarks(proposal, "plant"),
        "[plant]",
        f"fmu = {_value(fmu)}",
        *_names("inputs", proposal.inputs),
        *_names("outputs", proposal.outputs),
        *_names("measurements", proposal.measurements),
        "# how far each signal goes: what controllers scale it by",
        "[plant.nominal]",
        *(f"{_key(name)} = {_value(size)}" for name, size in proposal.nominal.items()),
    ]


def _names(key: str, variables: Iterable[Variable]) -> list[str]:
    return [f"{key} = [", *(f"    {_value(v.name)},{_about(v)}" for v in variables), "]"]


def _about(variable: Variable) -> str:
    parts = [f"[{variable.unit}]" if variable.unit else "", _one_line(variable.description)]
    text = " ".join(part for part in parts if part)
    return f"  # {text}" if text else ""


def _loop(proposal: Proposal) -> list[str]:
    return [
        *_remarks(proposal, "loop"),
        "[loop]",
        f"sampling_time = {_value(proposal.sampling_time)}  # s",
        f"duration = {_value(proposal.duration)}  # s",
    ]


def _references(proposal: Proposal) -> list[str]:
    lines = _remarks(proposal, "reference")
    for name, setpoints in proposal.setpoints.items():
        lines += [
            f"[reference.{_key(name)}]",
            'kind = "steps"',
            f"times = {_value(list(setpoints.times))}  # s",
            f"values = {_value(list(setpoints.values))}",
        ]
    return lines


def _bounds(proposal: Proposal) -> list[str]:
    return [
        *_remarks(proposal, "bounds"),
        "[bounds]",
        *(
            f"{_key(name)} = {{ min = {_value(b.low)}, max = {_value(b.high)} }}  # {b.origin}"
            for name, b in proposal.bounds.items()
        ),
    ]


def _recording(proposal: Proposal) -> list[str]:
    remarks = _remarks(proposal, "recording")
    if not proposal.excitation:
        return remarks
    return [
        *remarks,
        "[recording]",
        f"samples = {proposal.samples}",
        *(
            f"excitation.{_key(name)} = {{ low = {_value(low)}, high = {_value(high)} }}"
            for name, (low, high) in proposal.excitation.items()
        ),
    ]


def _controllers(proposal: Proposal) -> list[str]:
    lines = _remarks(proposal, "controllers")
    for key, competitor in proposal.competitors.items():
        lines += [*([""] if lines else []), *_controller(key, competitor)]
    return lines


def _controller(key: str, competitor: Competitor) -> Iterator[str]:
    yield from _comment(competitor.remark)
    yield f"[controllers.{_key(key)}]"
    yield f"type = {_value(competitor.type)}"
    yield f"label = {_value(competitor.label)}"
    yield f"[controllers.{_key(key)}.settings]"
    for name, value in competitor.settings.items():
        yield f"{_key(name)} = {_value(value)}"


def _remarks(proposal: Proposal, section: str) -> list[str]:
    return [line for remark in proposal.remarks.get(section, ()) for line in _comment(remark)]


def _comment(text: str) -> Iterator[str]:
    from textwrap import wrap

    return (f"# {line}" for line in wrap(_one_line(text), _WIDTH - 2))


def _one_line(text: str) -> str:
    """Return a text that cannot leave the comment that it stands in."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _value(value: Any) -> str:
    """Return a value in TOML, on one line."""
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value)}]"
    text = _table({"x": value})
    return text.partition(" = ")[2].strip()


def _key(name: str) -> str:
    """Return a key in TOML, quoted where that is needed."""
    return _table({name: 0}).rpartition(" = ")[0]


def _table(content: Mapping[str, Any]) -> str:
    return tomli_w.dumps(dict(content))
