"""What is charged in a loop: the signals that are paid for, and their prices over time."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Charge
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plant import Plant
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Reference
from ddpc_cosim.variables import FloatArray, Variable, names
from fmu_plants.spelling import did_you_mean


class ChargedSignals:
    """Inputs and outputs of a plant that are paid for.

    Parameters
    ----------
    prices : mapping of str to Price
        What they cost, by name.
    plant : Plant
        The plant.
    measured : sequence of Variable
        Which signals may be charged besides its inputs.
    is_left : array of bool, shape (inputs,)
        Which inputs are left to a plant that controls itself.

    Attributes
    ----------
    charges : tuple of Charge
        What they cost but for the price.

    Raises
    ------
    ConfigError
        A signal is not measured, a price does not fit its unit, or prices are in several moneys.
    """

    def __init__(
        self,
        prices: Mapping[str, Price],
        plant: Plant,
        measured: Sequence[Variable],
        is_left: NDArray[np.bool_],
    ) -> None:
        self.prices, self._is_left = prices, is_left
        inputs, outputs = names(plant.inputs), names(plant.outputs)
        seen = {*names(measured)}
        faults, charges = list[str](), list[Charge]()
        self._inputs, self._outputs = list[tuple[int, int]](), list[tuple[int, int]]()
        for name, price in prices.items():
            is_input = price.signal in inputs
            if price.signal not in seen and not is_input:
                what = "is not measured" if price.signal in outputs else "is not a signal of the plant"
                needed = did_you_mean(price.signal, sorted(seen))
                faults.append(
                    f"prices: {name}: {price.signal} {what}; needed: an input or a measurement; {needed}"
                )
                continue
            place = (inputs if is_input else outputs).index(price.signal)
            try:
                charges.append(price.charge(name, (plant.inputs if is_input else plant.outputs)[place]))
                (self._inputs if is_input else self._outputs).append((len(charges) - 1, place))
            except ConfigError as error:
                faults += [f"prices: {name}: {fault}" for fault in error.faults]
        money = {charge.unit: charge.name for charge in charges}
        if len(money) > 1:
            listed = ", ".join(f"{name} in {unit}" for unit, name in money.items())
            faults.append(f"prices: {listed}; needed: all in one money, as what is paid is added up")
        if faults:
            raise ConfigError(faults)
        self.charges = tuple(charges)

    @property
    def signals(self) -> dict[str, float | Reference]:
        """The prices over time, by what errors call them."""
        return {f"prices: {name}": price.price for name, price in self.prices.items()}

    def keep_outputs(self, amounts: FloatArray, outputs: FloatArray) -> None:
        """Put what the plant has of the outputs that are charged among the amounts of all prices."""
        for column, i in self._outputs:
            amounts[column] = outputs[i]

    def keep_inputs(self, amounts: FloatArray, applied: FloatArray, *, controls_itself: bool) -> None:
        """Put there what it has of the inputs that are charged, given all its inputs.

        Of those that are left to a plant that controls itself, it is not known.
        """
        for column, i in self._inputs:
            amounts[column] = math.nan if controls_itself and self._is_left[i] else applied[i]

    def prices_at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return prices and emissions per amount at times [s], both of shape (len(time), n_prices)."""
        tables = np.empty((2, len(time), len(self.prices)))
        for i, (name, price) in enumerate(self.prices.items()):
            tables[:, :, i] = price.over(name, time)
        tables.setflags(write=False)
        return tables[0], tables[1]
