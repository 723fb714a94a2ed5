"""What acts on a plant besides what is driven: the disturbances of a suggested study."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Self

from ddpc_cosim.inspection.words import SURROUNDINGS, Wording
from ddpc_cosim.signals.disturbances import KnownDisturbance
from ddpc_cosim.signals.excitations import InputExcitation
from ddpc_cosim.signals.signals import Constant, RandomLevels
from ddpc_cosim.study.file_format.sections import RecordingSection
from ddpc_cosim.suggestion import design
from ddpc_cosim.suggestion.operating_point import TriedPoint
from ddpc_cosim.suggestion.quantities import as_weather_goes
from ddpc_cosim.suggestion.response_types import ResponseType

_WHAT_TO_DO = (
    "What acts from outside and is measured. Nothing here knows its course: it stays where it rests, and in "
    "the experiment it moves about there, so that the data say what it does. Replace `signal` by yours, as "
    '{ kind = "file", file = "weather.csv", column = "..." }; known = "medium" or "perfect" gives forecasts. '
    "One that is an actuator after all: --input NAME."
)


_INSIDE = (
    'the weather, which the plant has inside. known = "measured" lets controllers see it; those that learn '
    "from data need an experiment that is long enough for it to be told from the inputs."
)
_MOST_INSIDE = 4


def _weather_inside(point: TriedPoint) -> Iterator[str]:
    """Yield outputs that are called the weather, move while inputs rest, and answer to none of them."""
    for j, variable in enumerate(point.outputs):
        wording = Wording(variable)
        is_weather = bool(wording.name & SURROUNDINGS) or wording.is_irradiance
        is_still = all(response.type is ResponseType.INSENSITIVE for response in point.tested.responses[j])
        if is_weather and is_still and j not in point.choice.outputs and point.tested.drift(j) > 0.0:
            yield variable.name


@dataclass(frozen=True, slots=True)
class Acting:
    """The disturbances that the study has, and what is said of them.

    Parameters
    ----------
    known : mapping of str to KnownDisturbance
        The disturbances, each at the level that it rests at.
    moving : mapping of str to RandomLevels
        How each that is an input moves in the experiment.
    comments : mapping of str to tuple of str
        What is said of them, by section of the study file.
    """

    known: dict[str, KnownDisturbance]
    moving: Mapping[str, RandomLevels]
    comments: Mapping[str, tuple[str, ...]]

    @classmethod
    def of(cls, point: TriedPoint, hold: float) -> Self:
        """Return those that a step test has shown to do something; the others rest.

        Parameters
        ----------
        point : TriedPoint
            What was found.
        hold : float
            For how long each keeps a level in the experiment [s].
        """
        working = design.working_range(point.inputs, point.bounds)
        known, moving, said = {}, {}, []
        for i, variable in enumerate(point.inputs):
            why = point.disturbances.get(variable.name)
            if why is None:
                continue
            column = [row[i] for row in point.tested.responses]
            if all(response.type is ResponseType.INSENSITIVE for response in column):
                said.append(
                    f"{variable.name} looks like a disturbance ({why}), and moves no output here: it rests"
                )
                continue
            said.append(f"{variable.name} looks like a disturbance: {why}.")
            level, low, high = (float(values[i]) for values in (point.rest, working.low, working.high))
            low, high = as_weather_goes(variable, level, low, high)
            known[variable.name] = KnownDisturbance(signal=Constant(level))
            resolution = (high - low) / 100
            moving[variable.name] = RandomLevels(
                design.rounded(low, resolution), design.rounded(high, resolution), hold
            )
        opening = [_WHAT_TO_DO] if known else []
        inside = [*_weather_inside(point)][:_MOST_INSIDE]
        if inside:
            known |= dict.fromkeys(inside, KnownDisturbance(known="unknown"))
            opening.append(f"{', '.join(inside)}: {_INSIDE}")
        comments = {"disturbances": (*opening, *said)} if known else {"plant": tuple(said)}
        return cls(known, moving, comments)

    def recorded(self, samples: int, excitation: dict[str, InputExcitation]) -> RecordingSection:
        """Return the experiment, in which they move; it begins at 0, as not every FMU runs before that."""
        if not self.known:
            return RecordingSection(samples=samples, excitation=excitation)
        return RecordingSection(
            samples=samples, excitation=excitation, disturbances={**self.moving}, start_time=0.0
        )
