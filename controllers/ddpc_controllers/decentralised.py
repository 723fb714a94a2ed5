"""Decentralised control: one controller for every group of inputs and outputs, none knowing of the others."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ddpc_controllers.checks import check_settings_and
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    Controller,
    FloatArray,
    Loop,
    Recording,
    Sample,
    Variable,
    check_settings,
    setting,
)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Inputs and outputs that belong together, and who controls them."""

    inputs: Sequence[str] = setting(doc="names of the inputs")
    outputs: Sequence[str] = setting(doc="names of the controlled outputs")
    measurements: Sequence[str] = setting((), doc="names of what is measured for this group; empty: all")
    controller: Controller = setting(doc="the group's controller")

    def __post_init__(self) -> None:
        check_settings(self)
        if not isinstance(self.controller, Controller):
            raise ConfigError(f"Group: controller = {self.controller!r} is no controller")

    @property
    def name(self) -> str:
        """The group's name in statuses and figures: its outputs."""
        return "+".join(self.outputs)


@dataclass(kw_only=True)
class Decentralised(Controller):
    """One controller per group of inputs and outputs."""

    groups: Sequence[Group] = setting(
        kind=Group, doc="the groups: every input and every output is in exactly one"
    )

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)
        self.horizon = max(group.controller.horizon for group in self.groups)

    @property
    def uses_recording(self) -> bool:
        """Whether one of the controllers needs a recording."""
        return any(group.controller.uses_recording for group in self.groups)

    @property
    def accepts_missing(self) -> bool:
        """Whether every one of the controllers goes on when a measurement is lost."""
        return all(group.controller.accepts_missing for group in self.groups)

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the longest that one of the controllers needs."""
        return max(
            group.controller.recording_length(
                len(group.inputs), len(group.outputs), len(group.measurements) or measurements
            )
            for group in self.groups
        )

    def start(self, loop: Loop) -> None:
        """Start every controller on its part of the loop.

        Raises
        ------
        ConfigError
            The groups do not share out the loop's inputs and outputs.
        CosimError
            A controller does not start on its part.
        """
        self._shares = _share_out(self.groups, loop)
        self._inputs = len(loop.inputs)
        # Copies: groups may have been given one and the same controller.
        self._controllers = [copy.deepcopy(group.controller) for group in self.groups]
        for controller, share in zip(self._controllers, self._shares, strict=True):
            controller.start(_part_of(loop, share))

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs of all controllers, with the faults and figures of each."""
        u = np.empty(self._inputs)
        faults, info = [], {}
        for group, controller, share in zip(self.groups, self._controllers, self._shares, strict=True):
            answer = controller.step(
                sample._replace(
                    y=sample.y[share.outputs],
                    measured=sample.measured[share.measurements],
                    reference=sample.reference[: controller.horizon, share.outputs],
                )
            )
            action = answer if isinstance(answer, Action) else Action(answer)
            u[share.inputs] = action.u
            if action.status != Action(action.u).status:
                faults.append(f"{group.name}: {action.status}")
            info.update({f"{group.name}.{name}": value for name, value in action.info.items()})
        if faults:
            return Action(u, "; ".join(faults), info)
        return Action(u, info=info) if info else u

    def diagnostics(self) -> Mapping[str, float]:
        """Return the figures of all controllers, by group."""
        return {
            f"{group.name}.{name}": value
            for group, controller in zip(self.groups, self._controllers, strict=True)
            for name, value in controller.diagnostics().items()
        }

    def _faults_between_settings(self) -> list[str]:
        if not self.groups:
            return ["Decentralised: groups is empty"]
        return [
            f"Decentralised: groups[{i}] = {group!r} is no group; an example is "
            'Group(inputs=["u"], outputs=["y"], controller=PID())'
            for i, group in enumerate(self.groups)
            if not isinstance(group, Group)
        ]


class _Share(NamedTuple):
    """Positions of a group's signals in the loop."""

    inputs: list[int]
    outputs: list[int]
    measurements: list[int]


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
    recording, bounds = loop.recording, loop.bounds
    return replace(
        loop,
        inputs=tuple(loop.inputs[i] for i in share.inputs),
        outputs=tuple(loop.outputs[i] for i in share.outputs),
        measurements=tuple(loop.measurements[i] for i in share.measurements),
        bounds=Bounds(
            bounds.u_min[share.inputs],
            bounds.u_max[share.inputs],
            bounds.y_min[share.outputs],
            bounds.y_max[share.outputs],
        ),
        recording=recording
        and Recording(
            recording.u[:, share.inputs],
            recording.y[:, share.outputs],
            recording.measured[:, share.measurements],
            recording.sampling_time,
        ),
        rng=copy.deepcopy(loop.rng),  # each controller draws as if it were alone
    )
