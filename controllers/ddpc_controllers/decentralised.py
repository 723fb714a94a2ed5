"""Decentralised control: one controller for every group of inputs and outputs, on its part of the loop."""

from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ddpc_controllers.export.code import Code, inner_step
from ddpc_controllers.wrapper import Inner, Wrapper, controller_faults, joined, joined_prior_info
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    Controller,
    Loop,
    Recording,
    Sample,
    Variable,
    check_settings,
    setting,
)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Inputs and outputs that belong together, and what controls them."""

    inputs: Sequence[str] = setting(doc="names of the inputs")
    outputs: Sequence[str] = setting(doc="names of the controlled outputs")
    measurements: Sequence[str] = setting((), doc="names of what is measured for this group; empty: all")
    controller: Controller = setting(doc="the group's controller")

    def __post_init__(self) -> None:
        check_settings(self)
        if faults := controller_faults("Group", controller=self.controller):
            raise ConfigError(faults)

    @property
    def name(self) -> str:
        """The group's name in statuses and values: its outputs."""
        return "+".join(self.outputs)


@dataclass(kw_only=True)
class Decentralised(Wrapper):
    """One controller per group of inputs and outputs."""

    _known_in_c: ClassVar[Collection[str]] = ()

    groups: Sequence[Group] = setting(
        kind=Group, doc="the groups: every input and every output is in exactly one"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.horizon = max(group.controller.horizon for group in self.groups)

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the longest that one of the controllers needs."""
        return max(
            group.controller.recording_length(
                len(group.inputs), len(group.outputs), len(group.measurements) or measurements, disturbances
            )
            for group in self.groups
        )

    def start(self, loop: Loop) -> None:
        """Start every controller on its part of the loop.

        Raises
        ------
        ConfigError
            An input or an output of the loop is not in exactly one group.
        CosimError
            A controller does not start on its part.
        """
        self._shares = _share_out(self.groups, loop)
        self._inputs = len(loop.inputs)
        self._running = [Inner(group.controller, group.name) for group in self.groups]
        for inner, share in zip(self._running, self._shares, strict=True):
            inner.start(_part_of(loop, share))

    def step(self, sample: Sample) -> Action:
        """Return the inputs of all controllers, with the fallbacks and values of each."""
        actions = [
            inner.step(
                sample._replace(
                    y=sample.y[share.outputs],
                    measured=sample.measured[share.measurements],
                    reference=sample.reference[: inner.controller.horizon, share.outputs],
                    setpoint=sample.setpoint[share.outputs],
                    **share.further(sample, inner.controller.horizon),
                )
            )
            for inner, share in zip(self._running, self._shares, strict=True)
        ]
        u = np.empty(self._inputs)
        for action, share in zip(actions, self._shares, strict=True):
            u[share.inputs] = action.u
        return joined(u, actions)

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add every controller, with its part of the loop."""
        code.kernel("parts")
        body = ""
        for inner, share in zip(self._running, self._shares, strict=True):
            p, q, m = len(share.outputs), len(share.measurements), len(share.inputs)
            horizon = inner.controller.horizon
            step = inner_step(inner.controller, code, _part_of(loop, share))
            group = code.constant(
                "Group",
                p=p,
                q=q,
                m=m,
                outputs=len(loop.outputs),
                horizon=horizon,
                of_outputs=code.sizes(share.outputs),
                of_measurements=code.sizes(share.measurements),
                of_inputs=code.sizes(share.inputs),
            )
            seen, inputs = code.memory(np.zeros(2 * p + q + horizon * p + m)), code.memory(np.zeros(m))
            body += (
                f"const Sample of_{group} = sample_of_group(&{group}, sample, {seen});\n"
                f"{step}(memory, &of_{group}, {inputs}, told);\n"
                f"place_inputs(&{group}, {inputs}, u);\n"
            )
        return code.step(body)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        parts = zip(self.groups, self._running, self._shares, strict=True)
        return joined_prior_info(
            {group.name: inner.controller.knowledge(_part_of(loop, share)) for group, inner, share in parts}
        )

    @property
    def _held(self) -> Sequence[Controller]:
        return [group.controller for group in self.groups]

    def _faults_between_settings(self) -> list[str]:
        if not self.groups:
            return ["Decentralised: groups is empty"]
        return [
            f"Decentralised: groups[{i}] = {group!r} is not a group; an example is "
            'Group(inputs=["u"], outputs=["y"], controller=PID())'
            for i, group in enumerate(self.groups)
            if not isinstance(group, Group)
        ]


class _Share(NamedTuple):
    """Positions of a group's signals in the loop."""

    inputs: list[int]
    outputs: list[int]
    measurements: list[int]

    def further(self, sample: Sample, horizon: int) -> dict[str, Any]:
        """Return what else a sample says to the group, as far as it says it at all."""
        fields: dict[str, tuple[int | slice | list[int], ...]] = {
            "forecast": (slice(horizon),),
            "band_now": (self.outputs,),
            "band": (slice(horizon), self.outputs),
            "price": (slice(horizon + 1),),
            "input_limits": (slice(horizon + 1), self.inputs),
            "output_limits": (slice(horizon), self.outputs),
        }
        said = {name: getattr(sample, name) for name in fields}
        return {name: values[fields[name]] for name, values in said.items() if values.size}


def _share_out(groups: Sequence[Group], loop: Loop) -> list[_Share]:
    faults: list[str] = []

    def places(kind: str, variables: tuple[Variable, ...], names: Sequence[str]) -> list[int]:
        known = [variable.name for variable in variables]
        faults.extend(
            f'Decentralised: no {kind} "{name}"; the loop has {", ".join(known)}'
            for name in names
            if name not in known
        )
        return [known.index(name) for name in names if name in known]

    shares = [
        _Share(
            places("input", loop.inputs, group.inputs),
            places("output", loop.outputs, group.outputs),
            places("measurement", loop.measurements, group.measurements)
            or list(range(len(loop.measurements))),
        )
        for group in groups
    ]
    for kind, variables, taken in (
        ("input", loop.inputs, [i for share in shares for i in share.inputs]),
        ("output", loop.outputs, [i for share in shares for i in share.outputs]),
    ):
        faults.extend(
            f'Decentralised: {kind} "{variable.name}" is in {taken.count(i)} groups; needed: one'
            for i, variable in enumerate(variables)
            if taken.count(i) != 1
        )
    if faults:
        raise ConfigError(faults)
    return shares


def _part_of(loop: Loop, share: _Share) -> Loop:
    bounds = loop.bounds
    inputs, outputs = (
        tuple(loop.inputs[i] for i in share.inputs),
        tuple(loop.outputs[i] for i in share.outputs),
    )
    names = {variable.name for variable in (*inputs, *outputs)}
    return replace(
        loop,
        inputs=inputs,
        outputs=outputs,
        bands=tuple(name for name in loop.bands if name in names),
        moving_limits=tuple(name for name in loop.moving_limits if name in names),
        measurements=tuple(loop.measurements[i] for i in share.measurements),
        bounds=Bounds(
            bounds.u_min[share.inputs],
            bounds.u_max[share.inputs],
            bounds.y_min[share.outputs],
            bounds.y_max[share.outputs],
        ),
        recording=_part_of_recording(loop.recording, share),
        past=_part_of_recording(loop.past, share),
        rng=deepcopy(loop.rng),  # each controller draws as if it were alone
    )


def _part_of_recording(recording: Recording | None, share: _Share) -> Recording | None:
    return recording and replace(
        recording,
        u=recording.u[:, share.inputs],
        y=recording.y[:, share.outputs],
        measured=recording.measured[:, share.measurements],
    )
