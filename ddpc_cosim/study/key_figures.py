"""The key figures of a building that a study asks for: what they are of, its limits and its prices."""

from collections.abc import Callable, Mapping

from ddpc_cosim.codec import independent
from ddpc_cosim.description import KeyFigureTags, applied_output
from ddpc_cosim.errors import Place
from ddpc_cosim.key_figures import (
    CO2,
    POWERS,
    SOURCES,
    TEMPERATURES,
    UNITS,
    UNUSED,
    WATER,
    factor_of,
    is_source,
    kind_of,
    tagged,
)
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band
from ddpc_cosim.study.disturbances import check_reach
from ddpc_cosim.study.file_format.sections import BandSection, KeyFiguresSection
from ddpc_cosim.study.selection import SelectedSignals
from ddpc_cosim.variables import Variable
from fmu_plants.spelling import did_you_mean

_PLACE: Place = ("metrics", "key_figures")
_SOURCES, _BANDS = (*_PLACE, "sources"), (*_PLACE, "bands")
_PLANT_SAYS = "kpis.json and config.json in the resources of an FMU do"
Built = Callable[[Place, BandSection, Variable], Band | None]


class StudyKeyFigures:
    """The key figures of a study whose signals are selected; what does not fit is reported.

    Parameters
    ----------
    signals : SelectedSignals
        The study and its signals.
    prices : mapping of str to Price
        Its prices.
    band : callable
        Returns a band at a place in a variable's own unit, and reports what is wrong with it.

    Attributes
    ----------
    tags : KeyFigureTags or None
        What they are of; None: there are none.
    monitors : dict of str to (Band or None)
        Outputs that they are of and that are not kept otherwise, with their bands.
    """

    def __init__(self, signals: SelectedSignals, prices: Mapping[str, Price], band: Built) -> None:
        self.study, self.errors, self._selected, self._prices = signals.study, signals.errors, signals, prices
        self._outputs = signals.variables.outputs
        self._known = {**{v.name: v for v in signals.inputs.variables}, **self._outputs}
        self.tags: KeyFigureTags | None = None
        self.monitors = dict[str, Band | None]()
        section = self._section()
        if section is None:
            return
        self.tags = self._tags(section)
        if self.tags is not None:
            bands = self._bands(section, band) or {}
            self._check_limits(self.tags)
            self._check_prices(self.tags)
            self.monitors = self._monitors(self.tags, bands)

    @independent
    def _section(self) -> KeyFiguresSection | None:
        return self.study.metrics.key_figures

    @independent
    def _tags(self, section: KeyFiguresSection) -> KeyFigureTags | None:
        """Return what the study says of area and sources, else what the plant does."""
        of_plant = self._selected.variables.key_figures
        area = of_plant.area if section.area is None and of_plant else section.area
        sources = section.sources or (of_plant.sources if of_plant else {})
        missing = [key for key, value in (("area", area), ("sources", sources)) if not value]
        if area is None or missing:
            listed = " and ".join(missing)
            what = f"{listed} missing, and the plant does not say so ({_PLANT_SAYS})"
            needed = '{ set = "boptest", area = 120.0, sources = { ElectricPower = ["..."] } }'
            self.errors.add(_PLACE, f"{what}; needed: as {needed}", *((*_PLACE, key) for key in missing))
            return None
        used = {source: list(outputs) for source, outputs in sources.items() if is_source(source)}
        for source in section.sources:
            if not is_source(source):
                self.errors.add(_SOURCES, f'no source "{source}"; {did_you_mean(source, SOURCES)}')
        for source, outputs in used.items():
            self._check_signals(source, outputs)
        used = {source: outputs for source, outputs in used.items() if kind_of(source) not in UNUSED}
        return KeyFigureTags(area, used)

    def _check_signals(self, source: str, signals: list[str]) -> None:
        """Report signals that the plant does not have, and those of another quantity."""
        place = (*_SOURCES, source)
        self.errors.require_known(place, "output, or input that is driven,", signals, self._known)
        for name in signals:
            unit = self._known[name].unit if name in self._known else ""
            try:
                factor_of(source, unit)
            except ValueError:
                needed = f"needed: one in {UNITS[kind_of(source)]}, or in another unit of the same"
                self.errors.add(place, f"{name} is in {unit}; {needed}")

    @independent
    def _bands(self, section: KeyFiguresSection, built: Built) -> dict[str, Band | None]:
        """Return the bands that are said for key figures alone."""
        self.errors.require_known(_BANDS, "output", section.bands, self._outputs)
        bands = dict[str, Band | None]()
        for name, said in section.bands.items():
            if name in self._outputs:
                place = (*_BANDS, name)
                bands[name] = built(place, said, self._outputs[name])
                for key, edge in (("lower", said.band.lower), ("upper", said.band.upper)):
                    check_reach(self._selected, (*place, "band", key), edge, *self._selected.span_at(place))
        return bands

    @independent
    def _check_limits(self, tags: KeyFigureTags) -> None:
        """Report zones' outputs without a band, all at once."""
        section, references = self.study.metrics.key_figures, self.study.reference or {}
        banded = {name for name, wanted in references.items() if isinstance(wanted, BandSection)}
        banded |= section.bands.keys() if section else set()
        zones = dict.fromkeys(name for _, name in tagged(tags, *TEMPERATURES, CO2))
        if without := [name for name in zones if name not in banded and name in self._known]:
            needed = ", ".join(
                f"bands.{name} = {{ band = {{ lower = ..., upper = ... }} }}" for name in without
            )
            what = f"limits are missing of {', '.join(without)}"
            instead = "a band as reference, or sources without them"
            self.errors.add(_PLACE, f"{what}; needed: {needed}, {instead}", ("reference",), _BANDS)

    @independent
    def _check_prices(self, tags: KeyFigureTags) -> None:
        """Report powers without a price where others have one: what is paid would be less than it is."""
        paid = {price.signal for price in self.study.prices.values()}
        used = dict.fromkeys(name for _, name in tagged(tags, *POWERS, WATER))
        unpaid = [name for name in used if name not in paid]
        if unpaid and len(unpaid) < len(used):
            what = f"{', '.join(unpaid)}: no price, and others of its sources have one"
            self.errors.add(_PLACE, f"{what}; needed: prices of all or of none", ("prices",))

    def _monitors(self, tags: KeyFigureTags, bands: dict[str, Band | None]) -> dict[str, Band | None]:
        """Return the outputs that have to be kept: also what tells what the plant's own control applies."""
        kept = {*self._selected.outputs.names, *(price.signal for price in self._prices.values())}
        of_sources = [name for signals in tags.sources.values() for name in signals]
        switches = self._selected.variables.switches
        applied = [applied_output(name) for name in self._selected.inputs.names if name in switches]
        further = {
            name: None for name in (*of_sources, *applied) if name in self._outputs and name not in kept
        }
        return {**further, **bands}
