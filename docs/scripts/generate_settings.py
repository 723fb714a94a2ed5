"""Write tables of pages from the code: settings of controllers, keys of study files, parameters of classes.

Run ``python docs/scripts/generate_settings.py``. A table stands between ``<!-- settings: NAME -->`` and
``<!-- end -->``; NAME is a controller's entry point, or ``module:Class`` of anything that declares settings.
After ``<!-- keys: module:Class -->`` it has the keys of a table of a study file, and after
``<!-- parameters: module:Class -->`` what the class's docstring says of its parameters.
"""

import dataclasses
import inspect
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from ddpc_cosim import SettingInfo, declared_settings
from ddpc_cosim.codec import KIND, Kinds, declared_fields, kind_key, shown, write_in_short
from ddpc_cosim.plugins import load_plugin

DOCS = Path(__file__).parents[1]
PAGES = (
    *sorted(DOCS.glob("methods/*.md")),
    DOCS / "study-keys.md",
    DOCS / "extend" / "write-a-controller-plug-in.md",
)
_TYPES = {bool: "true or false", int: "integer", float: "number", str: "text"}
_TABLE = re.compile(r"(<!-- (settings|keys|parameters): (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
_PARAMETER = re.compile(r"^(\S.*?) : (.*)\n((?: {4}.*\n?)+)", re.MULTILINE)


def settings_table(plugin: type[Any]) -> str:
    """Return the table of a class's settings in Markdown."""
    declared = declared_settings(plugin)
    fields = {field.name: field for field in dataclasses.fields(plugin)}
    rows = ["| setting | default | allowed | meaning |", "|---|---|---|---|"]
    for name, info in declared.items():
        cells = (f"`{name}`", _default(fields[name]), info.allowed, info.meaning)
        rows.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n" if declared else "It has no settings.\n"


def keys_table(kind: type[Any]) -> str:
    """Return what a table of a study file is, and the table of its keys in Markdown."""
    about = (inspect.getdoc(kind) or "").partition("\n")[0].replace("``", "`")
    rows = [about, "", "| key | default | allowed | meaning |", "|---|---|---|---|"]
    rows += [f'| `{kind_key(kind)}` | | `"{kind.kind}"` | |'] if hasattr(kind, KIND) else []
    for key, field in declared_fields(kind).items():
        value = None if field.is_required else _short(field.default())
        default = "" if value in ({}, [], "", None, math.inf) else f"`{_toml(value)}`"
        needed = "required" if field.is_required else default
        cells = (f"`{key}`", needed, _allowed(field.hint, field.info), field.info.meaning)
        rows.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"


def _short(value: Any) -> Any:
    """Return a default as a file says it, without what are defaults in it."""
    if isinstance(value, dict):
        return {key: _short(item) for key, item in value.items()}
    return write_in_short(value) if dataclasses.is_dataclass(value) else value


def _allowed(hint: Any, info: SettingInfo) -> str:
    """Return the type of a key's value, and its range, in words."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        kinds = next((argument for argument in arguments if isinstance(argument, Kinds)), None)
        if kinds is None:
            return _allowed(arguments[0], info)
        return " or ".join(f"table with `{key}`" for key in (kinds.key, *kinds.marked))
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_allowed(a, info) for a in arguments if a is not NoneType))
    if origin is Literal:
        return " or ".join(f"`{_toml(value)}`" for value in arguments)
    if origin in (dict, Mapping):
        return f"table by name: {_allowed(arguments[1], info)}"
    if origin in (list, Sequence):
        return f"list: {_allowed(arguments[0], info)}"
    if hint not in _TYPES:
        return "table" if dataclasses.is_dataclass(hint) else "any"
    limits = info.allowed if hint in (int, float) and info.allowed != "any" else ""
    kind = "path" if info.file and hint is str else _TYPES[hint]
    kind = "number or duration" if hint is float and info.unit == "s" else kind
    return " ".join(filter(None, (kind, limits)))


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        if not value:
            return "{}"
        return f"{{ {', '.join(f'{key} = {_toml(item)}' for key, item in value.items())} }}"
    return str(value).lower() if isinstance(value, bool) else shown(value).replace("'", '"')


def parameters_table(kind: type[Any]) -> str:
    """Return the table of a class's parameters in Markdown, from its docstring."""
    rows = ["| name | type | meaning |", "|---|---|---|"]
    section = inspect.cleandoc(kind.__doc__ or "").partition("Parameters\n----------\n")[2]
    for names, type_, meaning in _PARAMETER.findall(section.partition("\n\n")[0]):
        named = ", ".join(f"`{name}`" for name in names.split(", "))
        rows.append(f"| {named} | {type_} | {' '.join(meaning.split()).replace('``', '`')} |")
    return "\n".join(rows) + "\n"


def with_tables(text: str) -> str:
    """Return a page with its tables written anew."""
    tables = {"settings": settings_table, "keys": keys_table, "parameters": parameters_table}
    return _TABLE.sub(
        lambda match: match[1] + tables[match[2]](load_plugin("controllers", match[3])) + match[4], text
    )


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default_factory is not dataclasses.MISSING:
        value: Any = field.default_factory()
    elif field.default is not dataclasses.MISSING:
        value = field.default
    else:
        return "required"
    if dataclasses.is_dataclass(value):
        return f"`{type(value).__name__}`"
    if value is None or (isinstance(value, tuple) and not value):
        return "none"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


if __name__ == "__main__":
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        page.write_text(with_tables(text), encoding="utf-8", newline="\n")
