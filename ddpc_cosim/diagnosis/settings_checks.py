"""What the contract demands of a controller's settings."""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from ddpc_cosim.conformance import CheckFailedError, NotApplicableError
from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import SettingInfo, declared_settings, from_plain

_UNKNOWN = "no_such_setting"


def stores_its_settings(controller: Controller) -> None:
    """Require that what ``settings`` returns makes an equal controller: a study file is all that is kept."""
    kind = type(controller)
    if not declared_settings(kind):
        raise NotApplicableError("it declares no settings")
    plain = controller.settings()
    undeclared = sorted(set(plain) - set(declared_settings(kind)))
    if undeclared:
        raise CheckFailedError(f"{', '.join(undeclared)} is not declared with ddpc_cosim.setting")
    given = {name: from_plain(kind, name, value) for name, value in plain.items() if value is not None}
    again = kind(**given).settings()
    changed = [name for name in plain if again.get(name) != plain[name]]
    if changed:
        what = f"{changed[0]} = {plain[changed[0]]!r} comes back as {again.get(changed[0])!r}"
        raise CheckFailedError(f"settings() does not make an equal controller: {what}")


def refuses_unknown_settings(controller: Controller) -> None:
    """Require an error for an argument that is no setting."""
    try:
        type(controller)(**_given(controller), **{_UNKNOWN: 1.0})
    except (TypeError, ConfigError):
        return
    raise CheckFailedError(f"the constructor accepts {_UNKNOWN} = 1.0; it has to raise TypeError")


def refuses_impossible_settings(controller: Controller) -> None:
    """Require a ConfigError that names the setting, for every value outside a declared range."""
    kind = type(controller)
    ranges = {name: info for name, info in declared_settings(kind).items() if list(_outside(info))}
    if not ranges:
        raise NotApplicableError("it declares no ranges")
    for name, info in ranges.items():
        for value in _outside(info):
            try:
                kind(**{**_given(controller), name: value})
            except ConfigError as error:
                if not any(name in fault for fault in error.faults):
                    raise CheckFailedError(f"the error for {name} = {value!r} does not name it") from error
            else:
                raise CheckFailedError(
                    f"{name} = {value!r} is accepted although only {info.allowed} is allowed; if the class "
                    "has a __post_init__, it has to call super().__post_init__()"
                )


def _given(controller: Controller) -> dict[str, Any]:
    if not is_dataclass(controller):
        return {}
    return {field.name: getattr(controller, field.name) for field in fields(controller) if field.init}


def _outside(info: SettingInfo) -> Iterator[Any]:
    """Yield values that a setting does not take."""
    if info.choices:
        yield "no such choice"
        return
    if math.isfinite(info.low):
        yield info.low - 1
    if math.isfinite(info.above):
        yield info.above
    if math.isfinite(info.high):
        yield info.high + 1
