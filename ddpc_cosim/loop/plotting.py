"""Drawings of runs and of results, as plug-ins of reports make them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plugins import load_plugin
from fmu_plants.files import write_atomically

_PIXELS = 2.0
"""Of a picture of pixels, per unit of the drawing: sharp in print, too."""
SUFFIXES = (".svg", ".pdf", ".png", ".json")


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A drawing, which shows itself in a notebook.

    Parameters
    ----------
    title : str
        What it is of.
    svg : str
        The drawing.
    charts : tuple of dict
        Its charts from top to bottom, each a Vega-Lite specification with its data.
    """

    title: str
    svg: str
    charts: tuple[Mapping[str, Any], ...] = ()

    def save(self, path: str | Path) -> Path:
        """Write the drawing as SVG, PDF or PNG, or its charts as JSON, by the end of the file's name.

        Raises
        ------
        ConfigError
            The name ends otherwise.
        OSError
            The file cannot be written.
        """
        path = Path(path)
        if path.suffix not in SUFFIXES:
            raise ConfigError(f"{path}: the name must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
        write_atomically(path, self.encoded(path.suffix))
        return path

    def encoded(self, suffix: str) -> bytes:
        """Return what a file whose name ends in this, such as ``".pdf"``, holds."""
        if suffix == ".svg":
            return self.svg.encode()
        if suffix == ".json":
            return json.dumps(self.charts, ensure_ascii=False, allow_nan=False).encode()
        import vl_convert  # which takes a while to import

        if suffix == ".pdf":
            return vl_convert.svg_to_pdf(self.svg)
        return vl_convert.svg_to_png(self.svg, scale=_PIXELS)

    def __repr__(self) -> str:
        return f"Picture({self.title!r}, {len(self.charts)} charts)"

    def _repr_svg_(self) -> str:
        return self.svg


def drawn(what: str, *arguments: Any, **more: Any) -> Any:
    """Return what the installed plug-in ``pictures`` of reports draws, such as ``"of_traces"``."""
    return getattr(load_plugin("reports", "pictures"), what)(*arguments, **more)
