"""How the pages of this folder become a site: ``uv run --group docs sphinx-build -W docs docs/_build``.

Neither the build nor the built pages ask anything of a network: formulas become outlines of STIX Two Math,
and MathML for whoever has them read aloud; text is in the fonts of the reader's system. A page that would
load something from elsewhere is a warning. The built-in studies are run on a few seeds, so that their reports
open behind their pictures: their cases stand below the folder of doctrees, or in ``STUDY_RUNS``, where those
that the tests have run are, and are not run again.
"""

import dataclasses
import os
import re
import shutil
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import tostring

import lxml.html
import ziafont
import ziamath
from docutils import nodes
from lxml.html.builder import E
from math_core import LatexToMathML
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator
from sphinx_gallery.scrapers import figure_rst

import ddpc_cosim
from ddpc_cosim import Picture
from ddpc_cosim.plugins import plugin_names

project = "ddpc-cosim"
author = "the ddpc-cosim developers"
copyright = "2026, the ddpc-cosim developers"
version = release = ddpc_cosim.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
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

copybutton_selector = "div.highlight-python pre, div.highlight-sh pre, div.highlight-toml pre"

REPORTS = dict.fromkeys(plugin_names("studies"), (0, 1)) | {"paper": (5489, 0, 1, 2)}
del REPORTS["benchmark"]
"""Built-in studies that are run for the site, and on which seeds; the benchmark takes too long."""

_SIZE = 20.0
_INVISIBLE = dict.fromkeys((0x2061, 0x2063, 0xFE00))
ziafont.config.svg2 = False  # outlines where they are: symbols would have the same id in every formula
ziafont.config.precision = 2
_MATHML = LatexToMathML(fancy_error=False)
_LOADED = re.compile(
    r"""<(?:script|img|source|iframe|embed|video|audio)\b[^>]*?\bsrc=["']?(?:https?:)?//[^"'\s>]+
      | <link\b(?=[^>]*\brel=["']?(?:stylesheet|icon|\w*pre))[^>]*?\bhref=["']?(?:https?:)?//[^"'\s>]+
      | (?:@import\s|url\()\s*["']?(?:https?:)?//[^"'\s)]+""",
    re.VERBOSE | re.IGNORECASE,
)
_EMPTY_HEADING = re.compile(r"<th\b([^>]*)>(?:\s|</?p>)*</th>")
_log = logging.getLogger(__name__)


def _formula(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write a formula drawn, which looks the same in every browser, and as MathML that is read aloud."""
    block = isinstance(node, nodes.math_block)
    formula = _MATHML.convert_with_local_state(node.astext(), displaystyle=block)
    formula = re.sub(
        r"(?:<mo[^>]*>([.⋅])</mo>){3}", lambda dots: f"<mo>{'…⋯'['.⋅'.index(dots[1])]}</mo>", formula
    )
    both = f'<span class="unseen">{formula}</span>{_drawn(formula)}'
    inline = f'<span class="math">{both}</span>&#8288;'  # a comma after it does not begin a line
    translator.body.append(f'<div class="math" tabindex="0">{both}</div>' if block else inline)
    raise nodes.SkipNode


def _drawn(formula: str) -> str:
    """Return a formula in MathML as SVG, in units of the text's size."""
    aligned = re.sub(
        r'<mtd style="((?:width: 50%;)?text-align: (\w+))', r'<mtd columnalign="\2" style="\1', formula
    )
    drawing = ziamath.Math(aligned.translate(_INVISIBLE), size=_SIZE).svgxml()
    _, top, width, height = (float(number) / _SIZE for number in drawing.attrib["viewBox"].split())
    del drawing.attrib["width"], drawing.attrib["height"]
    box = f"width: {width:.3f}em; height: {height:.3f}em; vertical-align: {-top - height:.3f}em"
    drawing.attrib |= {"style": box, "aria-hidden": "true"}
    return tostring(drawing, encoding="unicode")


def _warn_of_what_is_loaded(app: Sphinx, exception: Exception | None) -> None:
    """Warn of every page and style that asks for something from the network when it is viewed."""
    for path in sorted(Path(app.outdir).rglob("*")):
        if exception is None and path.suffix in {".html", ".css"}:
            for match in _LOADED.finditer(path.read_text(encoding="utf-8")):
                _log.warning("%s loads from the network: %s", path.relative_to(app.outdir), match[0])


def _run_studies(app: Sphinx) -> None:
    """Run the studies whose reports are of the site, and put these beside the pages."""
    if app.builder.format != "html":
        return
    reports = Path(app.outdir, "reports")
    reports.mkdir(parents=True, exist_ok=True)
    for name, seeds in REPORTS.items():
        folder = Path(os.environ.get("STUDY_RUNS") or Path(app.doctreedir, "runs"), name)
        results = ddpc_cosim.Study.read(name).run(folder, jobs=2, seeds=seeds, progress=False)
        shutil.copy(results.report(), reports / f"{name}.html")


def _link_pictures_to_reports(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Make every first screen of a report that is of the site a link to the report."""
    for image in list(doctree.findall(nodes.image)):
        name = Path(image["uri"]).stem
        if image["uri"] == f"pictures/reports/{name}.png" and name in REPORTS:
            target = app.builder.get_relative_uri(page, f"reports/{name}")
            image.replace_self(nodes.reference("", "", image.deepcopy(), refuri=target, classes=["report"]))


def _fold_navigation(_app: Sphinx, _page: str, _template: str, context: dict[str, Any], _: object) -> None:
    """Fold the groups of pages in the sidebar, but that of the page shown (of the home page: the first)."""
    tree = lxml.html.fragment_fromstring(context["furo_navigation_tree"], create_parent="div")
    for below in tree.xpath('.//li[contains(@class, "toctree-l2")]/*[not(self::a)]'):
        below.drop_tree()  # one page per class: its package's page lists them
    groups = tree.xpath("./ul")
    shown = next((group for group in groups if "current" in group.get("class", "")), groups[0])
    for group in groups:
        caption, fold = group.getprevious(), E.details(E.summary(group.getprevious().text_content()))
        tree.replace(caption, fold)
        fold.append(group)
    shown.getparent().set("open", "")
    context["furo_navigation_tree"] = lxml.html.tostring(tree, encoding="unicode")


def _empty_headings(_app: Sphinx, _page: str, _template: str, context: dict[str, Any], _: object) -> None:
    """Make a cell of every heading of a table that says nothing, as above the names of rows."""
    context["body"] = _EMPTY_HEADING.sub(r"<td\1></td>", context.get("body", ""))


def _add_settings(_app: Sphinx, what: str, _name: str, obj: Any, _options: object, lines: list[str]) -> None:
    """Add what a class declares of its settings to its docstring, if that does not tell of them itself."""
    if what != "class" or not dataclasses.is_dataclass(obj) or "Parameters" in lines:
        return
    if settings := ddpc_cosim.declared_settings(obj):
        lines += ["", "Parameters", "----------"]
        for name, info in settings.items():
            lines += [f"{name} : {info.allowed}", f"    {info.meaning}".replace("|", r"\|")]


def setup(app: Sphinx) -> None:
    """Tell Sphinx what to do at which step, and how to write formulas."""
    app.connect("builder-inited", _run_studies)
    app.connect("doctree-resolved", _link_pictures_to_reports)
    app.connect("html-page-context", _empty_headings)
    app.connect("html-page-context", _fold_navigation, priority=900)  # after the theme has made it
    app.connect("autodoc-process-docstring", _add_settings, priority=1)  # before numpydoc reads it
    app.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    app.connect("build-finished", _warn_of_what_is_loaded)
