"""What an experiment applies to a plant, or adds to the inputs of a controller that stabilises it."""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from numbers import Integral, Real
from threading import Lock
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.codec import Kinds, Section, declared_fields
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import SIGNAL, setting
from ddpc_cosim.signals.signals import (
    RecordedSignal,
    Reference,
    Signal,
    Steps,
    by_kind,
    shown_without,
    type_faults,
)
from ddpc_cosim.variables import FloatArray, Variable, converter

# The stages whose sum modulo 2 is fed back, for registers of 2, 3, ... stages: their polynomials are
# primitive, which makes the sequences as long as they can be (S. W. Golomb, Shift Register Sequences,
# Holden-Day, 1967; the table is that of P. Alfke, Xilinx application note XAPP 052, 1996).
_TAPS: tuple[tuple[int, ...], ...] = (
    (2, 1),
    (3, 2),
    (4, 3),
    (5, 3),
    (6, 5),
    (7, 6),
    (8, 6, 5, 4),
    (9, 5),
    (10, 7),
    (11, 9),
    (12, 6, 4, 1),
    (13, 4, 3, 1),
    (14, 5, 3, 1),
    (15, 14),
    (16, 15, 13, 4),
    (17, 14),
    (18, 11),
    (19, 6, 2, 1),
    (20, 17),
    (21, 19),
    (22, 21),
    (23, 18),
    (24, 23, 22, 17),
    (25, 22),
    (26, 6, 2, 1),
    (27, 5, 2, 1),
    (28, 25),
)
# Which random numbers of a seed serve which kind; those of uniform samples are MATLAB's.
_PRBS_STREAM, _MULTISINE_STREAM, _CHIRP_STREAM = 1, 2, 3
# A generator of these takes longer to make, with a state that the system draws, than hundreds of samples do.
_matlab, _seeded = np.random.RandomState(0), Lock()


class Excitation(ABC):
    """What an experiment applies to a plant, or adds to the inputs of a controller that stabilises it."""

    @abstractmethod
    def draw(self, inputs: int) -> FloatArray:
        """Return the excitation of all inputs, shape (T, inputs), in their units, time along axis 0.

        Raises
        ------
        ConfigError
            It is made for another number of inputs.
        """

    def with_seed(self, seed: int) -> "Excitation":
        """Return the excitation with the random numbers of another seed; itself where it has none."""
        return self


@dataclass(frozen=True, slots=True, repr=False)
class _Ranged(Section, Excitation):
    """What the excitations between two limits share.

    A study file has one for each input: its samples are the recording's, its seed is the case's.
    """

    kind: ClassVar[str] = ""

    low: float | Sequence[float] = setting(doc="lowest value", unit=SIGNAL, written=float)
    high: float | Sequence[float] = setting(doc="highest value", unit=SIGNAL, written=float)
    samples: int = setting(doc="number of samples T", key=None)
    seed: int = setting(0, doc="seed of the stream", key=None)
    _: KW_ONLY
    unit: str = setting("", doc="unit of low and high; empty: the variable's own")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the limits, and with what the kind says besides."""
        try:
            self.made_for(1, 1e-9)
        except ConfigError as error:
            yield from (("", fault) for fault in error.faults)

    def made_for(self, samples: int, sampling_time: float, **changes: Any) -> "_Ranged":
        """Return the excitation for an experiment of so many samples, so far apart [s]."""
        timing: dict[str, Any] = (
            {"sampling_time": sampling_time} if hasattr(type(self), "sampling_time") else {}
        )
        return replace(self, samples=samples, **timing, **changes)

    def of_inputs(
        self, limits: Sequence[tuple[float, float]], samples: int, sampling_time: float
    ) -> "_Ranged":
        """Return the excitation of several inputs, with the limits of each in its own unit."""
        low, high = zip(*limits, strict=True)
        return self.made_for(samples, sampling_time, low=low, high=high, unit="")

    def __repr__(self) -> str:
        return shown_without(self, () if self.unit else ("unit",))

    def __post_init__(self) -> None:
        faults = []
        if not isinstance(self.samples, Integral) or self.samples < 1:
            faults.append(f"samples = {self.samples} is not possible; allowed: an integer >= 1")
        if not isinstance(self.seed, Integral) or not 0 <= self.seed < 2**32:
            faults.append(f"seed = {self.seed} is not possible; allowed: an integer from 0 to 2**32 - 1")
        if not all(_are_finite(value) for value in (self.low, self.high)):
            faults.append(f"low ({self.low}) and high ({self.high}) must be finite numbers")
        elif np.ndim(self.low) == np.ndim(self.high) == 1 and np.shape(self.low) != np.shape(self.high):
            faults.append(f"low ({self.low}) and high ({self.high}) need the same length")
        elif not _is_below(self.low, self.high):
            faults.append(f"low ({self.low}) must be below high ({self.high})")
        faults += type_faults(self, float) or self._faults()
        if faults:
            raise ConfigError([f"{self._title} excitation: {fault}" for fault in faults])

    @property
    def _title(self) -> str:
        return self.kind

    def with_seed(self, seed: int) -> "Excitation":
        """Return the excitation with the random numbers of another seed."""
        return replace(self, seed=seed)

    def draw(self, inputs: int) -> FloatArray:
        """Return the excitation of all inputs, shape (samples, inputs), time along axis 0.

        Raises
        ------
        ConfigError
            There are ranges for another number of inputs, or more inputs than it can serve.
        """
        for name in ("low", "high"):
            if np.shape(getattr(self, name)) not in ((), (inputs,)):
                values = getattr(self, name)
                raise ConfigError(
                    f"{self._title} excitation: {name} = {values}; needed: a number, or {inputs}"
                )
        low, high = np.asarray(self.low, dtype=float), np.asarray(self.high, dtype=float)
        # Twice the centred half range, in the order of the authors' program, gives its data to the last bit.
        drawn: FloatArray = (low + high) / 2 + (high - low) / 2 * self._shape(inputs)
        return drawn

    @abstractmethod
    def _shape(self, inputs: int) -> FloatArray:
        """Return the excitation between -1 and 1, shape (samples, inputs)."""

    def _faults(self) -> Iterator[str]:
        """Yield what is wrong with the settings of a kind."""
        yield from ()

    def _random(self, stream: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(int(self.seed), spawn_key=(stream,)))


@dataclass(frozen=True, slots=True, repr=False)
class UniformRandom(_Ranged):
    """Independent uniform samples, one stream of ``numpy.random.RandomState`` for all inputs.

    Sample by sample the stream serves the inputs in their order, so that one input's data of a seed equal
    MATLAB's ``rng(seed); rand(1, T)``.

    Parameters
    ----------
    low, high : float or sequence of float
        Range, for all inputs or one for each, in their units.
    samples : int
        Number of samples T.
    seed : int
        Seed of the stream; a study replaces it by the seed of the case.
    """

    kind: ClassVar[str] = "uniform"

    def _shape(self, inputs: int) -> FloatArray:
        with _seeded:
            _matlab.seed(self.seed)
            unit = _matlab.random_sample((self.samples, inputs))
        return 2 * unit - 1


@dataclass(frozen=True, slots=True, repr=False)
class PRBS(_Ranged):
    """Pseudo-random binary sequence: two levels, from a shift register of maximum length.

    The register is the shortest whose sequence does not repeat within the experiment, however many inputs
    there are: each gets a part of its own, so that they are as good as uncorrelated at every lag (L. Ljung,
    System Identification, 2nd ed., section 13.3). The seed draws where the sequence begins.

    Parameters
    ----------
    low, high, samples, seed
        As of :class:`UniformRandom`; low and high are the two levels.
    clock_period : int
        Samples for which each value of the sequence is held: longer excites slower dynamics.
    """

    kind: ClassVar[str] = "prbs"

    _: KW_ONLY
    clock_period: int = setting(1, doc="samples for which each value is held", low=1)

    @property
    def _title(self) -> str:
        return "PRBS"

    def _faults(self) -> Iterator[str]:
        if not isinstance(self.clock_period, Integral) or self.clock_period < 1:
            yield f"clock_period = {self.clock_period} is not possible; allowed: an integer >= 1"

    def _shape(self, inputs: int) -> FloatArray:
        bits = -(-self.samples // self.clock_period)
        taps = next((taps for taps in _TAPS if 2 ** taps[0] - 1 >= inputs * bits), _TAPS[-1])
        apart = (2 ** taps[0] - 1) // inputs
        start = int(self._random(_PRBS_STREAM).integers(1, 2 ** taps[0]))
        sequence = maximum_length_sequence(taps, start, (inputs - 1) * apart + bits)
        columns = np.column_stack([sequence[i * apart : i * apart + bits] for i in range(inputs)])
        return np.repeat(2.0 * columns - 1.0, self.clock_period, axis=0)[: self.samples]


def maximum_length_sequence(taps: Sequence[int], start: int, length: int) -> NDArray[np.uint8]:
    """Return what a shift register puts out: zeros and ones, shape (length,).

    Parameters
    ----------
    taps : sequence of int
        The stages that are fed back, counted from 1; the first one is the last stage n.
    start : int
        Its content, from 1 to 2**n - 1; the last stage is the lowest bit.
    length : int
        How many to return; from 2**n - 1 on they repeat.
    """
    stages = taps[0]
    fed_back = sum(1 << (stages - tap) for tap in taps)
    state, out = start, bytearray(length)
    for i in range(length):
        out[i] = state & 1
        state = (state >> 1) | (((state & fed_back).bit_count() & 1) << (stages - 1))
    return np.frombuffer(bytes(out), dtype=np.uint8)


@dataclass(frozen=True, slots=True, repr=False)
class Multisine(_Ranged):
    """Sum of sines of equal amplitude, at the harmonics of the experiment's length within a range.

    Of m inputs each gets every m-th harmonic, so that they excite no frequency together (D. E.
    Rivera, H. Lee, H. D. Mittelmann, M. W. Braun, J. Process Control 19(4), 2009,
    doi:10.1016/j.jprocont.2008.08.003). The signal is scaled to reach a limit. Schroeder's phases,
    ``-pi k (k - 1) / F`` for the k-th of F sines, keep its peaks low (M. R. Schroeder, IEEE Trans.
    Information Theory 16(1), 1970, doi:10.1109/TIT.1970.1054411); with them the seed draws where in its
    period the signal begins, otherwise the phases.

    Parameters
    ----------
    low, high, samples, seed
        As of :class:`UniformRandom`.
    sampling_time : float
        Time between samples [s].
    min_frequency, max_frequency : float
        Range of the frequencies [Hz]; default: all below half the sampling frequency, but zero.
    phases : {"schroeder", "random"}
        Where the phases come from.
    """

    kind: ClassVar[str] = "multisine"

    _: KW_ONLY
    sampling_time: float = setting(doc="time between samples", unit="s", key=None)
    min_frequency: float = setting(
        0.0, doc="lowest frequency; 0: one period in the experiment", unit="Hz", low=0
    )
    max_frequency: float = setting(
        np.inf,
        doc="highest frequency; none: all below half the sampling frequency",
        unit="Hz",
        above=0,
    )
    phases: Literal["schroeder", "random"] = setting("schroeder", doc="low peaks, or drawn by the seed")

    def _faults(self) -> Iterator[str]:
        yield from _sampling_faults(self.sampling_time)
        if not 0.0 <= self.min_frequency < self.max_frequency:
            yield (
                f"min_frequency = {self.min_frequency:g} Hz and max_frequency = {self.max_frequency:g} Hz; "
                "needed: 0 <= min_frequency < max_frequency"
            )
        if self.phases not in ("schroeder", "random"):
            yield f'phases = "{self.phases}" is not possible; allowed: "schroeder", "random"'

    def _shape(self, inputs: int) -> FloatArray:
        harmonics = np.arange(1, (self.samples + 1) // 2)
        frequencies = harmonics / (self.samples * self.sampling_time)
        margin = 1e-9 * frequencies
        within = (frequencies >= self.min_frequency - margin) & (frequencies <= self.max_frequency + margin)
        harmonics = harmonics[within]
        if len(harmonics) < inputs:
            raise ConfigError(
                f"multisine excitation: {len(harmonics)} harmonics of the experiment's "
                f"{1 / (self.samples * self.sampling_time):g} Hz are in the range of frequencies, and below "
                f"{1 / (2 * self.sampling_time):g} Hz; needed: one for each of {inputs} input(s): more "
                "samples, or a wider range"
            )
        rng = self._random(_MULTISINE_STREAM)
        columns = [self._sines(harmonics[i::inputs], rng) for i in range(inputs)]
        return np.column_stack([column / np.abs(column).max() for column in columns])

    def _sines(self, harmonics: NDArray[np.intp], rng: np.random.Generator) -> FloatArray:
        """Return the sum of sines at some harmonics, shape (samples,)."""
        count = len(harmonics)
        begin = int(rng.integers(self.samples))
        order = np.arange(1, count + 1)
        phases = -np.pi * order * (order - 1) / count
        if self.phases == "random":
            begin, phases = 0, rng.uniform(0.0, 2.0 * np.pi, count)
        spectrum = np.zeros(self.samples // 2 + 1, dtype=np.complex128)
        spectrum[harmonics] = np.exp(1j * phases)
        return np.roll(np.fft.irfft(spectrum, self.samples), begin)


@dataclass(frozen=True, slots=True, repr=False)
class Chirp(_Ranged):
    """Swept sine: its frequency goes from one value to another in the course of the experiment.

    Its phase is ``2 pi (f_0 t + (f_1 - f_0) t^2 / (2 T))`` with a linear sweep of duration T, and
    ``2 pi f_0 T ((f_1 / f_0)^(t/T) - 1) / ln(f_1 / f_0)`` with a logarithmic one, each plus one that the seed
    draws (R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 5).
    Of m inputs the i-th one, counted from 0, begins i/m of the way and goes round, so that no two of them
    have one frequency at a time.

    Parameters
    ----------
    low, high, samples, seed
        As of :class:`UniformRandom`.
    sampling_time : float
        Time between samples [s].
    from_frequency, to_frequency : float
        Where the sweep begins and ends [Hz], up to half the sampling frequency.
    sweep : {"linear", "logarithmic"}
        How the frequency changes over time.
    """

    kind: ClassVar[str] = "chirp"

    _: KW_ONLY
    sampling_time: float = setting(doc="time between samples", unit="s", key=None)
    from_frequency: float = setting(doc="frequency at the beginning", unit="Hz", above=0)
    to_frequency: float = setting(doc="frequency at the end", unit="Hz", above=0)
    sweep: Literal["linear", "logarithmic"] = setting("linear", doc="how the frequency changes over time")

    def _faults(self) -> Iterator[str]:
        faults = list(_sampling_faults(self.sampling_time))
        yield from faults
        highest = np.inf if faults else 0.5 / self.sampling_time * (1 + 1e-9)
        for name in ("from_frequency", "to_frequency"):
            frequency = getattr(self, name)
            if not 0.0 < frequency <= highest:
                yield (
                    f"{name} = {frequency:g} Hz is not possible; allowed: above 0, up to half the sampling "
                    f"frequency, {highest:g} Hz"
                )
        if self.from_frequency == self.to_frequency:
            yield f"from_frequency and to_frequency are both {self.to_frequency:g} Hz; needed: two"
        if self.sweep not in ("linear", "logarithmic"):
            yield f'sweep = "{self.sweep}" is not possible; allowed: "linear", "logarithmic"'

    def _shape(self, inputs: int) -> FloatArray:
        first, last = self.from_frequency, self.to_frequency
        k = np.arange(self.samples)[:, np.newaxis] + np.arange(inputs) * self.samples // inputs
        part = (k % self.samples) / self.samples  # t / T
        if self.sweep == "linear":
            cycles = first * part + (last - first) * part**2 / 2.0
        else:
            cycles = first * np.expm1(part * np.log(last / first)) / np.log(last / first)
        begin = self._random(_CHIRP_STREAM).uniform(0.0, 2.0 * np.pi, inputs)
        return np.sin(2.0 * np.pi * self.samples * self.sampling_time * cycles + begin)


@dataclass(frozen=True, slots=True)
class SignalExcitation(Excitation):
    """Signals over the experiment's time, which begins at 0: steps, or what was recorded before.

    Parameters
    ----------
    signals : sequence of Reference
        One for each input, in its unit.
    samples : int
        Number of samples T.
    sampling_time : float
        Time between samples [s].
    """

    signals: Sequence[Reference]
    samples: int
    sampling_time: float

    def __post_init__(self) -> None:
        faults = type_faults(self)
        if not (isinstance(self.signals, Collection) and all(isinstance(s, Reference) for s in self.signals)):
            faults.append(f"signals = {self.signals!r} is not possible; needed: a sequence of signals")
        if isinstance(self.samples, Integral) and self.samples < 1:
            faults.append(f"samples = {self.samples} is not possible; allowed: an integer >= 1")
        if isinstance(self.sampling_time, Real):
            faults += _sampling_faults(self.sampling_time)
        if faults:
            raise ConfigError([f"excitation: {fault}" for fault in faults])

    def draw(self, inputs: int) -> FloatArray:
        """Return the excitation of all inputs, shape (samples, inputs), time along axis 0."""
        if len(self.signals) != inputs:
            raise ConfigError(
                f"excitation: {len(self.signals)} signals; needed: one for each of {inputs} input(s)"
            )
        time = np.arange(self.samples, dtype=np.float64) * self.sampling_time
        return np.column_stack([signal.at(time) for signal in self.signals])


@dataclass(frozen=True, slots=True)
class MixedExcitation(Excitation):
    """Inputs that are excited in different ways.

    Parameters
    ----------
    parts : sequence of (Excitation, sequence of int)
        Excitations, equally long, and the numbers of the inputs that each of them serves.
    """

    parts: Sequence[tuple[Excitation, Sequence[int]]]

    def __post_init__(self) -> None:
        parts = self.parts if isinstance(self.parts, Sequence) else [self.parts]
        needed = "an excitation and the numbers of the inputs that it serves"
        faults = [
            f"mixed excitation: {part!r} is not possible; needed: {needed}"
            for part in parts
            if not (
                isinstance(part, Sequence)
                and len(part) == 2
                and isinstance(part[0], Excitation)
                and isinstance(part[1], Collection)
                and all(isinstance(number, Integral) for number in part[1])
            )
        ]
        if faults:
            raise ConfigError(faults)

    def with_seed(self, seed: int) -> "Excitation":
        """Return the excitation with the random numbers of another seed in every part."""
        return MixedExcitation(tuple((part.with_seed(seed), served) for part, served in self.parts))

    def draw(self, inputs: int) -> FloatArray:
        """Return the excitation of all inputs, shape (T, inputs), time along axis 0."""
        served = sorted(i for _, part in self.parts for i in part)
        if served != list(range(inputs)):
            raise ConfigError(f"mixed excitation: serves inputs {served}; needed: each of {inputs} once")
        drawn = np.hstack([np.asarray(part.draw(len(numbers))) for part, numbers in self.parts])
        order = np.argsort([i for _, part in self.parts for i in part])
        mixed: FloatArray = drawn[:, order]
        return mixed


EXCITATIONS = by_kind(UniformRandom, PRBS, Multisine, Chirp, Steps, RecordedSignal)
"""What may excite an input, by its kinds."""
InputExcitation = Annotated[Any, Kinds(EXCITATIONS, default="uniform")]
"""What excites one input, as a file says it: between two limits, or a signal over the experiment's time."""


def excited_together(entry: Any, name: str) -> object:
    """Return what inputs share that are excited by one for all of them; of a signal, each has its own."""
    if isinstance(entry, Signal):
        return name
    fields = declared_fields(type(entry)).values()
    settings = {f.name: getattr(entry, f.name) for f in fields if f.name not in ("low", "high", "unit")}
    return type(entry), *settings.items()


def excitation_of(
    entries: Sequence[tuple[Any, Variable]], samples: int, sampling_time: float, *, is_added: bool
) -> Excitation:
    """Return the excitation of inputs that are excited together, in their units.

    Parameters
    ----------
    entries : sequence of (InputExcitation, Variable)
        What a file says of each input.
    samples, sampling_time : int, float
        Number of samples T, and the time between them [s].
    is_added : bool
        The excitation is added to the inputs of a controller: its values are differences.

    Raises
    ------
    ConfigError
        It is not possible.
    DataError
        All that is wrong with the file of a signal.
    """
    first, variable = entries[0]
    if isinstance(first, Signal):
        signal = (
            first.rows(variable, samples, sampling_time, difference=is_added)
            if isinstance(first, RecordedSignal)
            else first.in_unit(variable, difference=is_added)
        )
        return SignalExcitation((signal,), samples, sampling_time)
    limits = [_limits(entry, of, is_added=is_added) for entry, of in entries]
    made: Excitation = first.of_inputs(limits, samples, sampling_time)
    return made


def _limits(entry: Any, variable: Variable, *, is_added: bool) -> tuple[float, float]:
    convert = converter(variable, entry.unit, difference=is_added)
    return float(convert(entry.low)), float(convert(entry.high))


def sampling_faults(excitation: Excitation, sampling_time: float) -> list[str]:
    """Return what is wrong where an excitation is made for another sampling time [s] than that of a loop."""
    if isinstance(excitation, MixedExcitation):
        return [fault for part, _ in excitation.parts for fault in sampling_faults(part, sampling_time)]
    time = getattr(excitation, "sampling_time", None)
    if not isinstance(time, Real) or math.isclose(time, sampling_time, rel_tol=1e-9):
        return []
    name = type(excitation).__name__
    return [f"excitation: {name} has sampling_time = {time:g} s, the loop {sampling_time:g} s; needed: one"]


def _are_finite(values: object) -> bool:
    if isinstance(values, float):
        return math.isfinite(values)
    try:
        return bool(np.isfinite(values).all())  # type: ignore[call-overload]
    except (TypeError, ValueError):  # a text, or lists of different lengths
        return False


def _is_below(low: float | Sequence[float], high: float | Sequence[float]) -> bool:
    if isinstance(low, float) and isinstance(high, float):
        return low < high
    return bool(np.all(np.asarray(low) < np.asarray(high)))


def _sampling_faults(sampling_time: float) -> Iterator[str]:
    if not (np.isfinite(sampling_time) and sampling_time > 0):
        yield f"sampling_time = {sampling_time} s is not possible; allowed: a number > 0"
