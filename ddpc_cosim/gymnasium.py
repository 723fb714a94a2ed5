"""Problems of studies as Gymnasium environments: what is learned there competes as any controller does.

An environment is the loop of a case, sample by sample: the same plant, signals, noise and parameters that a
seed has in ``ddpc-cosim run``. The problems of the built-in benchmark are registered by name, such as
``ddpc_cosim/pendulum-v1``.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ddpc_cosim.controller import Controller, Loop, Sample
from ddpc_cosim.errors import ConfigError, ControllerError, CosimError, MissingLibraryError
from ddpc_cosim.loop.master import Question, Resumption, Steps
from ddpc_cosim.loop.safe_calls import close_plant, decision_of, serialise_plant
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.metrics import headline, keys_named, split_key
from ddpc_cosim.observation import Observation
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.processes.rows import RowStore
from ddpc_cosim.responses import Actuation
from ddpc_cosim.study.case_runs import no_samples, open_plant, row_store, stepwise
from ddpc_cosim.study.cases import Case, with_seed, without_experiment
from ddpc_cosim.study.objects import Silent, Study
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.resolve import ResolvedStudy
from ddpc_cosim.study.single import single_case
from ddpc_cosim.tuning.objectives import reference_spans
from ddpc_cosim.variables import FloatArray, names
from fmu_plants.spelling import did_you_mean

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise MissingLibraryError.of("ddpc_cosim.gymnasium", "Gymnasium", "gym") from error

VERSION = 1
"""Of the registered problems: it changes with what they ask."""
_LARGEST_SEED = 2**31
_HOUR = 3600.0  # s


@dataclass(frozen=True, slots=True)
class SavedState:
    """Where an episode was: what ``reset(options={"state": ...})`` goes on from.

    Parameters
    ----------
    resumption : Resumption
        The state of the plant, and at which sample that was.
    parameters : dict of str to float, int, bool or str
        The plant's parameters, those included that the episode's seed has drawn.
    """

    resumption: Resumption
    parameters: dict[str, ParameterValue]


def make(
    study: "Study | str | Path",
    *,
    problem: str | None = None,
    scenario: str | None = None,
    horizon: int | None = None,
    weights: Mapping[str, float] | None = None,
    isolated: bool | Literal["auto"] = "auto",
) -> "ProblemEnv":
    """Return a problem of a study as an environment.

    Parameters
    ----------
    study : Study, str or Path
        The study, its file, or the name of a built-in one.
    problem, scenario : str, optional
        Which of the study's; default: the only problem, the first scenario.
    horizon : int, optional
        How many samples ahead are observed, as far as the problem's preview goes, at most those of an
        episode; default: as many as the controller of the study that asks for most.
    weights : mapping of str to float, optional
        By metric and signal (``"mean_abs_error.angle"``, ``"money"``), what a unit of each figure that the
        study ranks by counts in the reward; default: 1 where it is one figure, or where there are money or
        discomfort; of the errors of several outputs, the mean of what they are in parts of the reference's
        span.
    isolated : bool or "auto"
        Whether FMUs run in processes of their own, so that a crash or a hang ends the episode and not this
        process; auto: as the problem says, which is so for supplied FMUs by default.

    Raises
    ------
    ConfigError
        The study has errors, or no such problem or scenario; an input has no finite limits, which a space of
        actions needs; a weight is of no figure that the study ranks by, or no number; an impossible horizon.
    CosimError
        The plant cannot be built.
    """
    if isolated not in (True, False, "auto"):
        raise ConfigError(f'isolated = {isolated!r} is not possible; allowed: True, False, "auto"')
    resolved = study.resolved(problem) if isinstance(study, Study) else read_study(str(study), problem)
    if problem is None and len(resolved.problems) == 1:
        problem = next(iter(resolved.problems))
    first = next(iter(next(iter(resolved.problems.values())).study.controllers))
    case, single = single_case(resolved, first, Silent(), problem=problem, scenario=scenario)
    whole = resolved.problems[single.study.name]
    return ProblemEnv(_of_no_controller(case, isolated), whole, horizon, weights)


def _of_no_controller(case: Case, isolated: bool | Literal["auto"]) -> Case:
    """Return a case for whoever acts in the environment."""
    plant = case.plant
    if plant.isolated if isolated == "auto" else isolated:
        how = {"isolated": True, "step_timeout": case.step_timeout, "memory_limit": case.memory_limit}
        plant = plant.isolating(how)
    section = {"type": "", "settings": {}}
    case = replace(case, controller="environment", section=section, bounds=case.shared_bounds, plant=plant)
    # The noise of a run goes on from that of its experiment, whoever learns from it.
    return case if case.continue_recording or case.noise else without_experiment(case)


class ProblemEnv(gymnasium.Env[FloatArray, FloatArray]):
    """A problem of a study as an environment; :func:`make` makes it.

    An action is the inputs of the plant, in their units, held for one sampling interval; beyond the limits at
    its sample it is clipped, as for every controller. An observation is an :class:`ddpc_cosim.Observation`,
    a vector whose entries ``observation_names`` and ``observation_units`` name. The reward of the action at
    sample k is minus what that sample counts in the figure that the study ranks by, times its weight:

    ==================  ================================================================================
    ``mean_abs_error``  abs(reference_k - output_k) / n, over the n samples of an episode
    ``band_violation``  distance of output_k to its band * sampling time, in hours
    ``money``           integral of price times what is paid for, until the next sample
    ``cost``            weighted squares of errors, inputs and input changes at sample k
    ==================  ================================================================================

    The sum over an episode is minus the study's figure of the same run. Where a fault ends an episode early,
    each sample that is missing counts as the worst one so far, at least as an error of the size of the
    reference's span: no one gains by ending a run.

    Attributes
    ----------
    observation_names, observation_units : tuple of str
        Of each entry of an observation, as ``setpoint.angle`` and ``reference.angle[3]``, that in 3 samples.
    action_names, action_units : tuple of str
        Of each entry of an action.
    figures : dict of str to float
        What the study ranks by, and its weight in the reward.
    trace : Trace or None
        The samples of the last episode that has ended.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as its base class has it
    # Of the episode: who acts, its case, the question that is to be answered, its sample, what samples cost.
    _agent: "Agent"
    _begun: Case
    _question: Question
    _k: int
    _costs: "_Costs"

    def __init__(
        self,
        case: Case,
        resolved: ResolvedStudy,
        horizon: int | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        self._case, self._resolved = case, resolved
        self._horizon = _horizon_of(case, resolved, horizon)
        self._spans, self.figures = reference_spans(resolved), _figures(case, resolved, weights or {})
        self._plant: Plant | None = None
        self._run: Steps[Trace] | None = None
        self.trace: Trace | None = None
        # What can be known of the loop is told by one that is begun.
        self._begin(case)
        loop = self._agent.loop
        self._observation = Observation(loop, self._horizon)
        seen = self._observation.variables
        self.observation_names, self.observation_units = names(seen), tuple(v.unit for v in seen)
        self.action_names, self.action_units = names(loop.inputs), tuple(v.unit for v in loop.inputs)
        low, high = loop.bounds.u_min, loop.bounds.u_max
        if faults := [
            f"bounds of {v.name}: it has no finite limits, which an action needs; give it both in `bounds`"
            for v, ends in zip(loop.inputs, np.isfinite(low) & np.isfinite(high), strict=True)
            if not ends
        ]:
            self.close()
            raise ConfigError(faults)
        self._shape = low.shape
        self.action_space = spaces.Box(low, high, dtype=np.float64)
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(seen),), np.float64)
        self._end_run()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            That of the case whose noise, parameters and conditions it has; default: one that is drawn.
        options : dict, optional
            ``{"state": saved}``: the plant goes on from a state that :meth:`save_state` has returned, at its
            sample and until the problem's end. Actuators, sensors and noise begin anew.

        Returns
        -------
        observation : array, shape (n,)
            The first one.
        info : dict
            ``time`` [s] and ``seed``.

        Raises
        ------
        ConfigError
            An unknown option, or the plant cannot go on from the state.
        CosimError
            The plant cannot be initialised.
        """
        super().reset(seed=seed)
        case_seed = int(self.np_random.integers(_LARGEST_SEED)) if seed is None else seed
        case = with_seed(self._case, self._resolved, case_seed)
        if not isinstance(options, Mapping | None):
            raise ConfigError(f"options = {options!r}; needed: a dict, such as {{'state': saved}}")
        unknown = [name for name in options or {} if name != "state"]
        if unknown:
            hints = [f'options: "{name}" is unknown; {did_you_mean(name, ["state"])}' for name in unknown]
            raise ConfigError(hints)
        if options and options.get("state") is not None:
            case = _going_on(case, options["state"])
        self._end_run()
        sample = self._begin(case)
        return self._observation.of(sample), {"time": sample.time, "seed": case_seed}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Hold inputs until the next sample.

        Parameters
        ----------
        action : array, shape (m,)
            The inputs, in their units.

        Returns
        -------
        observation : array, shape (n,)
            At the next sample; where there is none, the last one again.
        reward : float
            Minus what the sample has cost.
        terminated : bool
            A fault of the plant, or an action that is not finite, has ended the episode, or the plant itself.
        truncated : bool
            It has reached the end of the problem.
        info : dict
            ``time`` [s]; at the end ``outcome``, as in ``metrics.csv``, and ``reason``.

        Raises
        ------
        ConfigError
            There is no episode, or the action has another shape.
        """
        run, k = self._run, self._k
        if run is None:
            raise ConfigError("there is no episode: call reset() first")
        action = np.asarray(action)
        if action.shape != self._shape:
            shape = f"shape {action.shape}; needed: {self._shape}"
            raise ConfigError(f"action: {shape}: {', '.join(self.action_names)}")
        try:
            question = self._question = self._answer(run, action)
        except StopIteration as end:
            return self._failed(end.value)
        self._k, sample = k + 1, question[1]
        info: dict[str, Any] = {"time": sample.time}
        if is_last := self._k == self._costs.samples:
            try:  # the last sample of a run is answered too, which acts no more
                self._answer(run, action)
            except StopIteration as end:
                info |= self._keep(end.value)
        return self._observation.of(sample), -self._costs.of(k), False, is_last, info

    def _answer(self, run: Steps[Trace], action: FloatArray) -> Question:
        """Let the run go on with an action and return what it asks next, as :func:`master.answer` does."""
        self._agent.action = action
        try:
            decision = decision_of(self._agent, self._agent.step(self._question[1]), 0.0, len(action))
        except ControllerError as error:
            return run.throw(error)
        return run.send(decision)

    def _failed(self, trace: Trace) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Return what a step returns that a fault has ended, or the plant."""
        sample = self._question[1]
        reward = -self._costs.until_end(self._k, trace.held)
        info = {"time": sample.time, **self._keep(trace)}
        self._close_plant()  # it may be anywhere
        return self._observation.of(sample), reward, True, False, info

    def _keep(self, trace: Trace) -> dict[str, str]:
        """Keep the trace of an episode that has ended and return how it did."""
        self._run, self.trace = None, trace
        return {"outcome": str(trace.outcome), "reason": trace.reason}

    def save_state(self) -> SavedState:
        """Return where the episode is now, for ``reset(options={"state": ...})`` of this problem.

        Raises
        ------
        ConfigError
            There is no episode, the plant cannot save its state, or the problem goes on from its experiment.
        FMUStepError
            The plant failed.
        """
        case = self._begun
        if self._run is None or self._plant is None:
            raise ConfigError("there is no episode: call reset() first")
        if case.continue_recording:
            raise ConfigError('loop.start is "recording-end": an episode cannot begin anywhere else')
        state = serialise_plant(self._plant, self._question[1].time)
        before = case.resumed or Resumption(b"", case.start_time - case.warm_up, changed={})
        resumption = before._replace(state=state, samples=before.samples + self._k)
        return SavedState(resumption, case.parameters)

    def render(self) -> None:
        """Show nothing: :attr:`trace` has a figure of an episode that has ended."""

    def close(self) -> None:
        """Close the plant."""
        self._end_run()
        self._close_plant()

    def _begin(self, case: Case) -> Sample:
        """Begin an episode and return its first sample."""
        self._end_run()
        if not (case.plant.is_fmu or case.plant.coupled):  # what others write is made anew for each run
            self._close_plant()
        self._agent, self._k, self._begun = Agent(self._horizon), 0, case
        try:
            self._plant = self._plant or open_plant(case)
            store = row_store(case)
            run = stepwise(case, self._plant, self._agent, store)
            self._question = next(run)
        except StopIteration as end:
            self._close_plant()
            raise CosimError(f"{case.plant.label}: {end.value.outcome}: {end.value.reason}") from None
        except BaseException:
            self._close_plant()
            raise
        sample = self._question[1]
        self._run, self._costs = run, _Costs(case, self.figures, self._spans, store, sample)
        return sample

    def _end_run(self) -> None:
        """Leave an episode."""
        run, self._run = self._run, None
        if run is not None:
            run.close()

    def _close_plant(self) -> None:
        plant, self._plant = self._plant, None
        if plant is not None:
            with suppress(CosimError):  # what it has done counts, and not how it ends
                close_plant(plant)


class Agent(Controller):
    """Stands for whoever acts in the environment.

    Parameters
    ----------
    horizon : int
        How many samples ahead are observed.
    """

    def __init__(self, horizon: int) -> None:
        self.horizon = horizon
        self.action: FloatArray = np.empty(0)

    def start(self, loop: Loop) -> None:
        """Keep what is known of the loop."""
        self.loop = loop

    def step(self, sample: Sample) -> FloatArray:
        """Return the action, which has been chosen at this sample, shape (m,)."""
        return self.action


def _going_on(case: Case, state: Any) -> Case:
    """Return a case whose plant goes on from a state until the case's end."""
    if not isinstance(state, SavedState):
        raise ConfigError(f"options: state = {state!r}; needed: what save_state() has returned")
    all_samples = round(case.duration / case.sampling_time)
    samples = all_samples - state.resumption.samples
    if samples < 1:
        end = f"an episode of this problem ends at sample {all_samples}"
        raise ConfigError(f"options: state: it is of sample {state.resumption.samples}; {end}")
    return replace(
        without_experiment(case),
        parameters=state.parameters,
        resumed=state.resumption,
        duration=samples * case.sampling_time,
        warm_up=0.0,
        warm_up_controller=None,
    )


def _horizon_of(case: Case, resolved: ResolvedStudy, horizon: int | None) -> int:
    """Return how many samples ahead are observed: as asked for, or by default."""
    if horizon is None:
        return resolved.forecast_horizon
    most = round(case.duration / case.sampling_time)
    if not isinstance(horizon, Integral) or isinstance(horizon, bool) or not 0 <= horizon <= most:
        needed = f"allowed: an integer from 0 to {most}, the samples of an episode"
        raise ConfigError(f"horizon = {horizon!r} is not possible; {needed}")
    return int(horizon)


def _figures(case: Case, resolved: ResolvedStudy, weights: Mapping[str, float]) -> dict[str, float]:
    """Return what a study ranks by, by key, and what a unit of each counts."""
    known = no_samples(case, Outcome.TERMINATED, "").metrics(case.metrics)
    ranked = headline(known, resolved.study.metrics.ranking)
    spans = reference_spans(resolved)
    errors = [key for key in ranked if split_key(key)[0] == "mean_abs_error"]
    in_spans = len(errors) == len(ranked) > 1
    figures = {key: 1.0 / abs(spans[split_key(key)[1]]) / len(ranked) if in_spans else 1.0 for key in ranked}
    if not isinstance(weights, Mapping):
        raise ConfigError(f"weights = {weights!r}; needed: numbers by metric, such as {{'money': 2.0}}")
    faults = list[str]()
    for name, weight in weights.items():
        if not isinstance(weight, Real) or isinstance(weight, bool) or not np.isfinite(weight):
            faults.append(f"weights: {name} = {weight!r} is not possible; allowed: a finite number")
            continue
        try:
            figures |= dict.fromkeys(keys_named(name, ranked), float(weight))
        except ConfigError as error:
            faults += [f"weights: {fault}" for fault in error.faults]
    if faults:
        raise ConfigError(faults)
    return figures


class _Costs:
    """What samples of an episode cost.

    Parameters
    ----------
    case : Case
        Its case.
    figures : mapping of str to float
        What is ranked by, by key, and what a unit of each counts.
    spans : mapping of str to float
        By how much each reference moves, in display units.
    store : RowStore
        Its rows.
    sample : Sample
        The first one.

    Attributes
    ----------
    samples : int
        n, how many there are.
    """

    def __init__(
        self,
        case: Case,
        figures: Mapping[str, float],
        spans: Mapping[str, float],
        store: RowStore,
        sample: Sample,
    ) -> None:
        self._store, self.samples = store, len(store.y) - 1
        weights = {split_key(key)[:2]: weight for key, weight in figures.items()}
        per_sample = {"mean_abs_error": 1.0 / self.samples, "band_violation": case.sampling_time / _HOUR}
        errors = np.zeros(len(case.outputs))
        sizes = np.empty(len(case.outputs))
        for i, variable in enumerate(case.outputs):
            factor = abs(variable.shown_in.factor)
            sizes[i] = abs(spans[variable.name]) / factor
            for name, share in per_sample.items():
                errors[i] += weights.get((name, variable.name), 0.0) * share * factor
        self._money = weights.get(("money", ""), 0.0)
        trace = no_samples(case, Outcome.COMPLETED, "")
        self._steps, between = trace.substeps, names(trace.intersample_signals)
        held = names((*trace.inputs, *trace.changed_inputs))
        self._charges = [
            (i, charge.rate * trace.sampling_time, charge.signal in held, _columns_of(charge.signal, between))
            for i, charge in enumerate(trace.charges)
        ]
        self._squares = weights.get(("cost", ""), 0.0)
        if self._squares:
            self._rest = np.array(
                [
                    Actuation(variable, np.empty(0), (float(low), float(high)), case.sampling_time).rest
                    for variable, (low, high) in zip(case.inputs, sample.input_limits[0], strict=True)
                ]
            )
            kinds = (("outputs", case.outputs), ("inputs", case.inputs), ("changes", case.inputs))
            self._of_squares = [
                np.array([case.metrics.cost.get(kind, {}).get(name, 0.0) for name in names(variables)])
                for kind, variables in kinds
            ]
        self._worst = float(errors @ sizes)
        self._of_errors = [(i, weight) for i, weight in enumerate(errors.tolist()) if weight]
        self._wanted, self._is = store.reference.item, store.y.item
        if self._charges:
            self._price, self._charged = store.more["price"].item, store.more["charged"].item
        if self._squares:
            self._worst += self._squares * float(self._of_squares[0] @ sizes**2)

    def of(self, k: int) -> float:
        """Return what sample k costs, whose inputs have been held."""
        store, cost = self._store, 0.0
        for i, weight in self._of_errors:
            cost += abs(self._wanted(k, i) - self._is(k, i)) * weight
        if self._squares:
            error = store.reference[k] - store.y[k]
            u = store.u[k] - self._rest
            changes = store.u[k] - (store.u[k - 1] if k else self._rest)
            squared = zip(self._of_squares, (error, u, changes), strict=True)
            with np.errstate(over="ignore"):  # a run that diverges has values of any size
                cost += self._squares * sum(float(weights @ values**2) for weights, values in squared)
        if self._money:
            cost += self._money * self._paid(k)
        if cost > self._worst:
            self._worst = cost
        return cost

    def until_end(self, k: int, held: int) -> float:
        """Return what sample k costs, where its inputs were held, and all that are missing after it."""
        cost = self.of(k) if k < held else 0.0
        return cost + (self.samples - held) * self._worst

    def _paid(self, k: int) -> float:
        """Return what is paid from sample k to the next one, as the trace's metric has it."""
        paid, charged = 0.0, self._charged
        for i, amount, is_held, between in self._charges:
            mean = charged(k, i)
            if not is_held:
                end = charged(k + 1, i)  # NaN where a fault has ended the interval
                if self._steps == 1 and not math.isnan(mean + end):
                    mean = (mean + end) / 2.0
                else:
                    inner = [] if between is None else self._store.more["intersample"][k, between].tolist()
                    mean = self._mean([mean, *inner, end])
            paid += self._price(k, i) * amount * mean
        return paid

    def _mean(self, values: list[float]) -> float:
        """Return the mean of straight lines between values at communication steps, of which some are missing.

        Where a fault has ended the interval the last one stays.
        """
        if math.isnan(sum(values)):
            values = [value for value in values if not math.isnan(value)]
        values += [values[-1]] * (self._steps + 1 - len(values))
        return (sum(values) - (values[0] + values[-1]) / 2.0) / self._steps


def _columns_of(signal: str, between: Sequence[str]) -> slice | None:
    """Return where a signal stands in rows of what is read between samples; None: it is not."""
    return slice(between.index(signal), None, len(between)) if signal in between else None


def _register() -> None:
    """Register the problems of the benchmark."""
    for problem in Study.read("benchmark").problems:
        name = f"ddpc_cosim/{problem}-v{VERSION}"
        if name not in gymnasium.registry:
            kwargs = {"study": "benchmark", "problem": problem}
            gymnasium.register(name, entry_point="ddpc_cosim.gymnasium:make", kwargs=kwargs)


_register()
