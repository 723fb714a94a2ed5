"""The requirements of a study: whether they are of metrics that its runs will have, in units that fit."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from ddpc_cosim.codec import independent
from ddpc_cosim.description import KeyFigureTags
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.key_figures import KeyFigures
from ddpc_cosim.metrics import Metric, all_metrics, expected_keys, in_unit, split_key
from ddpc_cosim.responses import Actuation, BandResponse, Charged, Response, WholeRun
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.study.file_format.requirements import Required
from ddpc_cosim.study.file_format.sections import BandSection
from ddpc_cosim.study.selection import SelectedSignals
from ddpc_cosim.variables import Variable
from fmu_plants.spelling import did_you_mean


class RequirementsCheck:
    """Checks the requirements of a study whose signals are selected; what does not fit is reported.

    Parameters
    ----------
    signals : SelectedSignals
        The study and its signals.
    prices : mapping of str to Price
        Its prices.
    tags : KeyFigureTags, optional
        What its key figures are of.
    """

    def __init__(
        self, signals: SelectedSignals, prices: Mapping[str, Price], tags: KeyFigureTags | None
    ) -> None:
        self._study, self._errors = signals.study, signals.errors
        self._outputs, self._inputs = signals.outputs, signals.inputs
        self._known = {**signals.variables.outputs, **signals.variables.inputs}
        self._prices, self._tags = prices, tags

    @independent
    def check(self) -> None:
        """Check every requirement."""
        requirements = self._study.requirements
        for required in requirements.required if requirements else ():
            self._check(required)

    @cached_property
    def _keys(self) -> dict[tuple[str, ...], str]:
        """Return the keys of the metrics that the runs will have, by metric and signal."""
        references = self._study.reference or {}
        keys = expected_keys(
            self._outputs.variables,
            self._inputs.variables,
            {name for name, wanted in references.items() if isinstance(wanted, BandSection)},
            _charged(self._prices, self._known) if self._prices else None,
            has_cost=self._study.metrics.cost is not None,
            key_figures=self._key_figures,
        )
        return {split_key(key)[:2]: key for key in keys}

    @property
    def _key_figures(self) -> KeyFigures | None:
        """Return the key figures, as far as it decides which there are."""
        if self._tags is None:
            return None
        signals = {name for names in self._tags.sources.values() for name in names}
        prices = [price for price in self._prices.values() if price.signal in signals]
        money = next((price.money for price in prices), "")
        return KeyFigures(self._tags, money, any(price.emissions != 0.0 for price in prices))

    @independent
    def _check(self, required: Required) -> None:
        place, section = required.place, required.section
        at = (*place, "scenarios")
        self._errors.require_known(at, "scenario", section.scenarios, self._study.scenarios)
        key = self._keys.get((required.metric, required.signal))
        if key is None:
            if fault := self._fault(required, all_metrics()[required.metric]):
                self._errors.add(place, fault, ("plant", "outputs"), ("plant", "inputs"))
            return
        try:
            in_unit(key, section.unit)
        except ConfigError as error:
            self._errors.add((*place, "unit"), str(error))

    def _fault(self, required: Required, metric: Metric[object]) -> str:
        """Return why the runs of the study will not have a metric."""
        name, signal = required.metric, required.signal
        if issubclass(metric.of, Actuation):
            return f'no input "{signal}"; {did_you_mean(signal, self._inputs.names)}'
        if issubclass(metric.of, Response):
            if signal not in self._outputs.names:
                return f'no controlled output "{signal}"; {did_you_mean(signal, self._outputs.names)}'
            of_band = issubclass(metric.of, BandResponse)
            wanted, instead = ("a reference", "a band") if of_band else ("a band", "a reference")
            return f"{signal} has {wanted}; {name} is of an output with {instead}"
        if issubclass(metric.of, WholeRun):
            return f"the study has no {name}; it needs weights, metrics.{name}"
        if issubclass(metric.of, KeyFigures) or name == "time_rat":
            return self._no_key_figure(name)
        if not self._study.prices:
            return f"the study has no {name}; it needs prices"
        if len(self._prices) < len(self._study.prices):  # what is wrong with one has been reported
            return ""
        what = "emissions of a price" if name == "emissions" else "a price of energy"
        return f"the study has no {name}; it needs {what}"

    def _no_key_figure(self, name: str) -> str:
        """Return why the runs will not have a key figure."""
        if self._study.metrics.key_figures is None:
            return f'the study has no {name}; it needs metrics.key_figures = "boptest"'
        if self._tags is None or len(self._prices) < len(self._study.prices):  # which has been reported
            return ""
        needed = {"cost_tot": "prices of its powers", "emis_tot": "emissions of its powers' prices"}
        return f"the study has no {name}; it needs {needed.get(name, 'signals of its sources')}"


def _charged(prices: Mapping[str, Price], known: Mapping[str, Variable]) -> Charged:
    """Return what is paid for over one interval, as far as it decides which metrics there are."""
    charges = [price.charge(name, known[price.signal]) for name, price in prices.items()]
    emission = np.array([[float(price.emissions != 0.0) for price in prices.values()]])
    none = np.zeros((1, len(charges)))
    charged = Charged.of(charges, none, {charge.signal for charge in charges}, none, none, 1.0)
    return replace(charged, emission=emission)
