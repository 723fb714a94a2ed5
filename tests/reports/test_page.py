"""The page as a file: complete, escaped, deterministic, and small enough."""

import base64
import csv
import io
import json
import re
import subprocess
import sys
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vl_convert
from rich.console import Console

from ddpc_cosim import ConfigError, CosimWarning, Outcome, StudyResults, Trace
from ddpc_cosim.cli.summary import summary_table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.metrics import METRICS, metric_name
from ddpc_cosim.study.results import METRICS_FILE, keep_logo, write_results
from ddpc_reports import sections, write_report
from ddpc_reports.embedding import chart_library
from ddpc_reports.figures import drawing, over_time
from ddpc_reports.page import render_page

from .synthetic import ANGLE, FORCE, SPEED, TORQUE, MakeResults, make_trace

HOSTILE = '</script><script>alert("x")</script><img src=x onerror=alert(1)>'


class Reader(HTMLParser):
    """Collects what the tests ask about: elements, ids, headings, tables, embedded JSON."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.headings: list[tuple[int, str]] = []
        self.text = ""
        self.json = ""
        self._inside = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.elements.append((tag, attributes))
        self._inside = "deflated" if attributes.get("id") == "report-data" else tag
        if re.fullmatch("h[1-6]", tag):
            self.headings.append((int(tag[1]), ""))

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "deflated":
            self.json += zlib.decompress(base64.b64decode(data)).decode()
        elif self._inside not in ("script", "style"):
            self.text += data
        if re.fullmatch("h[1-6]", self._inside):
            level, text = self.headings[-1]
            self.headings[-1] = (level, text + data.strip())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def written(tmp_path: Path, *results: StudyResults) -> str:
    path = write_report(results, tmp_path / "deep" / "report.html")
    return path.read_text(encoding="utf-8")


def several_seeds(make_results: MakeResults, **changes: Any) -> StudyResults:
    return make_results(seeds=[7, 0, 1], **changes)


def test_the_page_has_every_section_in_order(make_results: MakeResults, tmp_path: Path) -> None:
    results = several_seeds(
        make_results, trace_of=lambda key, seed: make_trace(0.4, diagnostics={"data_rank": 9})
    )
    headings = [text for level, text in Reader(written(tmp_path, results)).headings if level == 2]
    assert headings == [
        "Responses",
        "Errors",
        "Control signals",
        "Phase plane",
        "Distribution over seeds and paired differences",
        "Step response",
        "Limits and actuators",
        "Computation time",
        "Data diagnostics",
        "Failures and fallbacks",
        "Fairness and known limitations",
        "Settings",
        "Every case",
        "How to reproduce",
    ]


def test_the_same_results_give_the_same_bytes(make_results: MakeResults, tmp_path: Path) -> None:
    results = several_seeds(make_results)
    assert written(tmp_path, results) == written(tmp_path, results)


def test_the_date_stands_in_the_provenance_only(make_results: MakeResults, tmp_path: Path) -> None:
    page = written(tmp_path, make_results(provenance={"date": "2031-05-06T07:08:09", "fmu sha256": "cafe"}))
    assert page.count("2031-05-06") == 1
    assert "plant SHA-256" in page


def test_nothing_is_loaded_from_anywhere(make_results: MakeResults, tmp_path: Path) -> None:
    reader = Reader(written(tmp_path, several_seeds(make_results)))
    sources = [a[name] for _, a in reader.elements for name in ("src", "href", "xlink:href") if a.get(name)]
    assert all(str(source).startswith(("#", "data:")) for source in sources)
    policy = next(meta for meta in reader.all("meta") if meta.get("http-equiv"))
    assert str(policy["content"]).startswith("default-src 'none'")


def test_the_chart_library_is_embedded_once(make_results: MakeResults, tmp_path: Path) -> None:
    page = written(tmp_path, several_seeds(make_results), make_results())
    library = base64.b64encode(zlib.compress(chart_library().encode(), 9)).decode()
    assert page.count(library) == 1
    assert len(page) < 1_000_000


def test_the_chart_library_is_bundled_once_and_without_a_cache_as_often_as_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundled = []
    monkeypatch.setattr(vl_convert, "javascript_bundle", lambda snippet: bundled.append(snippet) or snippet)
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    library = chart_library.__wrapped__
    assert library() == library()
    assert "window.chartLibrary = {" in library()
    assert len(bundled) == 1
    (tmp_path / "file").touch()
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "file" / "cache"))
    assert library() == library()
    assert len(bundled) == 3


def test_hostile_names_stay_text(make_results: MakeResults, tmp_path: Path) -> None:
    controllers = {"evil": {"type": "x", "label": HOSTILE, "note": HOSTILE}, "good": {"type": "y"}}
    results = make_results(
        lambda key, seed: make_trace(0.5, settings={HOSTILE: HOSTILE}, diagnostics={HOSTILE: 1.0}),
        controllers,
        provenance={HOSTILE: HOSTILE},
        title=HOSTILE,
        summary=HOSTILE,
        report={"panels": [{"title": HOSTILE, "controllers": ["evil"]}], "limitations": [HOSTILE]},
        seeds=[7, 0],
    )
    page = written(tmp_path, results)
    reader = Reader(page)
    assert "<script>alert" not in page
    assert not reader.all("img")
    assert len(reader.all("script")) == 3
    assert HOSTILE in json.dumps(json.loads(reader.json), ensure_ascii=False).replace('\\"', '"')


def test_nothing_acts_unseen_in_page_data_tables_and_terminal(
    make_results: MakeResults, tmp_path: Path
) -> None:
    acting = "\u202e\u200b\u2066\x9b\x1b\r\x07"
    evil = f"a{acting}b\n{HOSTILE}"
    signal, drive = replace(ANGLE, name=f"angle{acting}"), replace(TORQUE, name=f"torque{acting}", unit=evil)

    def trace_of(key: str, seed: int) -> Trace:
        said = {
            "settings": {evil: evil},
            "diagnostics": {evil: 1.0},
            "outputs": (signal,),
            "inputs": (drive,),
        }
        if key == "failing":
            return make_trace(0.5, outcome=Outcome.FMU_ERROR, reason=evil, **said)
        return make_trace(0.5 if key == "evil" else 0.3, noise_seed=seed, **said)

    controllers = {
        key: {"type": "x", "label": f"{key}{evil}", "note": evil} for key in ("evil", "good", "failing")
    }
    results = make_results(
        trace_of,
        controllers,
        provenance={evil: evil},
        title=evil,
        summary=evil,
        reference={signal.name: {"kind": "constant", "value": 20.0, "unit": "deg"}},
        plant={"name": evil, "inputs": [drive.name], "outputs": [signal.name]},
        report={"panels": [{"title": evil, "controllers": ["evil"]}], "limitations": [evil]},
        seeds=["0:6"],
        scenarios={"calm": {}, "other": {"label": evil}},
    )
    # What a study file says is made printable when it is read; what plug-ins and other programs say is not.
    results = replace(
        results, cases=tuple(replace(c, label=f"{c.controller}{acting}") for c in results.cases)
    )
    page = written(tmp_path, results)
    reader = Reader(page)
    links = [str(link["href"]) for link in reader.all("a") if "download" in link]
    tables = [base64.b64decode(link.partition(",")[2]).decode() for link in links]
    screen = Console(file=io.StringIO(), width=500)
    screen.print(summary_table(results, screen))
    for remark in [remark for findings in results.findings().values() for remark in findings.remarks]:
        screen.print(printable(remark.text))
    assert isinstance(screen.file, io.StringIO)
    write_results(results)
    shown = {
        "page": page,
        "data": json.dumps(json.loads(reader.json), ensure_ascii=False),
        "tables": "".join(tables),
        "terminal": screen.file.getvalue(),
        "metrics": (results.folder / "metrics.csv").read_text(encoding="utf-8"),
    }
    assert "\\u202e" in shown["page"]
    assert "\\u202e" in shown["tables"]
    assert {what: common for what, text in shown.items() if (common := set(acting) & set(text))} == {}
    assert "<script>alert" not in page
    assert not reader.all("img")


def test_a_name_is_no_formula_for_who_opens_the_metrics_in_a_spreadsheet(make_results: MakeResults) -> None:
    plant = {"name": "=HYPERLINK(1)", "inputs": ["torque"], "outputs": ["angle"]}
    results = make_results(plant=plant)
    write_results(results)
    with (results.folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        assert {row["plant"] for row in csv.DictReader(file)} == {"'=HYPERLINK(1)"}


def test_a_reason_for_failure_is_shown(make_results: MakeResults, tmp_path: Path) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        if key == "slow":
            return make_trace(1.0, outcome=Outcome.FMU_ERROR, reason="fmi2DoStep failed at 3.0 s")
        return make_trace(0.3)

    text = Reader(written(tmp_path, make_results(trace_of))).text
    assert "Runs that did not complete: 1 of 2" in text
    assert "fmi2DoStep failed at 3.0 s" in text
    assert "slow: none of its cases completed" in text


def test_a_study_where_everything_failed_still_gives_a_report(
    make_results: MakeResults, tmp_path: Path
) -> None:
    failed = make_results(
        lambda key, seed: make_trace(0.5, outcome=Outcome.CRASHED, reason="gone"), seeds=[7, 0]
    )
    assert "No case completed, so nothing is ranked" in Reader(written(tmp_path, failed)).text


def test_one_case_alone_gives_a_report(make_results: MakeResults, tmp_path: Path) -> None:
    text = Reader(written(tmp_path, make_results(controllers={"only": {"type": "x"}}))).text
    assert "The case completed." in text
    assert "One seed only" in text


def test_every_output_and_input_has_its_row_of_charts(make_results: MakeResults, tmp_path: Path) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(0.5, outputs=(ANGLE, SPEED), inputs=(TORQUE, FORCE))

    data = json.loads(Reader(written(tmp_path, make_results(trace_of))).json)
    drawn = {view["data"] for view in data["views"].values() if view["data"]}
    assert drawn == {f"s1-1-{kind}{i}" for kind in "yeud" for i in range(2)}


def test_figures_show_the_samples_of_the_first_seed_in_display_units(
    make_results: MakeResults, tmp_path: Path
) -> None:
    results = several_seeds(make_results)
    data = json.loads(Reader(written(tmp_path, results)).json)["data"]
    trace = results.cases[0].trace()
    assert samples(data["s1-1-y0"]["t"]) == pytest.approx(trace.time)
    assert samples(data["s1-1-y0"]["r"]) == pytest.approx([20.0] * len(trace))
    assert samples(data["s1-1-y0"]["c0"]) == pytest.approx(trace.y[:, 0] * 180 / 3.141592653589793, abs=2e-4)
    assert samples(data["s1-1-u0"]["c0"]) == pytest.approx(trace.u[:, 0], abs=3e-5)
    changes = [trace.u[0, 0], *(trace.u[1:, 0] - trace.u[:-1, 0])]
    assert samples(data["s1-1-d0"]["c0"]) == pytest.approx(changes, abs=3e-5)


def samples(packed: list[int]) -> list[float]:
    """Return what a column of the page stands for: decimals, first value, changes from value to value."""
    decimals, *changes = packed
    return [total / 10.0**decimals for total in accumulate(changes)]


def test_panels_of_the_study_are_kept_in_all_figures(make_results: MakeResults, tmp_path: Path) -> None:
    panels = [
        {"title": "First", "controllers": ["quick"]},
        {"title": "Both", "controllers": ["quick", "slow"]},
    ]
    data = json.loads(Reader(written(tmp_path, make_results(report={"panels": panels}))).json)
    lines = [list(view["lines"]) for view in data["views"].values() if view["data"]]
    assert lines == [["c0"], ["c0", "c1"]] * 4


def test_several_studies_share_one_list_of_contents(make_results: MakeResults, tmp_path: Path) -> None:
    first, second = make_results(title="Study one"), make_results(title="Study two")
    reader = Reader(written(tmp_path, first, second))
    assert [text for level, text in reader.headings if level <= 2] == [
        "2 studies compared",
        "Study one",
        "Study two",
    ]
    anchors = {a["href"] for a in reader.all("a") if str(a["href"]).startswith("#")}
    ids = [str(a["id"]) for _, a in reader.elements if a.get("id")]
    assert sorted(ids) == sorted(set(ids))
    assert anchors <= {f"#{name}" for name in ids}


def test_headings_never_skip_a_level(make_results: MakeResults, tmp_path: Path) -> None:
    scenarios = {"calm": {}, "noisy": {"label": "Noisy", "noise": {"angle": 0.01}}}
    results = [make_results(scenarios=scenarios), make_results(scenarios=scenarios)]
    levels = [level for level, _ in Reader(written(tmp_path, *results)).headings]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_every_table_can_be_saved_as_csv(make_results: MakeResults, tmp_path: Path) -> None:
    results = several_seeds(make_results)
    reader = Reader(written(tmp_path, results))
    files = {str(a["download"]): str(a["href"]) for a in reader.all("a") if a.get("download")}
    assert len(reader.all("table")) == len([a for a in reader.all("a") if a.get("download")])
    text = base64.b64decode(files["cases.csv"].partition(",")[2]).decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    expected = [case.metrics["mean_abs_error.angle [deg]"] for case in results.cases]
    assert [float(row["mean absolute error of angle (°)"]) for row in rows] == pytest.approx(expected)


def test_a_metric_has_one_label_in_page_and_terminal_and_its_name_in_files(
    make_results: MakeResults, tmp_path: Path
) -> None:
    scenarios = {"calm": {}, "noisy": {"label": "Noisy", "noise": {"angle": 0.01}}}
    results = several_seeds(make_results, scenarios=scenarios)
    page = " ".join(Reader(written(tmp_path, results)).text.replace("\N{MINUS SIGN}", "-").split())
    console = Console(width=200)
    with console.capture() as capture:
        console.print(summary_table(results, console))
    write_results(results)
    columns = (results.folder / METRICS_FILE).read_text(encoding="utf-8").splitlines()[0]
    keys = {key for key in columns.split(",") if key.partition(".")[0].partition(" [")[0] in METRICS}
    assert keys == {key for case in results.cases for key in case.metrics}
    for name in METRICS.keys() & {key.partition(".")[0].partition(" [")[0] for key in keys}:
        words, of_file, metric = metric_name(name), name.replace("_", " "), METRICS[name]
        assert ("report" not in metric.shown) or words in page, words
        assert ("terminal" not in metric.shown) or words in capture.get(), words
        if " " in of_file and of_file != words.casefold():
            assert of_file not in (page + capture.get()).casefold()


@pytest.mark.parametrize("scenarios", [{"calm": {}}, {"calm": {}, "noisy": {"noise": {"angle": 0.01}}}])
def test_page_and_terminal_rank_alike(
    make_results: MakeResults, tmp_path: Path, scenarios: dict[str, Any]
) -> None:
    """In the same order, with the same ranks; who has a failed run comes last."""

    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace({"slow": 1.0, "quick": 0.3, "also": 0.3, "failing": 0.2}[key], noise_seed=seed)
        return trace if (key, seed) != ("failing", 3) else replace(trace, outcome=Outcome.DIVERGED)

    controllers = {name: {"type": "a"} for name in ("failing", "slow", "also", "quick")}
    results = make_results(trace_of, controllers, seeds=[*range(12)], scenarios=scenarios)
    reader = Reader(written(tmp_path, results))
    name = "ranking.csv" if len(scenarios) == 1 else "matrix.csv"
    (packed,) = (str(a["href"]) for a in reader.all("a") if a.get("download") == name)
    rows = csv.DictReader(io.StringIO(base64.b64decode(packed.partition(",")[2]).decode()))
    on_page = [(row["rank"], row["Controller"]) for row in rows]
    console = Console(width=200)
    with console.capture() as capture:
        console.print(summary_table(results, console))
    lines = [line.split()[:2] for line in capture.get().splitlines()]
    in_terminal = [(words[0], words[1]) for words in lines if words[1:] and words[1] in controllers]
    assert [rank for rank, _ in in_terminal] == ["1-2", "1-2", "3", "4"]
    assert [(rank[0], name) for rank, name in in_terminal] == on_page
    assert [rank for rank, _ in on_page] == ["1", "1", "3", "4"]
    assert on_page[-1][1] == "failing"


def test_a_thousand_cases_do_not_blow_the_page_up(make_results: MakeResults, tmp_path: Path) -> None:
    few = make_results(controllers={"only": {"type": "x"}})
    case = few.cases[0]
    many = [replace(case, seed=seed, id=f"case{seed}") for seed in range(1000)]
    page = written(tmp_path, replace(few, cases=tuple(many)))
    assert len(page) < 2_000_000


def test_large_seeds_sort_by_all_their_digits(make_results: MakeResults, tmp_path: Path) -> None:
    few = make_results(controllers={"only": {"type": "x"}})
    cases = tuple(
        replace(few.cases[0], seed=seed, id=f"case{seed}") for seed in (4_000_000_001, 4_000_000_002)
    )
    page = written(tmp_path, replace(few, cases=cases))
    assert 'data-value="4000000001"' in page
    assert 'data-value="4000000002"' in page


def test_no_results_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one study"):
        write_report([], tmp_path / "report.html")


def test_finding_the_plug_in_imports_nothing_heavy() -> None:
    heavy = {"jinja2", "pandas", "vl_convert", "numpy"}
    program = f"import sys, ddpc_reports; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("largest", [1.7e308, 1e-320])
def test_values_of_any_size_can_be_shown(make_results: MakeResults, tmp_path: Path, largest: float) -> None:
    def swinging(key: str, seed: int) -> Trace:
        trace = make_trace(0.3, noise_seed=seed)
        y = largest * (-1.0) ** np.arange(len(trace))[:, np.newaxis]
        return replace(trace, y=y, measured=y) if key == "quick" else trace

    page = written(tmp_path, make_results(swinging, seeds=[7, 8]))
    assert "cannot be shown" not in page
    assert "could not be drawn" not in page


def fail(*_: object, **__: object) -> None:
    raise KeyError("broken")


def test_what_fails_costs_the_page_its_own_place(
    make_results: MakeResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = Reader(written(tmp_path, make_results()))
    monkeypatch.setattr(sections, "cases_table", fail)
    time_figure = over_time._time_figure

    def fail_for_inputs(*arguments: Any) -> over_time.Figure:
        return fail() if arguments[2] == "Control signals" else time_figure(*arguments)  # type: ignore[return-value]

    monkeypatch.setattr(over_time, "_time_figure", fail_for_inputs)
    with pytest.warns(CosimWarning, match="cannot be shown: KeyError: 'broken'") as warned:
        page = Reader(written(tmp_path, make_results()))
    assert len(warned) == 2
    assert page.headings == sound.headings
    for what in ("Every case", "Control signals"):
        assert f"{what}: cannot be shown: KeyError: 'broken'" in page.text
    assert len(page.all("figure")) == len(sound.all("figure")) - 1


def test_a_picture_that_cannot_be_drawn_is_a_sentence(
    make_results: MakeResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where memory is limited: V8 ends its process then."""
    sound = json.loads(Reader(written(tmp_path, make_results())).json)
    assert len(sound["views"]) > 0
    dies = "import os, signal; os.kill(os.getpid(), signal.SIGTRAP)"
    for code, words in ((dies, "ended with SIGTRAP"), ("import sys; sys.exit(3)", "ended with exit code 3")):
        monkeypatch.setattr(drawing, "_CODE", code)
        monkeypatch.setattr(drawing, "_painter", drawing._Painter())
        page = Reader(written(tmp_path, make_results()))
        still = page.text.count(f"This picture does not answer a pointer: the process that draws {words}")
        none = page.text.count(f"This picture could not be drawn: the process that draws {words}")
        assert still + none == len(sound["views"]) > none > 0
        assert json.loads(page.json) == sound | {"views": {}}


def test_a_process_that_does_not_answer_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "_CODE", "import signal; signal.pause()")
    monkeypatch.setattr(drawing, "_LONGEST_SECONDS", 0.01)
    painter = drawing._Painter()
    for _ in range(2):  # and not started again
        with pytest.raises(drawing.DrawingError, match=r"took longer than 0\.01 s and was ended"):
            painter.draw(b"[]\n")
    assert painter.end() is None


def test_a_process_that_dies_on_one_picture_draws_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    painter = drawing._Painter()
    draws = "vega = vl_convert.vegalite_to_vega(spec)"
    code = drawing._CODE.replace(draws, f"if spec == 'bad': sys.exit(5)\n        {draws}")
    monkeypatch.setattr(drawing, "_CODE", code)
    for _ in range(2):
        assert b"<svg" in painter.draw(b'[{"mark": "point"}, {}]\n')
        with pytest.raises(drawing.DrawingError, match="ended with exit code 5"):
            painter.draw(b'["bad", {}]\n')
    painter.end()


def test_pictures_are_drawn_once_and_without_a_cache_every_time(
    make_results: MakeResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    draw = drawing._Painter.draw
    monkeypatch.setattr(drawing._Painter, "draw", lambda *given: drawn.append(given) or draw(*given))
    monkeypatch.setattr(drawing, "_MOST_CACHED", 8)
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    page = written(tmp_path, make_results())
    pictures = len(json.loads(Reader(page).json)["views"])
    assert len(drawn) == pictures
    assert len(list((tmp_path / "cache" / "pictures").iterdir())) <= 8
    monkeypatch.setattr(drawing, "_MOST_CACHED", 1000)
    assert written(tmp_path, make_results()) == page
    drawn.clear()
    assert written(tmp_path, make_results()) == page
    assert not drawn
    (tmp_path / "file").touch()
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "file" / "cache"))
    assert written(tmp_path, make_results()) == page
    assert len(drawn) == pictures


def test_a_page_that_cannot_be_written_leaves_the_older_one(
    make_results: MakeResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = make_results()
    path = write_report([results], tmp_path / "report.html")
    before = path.read_bytes()

    def fill_the_disk(path: Path, content: bytes) -> int:
        path.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill_the_disk)
    with pytest.raises(OSError, match="No space left"):
        write_report([results], path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.glob("*report*")] == ["report.html"]


def test_author_comment_and_logo_stand_at_the_head_as_texts_and_data(make_results: MakeResults) -> None:
    """The logo lies with the results; what it would load or run does nothing in a picture."""
    svg = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><script>alert(1)</script></svg>'
    results = make_results(report={"author": "A <b>B</b>", "comment": "Good & bad."})
    (results.folder / "logo.svg").write_bytes(svg)
    page = render_page([results])
    assert "A &lt;b&gt;B&lt;/b&gt;" in page
    assert '<p class="comment">Good &amp; bad.</p>' in page
    (source,) = re.findall(r'<img class="logo" src="data:image/svg\+xml;base64,([^"]*)" alt="">', page)
    assert base64.b64decode(source) == svg
    assert '<img class="logo"' not in render_page([make_results()])


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "cannot be read: No such file or directory"), (b"x" * 300_001, "300 kB; allowed: 300 kB")],
    ids=["missing", "large"],
)
def test_a_logo_that_cannot_be_kept_is_told_before_the_run(
    make_results: MakeResults, tmp_path: Path, content: bytes | None, words: str
) -> None:
    logo = tmp_path / "a.PNG"
    study = make_results(report={"logo": str(logo)}).whole
    if content is not None:
        logo.write_bytes(content)
    with pytest.raises(ConfigError, match=words):
        keep_logo(tmp_path, study)
    logo.write_bytes(b"png")
    keep_logo(tmp_path, study)
    assert (tmp_path / "logo.png").read_bytes() == b"png"
    logo.unlink()
    keep_logo(tmp_path, study)
    assert (tmp_path / "logo.png").exists(), "results that went elsewhere have it"
