"""From the controller sections of a study to controllers: sweeps written out, each one built once."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ddpc_cosim.codec import (
    InvalidFieldError,
    ValidationErrors,
    in_folder,
    independent,
    plant_in_folder,
)
from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ControllerError, MissingLibraryError, Place, PluginError
from ddpc_cosim.loop.safe_calls import (
    DEFAULT_STEP_TIMEOUT,
    CallsInTime,
    controller_settings,
    horizon_of,
    learns_from_recording,
)
from ddpc_cosim.settings import (
    PLANT,
    SettingsError,
    is_plain,
    map_files,
    map_plants,
)
from ddpc_cosim.study.controller_plugins import controller_class, make_controller
from ddpc_cosim.study.file_format.sections import (
    ControllerSection,
    StabiliserSection,
    Study,
)
from ddpc_cosim.study.file_format.sweeps import combinations, variant_label, variant_name
from fmu_plants.files import is_file


class StudyController(NamedTuple):
    """A controller of a study: a section of the file, or one combination of the values of its sweeps.

    Parameters
    ----------
    name : str
        Its name in the study.
    of : str
        Name of the section.
    varied : dict
        The settings from a sweep; empty for the section itself.
    place : Place
        Where its settings stand in the file.
    settings : dict
        Its settings in plain values, every default filled in, paths absolute.
    controller : Controller or None
        To be asked what it needs; where it runs, another one is built. None if it has errors, is late,
        or lacks a package.
    uses_recording : bool
        Whether it learns from a recording.
    horizon : int
        How many future references it wants.
    late : str
        Which of its calls has not returned in time; empty: none.
    lacking : str
        What it needs that is not installed, and how it is; empty: nothing.
    """

    name: str
    of: str
    varied: dict[str, Any]
    place: Place
    settings: dict[str, Any]
    controller: Controller | None = None
    uses_recording: bool = False
    horizon: int = 0
    late: str = ""
    lacking: str = ""

    def section(self, section: ControllerSection) -> ControllerSection:
        """Return its section in a study without sweeps, with all its settings."""
        changes: dict[str, Any] = {"settings": self.settings, "label": section.label or self.of, "sweep": []}
        if self.varied:
            changes["label"] = variant_label(changes["label"], self.varied)
            changes |= {"variant_of": self.of, "varied": list(self.varied), "tuned": None}
        return replace(section, **changes)


@independent
def resolve_controllers(
    study: Study, folder: Path, errors: ValidationErrors, in_time: CallsInTime, late: dict[str, str]
) -> list[StudyController]:
    """Return the controllers of a study; paths among their settings are relative to a folder.

    ``late`` holds, by type, the call that timed out; timed-out controllers found here are added.
    """
    controllers: list[StudyController] = []
    taken = set(study.controllers)
    for of, section in study.controllers.items():
        place: Place = ("controllers", of)
        for name, varied, sweep in _variants(of, section, with_sweeps=(*place, "sweep") not in errors.found):
            if varied and name in taken:
                errors.add((*place, "sweep"), f'two controllers are called "{name}"; change a value')
            taken.add(name)
            named = StudyController(name, of, varied, (*place, "settings"), {**section.settings, **varied})
            controllers.append(_build(named, section, folder, errors, in_time, late, sweep) or named)
    return controllers


@independent
def resolve_stabiliser(
    study: Study, folder: Path, errors: ValidationErrors, in_time: CallsInTime
) -> StudyController | None:
    """Return the controller that keeps the plant while it is recorded, if there is one."""
    section = study.recording.controller if study.recording is not None else None
    return _built_alone(("recording", "controller"), section, folder, errors, in_time)


@independent
def resolve_warm_up(
    study: Study, folder: Path, errors: ValidationErrors, in_time: CallsInTime
) -> StudyController | None:
    """Return the controller of the plant before the first sample, if there is one."""
    section = study.loop.warm_up_controller
    return _built_alone(("loop", "warm_up_controller"), section, folder, errors, in_time)


def _built_alone(
    place: Place,
    section: StabiliserSection | None,
    folder: Path,
    errors: ValidationErrors,
    in_time: CallsInTime,
) -> StudyController | None:
    """Return a controller of which no result is reported, and which has to control without a recording."""
    if section is None:
        return None
    named = StudyController("", "", {}, (*place, "settings"), section.settings)
    built = _build(named, section, folder, errors, in_time, {}) or named
    if built.uses_recording:
        errors.add(place, "learns from a recording itself; needed: one that controls without")
    if built.lacking:
        errors.add(place, built.lacking)
    if built.late:
        errors.add(place, late_call(section.type, built.late, in_time.seconds))
    return built


def time_limit(study: Study) -> float:
    """Return the longest time for any call of a controller [s], also where the loop has errors."""
    try:
        return study.loop.step_timeout
    except InvalidFieldError:
        return DEFAULT_STEP_TIMEOUT


def late_call(kind: str, call: str, seconds: float) -> str:
    """Return what is wrong with a controller one of whose calls has not returned within so many seconds."""
    hint = "raise loop.step_timeout if it needs longer"
    return f"controller {kind}: no return within {seconds:g} s in {call} when the study was read; {hint}"


def _variants(
    name: str, section: ControllerSection, *, with_sweeps: bool
) -> Iterator[tuple[str, dict[str, Any], Place]]:
    """Yield the name of a section, then each variant's (``deepc-lambda_g-5``), what it varies, and where."""
    yield name, {}, ()
    variants = (
        (("controllers", name, "sweep", i), varied)
        for i, table in enumerate(section.sweep if with_sweeps else ())
        for varied in combinations(table)
    )
    for number, (place, varied) in enumerate(variants, start=1):
        yield variant_name(name, varied, number), varied, place


@independent
def _build(
    named: StudyController,
    section: ControllerSection | StabiliserSection,
    folder: Path,
    errors: ValidationErrors,
    in_time: CallsInTime,
    late: dict[str, str],
    sweep: Place = (),
) -> StudyController | None:
    """Return a controller with all its settings and what it needs; None if it has errors, which are reported.

    ``late`` holds, by type, the call that has not returned in time: others would not either.
    """
    place, varied, given, doing = named.place[:-1], named.varied, named.settings, "constructor"

    def absolute(path: str) -> str:
        if path == PLANT:
            return path
        file = in_folder(folder, path)
        if not is_file(file):
            errors.add((*place, "settings"), f"{file}: no such file")
        return str(file)

    def asked() -> tuple[Controller, dict[str, Any], bool, int]:
        nonlocal doing
        controller = make_controller(section.type, given)
        doing = "settings"
        settings = controller_settings(controller)
        doing = "uses_recording"
        uses_recording = learns_from_recording(controller)
        doing = "horizon"
        return controller, settings, uses_recording, horizon_of(controller)

    try:
        kind = controller_class(section.type)  # here: not every module can be imported in another thread
        with suppress(PluginError):  # of a class among the settings: making it tells where
            given = map_files(kind, given, absolute)
            given = map_plants(kind, given, lambda name: plant_in_folder(folder, name))
        if section.type in late:
            return named._replace(settings=given, late=late[section.type])
        controller, settings, uses_recording, horizon = in_time(asked)
        # What a file cannot say is a default, or what the controller has made of what the file says.
        plain_settings = {name: value for name, value in settings.items() if is_plain(value)}
        return named._replace(
            settings=map_files(kind, given | plain_settings, absolute),
            controller=controller,
            uses_recording=uses_recording,
            horizon=horizon,
        )
    except TimeoutError:
        late[section.type] = doing
        return named._replace(settings=given, late=doing)
    except MissingLibraryError as error:
        return named._replace(settings=given, lacking=str(error))
    except SettingsError as error:
        for setting, fault in error.found:
            at = (*place, "settings", *setting)
            # What concerns several settings at once is the sweep's, unless the section itself has it.
            in_sweep = (
                setting[0] in varied if setting else bool(varied) and fault not in errors.found.get(at, ())
            )
            errors.add((*sweep, *setting) if in_sweep else at, fault)
    except PluginError as error:
        errors.add((*place, "type"), str(error))
    except ControllerError as error:
        errors.add(place, str(error))
    return None
