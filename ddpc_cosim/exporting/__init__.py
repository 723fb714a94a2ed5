"""A started controller as an FMU for Co-Simulation, in plain C, which needs no Python."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.controller import Controller, Loop
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.loop.safe_calls import controller_code, controller_settings, horizon_of, learns_from_recording
from ddpc_cosim.observation import Observation
from ddpc_cosim.study.case_files import sealed_json
from ddpc_cosim.study.running.provenance import versions
from ddpc_cosim.variables import Variable, names
from fmu_plants.export import Progress, export_block
from fmu_plants.export.sampled_block import SampledBlock
from fmu_plants.model import ExportError, ExportUsageError, identifier

_RESOURCE = "controller.json"


def export_controller(
    controller: Controller,
    loop: Loop,
    path: str | Path,
    fmi_version: str = "2.0",
    *,
    platforms: str | Sequence[str] | None = None,
    facts: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a started controller as a standalone FMU for Co-Simulation, which needs no Python.

    It is a sampled block. Its inputs are called as the measured signals (controlled outputs, then the other
    measurements; NaN where one is missing), ``setpoint.NAME`` for the reference now and ``reference.NAME[k]``
    for that in k samples, and what :func:`further_signals` names; its outputs as the plant's inputs, then
    ``status`` (0, or a sum of the numbers that
    ``resources/controller.json`` explains), ``iterations`` and ``active_bounds``. Of two signals of one name,
    the later one has its kind before it: ``measurement.``, ``reference.``, ``input.`` or ``controller.``.
    Where ``active`` is 0 it follows the plant that the inputs ``applied.NAME`` drive, as if it had been
    started with what it saw as :attr:`Loop.past` when it becomes active again.
    ``sources/`` has the C code, ``controller.h`` included, for other uses than an FMU's.

    Parameters
    ----------
    controller : Controller
        The controller, after its ``start``.
    loop : Loop
        The loop it was started with.
    path : str or Path
        The file to write; an existing one is replaced. Its folder must exist. The FMU is named after it.
    fmi_version : str
        ``"2.0"`` or ``"3.0"``.
    platforms : str or sequence of str, optional
        As of :func:`fmu_plants.export_fmu`; default: this one.
    facts : mapping of str to Any, optional
        What else ``resources/controller.json`` is to say of where the controller comes from.
    progress : callable, optional
        Is told in words how far a build for several platforms is.

    Returns
    -------
    path : Path
        The file.

    Raises
    ------
    ConfigError
        The controller cannot be exported, and why; there is no such version or platform, or the file cannot
        be written.
    CosimError
        There is no compiler, or it fails.

    Examples
    --------
    >>> import numpy as np
    >>> from ddpc_controllers import PID
    >>> from ddpc_cosim import Bounds, Loop, Variable
    >>> limits = Bounds(*(np.array([one]) for one in (-3.5, 3.5, -np.inf, np.inf)))
    >>> angle, torque = Variable("angle", "rad"), Variable("torque", "N.m")
    >>> loop = Loop(0.1, (torque,), (angle,), (angle,), limits, None, np.random.default_rng(0))
    >>> pid = PID(proportional=2.0)
    >>> pid.start(loop)
    >>> export_controller(pid, loop, "pid.fmu").name
    'pid.fmu'
    """
    return write_block(
        block_of(controller, loop, Path(path).stem, facts or {}), path, fmi_version, platforms, progress
    )


def block_of(
    controller: Controller,
    loop: Loop,
    name: str,
    facts: Mapping[str, Any],
    resources: Mapping[str, str] | None = None,
) -> SampledBlock:
    """Return a started controller as a sampled block, with what it was made from.

    Parameters
    ----------
    controller, loop, facts
        As of :func:`export_controller`.
    name : str
        What it is called.
    resources : mapping of str to str
        Further files that go along, by name.
    """
    code = controller_code(controller, loop)
    bounds, recording = loop.bounds, loop.recording if learns_from_recording(controller) else None
    observation = Observation(loop, horizon_of(controller))
    controls = [
        _scalar(variable, min=float(low), max=float(high))
        for variable, low, high in zip(loop.inputs, bounds.u_min, bounds.u_max, strict=True)
    ]
    kind = type(controller)
    resource = {
        "name": name,
        **facts,
        "class": f"{kind.__module__}:{kind.__qualname__}",
        "settings": controller_settings(controller),
        "sampling_time": loop.sampling_time,
        "preview": min(loop.preview, horizon_of(controller)),
        "measurements": names(observation.measurements),
        "inputs": names(loop.inputs),
        "recording": recording and {"sha256": recording.digest, "samples": len(recording)},
        "status": {str(bit): text for bit, text in code.statuses.items()},
        "bytes": code.footprint and code.footprint._asdict(),
        "versions": {f"{name} version": version for name, version in versions().items()},
    }
    learned = f", from the recording {recording.digest[:16]}" if recording else ""
    where = "".join(
        f", {key} {facts[key]}"
        for key in ("study", "problem", "scenario", "seed")
        if facts.get(key) not in (None, "")
    )
    block = SampledBlock(
        identifier(name),
        f"{kind.__name__}{where}{learned}: sampled every {loop.sampling_time:g} s",
        loop.sampling_time,
        list(map(_scalar, observation.measurements)),
        [*map(_scalar, observation.references), *observation.further],
        controls,
        code.sources,
        follows=code.follows,
    )
    resource["hand_over"] = block.hand_over()
    return replace(block, resources={_RESOURCE: sealed_json(resource).decode(), **(resources or {})})


def write_block(
    block: SampledBlock,
    path: str | Path,
    fmi_version: str,
    platforms: str | Sequence[str] | None,
    progress: Progress | None,
) -> Path:
    """Write the FMU of a block; parameters and errors as of :func:`export_controller`."""
    try:
        return export_block(block, path, fmi_version, platforms=platforms, progress=progress)
    except ExportUsageError as error:
        raise ConfigError(str(error)) from error
    except ExportError as error:
        raise CosimError(str(error)) from error


def _scalar(variable: Variable, **changes: Any) -> Variable:
    """Return a signal as a variable of the FMU, which starts within its range."""
    changed = replace(variable, **changes)
    return replace(changed, start=float(np.clip(np.nan_to_num(changed.start), changed.min, changed.max)))
