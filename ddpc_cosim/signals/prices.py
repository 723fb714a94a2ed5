"""Prices: what signals cost over time, in money and emissions."""

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np

from ddpc_cosim.codec import Section
from ddpc_cosim.controller import Charge
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import setting
from ddpc_cosim.signals.signals import Reference, ReferenceSignal, in_unit_of, values_at
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.units import display_unit, parse_unit

_MONEY_AND_UNIT = frozenset({"ct"})
"""Names of moneys that are units as well: cents, and centitonnes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Price(Section):
    """What a signal costs.

    Parameters
    ----------
    signal : str
        An input, or a measured output such as power.
    price : float or Reference
        Price over time, in ``unit``.
    unit : str
        Money per amount, ``"EUR/kWh"``: the amount is the signal, times ``factor``, over time.
    factor : float
        What is paid for per unit of the signal: 1 / COP where heat is the signal and electricity is paid for.
    known : bool
        Whether prices are known ahead; otherwise controllers are told that of now for all of the future.
    emissions : float or Reference
        What is emitted per the same amount.
    emissions_unit : str
        Its unit, ``"kg/kWh"``.
    """

    signal: str = setting(doc="an input, or a measured output such as power")
    price: float | ReferenceSignal = setting(doc="price over time", unit="the price's")
    unit: str = setting(doc='money per amount, as "EUR/kWh"')
    factor: float = setting(1.0, doc="what is paid for per unit of the signal")
    known: bool = setting(True, doc="whether prices are known ahead")
    emissions: float | ReferenceSignal = setting(0.0, doc="what is emitted per the same amount")
    emissions_unit: str = setting("kg/kWh", doc="unit of the emissions")

    @property
    def money(self) -> str:
        """What is paid with."""
        return self.unit.partition("/")[0].strip()

    @property
    def amount(self) -> str:
        """Unit of the amounts that are paid for."""
        return self.unit.partition("/")[2].strip() or "1"

    def over(self, name: str, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is paid, in its unit, and emitted [kg], per amount at times [s], shape (len(time),).

        Raises
        ------
        ConfigError
            A signal has values that are not possible or a unit that does not fit, or emissions are not a mass
            per amount.
        """
        what = f"emissions of {name}"
        price = _values(Variable(f"price {name}", self.unit), self.price, f"price {name}", time)
        if self.emissions == 0.0:  # in whatever unit
            return price, np.zeros_like(price)
        emission = _values(Variable(what, self.emissions_unit), self.emissions, what, time)
        try:
            in_kilograms = display_unit(self.emissions_unit, f"kg/{self.amount}").factor
        except ValueError as error:
            unit = f'unit "{self.emissions_unit}" is not a mass per {self.amount}'
            raise ConfigError(f'prices: {what}: {unit}; needed: as "kg/{self.amount}"') from error
        return price, emission * in_kilograms

    def charge(self, name: str, variable: Variable) -> Charge:
        """Return what the signal costs but for the price.

        Raises
        ------
        ConfigError
            The price is not money per amount, or the unit of the signal over time is not the amount's.
        """
        over_time = f"{variable.unit}.s" if variable.unit not in ("", "1") else "s"
        if not _is_money(self.money):
            needed = f'needed: money per amount, as "EUR/{over_time}" or, of a power, "EUR/kWh"'
            raise ConfigError(f'a price in "{self.unit}" is not one in money; {needed}')
        try:
            rate = display_unit(over_time, self.amount).factor
        except ValueError as error:
            what = f'a price in "{self.unit}" does not fit {self.signal}: {variable.unit or 1} over time'
            needed = f'needed: as "{self.money}/{over_time}", or in another unit of the same amounts'
            raise ConfigError(f"{what} is not an amount in {self.amount}; {needed}") from error
        return Charge(name, self.signal, rate * self.factor, self.money, self.known, self.amount)


def _is_money(name: str) -> bool:
    """Return whether a name can be that of a money: it is not one of a physical unit."""
    try:
        return bool(name) and (name in _MONEY_AND_UNIT or not parse_unit(name).exponents)
    except ValueError:
        return True


def _values(variable: Variable, signal: float | Reference, what: str, time: FloatArray) -> FloatArray:
    if isinstance(signal, Reference):
        return values_at(in_unit_of(variable, signal), what, time)
    if not (isinstance(signal, Real) and math.isfinite(signal)):
        raise ConfigError(f"prices: {what} = {signal!r}; needed: a finite number or a signal of time")
    return np.full(len(time), float(signal))
