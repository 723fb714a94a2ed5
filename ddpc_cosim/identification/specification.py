"""A plant identified from data as a study has it: what it is, before and after its models are found."""

import hashlib
import importlib.metadata
import json
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from ddpc_cosim.codec import read, write
from ddpc_cosim.description import PlantDescription, describe
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.identification.identification import Identification, LoggedPlant, read_logged_plant
from ddpc_cosim.identification.innovation import PlantModel
from ddpc_cosim.identification.plant import IdentifiedPlant
from ddpc_cosim.plugins import package_version
from ddpc_cosim.settings import hash_of_file
from ddpc_cosim.variables import FloatArray, Variable, names, with_start
from fmu_plants.files import cached

if TYPE_CHECKING:
    from ddpc_cosim.identification.candidates import Candidate

_DRAWS_OF_BOOTSTRAP = 28
"""Seed of the blocks that are drawn: the same logs give the same models."""


@dataclass(frozen=True, slots=True, eq=False)
class Ensemble:
    """The models of a log.

    Parameters
    ----------
    inputs, outputs : tuple of Variable
        The signals, disturbances after the inputs that are driven.
    models : tuple of PlantModel
        The model of all data, and those of data that might have been recorded as well.
    states : tuple of array, shape (n,)
        Where each of them is at the end of the log.
    ranges : mapping of str to (float, float)
        What each signal was recorded between.
    facts : dict of str to str
        What a report says of them.
    tried : tuple of (str, float)
        Each method that was tried, in words, with its error on data held out, the best first.
    held_out : dict of str to float
        What the model of a part of the data explains of each output on the rest [%].
    samples : int
        Length of the logs.
    treatments : tuple of str
        What was done to them.
    """

    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    models: tuple[PlantModel, ...]
    states: tuple[FloatArray, ...]
    ranges: Mapping[str, tuple[float, float]]
    facts: dict[str, str]
    tried: tuple[tuple[str, float], ...]
    held_out: dict[str, float]
    samples: int
    treatments: tuple[str, ...]

    def beyond(self, courses: Mapping[str, FloatArray]) -> dict[str, float]:
        """Return in what share of its samples each signal was outside its range, where it ever was.

        Parameters
        ----------
        courses : mapping of str to array, shape (T,)
            Values of signals by name; those that are not finite do not count.
        """
        shares = dict[str, float]()
        for name in courses.keys() & self.ranges.keys():
            (low, high), course = self.ranges[name], courses[name][np.isfinite(courses[name])]
            outside = (course < low) | (course > high)
            if outside.any():
                shares[name] = float(outside.mean())
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


@dataclass(frozen=True, slots=True)
class IdentifiedSpec:
    """A plant that is identified from logs.

    Parameters
    ----------
    identification : Identification
        The logs, with absolute paths, and how models are found.
    inputs, outputs : tuple of str
        Signals that are driven, and those that are controlled or measured.
    ensemble : Ensemble or None
        The models, once they have been found.
    """

    identification: Identification
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    ensemble: Ensemble | None = field(default=None, compare=False)

    @property
    def label(self) -> str:
        """What it is called: the names of the logs."""
        return ", ".join(Path(path).name for path in self.identification.file)

    def logged(self) -> LoggedPlant:
        """Return what the logs hold, which are read once; DataError: what is wrong with them."""
        return _logged(*self._key)

    def variables(self) -> PlantDescription:
        """Return the signals as a plant's description; DataError: what is wrong with the logs."""
        logged = self.logged()
        described = describe((*logged.inputs, *logged.disturbances), logged.outputs)
        return replace(described, default_inputs=names(logged.inputs))

    @property
    def content(self) -> str:
        """What decides the models: the content of the logs and the settings."""
        hashes, _, *signals = self._key
        settings = {key: value for key, value in write(self.identification).items() if key != "file"}
        decisive = json.dumps([hashes, settings, signals], sort_keys=True)
        return f"identified {hashlib.sha256(decisive.encode()).hexdigest()}"

    @property
    def _key(self) -> tuple[tuple[str, ...], str, tuple[str, ...], tuple[str, ...]]:
        """What a log and its models are kept by."""
        hashes = tuple(map(hash_of_file, self.identification.file))
        return hashes, json.dumps(write(self.identification)), self.inputs, self.outputs

    def built(self) -> Self:
        """Return the plant with its models.

        Raises
        ------
        DataError
            The logs do not do.
        """
        return replace(self, ensemble=_ensemble(*self._key))

    def open(self, start: Mapping[str, float], seed: int, *, records: bool) -> IdentifiedPlant:
        """Open the plant, which is built, that seed s plays.

        Parameters
        ----------
        start : mapping of str to float
            Values that inputs start from and rest at, in place of those of the log.
        seed : int
            Says which model it is, and draws its noise.
        records : bool
            Whether an experiment comes before the run.
        """
        assert self.ensemble is not None
        number = seed % len(self.ensemble.models)
        ends = self.identification.start == "log-end"
        return IdentifiedPlant(
            self.ensemble.models[number],
            with_start(self.ensemble.inputs, start),
            self.ensemble.outputs,
            seed=seed if self.identification.noise else None,
            state=self.ensemble.states[number] if ends else None,
            records=records,
            facts=self.ensemble.facts,
        )


@lru_cache(maxsize=8)
def _logged(
    hashes: tuple[str, ...], settings: str, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> LoggedPlant:
    """Read logs of this content, once."""
    return read_logged_plant(read(Identification, json.loads(settings)), inputs, outputs)


@lru_cache(maxsize=8)
def _ensemble(
    hashes: tuple[str, ...], settings: str, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> Ensemble:
    """Return the models of logs of this content, which are found once and kept in the cache."""
    decisive = hashes, settings, inputs, outputs, _code()
    place = f"identified/{hashlib.sha256(repr(decisive).encode()).hexdigest()}.pickle"

    def made() -> bytes:
        return pickle.dumps(_found(hashes, settings, inputs, outputs))

    try:
        content = cached(place, made).read_bytes()
    except OSError:  # a cache that cannot be used costs time, and nothing else
        content = made()
    models: Ensemble = pickle.loads(content)
    return models


def _code() -> str:
    """Return what decides models besides logs and settings: the code that reads those, and its libraries."""
    code = hashlib.sha256()
    package = Path(__file__).parent.parent
    for path in sorted(
        [*package.glob("identification/*.py"), *package.glob("files/*.py"), *package.glob("*.py")]
    ):
        code.update(path.read_bytes())
    versions = package_version(), *map(importlib.metadata.version, ("numpy", "scipy"))
    return f"{code.hexdigest()} {' '.join(versions)}"


def _found(
    hashes: tuple[str, ...], settings: str, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> Ensemble:
    """Find the models of logs of this content."""
    # With what estimates, SciPy's optimisation too: reading a study and running its cases do without.
    from ddpc_cosim.identification.bootstrap import ensemble
    from ddpc_cosim.identification.candidates import candidates

    identification = read(Identification, json.loads(settings))
    logged = _logged(hashes, settings, inputs, outputs)
    recording = logged.recording
    tried = candidates(recording, identification.method, identification.order)
    best = tried[0]
    rng = np.random.default_rng(_DRAWS_OF_BOOTSTRAP)
    models = best.model, *ensemble(recording, best, identification.members - 1, rng)
    held_out = dict(zip(names(logged.outputs), best.held_out.tolist(), strict=True))
    return Ensemble(
        (*logged.inputs, *logged.disturbances),
        logged.outputs,
        models,
        tuple(model.last_state(recording.pieces[-1]) for model in models),
        logged.ranges,
        _facts(identification, logged, best, held_out),
        tuple((candidate.words, candidate.error) for candidate in tried),
        held_out,
        len(recording),
        logged.treatments,
    )


def _facts(
    identification: Identification, logged: LoggedPlant, best: "Candidate", held_out: Mapping[str, float]
) -> dict[str, str]:
    """Return what a report says of the models, by key."""
    recording, members = logged.recording, identification.members
    files = ", ".join(Path(path).name for path in identification.file)
    others = f", and {members - 1} of data that might have been recorded as well" if members > 1 else ""
    return {
        "identified_from": f"{files}: {len(recording)} samples, {in_words(recording.sampling_time)} apart",
        "identified_by": best.words,
        "models": f"one of all data{others}",
        "fit_on_data_held_out": ", ".join(f"{name} {fit:.3g} %" for name, fit in held_out.items()),
        "recorded_ranges": "; ".join(
            f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in logged.ranges.items()
        ),
        **({"treatment_of_the_data": "; ".join(logged.treatments)} if logged.treatments else {}),
    }
