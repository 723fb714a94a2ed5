"""What a suggested study consists of, before it is written down."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ddpc_cosim.variables import Variable


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of an input, in its unit, and where they come from."""

    low: float
    high: float
    origin: str


@dataclass(frozen=True, slots=True)
class Setpoints:
    """A reference in steps, in the output's unit."""

    times: tuple[float, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Competitor:
    """A controller of the study: its type, its settings, and why these."""

    type: str
    label: str
    settings: Mapping[str, Any]
    remark: str


@dataclass(frozen=True)
class Proposal:
    """A suggested study.

    Parameters
    ----------
    plant : str
        Name of the plant, for the title.
    inputs, outputs, measurements : tuple of Variable
        What is driven, controlled and measured.
    nominal : mapping of str to float
        Sizes of inputs and controlled outputs, in their units: what controllers scale them by.
    bounds : mapping of str to Bounds
        By input.
    setpoints : mapping of str to Setpoints
        By output.
    sampling_time, duration : float
        In s.
    excitation : mapping of str to (float, float)
        Range of the recording's random inputs; empty for no recording.
    samples : int
        Length of the recording.
    competitors : mapping of str to Competitor
        The controllers by key.
    remarks : mapping of str to tuple of str
        What to know, by section of the study: findings, guesses and warnings.
    """

    plant: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    nominal: Mapping[str, float]
    bounds: Mapping[str, Bounds]
    setpoints: Mapping[str, Setpoints]
    sampling_time: float
    duration: float
    excitation: Mapping[str, tuple[float, float]]
    samples: int
    competitors: Mapping[str, Competitor]
    remarks: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
