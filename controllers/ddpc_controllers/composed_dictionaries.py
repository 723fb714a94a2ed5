"""Dictionaries made of others: a state with its past, and several dictionaries side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddpc_controllers.dictionaries import Dictionary, Identity, Lift, memory_of, require_dictionary
from ddpc_cosim import ConfigError, FloatArray, check_settings, setting


@dataclass(frozen=True, kw_only=True)
class Delays:
    """Past samples of the state, and what another dictionary makes of the state with its past.

    By Takens' argument a few past samples of the outputs stand for the states that are not measured.
    """

    samples: int = setting(1, low=1, doc="number of past samples")
    dictionary: Dictionary = setting(
        default_factory=Identity, doc="dictionary that lifts the state with its past"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        require_dictionary(self.dictionary, "Delays: dictionary")
        if memory_of(self.dictionary):
            raise ConfigError("Delays: dictionary looks back itself; set samples to the sum instead")

    @property
    def memory(self) -> int:
        """Number of past samples needed."""
        return self.samples

    def functions(self, size: int) -> int:
        """Return the number of past values and of observables of all of them."""
        return self.samples * size + self.dictionary.functions((self.samples + 1) * size)

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Draw the inner dictionary; see :class:`Dictionary`."""
        size = states.shape[-1] // (self.samples + 1)
        return _Delayed(size, self.dictionary.draw(states, rng))


@dataclass(frozen=True, eq=False)
class _Delayed:
    size: int
    inner: Lift

    def __call__(self, states: FloatArray) -> FloatArray:
        return np.concatenate([states[..., self.size :], self.inner(states)], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Combined:
    """Several dictionaries side by side."""

    dictionaries: Sequence[Dictionary] = setting(doc="the dictionaries, in the order of their observables")

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.dictionaries:
            raise ConfigError("Combined: dictionaries is empty")
        for i, dictionary in enumerate(self.dictionaries):
            require_dictionary(dictionary, f"Combined: dictionaries[{i}]")

    @property
    def memory(self) -> int:
        """Number of past samples needed: the most that one of them needs."""
        return max(map(memory_of, self.dictionaries))

    def functions(self, size: int) -> int:
        """Return the number of all observables."""
        return sum(dictionary.functions(size) for dictionary in self.dictionaries)

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Draw one after another; see :class:`Dictionary`."""
        size = states.shape[-1] // (self.memory + 1)
        widths = [(memory_of(dictionary) + 1) * size for dictionary in self.dictionaries]
        lifts = [d.draw(states[:, :width], rng) for d, width in zip(self.dictionaries, widths, strict=True)]
        return _SideBySide(lifts, widths)


@dataclass(frozen=True, eq=False)
class _SideBySide:
    lifts: list[Lift]
    widths: list[int]

    def __call__(self, states: FloatArray) -> FloatArray:
        parts = [lift(states[..., :width]) for lift, width in zip(self.lifts, self.widths, strict=True)]
        return np.concatenate(parts, axis=-1)
