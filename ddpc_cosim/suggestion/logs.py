"""Logs as a plant for a step test: its identified model without noise, and what of them a study takes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Self

import numpy as np

from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import PARQUET
from ddpc_cosim.files.log_cells import encoding_of
from ddpc_cosim.files.log_format import LogFormat
from ddpc_cosim.identification.identification import Identification
from ddpc_cosim.inspection.log_files import inspect_log, time_column_of
from ddpc_cosim.inspection.logs import LogSummary
from ddpc_cosim.signals.signals import Band, Reference, Steps
from ddpc_cosim.study.file_format.sections import ControllerSection, PlantSection, RecordingSection
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.roles import Roles
from ddpc_cosim.suggestion.systems import OpenSystem
from ddpc_cosim.suggestion.writing import Proposal

SUFFIXES = (".csv", ".txt", ".parquet")
"""Of files that are logs."""
_RECORDED, _IDENTIFIED = [0.0, 0.5], [0.5, 1.0]
"""Parts of the rows that controllers learn from, and that the plant is identified from."""
_MENDED = LogFormat(gaps="split", missing=3, duplicates="first")
"""How a log is read that is refused as it is."""
_SEEDS = [*range(10)]
_BY_METHOD = ("deepc",)
"""Controllers whose predictor is told that its data were recorded in closed loop."""


def _words(summary: LogSummary) -> tuple[str, str]:
    """Return what a log says of its plant, and what that means for controllers that do not settle."""
    meaning = (
        "So far ahead methods predict samples of the log that they were not shown; it does not say that a "
        "controller settles. If none does below, look at setpoints, limits and settings before the log."
        if summary.good
        else "If no controller settles below, that is the likely cause: `ddpc-cosim inspect` says which "
        "experiment to make."
    )
    return f"What the log says of the plant: {summary.verdict}", meaning


class LoggedSystem:
    """A plant that is known from its logs alone, opened as its model without noise.

    Parameters
    ----------
    identification : Identification
        The logs by absolute paths, and which signals act from outside.
    inputs, outputs : sequence of str
        What can be driven, and what can be controlled.
    said : tuple of str
        What is to be said of the logs.
    in_closed_loop : bool
        Whether a controller drove the inputs while they were recorded.

    Attributes
    ----------
    description : PlantDescription
        The signals.
    ranges : mapping of str to (float, float)
        Between what values each of them was.

    Raises
    ------
    DataError
        What is wrong with the logs.
    """

    files: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()
    exchange = math.inf

    def __init__(
        self,
        identification: Identification,
        inputs: Sequence[str],
        outputs: Sequence[str],
        said: tuple[str, ...] = (),
        *,
        in_closed_loop: bool = False,
    ) -> None:
        self._identification = replace(identification, part=_IDENTIFIED)
        self._inputs, self._outputs = [*inputs], [*outputs]
        self._said, self._in_closed_loop = said, in_closed_loop
        quiet = replace(self._identification, noise=False, members=1)
        spec = PlantSpec.of(replace(self.section(0.0), identified=quiet), Path())
        assert spec.identified is not None
        logged = spec.identified.logged()
        self.ranges: Mapping[str, tuple[float, float]] = logged.ranges
        self._treatments = logged.treatments
        self.description = replace(spec.variables(), fixed_step=logged.recording.sampling_time)
        self._spec = spec.built()

    @classmethod
    def of(
        cls,
        files: Sequence[Path],
        inputs: Sequence[str] | None,
        outputs: Sequence[str] | None,
        disturbances: Sequence[str],
        sampling_time: float | None,
    ) -> Self:
        """Return the plant of some logs; what its signals are is guessed where it is not said.

        Raises
        ------
        ConfigError
            No input or no output is known.
        DataError
            What is wrong with the logs, and cannot be mended.
        """
        summary = inspect_log(files[0], inputs or (), outputs or (), disturbances, sampling_time)
        roles = {
            role: [column.name for column in summary.evidence.columns if column.role == role]
            for role in ("input", "output", "disturbance")
        }
        for role in ("input", "output"):
            if not roles[role]:
                known = ", ".join(column.name for column in summary.evidence.columns)
                raise ConfigError(
                    f"{files[0]}: which column is an {role} is not clear; --{role} says it: {known}"
                )
        identification = Identification(
            file=[str(file.resolve()) for file in files],
            disturbances=roles["disturbance"],
            sampling_time=sampling_time,
            time_column=time_column_of(files[0]),
            encoding=encoding_of(*(file for file in files if file.suffix != PARQUET)),
            resample="no" if sampling_time is None else "mean",
        )
        signals = roles["input"], roles["output"]
        said = (*_words(summary), *summary.reservations)
        closed = bool(summary.evidence.closed_inputs)
        try:
            return cls(identification, *signals, said, in_closed_loop=closed)
        except DataError:
            mended = {key: getattr(_MENDED, key) for key in ("gaps", "missing", "duplicates")}
            return cls(replace(identification, **mended), *signals, said, in_closed_loop=closed)

    def request(self, asked: Request) -> Request:
        """Return what is asked for: samples as far apart and inputs going as far as in the logs.

        What each output reached is not asked for: the inputs may not hold all outputs there together.
        """
        ranges = {name: self.ranges[name] for name in self._inputs}
        return replace(
            asked,
            ranges={**ranges, **asked.ranges},
            sampling_time=self.description.fixed_step,
            inputs=self._inputs,
            outputs=self._outputs,
        )

    @property
    def roles(self) -> Roles:
        """What the inputs are for, which is known."""
        acting = dict.fromkeys(self._identification.disturbances, "it is a disturbance of the log")
        return Roles(driven=tuple(self._inputs), disturbances=acting)

    def refine(self, *_: object) -> bool:
        """Return that there is nothing to refine."""
        return False

    def section(self, _sampling_time: float) -> PlantSection:
        """Return the plant of a study."""
        return PlantSection(identified=self._identification, inputs=self._inputs, outputs=self._outputs)

    def count(self, _h: float) -> int:
        """Return in how many steps one is done: in one."""
        return 1

    def open(
        self, *, start: Mapping[str, float], inputs: Sequence[str], outputs: Sequence[str], **_: object
    ) -> OpenSystem:
        """Open the model, at rest at the start values of its inputs; it runs no foreign code."""
        return OpenSystem(self._spec.starting_at(start).open(inputs, outputs), self)

    def learnt(self, proposal: Proposal) -> Proposal:
        """Return a proposal whose controllers learn from the logs, of another part than the plant is."""
        identification = self._identification
        format = {field.name: getattr(identification, field.name) for field in fields(LogFormat)}
        recording = RecordingSection(file=identification.file, **{**format, "part": _RECORDED})
        plant = proposal.study.plant
        said = {
            "head": self._said,
            "plant": (
                "Identified from the second half of the rows: seed s plays model s of an ensemble, with its "
                "noise; the answer holds as far as the log shows the plant.",
                *(f"Done to the rows: {words}" for words in self._treatments),
            ),
            "recording": (
                "Controllers learn from the first half of the rows, so that none is judged by a model of the "
                "rows that it learned from.",
            ),
            "bounds": ("Limits of the inputs: between what values they were in the log.",),
        }
        origins = {
            name: origin if name in proposal.asked.ranges and origin != "as asked for" else "the log's range"
            for name, origin in proposal.origins.items()
        }
        controllers = {key: self._told(controller) for key, controller in proposal.study.controllers.items()}
        comments = {
            **proposal.comments,
            **{
                key: (*texts, *(() if key in ("recording", "bounds") else proposal.comments.get(key, ())))
                for key, texts in said.items()
            },
        }
        return replace(
            proposal.changed(
                recording=recording,
                seeds=_SEEDS,
                controllers=controllers,
                plant=plant,
                reference=self._reached(proposal),
            ),
            comments=comments,
            origins=origins,
        )

    def _reached(self, proposal: Proposal) -> dict[str, Reference | Band]:
        """Return what is wanted of the outputs, no further than the log went, unless it is asked for."""
        reference = dict(proposal.study.reference or {})
        for name, wish in reference.items():
            if isinstance(wish, Steps) and name not in proposal.asked.ranges:
                values = np.clip(wish.values, *self.ranges[name]).tolist()
                reference[name] = replace(wish, values=tuple(values))
        return reference

    def _told(self, controller: ControllerSection) -> ControllerSection:
        """Return a controller that is told that its data were recorded in closed loop, if they were."""
        if not self._in_closed_loop or controller.type not in _BY_METHOD:
            return controller
        return replace(controller, settings={**controller.settings, "instruments": "closed-loop"})
