"""Run by the peers' own Python: read question.json, solve with each peer, write answer.json."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np

Answer = dict[str, list[float]]

TIGHT = {"ipopt.tol": 1e-12, "ipopt.acceptable_tol": 1e-12, "ipopt.bound_relax_factor": 0.0}


def samples(question: dict[str, Any]) -> Iterator[tuple[Any, Any, Any]]:
    """Yield the past and the reference of the samples to solve, spread over the loop."""
    past, every = question["initial_length"], len(question["reference"]) // question["solves"]
    u, y = np.array(question["past_u"])[:, np.newaxis], np.array(question["past_y"])[:, np.newaxis]
    for k in range(0, question["solves"] * every, every):
        yield u[k : k + past], y[k : k + past], np.array(question["reference"][k])[:, np.newaxis]


def deepctools(question: dict[str, Any], svd: bool, options: dict[str, float]) -> Answer:
    """Solve the regulation form with ridge and slack, which deepctools calls robust DeePC.

    Timed with IPOPT's own tolerances, as its users do; the inputs are compared with tighter ones.
    """
    import deepctools as package

    past, horizon = question["initial_length"], question["horizon"]
    columns = len(question["u"]) - past - horizon + 1
    toolbox = package.deepctools(
        1,
        1,
        len(question["u"]),
        past,
        horizon,
        np.array(question["u"]),
        np.array(question["y"]),
        question["q"] * np.eye(horizon),
        question["r"] * np.eye(horizon),
        question["lambda_g"] * np.eye(columns),
        question["lambda_sigma"] * np.eye(past),
        sp_change=True,
        ineqconidx={"u": [0], "y": [0]},
        ineqconbd={
            "lbu": [-question["torque"]],
            "ubu": [question["torque"]],
            "lby": [-question["angle"]],
            "uby": [question["angle"]],
        },
        svd=svd,
    )
    toolbox.init_RDeePCsolver(uloss="u", opts={"ipopt.print_level": 0, "print_time": 0, **options})
    rest = np.zeros((horizon, 1))
    answer: Answer = {"microseconds": [], "u": []}
    for u_ini, y_ini, reference in samples(question):
        start = perf_counter_ns()
        u, _, _ = toolbox.solver_step(u_ini, y_ini, rest, reference)
        answer["microseconds"].append((perf_counter_ns() - start) / 1e3)
        answer["u"].append(float(u[0]))
    return answer


def direct_data_driven_mpc(question: dict[str, Any]) -> Answer:
    """Solve its nonlinear tracking controller: artificial setpoint, ridge and slack, with frozen data.

    Its window is n + 1 samples longer than the horizon L, so that L = N - 1 and n = Tini make the same depth.
    """
    from direct_data_driven_mpc.nonlinear_data_driven_mpc_controller import NonlinearDataDrivenMPCController

    order, horizon = question["initial_length"], question["horizon"] - 1
    limit = np.array([[-question["torque"], question["torque"]]])
    controller = NonlinearDataDrivenMPCController(
        n=order,
        m=1,
        p=1,
        u=np.array(question["u"]),
        y=np.array(question["y"]),
        L=horizon,
        Q=question["q"] * np.eye(horizon + order + 1),
        R=question["r"] * np.eye(horizon + order + 1),
        S=question["s"] * np.eye(1),
        y_r=np.zeros((1, 1)),
        lamb_alpha=question["lambda_g"],
        lamb_sigma=question["lambda_sigma"],
        U=limit,
        Us=0.99 * limit,
        update_cost_threshold=1e30,
    )
    answer: Answer = {"microseconds": [], "u": []}
    for u_ini, y_ini, reference in samples(question):
        for u, y in zip(u_ini, y_ini, strict=True):
            controller.store_input_output_measurement(u, y)
        start = perf_counter_ns()
        controller.set_output_setpoint(reference[:1])
        controller.update_and_solve_data_driven_mpc()
        answer["microseconds"].append((perf_counter_ns() - start) / 1e3)
        answer["u"].append(float(controller.get_optimal_control_input_at_step(0)[0]))
    return answer


def main(folder: Path) -> None:
    """Answer the question in a folder."""
    question = json.loads((folder / "question.json").read_text(encoding="utf-8"))
    answers = {
        "deepctools": deepctools(question, svd=False, options={}),
        "deepctools, reduced by SVD": deepctools(question, svd=True, options={}),
        "direct-data-driven-mpc": direct_data_driven_mpc(question),
    }
    answers["deepctools"]["u"] = deepctools(question, svd=True, options=TIGHT)["u"]
    (folder / "answer.json").write_text(json.dumps(answers), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
