"""What a report says of the trials of a tuning, from the file that `tune` leaves beside the results."""

from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim import StudyResults
from ddpc_reports.page import render_page
from ddpc_reports.tuning import front_figures, trials_tables

from .synthetic import make_results_in

HEAD = "problem,controller,trial,runs,pruned,{},not dominated,chosen,{},settings\n"
SETTINGS = '"{""a"": 1.5}"'
ONE = [
    "synthetic,quick,0,6,false,1,0.5,true,false,2,0.75",
    "synthetic,quick,1,6,false,0,0.25,true,true,3,0.5",
    "synthetic,quick,2,2,true,1,,false,false,,",
    "another,quick,0,9,false,0,9.0,true,true,0,9.0",
]
TWO = [
    "synthetic,quick,0,6,false,0,1.0,4.0,true,false,0,1.0,4.0",
    "synthetic,quick,1,6,false,0,0.5,5.0,true,true,0,0.5,5.0",
    "synthetic,quick,2,6,false,0,1.5,4.5,false,false,,,",
    "synthetic,quick,3,6,false,0,2.0,inf,false,false,,,",
    "synthetic,quick,4,6,false,2,0.1,0.1,true,false,,,",
]


def tuned(folder: Path, objectives: str, rows: list[str]) -> StudyResults:
    folder.mkdir()
    figures = ["runs failed", *objectives.split(",")]
    head = HEAD.format(",".join(figures), ",".join(f"held out: {figure}" for figure in figures))
    content = head + "".join(f"{row},{SETTINGS}\n" for row in rows)
    (folder / "trials.csv").write_text(content, encoding="utf-8")
    controllers = {"quick": {"type": "quick", "label": "Quick, tuned"}, "slow": {"type": "slow"}}
    return make_results_in(folder, None, controllers, {"tuning": "3 trials, 14 runs, which took 5 s"})


def test_the_trials_of_each_controller_are_summed_up(tmp_path: Path) -> None:
    results = tuned(tmp_path / "one", "rmse", ONE)
    worth, trials = trials_tables(results, "x-")
    (row,) = worth.rows
    assert row.header == "Quick"
    assert [(cell.raw, cell.best) for cell in row.cells[:-1]] == [
        (2.0, True),
        (3.0, False),
        (0.75, False),
        (0.5, True),
    ]
    assert row.cells[-1].text == "a = 1.5"
    (row,) = trials.rows
    assert [cell.raw for cell in row.cells] == [3, 1, 14, 1, 0, 0.5, 0.25]
    assert "3 trials, 14 runs, which took 5 s." in trials.notes
    assert front_figures(results, "x-") == []
    assert 'id="s1-tuned-table"' in render_page([results])


def test_where_settings_come_from_and_which_are_at_an_end_of_the_search_is_told(tmp_path: Path) -> None:
    results = tuned(tmp_path / "one", "rmse", ONE)
    file = tmp_path / "one" / "trials.csv"
    assert "at an end" not in "".join(trials_tables(results, "x-")[0].notes)
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    more = [f"{head},origin,at ends", *(f'{row},search,"a, b"' for row in rows)]
    file.write_text("\n".join(more), encoding="utf-8")
    worth, trials = trials_tables(results, "x-")
    assert worth.rows[0].cells[-1].text == "a, b"
    assert "within 3 % of an end" in worth.notes[0]
    assert trials.rows[0].cells[-1].text == "search"


def test_two_objectives_are_drawn_as_a_front(tmp_path: Path) -> None:
    """Trials with more failed runs than the one chosen are left out, and those without a figure."""
    (figure,) = front_figures(tuned(tmp_path / "two", "rmse,total_variation", TWO), "x-")
    spec: dict[str, Any] = figure.views[0].spec
    points = spec["data"]["values"]
    assert [(point["x"], point["y"]) for point in points] == [(1.0, 4.0), (0.5, 5.0), (1.5, 4.5)]
    assert [(p["front"], p["chosen"], p["given"]) for p in points] == [
        (True, False, True),
        (True, True, False),
        (False, False, False),
    ]
    assert "Left out: 2 trials" in figure.caption
    assert "<svg" in figure.views[0].drawing.svg


def test_without_trials_there_is_no_such_section(tmp_path: Path) -> None:
    results = make_results_in(tmp_path)
    assert trials_tables(results, "x-") == []
    assert 'id="s1-tuned-table"' not in render_page([results])


@pytest.mark.parametrize("content", ["", "a,b\n1,2\n"])
def test_a_file_that_is_another_costs_the_section_alone(content: str, tmp_path: Path) -> None:
    results = tuned(tmp_path / "other", "rmse", ONE)
    (results.folder / "trials.csv").write_text(content, encoding="utf-8")
    with pytest.warns(UserWarning, match="Tuning: cannot be shown"):
        assert 'id="s1-ranking-table"' in render_page([results])


def test_the_marks_of_a_front_are_explained_in_the_figure(tmp_path: Path) -> None:
    (figure,) = front_figures(tuned(tmp_path / "two", "rmse,total_variation", TWO), "x-")
    assert [(key.label, key.shape) for key in figure.keys] == [
        ("trial", "small-dot"),
        ("no other is better in one and worse in none", ""),
        ("trial chosen", "ring"),
        ("as given", "square"),
    ]
    assert all(key.path or not key.shape for key in figure.keys)
    assert "diamond" not in figure.caption
