"""What a kind of condition is: the class that one more is derived from."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from numbers import Real
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from ddpc_cosim.settings import SIGNAL, SettingInfo
from ddpc_cosim.variables import FloatArray

Place = Literal["actuator", "sensor"]


class ConditionSetup(NamedTuple):
    """What a condition is made for in a loop.

    Parameters
    ----------
    place : {"actuator", "sensor"}
        Where it acts.
    signals : sequence of str
        Names of all signals that pass there.
    values : array, shape (len(signals),)
        What is given for each of them; ``neutral`` where nothing is.
    sampling_time : float
        Time between samples [s].
    seed : int
        Seed of random numbers.
    """

    place: Place
    signals: Sequence[str]
    values: FloatArray
    sampling_time: float
    seed: int


class Condition(ABC):
    """What actuators or sensors do to signals that pass through them, each by a number of its own.

    Its class says all that there is to know of a kind of condition: a study file gives it as a table of the
    name that it is installed by, ``rate_limit = { torque = 5.0 }``, Python as ``Conditions(rate_limit=...)``.
    Its life: it is made once for a loop and each of its places, ``start`` is called before each run, an
    experiment is one too, and ``apply`` once per sample. Set in all classes: ``places``, ``order``, ``value``
    and ``words``.
    """

    places: ClassVar[tuple[Place, ...]]
    """Where it acts: on driven inputs, on measurements, or on both."""
    order: ClassVar[float]
    """When it acts, of all in its place: the lower ones first. The noise of sensors is at 0."""
    value: ClassVar[SettingInfo]
    """The number that is given for each signal: what it is, its range, its unit (``SIGNAL``: that of it)."""
    words: ClassVar[str]
    """What the report says of a signal, with ``{name}`` and ``{value}``."""
    neutral: ClassVar[float] = 0.0
    """The number with which it does nothing."""
    in_experiments: ClassVar[bool] = True
    """Whether it acts in the experiment that records data, too."""
    loses: ClassVar[bool] = False
    """Whether what it returns can be NaN: a measurement that is lost."""

    c_code: ClassVar[str] = ""
    """What it does to one signal in C, for loops that are compiled: statements that end with a ``return``.

    They have its ``value`` at the sample of number ``k``, and its number ``given`` and ``memory`` as
    :meth:`in_c` returns them. Empty: loops with it run in Python.
    """

    def __init__(self, setup: ConditionSetup) -> None:
        self.setup = setup

    @abstractmethod
    def apply(self, k: int, values: FloatArray) -> FloatArray:
        """Return what becomes of the values at sample k, both of shape (len(signals),), in new memory."""

    def start(self, time: FloatArray, rest: FloatArray | None) -> None:  # noqa: B027 - may be left as it is
        """Prepare for a run with samples at these times [s].

        Parameters
        ----------
        time : array, shape (K,)
            The times of the samples.
        rest : array, shape (len(signals),), or None
            Where the signals are before the run; NaN: not known. None: the run goes on from where it is.
        """

    def in_c(self) -> tuple[FloatArray, FloatArray]:
        """Return what ``c_code`` has of each signal once a run has started, in new memory.

        Returns
        -------
        given : array, shape (len(signals),)
            Its number; default: as it was given.
        memory : array, shape (len(signals), n)
            What it remembers, or has drawn; default: nothing.
        """
        return self.setup.values, np.empty((len(self.setup.values), 0))

    @classmethod
    def allowed(cls) -> str:
        """Return the range of its values in words."""
        return f"a finite number {cls.value.allowed}"

    @classmethod
    def is_possible(cls, value: object) -> bool:
        """Whether a number is in its range."""
        return isinstance(value, Real) and not cls.value.needed_of(float(value))

    @classmethod
    def fault_of(cls, value: float, sampling_time: float, steps: float = math.inf, run: str = "run") -> str:
        """Return why a number is not possible in a run of so many sampling intervals; empty if it is."""
        return ""

    @classmethod
    def unit_of(cls, signal: str) -> str:
        """Return the unit of its values, given that of the signal."""
        return signal if cls.value.unit == SIGNAL else cls.value.unit

    @classmethod
    def whose(cls) -> str:
        """Return which signals may have it, in words."""
        words = {"actuator": "input that the controllers drive", "sensor": "measurement"}
        return "input or measurement" if len(cls.places) > 1 else words[cls.places[0]]
