"""The prices of a study: what is paid for, in which units, over all of the run."""

from dataclasses import replace

from ddpc_cosim.codec import independent
from ddpc_cosim.errors import ConfigError, Place
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Reference
from ddpc_cosim.study.disturbances import check_reach
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
        measured = (*signals.outputs.variables, *signals.measurements.variables)
        self._known = {v.name: v for v in (*signals.variables.inputs.values(), *measured)}
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

    @independent
    def _resolved(self, name: str, section: Price) -> Price | None:
        place = (*_PRICES, name)
        if section.signal not in self._known:
            what = f'"{section.signal}" is not measured; needed: an input, or one of plant.measurements'
            in_doubt = (("plant", "outputs"), ("plant", "measurements"))
            hint = did_you_mean(section.signal, self._known)
            self.errors.add((*place, "signal"), f"{what}; {hint}", *in_doubt)
            return None
        try:
            section.charge(name, self._known[section.signal])
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add((*place, "unit"), fault.removeprefix(f"prices: {name}: "))
            return None
        self._check_money(name, section)
        price = self._level((*place, "price"), section.price, Variable(name, section.unit), "")
        emissions: Reference | float | None = section.emissions
        of_emissions = Variable(name, f"{_MASS}/{section.amount}")
        if emissions != 0.0:
            at, unit = (*place, "emissions"), section.emissions_unit
            emissions = self._level(at, section.emissions, of_emissions, unit)
        if price is None or emissions is None:
            return None
        return replace(section, price=price, emissions=emissions, emissions_unit=of_emissions.unit)

    def _check_money(self, name: str, section: Price) -> None:
        """Report a price in another money than those before it."""
        money = section.unit.partition("/")[0].strip()
        other = next((known for known, its_money in self._money.items() if its_money != money), None)
        self._money[name] = money
        if other is not None:
            what = f"is in {money}, and {other} in {self._money[other]}"
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
        begin, end = self._selected.span_at(place)
        ahead = self._horizon * self.study.loop.sampling_time
        check_reach(self._selected, place, level, begin, end + ahead)
        return signal
