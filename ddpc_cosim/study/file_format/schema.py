"""JSON Schema of study files, from what their classes declare: for editors.

It says what each field may be, not what stands between fields, and leaves the settings of a type open that is
not installed.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ddpc_cosim.codec import KIND, Kinds, Prepared, Rule, Size, declared_fields, kind_key
from ddpc_cosim.files.durations import DURATION_SCHEMA
from ddpc_cosim.plugins import installed
from ddpc_cosim.settings import SettingInfo, Weight, declared_settings
from ddpc_cosim.study.file_format.replacing import CONTROLLERS, EXTENDS, OF_PROBLEM, PROBLEMS, STUDY, SWEEP
from ddpc_cosim.study.file_format.sections import ControllerSection, Study

Schema = dict[str, Any]

_TYPES: dict[Any, str] = {bool: "boolean", int: "integer", float: "number", str: "string"}
_ANY = SettingInfo("")


def study_schema() -> Schema:
    """Return the JSON Schema of study files, with the plug-ins that are installed here."""
    schemas = _Schemas()
    flat, changes = (schemas.of_class(Study, partial=partial) for partial in (False, True))
    controllers = schemas.controllers()
    problem = {key: flat["properties"][key] for key in (*OF_PROBLEM, "title", "summary", "source", "report")}
    problems = {
        "type": "object",
        "description": "several problems, each by its name, in place of the tables of one",
        "additionalProperties": {
            "if": {"type": "object", "required": [STUDY]},
            "then": _table(_partial(changes, problem) | {STUDY: {"type": "string"}}),
            "else": {
                "anyOf": [{"const": False}, _table(problem)],
            },
        },
    }
    of_file = {
        EXTENDS: {"type": "string", "description": "a study file, or the name of a built-in study"},
        SWEEP: {"type": ["array", "object"], "description": "values by path, of which variants are made"},
        PROBLEMS: problems,
    }
    whole = flat["properties"] | of_file | {CONTROLLERS: controllers}
    extending = changes["properties"] | of_file | {CONTROLLERS: controllers}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Study file of ddpc-cosim",
        "type": "object",
        "if": {"required": [EXTENDS]},
        "then": _table(extending),
        "else": {
            "if": {"required": [PROBLEMS]},
            "then": _table(whole),
            "else": _table(whole, flat["required"]),
        },
        "$defs": schemas.definitions,
    }


def _table(properties: Schema, required: Sequence[str] = ()) -> Schema:
    table: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return table | ({"required": list(required)} if required else {})


def _partial(changes: Schema, keys: Mapping[str, Any]) -> Schema:
    return {key: changes["properties"][key] for key in keys}


class _Schemas:
    """Makes schemas of types; classes are defined once, and once more without what they require."""

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}

    def controllers(self) -> Schema:
        """Return the schema of the table of controllers: settings by the type of each."""
        section = self.of_class(ControllerSection, partial=True)
        changes = section["properties"] | {PROBLEMS: {"type": "object"}}
        by_type = [
            {
                "if": {"properties": {"type": {"const": name}}, "required": ["type"]},
                "then": {"properties": {"settings": self._settings(name, kind)}},
            }
            for name, kind in _installed_controllers().items()
        ]
        controller = {**_table(changes), "allOf": by_type}
        return {
            "type": "object",
            "description": "what is compared",
            "additionalProperties": {"if": {"const": False}, "else": controller},
        }

    def of_class(self, kind: type[Any], *, partial: bool = False) -> Schema:
        """Return the schema of a table of a class; ``partial``: of what differs from another study's."""
        fields = declared_fields(kind)
        properties: Schema = {kind_key(kind): {"const": kind.kind}} if hasattr(kind, KIND) else {}
        for key, field in fields.items():
            schema = self.of(field.hint, field.info, partial=partial)
            properties[key] = {"description": field.info.meaning} | schema
        required = [key for key, field in fields.items() if field.is_required and not partial]
        return _table(properties, required)

    def of(self, hint: Any, info: SettingInfo, *, partial: bool = False) -> Schema:
        """Return the schema of a value of a type."""
        origin, arguments = get_origin(hint), get_args(hint)
        if origin is Annotated:
            return self._annotated(arguments[0], arguments[1:], info, partial=partial)
        if origin in (Union, UnionType):
            some = [
                self.of(argument, info, partial=partial) for argument in arguments if argument is not NoneType
            ]
            return some[0] if len(some) == 1 else {"anyOf": some}
        if origin is Literal:
            return {"enum": list(arguments)}
        if origin in (dict, Mapping):
            names = self.of(arguments[0], _ANY)
            table = {"type": "object", "additionalProperties": self._entry(arguments[1], info, partial)}
            return table | ({"propertyNames": names} if names != {"type": "string"} else {})
        if origin in (list, Sequence):
            return {"type": "array", "items": self.of(arguments[0], info)}
        if dataclasses.is_dataclass(hint):
            return self._reference(hint, partial=partial)
        return _number_or_text(hint, info) if hint in _TYPES else {}

    def _entry(self, hint: Any, info: SettingInfo, partial: bool) -> Schema:
        """Return the schema of an entry of a table, which a study that extends another can leave out."""
        entry = self.of(hint, info)
        return {"if": {"const": False}, "else": entry} if partial else entry

    def _reference(self, kind: Any, *, partial: bool) -> Schema:
        name = f"{kind.__name__}{' changed' if partial else ''}".replace(" ", "_")
        if name not in self.definitions:
            self.definitions[name] = {}
            self.definitions[name] = self.of_class(kind, partial=partial)
        return {"$ref": f"#/$defs/{name}"}

    def _annotated(self, hint: Any, metadata: Sequence[Any], info: SettingInfo, *, partial: bool) -> Schema:
        kinds = next((annotation for annotation in metadata if isinstance(annotation, Kinds)), None)
        schema = self._of_kinds(kinds) if kinds else self.of(hint, info, partial=partial)
        for annotation in metadata:
            if isinstance(annotation, Rule):
                schema = {**schema, **annotation.schema}
            elif isinstance(annotation, Size):
                what = {"array": "Items", "object": "Properties", "string": "Length"}.get(
                    schema.get("type", "")
                )
                if what:
                    schema = schema | (
                        {f"min{what}": annotation.least} if annotation.least and not partial else {}
                    )
                    schema = schema | ({f"max{what}": annotation.most} if annotation.most is not None else {})
        for annotation in metadata:
            if isinstance(annotation, Prepared) and annotation.schema:
                schema = _or_else(schema, dict(annotation.schema))
        return schema

    def _of_kinds(self, kinds: Kinds) -> Schema:
        key_of_kind = kinds.key
        by_kind = [
            {
                "if": {"properties": {key_of_kind: {"const": name}}, "required": [key_of_kind]},
                "then": self._reference(kind, partial=False),
            }
            for name, kind in kinds.classes.items()
        ]
        if kinds.default:
            default = self._reference(kinds.classes[kinds.default], partial=False)
            by_kind.append({"if": {"not": {"required": [key_of_kind]}}, "then": default})
        required = {} if kinds.default else {"required": [key_of_kind]}
        schema: Schema = {
            "type": "object",
            "properties": {key_of_kind: {"enum": list(kinds.classes)}},
            **required,
            "allOf": by_kind,
        }
        for key, kind in kinds.marked.items():
            marked = {"type": "object", "required": [key]}
            schema = {"if": marked, "then": self._reference(kind, partial=False), "else": schema}
        return schema

    def _settings(self, name: str, kind: type[Any]) -> Schema:
        """Return the schema of a controller's settings; open where it does not declare them."""
        declared = declared_settings(kind)
        if not declared:
            return {"type": "object"}
        try:
            hints = get_type_hints(kind)
        except Exception:  # a third party's annotations can be anything
            hints = {}
        properties = {
            key: {"description": info.doc, **self._setting(hints.get(key, Any), info)}
            for key, info in declared.items()
        }
        return _table(properties)

    def _setting(self, hint: Any, info: SettingInfo) -> Schema:
        if info.choices:
            return {"enum": list(info.choices)}
        if hint == Weight:
            return {"type": ["number", "array"]}
        return _number_or_text(hint, info) if hint in (bool, int, float) else {}


def _installed_controllers() -> dict[str, type[Any]]:
    return {plugin.name: plugin.value for plugin in installed(CONTROLLERS) if isinstance(plugin.value, type)}


def _or_else(schema: Schema, other: Schema) -> Schema:
    """Return the schema of a value that may be written otherwise, so that errors have the right place."""
    if "if" in other:
        return other
    if schema.get("type") == "array":
        alone = schema["items"] if other == {"type": "object"} else other
        return {"if": {"type": "array"}, "then": schema, "else": alone}
    return {"if": other, "else": schema}


def _number_or_text(hint: Any, info: SettingInfo) -> Schema:
    """Return the schema of a plain value; of a number in seconds also as people say a duration."""
    schema = {"type": _TYPES[hint], **_range(hint, info)}
    return (
        {"if": {"type": "string"}, "then": DURATION_SCHEMA, "else": schema}
        if _is_time(hint, info)
        else schema
    )


def _is_time(hint: Any, info: SettingInfo) -> bool:
    return hint is float and info.unit == "s"


def _range(hint: Any, info: SettingInfo) -> Schema:
    if hint not in (int, float):
        return {}
    limits = {
        "exclusiveMinimum": info.above,
        "minimum": info.low,
        "maximum": info.high,
        "exclusiveMaximum": info.below,
    }
    return {key: limit for key, limit in limits.items() if math.isfinite(limit)}
