"""The prices of a study: what is paid for, in which units, over all of the run."""

from dataclasses import replace

from ddpc_cosim.codec import independent
from ddpc_cosim.errors import ConfigError, Place
from ddpc_cosim.prices import Price
from ddpc_cosim.signals import Reference, SignalFromFile
from ddpc_cosim.study.disturbances import check_covers
from ddpc_cosim.study.selection import SelectedSignals
from ddpc_cosim.variables import Variable
from fmu_plants.spelling import did_you_mean

_PRICES: Place = ("prices",)
_MASS = "kg"
"""The unit in which all emissions are counted."""


class Prices:
    """The prices of a study, whose signals are selected; what does not fit is reported.

    Parameters
    ----------
    signals : SelectedSignals
        The study and its signals.
    horizon : int
        The longest horizon of its controllers, as far as prices are told.
    """

    def __init__(self, signals: SelectedSignals, horizon: int) -> None:
        self.study, self.errors, self._selected, self._horizon = (
            signals.study,
            signals.errors,
            signals,
            horizon,
        )
        inputs, outputs = signals.variables.inputs, signals.variables.outputs
        self._known = {**outputs, **inputs}
        self._money = dict[str, str]()
        self.of_study = dict[str, Price]()
        for name, section in self.study.prices.items():
            if (price := self._resolved(name, section)) is not None:
                self.of_study[name] = price
        self.of_scenarios = {name: self._of_scenario(name) or {} for name in self.study.scenarios}

    def of(self, scenario: str) -> dict[str, Price]:
        """Return the prices in a scenario, in which signals are in their units."""
        changed = self.of_scenarios[scenario]
        return {
            name: replace(price, price=changed[name]) if name in changed else price
            for name, price in self.of_study.items()
        }

    @property
    def signals(self) -> tuple[Variable, ...]:
        """The signals that are paid for."""
        named = dict.fromkeys(price.signal for price in self.of_study.values())
        return tuple(self._known[name] for name in named)

    @independent
    def _resolved(self, name: str, section: Price) -> Price | None:
        place = (*_PRICES, name)
        if section.signal not in self._known:
            what = f'"{section.signal}" is not measured: it is neither an input nor an output of the plant'
            self.errors.add((*place, "signal"), f"{what}; {did_you_mean(section.signal, self._known)}")
            return None
        try:
            section.charge(name, self._known[section.signal])
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add((*place, "unit"), fault)
            return None
        self._check_money(name, section)
        amount = section.unit.partition("/")[2].strip()
        price = self._level((*place, "price"), section.price, Variable(name, section.unit), "")
        emissions: Reference | float | None = section.emissions
        unit = section.emissions_unit
        if emissions != 0.0:
            variable = Variable(name, f"{_MASS}/{amount}")
            emissions = self._level((*place, "emissions"), section.emissions, variable, unit)
            unit = variable.unit
        if price is None or emissions is None:
            return None
        return replace(section, price=price, emissions=emissions, emissions_unit=unit)

    def _check_money(self, name: str, section: Price) -> None:
        """Report a price in another money than those before it."""
        other = next((known for known, money in self._money.items() if money != section.money), None)
        self._money[name] = section.money
        if other is not None:
            what = f"is in {section.money}, and {other} in {self._money[other]}"
            needed = "one money for all prices of a problem, which are added up"
            self.errors.add((*_PRICES, name, "unit"), f"{what}; needed: {needed}")

    @independent
    def _of_scenario(self, scenario: str) -> dict[str, Reference] | None:
        given, place = self.study.scenarios[scenario].prices, ("scenarios", scenario, "prices")
        self.errors.require_known(place, "price", given, self.study.prices)
        changed = dict[str, Reference]()
        for name, level in given.items():
            if name in self.of_study:
                variable = Variable(name, self.of_study[name].unit)
                signal = self._level((*place, name), level, variable, "")
                changed |= {} if signal is None else {name: signal}
        return changed

    @independent
    def _level(
        self, place: Place, level: float | Reference, variable: Variable, unit: str
    ) -> Reference | None:
        """Return a number or a signal in a unit; what is wrong with it, or too short, is reported."""
        of_unit = (*place[:-1], f"{place[-1]}_unit")
        signal = self._selected.level(place, level, variable, unit, of_unit)
        if signal is None:
            return None
        if isinstance(level, SignalFromFile):
            loop = self.study.loop
            begin, end = loop.start_time - loop.warm_up, loop.end + self._horizon * loop.sampling_time
            check_covers(self._selected, place, signal, (begin, end), "the run and the longest horizon")
        return signal
