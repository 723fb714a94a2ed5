"""The report as CSV: every number again from metrics.csv, by pandas."""

import math
from pathlib import Path

import pandas as pd
import pytest

from ddpc_cosim import Outcome, Trace
from ddpc_cosim.study.results import write_metrics
from ddpc_reports import write_csv

from .synthetic import MakeResults, make_trace

SEEDS = list(range(12))


def trace_of(key: str, seed: int) -> Trace:
    crashes = key == "slow" and seed in (3, 4)
    return make_trace(
        {"quick": 0.3, "slow": 0.9}.get(key, 0.5) + 0.01 * seed,
        noise_seed=seed,
        outcome=Outcome.CRASHED if crashes else Outcome.COMPLETED,
        fallbacks=seed,
    )


@pytest.fixture
def tables(make_results: MakeResults, tmp_path: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the report's table, and metrics.csv."""
    controllers = {
        "quick": {"type": "x", "label": "=Quick\x1b"},
        "slow": {"type": "x"},
        "quick-2": {"type": "x", "variant_of": "quick", "varied": []},
    }
    results = make_results(trace_of, controllers, seeds=SEEDS, scenarios={"calm": {}, "windy": {}})
    write_metrics(results)
    path = write_csv([results], tmp_path / "new" / "report.csv")
    assert path.read_bytes() == write_csv([results], tmp_path / "again.csv").read_bytes()
    return pd.read_csv(path, keep_default_na=False, na_values=[""]), pd.read_csv(
        results.folder / "metrics.csv"
    )


def test_every_row_follows_from_the_cases(tables: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    table, metrics = tables
    for (controller, scenario), cases in metrics.groupby(["controller", "scenario"], sort=False):
        rows = table[(table["controller"] == controller) & (table["scenario"] == scenario)]
        assert len(rows) == sum("[" in name for name in metrics.columns)
        sound = cases[~cases["failed"]]
        assert set(rows["runs"]) == {len(cases)}
        assert set(rows["failed"]) == {len(cases) - len(sound)}
        for _, row in rows.iterrows():
            signal = "" if isinstance(row["signal"], float) else f".{row['signal']}"
            known = sound[f"{row['metric']}{signal} [{row['unit']}]"].dropna()
            for column, value in (("median", known.median()), ("low", known.min()), ("high", known.max())):
                assert row[column] == pytest.approx(value, rel=1e-12, nan_ok=True)
            if not math.isnan(row["interval_low"]):
                assert (
                    row["low"] <= row["interval_low"] <= row["median"] <= row["interval_high"] <= row["high"]
                )


def test_ranks_are_those_of_the_page_and_texts_act_on_nothing(
    tables: tuple[pd.DataFrame, pd.DataFrame],
) -> None:
    """Slow has failed runs and comes last; the variant of a sweep does not compete."""
    table, _ = tables
    ranks = table.groupby("controller", sort=False)["rank"].agg(["min", "max"])
    assert ranks.loc["quick"].tolist() == [1, 1]
    assert ranks.loc["slow"].tolist() == [2, 2]
    assert ranks.loc["quick-2"].isna().all()
    assert set(table.loc[table["controller"] == "quick", "label"]) == {"'=Quick\\x1b"}


def test_values_are_summed_up_as_the_page_does(tables: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    """Fallbacks are counted over all runs, the longest step is the longest, and errors are medians."""
    table, metrics = tables
    rows = table[(table["controller"] == "slow") & (table["scenario"] == "calm")].set_index("metric")["value"]
    cases = metrics[(metrics["controller"] == "slow") & (metrics["scenario"] == "calm")]
    completed = cases[cases["outcome"] == "completed"]
    assert rows["failures"] == cases["failures [1]"].sum()
    assert rows["solve_time_max"] == completed["solve_time_max [s]"].max()
    assert rows["rmse"] == pytest.approx(completed["rmse.angle [deg]"].median(), rel=1e-12)
