"""Prices: what signals cost over time, in money and emissions."""

from dataclasses import dataclass

from ddpc_cosim.codec import Section
from ddpc_cosim.controller import Charge
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import setting
from ddpc_cosim.signals import Constant, Reference, ReferenceSignal
from ddpc_cosim.variables import Variable
from fmu_plants.units import display_unit


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

    def signal_of_time(self) -> Reference:
        """Return the price over time."""
        return self.price if isinstance(self.price, Reference) else Constant(float(self.price))

    def charge(self, name: str, variable: Variable) -> Charge:
        """Return what the signal costs but for the price.

        Raises
        ------
        ConfigError
            Its unit over time is not that of the amount.
        """
        _, _, amount = self.unit.partition("/")
        over_time = f"{variable.unit}.s" if variable.unit not in ("", "1") else "s"
        try:
            rate = display_unit(over_time, amount.strip()).factor
        except ValueError as error:
            what = f'a price in "{self.unit}" does not fit {self.signal}: {variable.unit or 1} over time'
            raise ConfigError(f"price {name}: {what} is not an amount in {amount or 1}") from error
        return Charge(name, self.signal, rate * self.factor, self.money, self.known, amount.strip())
