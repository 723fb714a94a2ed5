"""What the words and the unit of a signal usually stand for: its name, however spelt, and its description."""

import math
import re
from collections.abc import Iterable, Mapping
from itertools import pairwise

from ddpc_cosim.variables import Variable
from fmu_plants.units import parse_unit

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[A-Z]|\d+")
_UNIT_SAID = re.compile(r"\[([^\[\]]{1,20})\]\s*$")
_MOST_WORDS = 10  # of a description: what comes later is seldom about what the signal is


def words_of(text: str) -> tuple[str, ...]:
    """Return words and numbers of a text in lower case: ``TOutdoor_air.y2`` is t, outdoor, air, y, 2."""
    return tuple(word.lower() for word in _WORD.findall(text))


def listed(names: Iterable[str], most: int, what: str) -> str:
    """Return names with commas between them; of more than so many the first, and how many there are.

    Parameters
    ----------
    names : iterable of str
        All of them.
    most : int
        How many are shown.
    what : str
        What they are, in the plural, for ``12 of 104 inputs shown``.
    """
    every = [*names]
    cut = f" ({most} of {len(every)} {what} shown)" if len(every) > most else ""
    return ", ".join(every[:most]) + cut


def unit_of(variable: Variable) -> str:
    """Return the unit of a signal; of one without, what its description ends in: ``Altitude [m]``."""
    said = _UNIT_SAID.search(variable.description)
    return said[1] if variable.unit == "" and said and exponents_of(said[1]) is not None else variable.unit


def exponents_of(unit: str) -> Mapping[str, int] | None:
    """Return the exponents of the SI base units in a unit; None for one that is not known, or for none."""
    try:
        return parse_unit(unit).exponents if unit else None
    except ValueError:
        return None


def vocabulary(text: str) -> frozenset[str]:
    """Return the words that a text lists."""
    return frozenset(text.split())


SURROUNDINGS = vocabulary(
    "ambient amb ambience tamb outdoor outdoors outside exterior weather wea meteo solar sun sunlight "
    "ppv photovoltaic pdem qdem meal meals carbs oda odt "
    "irradiance irradiation insolation sunshine qsol qsolar isol ghi dni dhi hglohor hdirnor hdifhor glohor "
    "dirnor difhor drybul drybulb wetbul tout toa oat wind winds winspe windir gust rain rainfall "
    "precipitation occ cloud clouds cloudiness sky climate occupancy occupants occupant people persons "
    "occupan disturbance disturbances perturbation disturb dist atmosphere atmospheric surrounding "
    "surroundings environment environmental env season road terrain wave waves bump umgebung aussen wetter "
    "gai qgai intgai intcon intrad intlat"
)
"""What the weather does, the ground, and people: no actuator is named so."""
SUPPLIED = vocabulary(
    "load loads feed influent inflow inlet incoming upstream demand consumption drawoff tapping usage gains "
    "external extern ext ground soil slope grade incline gradient traffic leak leakage friction tin thead "
    "outflow qout fout mdotout tf zf xf tfeed caf cin cain cf sf fext "
    "backpressure downstream uncontrolled"
)
"""What others bring to a plant or take from it, which may be what one drives."""
_SUBSCRIPTS = {
    "l": ("tm", {"kg": 1, "m": 2, "s": -2}),  # of a load torque
    "d": ("ft", {"kg": 1, "m": 1, "s": -2}),  # of a disturbance force
    "w": ("vu", {"m": 1, "s": -1}),  # of the wind's speed
}
"""Subscripts of textbooks, the symbols that have them, and the unit where they have one."""
_CARRIED = vocabulary(
    "torque force moment power current heat thermal cooling heating flow mass weight resistance"
)
"""Beside ``load``: what it weighs on a plant with."""
_CONSUMED = vocabulary("heat water power electric electrical electricity hot energy flow steam gas building")
_GAINED = vocabulary("heat internal convective radiative radiant latent sensible metabolic")
"""Beside ``gain``: what people and devices bring into a room."""
_WANTED = vocabulary("torque force speed position current pressure throttle thrust brake")
"""Beside ``demand``: what is consumed, and what a driver wants."""
DEVICES = vocabulary(
    "valve pump fan heater damper motor actuator throttle pitch rudder aileron elevator boiler chiller "
    "compressor inverter converter burner injector blower shutter blind blinds vent louver thruster nozzle "
    "command commanded cmd control controlled ctrl controller setpoint setpt sp opening duty pwm manipulated "
    "steering override ove reflux boilup reboiler coolant jacket switch"
)
"""What can be moved, and what one calls what moves it: also where it is a solar pump."""
_USUALLY_DRIVEN = DEVICES | vocabulary(
    "set heating cooling supply speed voltage pedal brake gate steam ratio"
)
"""Words beside which ``feed`` and ``load`` say nothing."""
_ACTUATED = [
    {"kg": 1, "m": 2, "s": -3},  # W
    {"kg": 1, "m": 2, "s": -3, "A": -1},  # V
    {"A": 1},
    {"kg": 1, "m": 1, "s": -2},  # N
    {"kg": 1, "m": 2, "s": -2},  # N.m
    {"m": 3, "s": -1},
    {"kg": 1, "s": -1},
    {"mol": 1, "s": -1},
    {"s": -1},  # a dilution rate
]
_IRRADIANCE, _TEMPERATURE = {"kg": 1, "s": -3}, {"K": 1}
_CONCENTRATIONS = [{"mol": 1, "m": -3}, {"kg": 1, "m": -3}]
CERTAIN, LIKELY = 3, 2
"""How much speaks for a disturbance: whatever else there is, and where something else can be driven."""


_COMPOUNDS = ("ambient", "outdoor", "outside", "weather", "irradiance", "disturbance", "occupan", "solar")
_QUANTITIES = "tqipmfghvxuw"
_NOT_DIVIDED = vocabulary("train window preset pact")


def _with_pairs(words: tuple[str, ...]) -> frozenset[str]:
    """Return words and what is in them: `Tload` is a load, `T_out` no more than `Tout`."""
    bare = {w[1:] for w in words if len(w) > 3 and w[0] in _QUANTITIES and w not in _NOT_DIVIDED}
    within = {stem for w in words for stem in _COMPOUNDS if stem in w and w not in SURROUNDINGS}
    return frozenset(words) | {first + second for first, second in pairwise(words)} | bare | within


class Wording:
    """The words of a signal: of the last part of its name, of the path to it, and of its description.

    Parameters
    ----------
    variable : Variable
        The signal.
    """

    def __init__(self, variable: Variable) -> None:
        self.unit = unit_of(variable)
        self.exponents = exponents_of(self.unit)
        self.is_limited = math.isfinite(variable.min) and math.isfinite(variable.max)
        path, _, last = variable.name.rpartition(".")
        self.labels = words_of(last)
        self.words = tuple(word for word in self.labels if not word.isdigit())
        self.name, self.path = _with_pairs(self.words), _with_pairs(words_of(path))
        self.text = frozenset(words_of(variable.description)[:_MOST_WORDS])
        self.all = self.name | self.path | self.text

    @property
    def is_temperature(self) -> bool:
        """Whether its unit is that of a temperature."""
        return self.exponents == _TEMPERATURE

    @property
    def is_irradiance(self) -> bool:
        """Whether its unit is that of an irradiance."""
        return self.exponents == _IRRADIANCE

    @property
    def is_of_a_stream(self) -> bool:
        """Whether its unit is that of a temperature or a concentration, which something brings along."""
        return self.is_temperature or self.exponents in _CONCENTRATIONS

    @property
    def looks_driven(self) -> bool:
        """Whether anything says that it is an actuator: a word, its unit or limits, or that it is u."""
        return bool(self.all & DEVICES) or self.exponents in _ACTUATED or self.is_limited or self.is_u

    def disturbance(self) -> tuple[int, tuple[str, ...]]:
        """Return how much speaks for a disturbance, and what does."""
        if self.name & DEVICES:
            return 0, ()
        points, reasons = 0, list[str]()
        for words, where in ((self.name, "name"), (self.path, "name"), (self.text, "description")):
            if words & DEVICES:
                continue
            certain = words & SURROUNDINGS or self._weighs(words)
            if words is self.name and not certain:
                certain = self._subscript()
            likely = frozenset() if self.name & _USUALLY_DRIVEN else _supplied(words)
            said = certain or likely
            if said and not any(reason.endswith(f' "{min(said)}"') for reason in reasons):
                points = max(points, CERTAIN if certain else LIKELY)
                reasons.append(f'its {where} says "{min(said)}"')
        of_unit = self._unit_points()
        return points + of_unit, (*reasons, *([f"its unit is {self.unit}"] if of_unit else []))

    @staticmethod
    def _weighs(words: frozenset[str]) -> frozenset[str]:
        """Return the word for a load that weighs on the plant, or a demand that is met."""
        is_load = bool(words & {"load", "loads"} and words & _CARRIED)
        is_gain = bool(words & {"gain", "gains"} and words & _GAINED)
        is_demand = bool(words & {"demand", "consumption"} and words & _CONSUMED)
        return (
            words & {"load", "loads"}
            if is_load
            else words & {"demand", "consumption"}
            if is_demand
            else words & {"gain", "gains"}
            if is_gain
            else frozenset()
        )

    @property
    def is_u(self) -> bool:
        """Whether it is called what control theory calls an input."""
        return self.words == ("u",)

    @property
    def is_rate(self) -> bool:
        """Whether its name ends in how much of something there is at a time, as what one sets does."""
        return self.words[-1:] in (("rate",), ("flowrate",))

    @property
    def says_driven(self) -> bool:
        """Whether its name says that it is what one drives."""
        return self.is_u or bool((self.name | self.path) & _USUALLY_DRIVEN)

    def _subscript(self) -> frozenset[str]:
        """Return a symbol with a subscript that textbooks give to loads, disturbances and the wind."""
        symbol = "".join(self.words)
        of, unit = _SUBSCRIPTS.get(symbol[-1:], ("", {}))
        is_symbol = (len(symbol) == 2 and symbol[0] in of) or symbol in ("taul", "taud")
        fits = self.exponents in (None, unit, {"kg": 1, "m": 2, "s": -2})
        return frozenset({symbol}) if is_symbol and fits else frozenset()

    def _unit_points(self) -> int:
        if self.all & _USUALLY_DRIVEN:
            return 0
        if self.is_irradiance or self.unit in ("lx", "lux"):
            return CERTAIN
        return LIKELY if self.exponents in _CONCENTRATIONS else 1 if self.is_temperature else 0


def _supplied(words: frozenset[str]) -> frozenset[str]:
    return words & SUPPLIED - {"demand"} if words & _WANTED else words & SUPPLIED


_ENABLING = vocabulary(
    "start started permit release engage "
    "on enable enabled enabling activate activated active activation running run avail available"
)
_STOPPING = vocabulary(
    "off reset stop fault faulty failure fail failed alarm trip tripped disable disabled emergency lock "
    "locked freeze frozen hold bypass inhibit block blocked shutdown halt error clear estop"
)


def enables(wording: Wording) -> bool:
    """Whether a signal that is 0 or 1 is called what switches something on."""
    return bool(wording.all & _ENABLING) and not stops(wording)


def stops(wording: Wording) -> bool:
    """Whether a signal that is 0 or 1 is called what stops something: it is left alone."""
    return bool(wording.name & _STOPPING)


_SETPOINTS = vocabulary(
    "setpoint setpt set sp ref reference target desired wanted soll yref yset xset rset us r w"
)
_MEASURED = vocabulary("meas measured measurement mea feedback fb fbk pv actual sensor sensed ist ym um y m")
_SHORT = 2  # words: a name that says little else
_ERRORS = vocabulary("error err e deviation")
_COOLING, _OF_WATER = vocabulary("cooling cool coo"), vocabulary("supply sup water chilled production pro")
_COMMANDS = vocabulary(
    "u command cmd control ctrl controller actuator act manipulated mv output out drive uc con y"
)


_STRICTLY_MEASURED = _MEASURED - vocabulary("y m")
_STRICTLY_COMMANDS = _COMMANDS - vocabulary("y act con drive")


def is_comparison(wanted: Wording, measured: Wording, sent: Wording) -> bool:
    """Whether words alone say that one signal is wanted, one is measured, and one is the command."""
    if (wanted.words, measured.words, sent.words) in ((("r",), ("y",), ("u",)), (("w",), ("y",), ("u",))):
        return True
    is_wanted = _is_called(wanted, _SETPOINTS - vocabulary("r w"), _STRICTLY_MEASURED)
    is_measured = _is_called(measured, _STRICTLY_MEASURED, _SETPOINTS) and not measured.all & SURROUNDINGS
    is_signal = sent.unit in ("", "1", "%") or bool(sent.all & _STRICTLY_COMMANDS)
    is_other = not wanted.unit or wanted.unit != sent.unit
    return is_wanted and is_measured and wanted.unit == measured.unit and is_other and is_signal


def _is_called(wording: Wording, words: frozenset[str], others: frozenset[str]) -> bool:
    """Whether a name says one thing and not another, or the description where the name says neither."""
    if wording.name & (words | others):
        return bool(wording.name & words) and not wording.name & others
    return bool(wording.text & words) and not wording.text & others


def setpoint(wording: Wording) -> bool:
    """Whether a signal is called what somebody wants."""
    return bool(wording.all & _SETPOINTS)


def measurement(wording: Wording) -> bool:
    """Whether a signal is called what is measured."""
    return bool(wording.all & _MEASURED)


def control_error(wording: Wording) -> bool:
    """Whether a signal is called a deviation from what is wanted."""
    by_name = len(wording.words) <= _SHORT and not wording.path and bool(set(wording.words) & _ERRORS)
    return by_name or {"control", "error"} <= wording.text


def command(wording: Wording) -> bool:
    """Whether a signal is called what a controller has to say."""
    return bool(wording.all & _COMMANDS)


_READ = vocabulary(
    "temperature temp level pressure position angle concentration composition ph height altitude speed "
    "velocity humidity frequency quality measurement measured meas sensor rea reading room zone indoor"
)
_SPENT = vocabulary(
    "power energy cost price consumption work losses loss efficiency cop heat flux balance total cumulative "
    "cmd command status mode flag limit limits setpoint set"
)
_METERED = vocabulary("energy cost costs price consumption consumed cumulative ptot etot")
_CONTROLLERS = vocabulary("regulator pid")
_AROUND = vocabulary("with and plus plant loop system")
_STORED = vocabulary("stored storage battery soc charge tank accumulator kinetic potential")
_TEMPERATURES = vocabulary("temperature temperatures temp")
_INTERNAL = vocabulary(
    "internal debug der aux auxiliary dummy tmp state derivative residual error err log diag"
)


def rank_of_output(variable: Variable) -> int:
    """Return how late an output is tried as one to control: readings first, what goes on inside last."""
    wording = Wording(variable)
    if (wording.name | wording.path) & _INTERNAL:
        return 3
    if wording.all & _SPENT or wording.all & SURROUNDINGS:
        return 2
    return 0 if wording.all & _READ or wording.is_temperature else 1


def is_reading(variable: Variable) -> bool:
    """Whether an output is called what one reads and wants to have at a value: a temperature, a level."""
    return rank_of_output(variable) == 0


def is_meter(variable: Variable) -> bool:
    """Whether an output is called what is spent, as energy or cost; what is stored is none."""
    said = Wording(variable).all
    return bool(said & _METERED) and not said & _STORED


def is_cooling_setpoint(variable: Variable) -> bool:
    """Whether a signal is called what a room is cooled to, which is warmer than what it is heated to."""
    wording = Wording(variable)
    return bool(setpoint(wording) and wording.all & _COOLING and not wording.all & _OF_WATER)


def is_called_temperature(variable: Variable) -> bool:
    """Whether a signal without a unit says in a word that it is a temperature."""
    return variable.unit in ("", "1") and bool(Wording(variable).all & _TEMPERATURES)


def is_named_controller(name: str) -> bool:
    """Whether the name of a model says that it is a controller, and not a plant with one."""
    said = {*words_of(name)}
    is_one = bool(said & _CONTROLLERS) or any(word.endswith("controller") for word in said)
    return is_one and not said & _AROUND
