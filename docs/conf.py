"""How the pages of this folder become a site: ``uv run --group docs sphinx-build -W docs docs/_build``.

Neither the build nor the built pages ask anything of a network: formulas become MathML, fonts are those of
the reader's system, and a page that would load something from elsewhere is a warning.
"""

import dataclasses
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from math_core import LatexToMathML
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator
from sphinx_gallery.scrapers import figure_rst

import ddpc_cosim
from ddpc_cosim import Picture

project = "ddpc-cosim"
author = "the ddpc-cosim developers"
copyright = "2026, the ddpc-cosim developers"
version = release = ddpc_cosim.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_templates", "examples"]
highlight_language = "text"
suppress_warnings = ["config.cache"]  # a function in sphinx_gallery_conf: pages are read anew every time

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # as GitHub writes formulas
myst_heading_anchors = 4

autosummary_ignore_module_all = False
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # the docstrings say them, with shapes and units
numpydoc_show_class_members = False  # autodoc shows those that have a docstring
numpydoc_validation_checks = {"GL06", "GL07", "PR02", "PR10", "YD01"}  # names of sections and parameters


def save_chart(block: object, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Keep the chart that a cell of an example ends with."""
    chart = block_vars["example_globals"].get("___")
    if not isinstance(chart, Picture):
        return ""
    block_vars["example_globals"]["___"] = None  # later cells have figures of their own
    path = next(block_vars["image_path_iterator"]).replace(".png", ".svg")
    chart.save(path)
    return figure_rst([path], gallery_conf["src_dir"], "The run over time")


sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "generated/examples",
    "ignore_repr_types": "ddpc_cosim|NoneType",
    "filename_pattern": r"\.py$",  # run them all
    "image_scrapers": (save_chart,),
    "reset_modules": (),
    "abort_on_example_error": True,
    "min_reported_time": 3600,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
}

html_theme = "furo"
html_title = "ddpc-cosim"
templates_path = ["_templates"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False

_MATHML = LatexToMathML(fancy_error=False)
_LOADED = re.compile(
    r"""<(?:script|img|source|iframe|embed|video|audio)\b[^>]*?\bsrc=["']?(?:https?:)?//[^"'\s>]+
      | <link\b(?=[^>]*\brel=["']?(?:stylesheet|icon|\w*pre))[^>]*?\bhref=["']?(?:https?:)?//[^"'\s>]+
      | (?:@import\s|url\()\s*["']?(?:https?:)?//[^"'\s)]+""",
    re.VERBOSE | re.IGNORECASE,
)
_log = logging.getLogger(__name__)


def _formula(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    block = isinstance(node, nodes.math_block)
    formula = _MATHML.convert_with_local_state(node.astext(), displaystyle=block)
    translator.body.append(f'<div class="math">{formula}</div>' if block else formula)
    raise nodes.SkipNode


def _warn_of_what_is_loaded(app: Sphinx, exception: Exception | None) -> None:
    """Warn of every page and style that asks for something from the network when it is viewed."""
    for path in sorted(Path(app.outdir).rglob("*")):
        if exception is None and path.suffix in {".html", ".css"}:
            for match in _LOADED.finditer(path.read_text(encoding="utf-8")):
                _log.warning("%s loads from the network: %s", path.relative_to(app.outdir), match[0])


def _add_settings(_app: Sphinx, what: str, _name: str, obj: Any, _options: object, lines: list[str]) -> None:
    """Add what a class declares of its settings to its docstring, if that does not tell of them itself."""
    if what != "class" or not dataclasses.is_dataclass(obj) or "Parameters" in lines:
        return
    if settings := ddpc_cosim.declared_settings(obj):
        lines += ["", "Parameters", "----------"]
        for name, info in settings.items():
            lines += [f"{name} : {info.allowed}", f"    {info.meaning}".replace("|", r"\|")]


def setup(app: Sphinx) -> None:
    """Tell Sphinx of the settings, of the formulas and of the last check."""
    app.connect("autodoc-process-docstring", _add_settings, priority=1)  # before numpydoc reads it
    app.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    app.connect("build-finished", _warn_of_what_is_loaded)
