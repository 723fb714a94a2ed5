"""What an FMU's resources say of its use, as a study: weather, comfort, prices and days of the year.

The names are BOPTEST's; see :mod:`ddpc_cosim.fmu.resources`.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Self

import numpy as np

from ddpc_cosim.description import PlantDescription, applied_output
from ddpc_cosim.errors import CosimError
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.files.time_tables import TimeTable, base_name
from ddpc_cosim.fmu.resources import Resources
from ddpc_cosim.key_figures import CO2, POWERS, TEMPERATURES, kind_of
from ddpc_cosim.plugins import plugin_names
from ddpc_cosim.signals.disturbances import KnownDisturbance
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band, Reference, SignalFromResource
from ddpc_cosim.study.file_format.sections import (
    BandSection,
    ControllerSection,
    KeyFiguresSection,
    MetricsSection,
    ReportSection,
    ScenarioSection,
)
from ddpc_cosim.suggestion.design import clean, whole_periods
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.step_test import Timing
from ddpc_cosim.suggestion.writing import Proposal
from ddpc_cosim.variables import Variable

_DAY, _HOUR = 86_400.0, 3600.0
_OFTEN = 300.0  # s
"""Thermostats and the control of heat pumps commonly switch no more often than that."""
_WEEK = 7 * _DAY
_FORTNIGHT = 2 * _WEEK
_LONGEST_TEST = 0.9 * _FORTNIGHT  # s: of a step test; beyond, the season tells more than an input
_STEPS = (60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0)
_MUCH = 4.0  # times: sampling times that differ by more are another choice
_AHEAD = 12 * _HOUR  # a horizon sees half a day, in 8 to 24 samples
_FEWEST_AHEAD, _MOST_AHEAD = 8, 24
_PAST = 4
_TIME_CONSTANTS = 3.0  # within which a lag of first order settles
_LEAST_RECORDED = _WEEK
_WEATHER = ("TDryBul", "HGloHor")
_BEAMS = ("HDirNor", "HDifHor")
_READER = re.compile(r"(?:rea)?(?:Wea)?(?P<column>[A-Za-z]\w*)")
_OCCUPANTS = re.compile(r"(?:rea)?Occ(?:upancy)?(?:Zone?)?(?P<zone>\w*)")
_OFF = 0.005  # of a band's width: what prices may draw an output beyond it
_MARGIN = 0.1  # of a band's width: how far within it those stay that know no bands
_OUTPUT_WEIGHT, _INPUT_WEIGHT = 10.0, 1e-3
_ELECTRIC = "ElectricPower"
_USUAL_POWER, _USUAL_AREA = 20.0, 150.0  # W/m2, m2
_KINDS = re.compile(r"[A-Z][a-z]*")
_PLANT = "plant"
_TRIED = 2 * _DAY
_TRIED_WARM_UP = _DAY

_ON_DISTURBANCES = (
    "Tables of the plant's resources say what will be. known: weather is forecast with medium errors, what "
    'follows a schedule is known; "measured" tells what forecasts are worth.'
)
_ON_SCENARIOS = (
    "Each 14 days, from a week before the day that its name says to a week after. `--only NAME` runs some."
)
_ON_PRICES = (
    "Where tables do not say in which money prices are, EUR is assumed. Scenarios have the other kinds."
)


@dataclass(frozen=True, slots=True)
class Building:
    """A plant whose resources say how it is to be used.

    Parameters
    ----------
    resources : Resources
        What they say.
    description : PlantDescription
        The plant.
    """

    resources: Resources
    description: PlantDescription

    @classmethod
    def of(cls, resources: Resources, description: PlantDescription) -> Self | None:
        """Return the plant if its resources say between what temperatures a zone is wanted, else None."""
        building = cls(resources, description)
        return building if building.zones else None

    @property
    def zones(self) -> dict[str, tuple[str, str]]:
        """Outputs that are temperatures of zones, each with the columns of its comfort band."""
        return {
            output: (edges[0], edges[1])
            for zone, output in self._sources(*TEMPERATURES)
            if output in self.description.outputs
            and (edges := self._columns_of_zone(zone, "LowerSetp", "UpperSetp"))
        }

    @property
    def temperatures(self) -> list[str]:
        """Outputs that key figures name as temperatures of zones, whether or not there is a band for them."""
        outputs = self.description.outputs
        return [output for _, output in self._sources(*TEMPERATURES) if output in outputs]

    @property
    def signals(self) -> dict[str, Variable]:
        """Inputs and outputs by name."""
        return {**self.description.inputs, **self.description.outputs}

    def _sources(self, *kinds: str) -> Iterator[tuple[str, str]]:
        """Yield the signals of the sources of some kinds, those that exist, each after its source."""
        known = self.signals
        for source, names in self.resources.key_figures.items():
            if kind_of(source) in kinds:
                yield from ((source, name) for name in names if name in known)

    def _columns_of_zone(self, source: str, *names: str) -> tuple[str, ...]:
        """Return the columns of the zone of a source; none unless all of them are there."""
        zone = source.partition("[")[2].rstrip("]")
        columns = [next(filter(self.resources.find, (f"{name}[{zone}]", name)), "") for name in names]
        return tuple(columns) if all(columns) else ()

    def signal(self, column: str, variable: Variable, interpolation: Any = "hold") -> SignalFromResource:
        """Return a column as a signal, whose unit is said where it is another than that of the variable."""
        table, unit = self._table(column)
        unit = "" if unit == variable.unit else unit
        return SignalFromResource(table.file, column, interpolation=interpolation, unit=unit)

    def _table(self, column: str) -> tuple[TimeTable, str]:
        found = self.resources.find(column)
        if found is None:
            raise KeyError(column)
        return found

    @staticmethod
    def within_a_season(timing: Timing) -> Timing:
        """Return what is known about time, with a step test that the season does not matter for."""
        longest, beyond = min(timing.longest, _LONGEST_TEST), min(timing.beyond, _LONGEST_TEST)
        return replace(timing, longest=longest, beyond=beyond)

    def sampling_time(self, tested: float) -> tuple[float, tuple[str, ...]]:
        """Return a sampling time [s], given that of the step test, and what is to be said of it."""
        step = self.resources.step
        fixed = self.description.fixed_step
        if step is not None and fixed and abs(step / fixed - round(step / fixed)) > 1e-9:
            step = None
        near = min(_STEPS, key=lambda candidate: abs(math.log(candidate / tested)))
        if step is None:
            return (tested if fixed else near), ()
        if 1 / _MUCH <= near / step <= _MUCH or fixed:
            return step, ()
        said = f"config.json says steps of {in_words(step)}; what the step test shows suits {in_words(near)}"
        return near, (f"{said} better.",)

    def band(self, output: str) -> BandSection:
        """Return the comfort band of a zone."""
        variable = self.description.outputs[output]
        lower, upper = (self.signal(column, variable) for column in self.zones[output])
        return BandSection(band=Band(lower, upper))

    def width(self, output: str) -> float:
        """Return the least width of a zone's band, in kelvin."""
        (low, _), (high, _) = (self._table(column) for column in self.zones[output])
        lower, upper = (
            table.statistics(column) for table, column in zip((low, high), self.zones[output], strict=True)
        )
        return max(upper.min - lower.max, 0.0) or upper.mean - lower.mean

    def disturbances(self, driven: Sequence[str], controlled: Sequence[str]) -> dict[str, KnownDisturbance]:
        """Return the inputs and outputs that tables tell, with what is known of them."""
        weather = [c for c in _WEATHER if self.resources.find(c)]
        weather += [c for c in _BEAMS if self.resources.find(c) and "HGloHor" not in weather]
        known = dict[str, KnownDisturbance]()
        taken = {*driven, *controlled, *self.description.switches.values()}
        for name, variable in {**self.description.outputs, **self.description.inputs}.items():
            is_input, column = name in self.description.inputs, self._column_of(name)
            is_told = variable.name not in taken and column and self._fits(column, variable)
            if not is_told or not (is_input or column in weather or base_name(column) == "Occupancy"):
                continue
            is_weather = column in (*_WEATHER, *_BEAMS)
            signal = self.signal(column, variable, "linear" if is_weather else "hold")
            known[name] = KnownDisturbance(signal=signal, known="medium" if is_weather else "perfect")
        return known

    def _column_of(self, name: str) -> str:
        """Return the column that tells an input or an output, by its name; empty: there is none."""
        last = re.sub(r"_[yu]$", "", name).rpartition("_")[2]
        if (match := _OCCUPANTS.fullmatch(last)) and self.resources.find(f"Occupancy[{match['zone']}]"):
            return f"Occupancy[{match['zone']}]"
        candidates = [name]
        if match := _READER.fullmatch(last):
            candidates.append(match["column"])
        return next((c for c in candidates if c and self.resources.find(c)), "")

    def _fits(self, column: str, variable: Variable) -> bool:
        """Whether a column may be in the unit of a variable."""
        table, unit = self._table(column)
        signal = SignalFromResource(table.file, column, unit=unit, table=table)
        try:
            signal.in_unit(variable)
        except CosimError:
            return False
        return True

    def prices(self) -> tuple[dict[str, Price], dict[str, dict[str, SignalFromResource]]]:
        """Return the price of each power that has one, and those of other kinds by kind and name."""
        prices, kinds = dict[str, Price](), dict[str, dict[str, SignalFromResource]]()
        paid = [*self._sources(*POWERS)]
        electric = [name for source, name in paid if source == _ELECTRIC]
        for source, output in paid:
            columns = self._price_columns(source)
            if not columns:
                continue
            name = "electricity" if electric == [output] else output
            emissions = f"Emissions{source}"
            _, unit = self._table(columns[0])
            emitted: float | SignalFromResource = 0.0
            if self.resources.find(emissions):
                emitted = self.signal(emissions, Variable("", "kg/kWh"))
            price = self.signal(columns[0], Variable("", unit))
            prices[name] = Price(signal=output, price=price, unit=_money_per_energy(unit), emissions=emitted)
            for column in columns:
                kind = column.removeprefix(f"Price{source}")
                if len(columns) > 1:
                    kinds.setdefault(kind, {})[name] = self.signal(column, Variable("", unit))
        return prices, kinds

    def power(self, variable: Variable, driven: Sequence[Variable]) -> float:
        """Return about how large a power is [W].

        Its nominal value, else what goes by the floor area; where that is not known, what a driven input in
        watts can give, or what goes by that of a usual house.
        """
        if variable.nominal != 1.0:
            return variable.nominal
        if self.resources.area is not None:
            return _USUAL_POWER * self.resources.area
        given = [v.max - v.min for v in driven if v.unit == "W" and math.isfinite(v.max - v.min)]
        return max(given, default=_USUAL_POWER * _USUAL_AREA)

    def _price_columns(self, source: str) -> list[str]:
        """Return the columns of prices of a source, the constant one first."""
        every = chain.from_iterable(table.columns for table in self.resources.tables)
        columns = dict.fromkeys(column for column in every if column.startswith(f"Price{source}"))
        return sorted(columns, key=lambda column: not column.endswith("Constant"))

    def scenarios(self, earliest: float) -> dict[str, ScenarioSection]:
        """Return a scenario for each day and kind of price, none of which begins before a time [s]."""
        _, kinds = self.prices()
        days = {name: max((day - 7) * _DAY, earliest) for name, day in self.resources.days.items()}
        begins: Mapping[str, float | None] = days or {"": None}
        scenarios = dict[str, ScenarioSection]()
        for day, begin in begins.items():
            for kind in kinds or [""]:
                words = [day.replace("_", " "), f"{_words(kind)} price" if kind else ""]
                name = "-".join(filter(None, [_key(day), _key(_words(kind))])) or "nominal"
                # The first kind is that of the study.
                other = kinds.get(kind, {}) if kinds and kind != next(iter(kinds)) else {}
                label = ", ".join(filter(None, words))
                scenarios[name] = ScenarioSection(label=label, start_time=begin, prices={**other})
        return scenarios

    def key_figures(self, controlled: Sequence[str], paid: Sequence[str]) -> KeyFiguresSection | None:
        """Return BOPTEST's key figures, of those sources whose limits and prices are known.

        They are per floor area: where the plant does not say that, there are none.
        """
        if self.resources.area is None:
            return None
        bands = {name: self.band(name) for name in self.zones if name not in controlled}
        for source, output in self._sources(CO2):
            if columns := self._columns_of_zone(source, "UpperCO2"):
                upper = self.signal(columns[0], self.signals[output])
                bands[output] = BandSection(band=Band(0.0, upper))
        known = {*controlled, *bands, *paid}
        said = self.resources.key_figures
        used = {
            source: [name for name in outputs if name in known]
            for source, outputs in said.items()
            if kind_of(source) in (*TEMPERATURES, CO2, *POWERS)
        }
        used = {source: outputs for source, outputs in used.items() if outputs}
        is_all = used == {source: [*outputs] for source, outputs in said.items()}
        return KeyFiguresSection(set="boptest", sources={} if is_all else used, bands=bands)


def _money_per_energy(unit: str) -> str:
    """Return the unit of a price that can be one: ``$`` is the one that a file of BOPTEST's may say."""
    return unit.replace("$", "USD").replace("(USD/Euro)", "EUR").replace("€", "EUR")


def _words(kind: str) -> str:
    """Return the kind of a price in words: HighlyDynamic is highly dynamic."""
    return " ".join(word.lower() for word in _KINDS.findall(kind))


def _key(text: str) -> str:
    """Return what is left of a text as a part of a scenario's name."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-")


def in_use(proposal: Proposal, building: Building, request: Request, settling_time: float) -> Proposal:
    """Return a proposal for a building as its resources say that it is used.

    Parameters
    ----------
    proposal : Proposal
        What the step test suggests.
    building : Building
        The plant.
    request : Request
        What is asked for.
    settling_time : float
        How long the plant takes to settle [s].
    """
    study, loop = proposal.study, proposal.study.loop
    h = loop.sampling_time
    driven = [v.name for v in proposal.inputs]
    bands: dict[str, Any] = {
        v.name: building.band(v.name) for v in proposal.outputs if v.name in building.zones
    }
    known = building.disturbances(driven, study.plant.outputs)
    known |= {name: one for name, one in study.disturbances.items() if name not in known and one.signal}
    prices, _ = building.prices()
    switches = building.description.switches
    applied = [applied_output(name) for name in driven if name in switches]
    outputs = building.description.outputs
    paid = [price.signal for price in prices.values()]
    further = [name for name in (*paid, *applied) if name in outputs]
    measured = [*dict.fromkeys([*study.plant.measurements, *further])]
    warm_up = building.resources.warm_up or (_WEEK if building.resources.days else 0.0)
    duration = request.duration or clean(math.floor(_FORTNIGHT / h) * h)
    warm_up = min(clean(math.floor(warm_up / h) * h), duration)
    scenarios = building.scenarios(warm_up)
    first = next((s.start_time for s in scenarios.values() if s.start_time is not None), None)
    start = first if first is not None else max(building.resources.start_time or 0.0, warm_up)
    price_weight = _price_weight(proposal, building, bands, prices, settling_time)
    controllers = _controllers(proposal, building, bands, price_weight)
    if any(name in switches for name in driven):
        controllers[_PLANT] = ControllerSection(type=_PLANT, label="Its own control")
    recording = study.recording
    if recording is not None:
        begins = [s.start_time for s in scenarios.values() if s.start_time is not None] or [start]
        samples = _recorded(proposal, known, measured, h, min(begins))
        recording = replace(
            recording,
            samples=samples,
            start_time=None,
            disturbances={k: v for k, v in recording.disturbances.items() if _is_untold(known, k)},
            excitation={k: replace(signal, samples=samples) for k, signal in recording.excitation.items()},
        )
    changed = proposal.changed(
        plant=replace(
            study.plant,
            measurements=measured,
            nominal={**study.plant.nominal, **_of_powers(building, prices, proposal.inputs)},
        ),
        loop=replace(
            loop,
            duration=duration,
            start_time=start,
            warm_up=warm_up,
            communication_step=_communication_step(h) if _PLANT in controllers else None,
        ),
        reference={**(study.reference or {}), **bands},
        disturbances=known,
        prices=prices,
        scenarios=scenarios,
        recording=recording,
        controllers=controllers,
        metrics=MetricsSection(key_figures=building.key_figures(study.plant.outputs, paid)),
        report=ReportSection(baseline=_PLANT) if _PLANT in controllers else study.report,
    )
    return replace(
        changed,
        measurements=tuple(outputs[name] for name in measured),
        comments=_comments(proposal, known, prices, scenarios),
    )


def _of_powers(
    building: Building, prices: Mapping[str, Price], driven: Sequence[Variable]
) -> dict[str, float]:
    """Return about how large the powers are that declare no nominal value."""
    paid = {price.signal: building.signals[price.signal] for price in prices.values()}
    outputs = building.description.outputs
    return {
        name: clean(building.power(v, driven))
        for name, v in paid.items()
        if name in outputs and v.nominal == 1.0
    }


def _is_untold(known: Mapping[str, KnownDisturbance], name: str) -> bool:
    return not isinstance(known[name].signal, SignalFromResource) if name in known else False


def _recorded(
    proposal: Proposal, known: Mapping[str, KnownDisturbance], measured: Sequence[str], h: float, begin: float
) -> int:
    """Return how many samples are recorded before the first run begins [s]: a week if there is time."""
    m, p = len(proposal.inputs), len(proposal.outputs)
    needed = (m + len(known) + 1) * (_PAST + _ahead(h) + p * _PAST)
    wanted = whole_periods(max(2 * needed, math.ceil(_LEAST_RECORDED / h)), h, _DAY)
    return max(min(wanted, math.floor(begin / h)), needed)


def _ahead(h: float) -> int:
    return int(np.clip(round(_AHEAD / h), _FEWEST_AHEAD, _MOST_AHEAD))


def _controllers(
    proposal: Proposal,
    building: Building,
    bands: Mapping[str, BandSection],
    price_weight: float,
) -> dict[str, ControllerSection]:
    """Return the proposal's controllers: some know bands and prices, others follow the edge of the band."""
    horizon, chosen = _ahead(proposal.sampling_time), dict(proposal.study.controllers)
    economic: dict[str, Any] = {
        "horizon": horizon,
        "output_weight": _OUTPUT_WEIGHT,
        "input_weight": _INPUT_WEIGHT,
    }
    if price_weight:
        economic["price_weight"] = price_weight
    if "deepc" in chosen:
        settings = economic | {
            "initial_length": _PAST,
            "affine_sum": "all",
            "use_current_output": True,
            "artificial_setpoint": False,
            "regulariser": "projection",
            "lambda_g": 100.0,
        }
        chosen["deepc"] = replace(chosen["deepc"], settings=settings)
    if "mpc" in chosen:
        chosen["mpc"] = replace(chosen["mpc"], settings=economic | {"setpoint": "none"})
    if "band-edge" not in plugin_names("controllers"):
        return chosen
    for key in ("mfapc", "pid"):
        if key in chosen:
            inner = {"type": chosen[key].type, **chosen[key].settings}
            outputs = proposal.study.plant.outputs
            widths = [building.width(name) if name in bands else 0.0 for name in outputs]
            margins = [clean(round(_MARGIN * width, 3)) for width in widths]
            settings = {"margin": margins, "controller": inner}
            label = f"{chosen[key].label}, on the edge of the band"
            chosen[key] = replace(chosen[key], type="band-edge", label=label, settings=settings)
    return chosen


def _communication_step(h: float) -> float | None:
    """Return how often a plant with a control of its own is read for its figures; None: at the samples."""
    steps = math.ceil(h / _OFTEN)
    return None if steps == 1 else h / steps


def _price_weight(
    proposal: Proposal,
    building: Building,
    bands: Mapping[str, BandSection],
    prices: Mapping[str, Price],
    settling_time: float,
) -> float:
    """Return a weight of money with which an output is drawn out of its band by a small part of its width.

    Where the cost is least, what one more sample of all power would save is worth what it would take off the
    violation v of all outputs: price_weight p P h = 2 q v K / y_n^2, with K what the input range moves an
    output by within the horizon, which is what one sample of it does in all samples after it.
    """
    if not prices or not bands:
        return 0.0
    nominal, h = proposal.study.plant.nominal, proposal.sampling_time
    seen = 1.0 - math.exp(-_TIME_CONSTANTS * _ahead(h) * h / settling_time)
    bounds = [proposal.study.bounds[v.name] for v in proposal.inputs]
    spans = [end.max - end.min for end in bounds if isinstance(end.min, float) and isinstance(end.max, float)]
    effects = np.abs(np.nan_to_num(proposal.gains)) @ np.array(spans)
    worth, power = 0.0, 0.0
    for variable, effect in zip(proposal.outputs, effects.tolist(), strict=True):
        if (name := variable.name) in bands:
            worth += 2 * _OUTPUT_WEIGHT * _OFF * building.width(name) * seen * effect / nominal[name] ** 2
    for price in prices.values():
        paid = building.signals[price.signal]
        rate = price.charge(price.signal, paid).rate
        power = max(power, _mean(building, price.price) * rate * building.power(paid, proposal.inputs) * h)
    return float(f"{worth / power:.2g}") if worth > 0.0 and power > 0.0 else 0.0


def _mean(building: Building, price: float | Reference) -> float:
    if isinstance(price, SignalFromResource):
        found = building.resources.find(price.column)
        return abs(found[0].statistics(price.column).mean) if found else 0.0
    return abs(float(price)) if isinstance(price, int | float) else 0.0


def _comments(
    proposal: Proposal,
    known: Mapping[str, KnownDisturbance],
    prices: Mapping[str, Price],
    scenarios: Mapping[str, ScenarioSection],
) -> dict[str, tuple[str, ...]]:
    said = {**proposal.comments, "reference": ("The comfort band of the plant's resources.",)}
    if known:
        said["disturbances"] = (_ON_DISTURBANCES,)
    if prices:
        said["prices"] = (_ON_PRICES,)
    if any(scenario.start_time is not None for scenario in scenarios.values()):
        said["scenarios"] = (_ON_SCENARIOS,)
    return said


def shortened(proposal: Proposal) -> Proposal:
    """Return the proposal with the beginning of its first scenario alone, as a trial has time for."""
    loop, h = proposal.study.loop, proposal.study.loop.sampling_time
    duration = min(loop.duration, clean(math.ceil(_TRIED / h) * h))
    warm_up = min(loop.warm_up, clean(math.floor(_TRIED_WARM_UP / h) * h), duration)
    name, scenario = next(iter(proposal.study.scenarios.items()))
    return proposal.changed(
        loop=replace(loop, duration=duration, warm_up=warm_up), scenarios={name: scenario}
    )


def as_proposed(tried: Proposal, proposal: Proposal) -> Proposal:
    """Return what has been tried, with all the time and all the scenarios of the proposal."""
    kept, study = tried.study.controllers, proposal.study
    report = replace(tried.study.report, baseline=_PLANT if _PLANT in kept else None)
    return tried.changed(loop=study.loop, scenarios=study.scenarios, report=report)
