"""Hammerstein-Wiener models: a linear model between nonlinearities without memory.

    x+ = A x + B g(u) + E d + K eps,   y = h(C x) + eps

with g and h piecewise linear, signal by signal. Given the linear part, what the outputs are predicted to be
is linear in the values of g at its points; given g, the linear part is found by prediction errors: each in
turn (E.-W. Bai, Automatica 34(3), 1998, doi:10.1016/S0005-1098(97)00198-2, for the parametrisation). The
output's map is the regression of the output on what the linear part simulates, made to rise.
"""

from dataclasses import replace

import numpy as np

from ddpc_cosim.controller import Recording
from ddpc_cosim.identification.innovation import StaticMap
from ddpc_cosim.identification.prediction_error import refine
from ddpc_cosim.identification.predictor import Predictor, Samples, scan
from ddpc_cosim.variables import FloatArray

_POINTS = 7
_ROUNDS = 10
_STEPS = 4
_LITTLE = 1e-6  # of a signal's information: what points that are not visited are held by
_EXACT = 1e-9
_FLAT = 0.05  # of the mean slope: what an output's map rises by at least


def input_map_of(
    recording: Recording, start: Predictor, delays: tuple[int, ...], rounds: int = _ROUNDS
) -> tuple[StaticMap, Predictor]:
    """Return the nonlinearities of the inputs, and the linear part between them and the outputs.

    Parameters
    ----------
    recording : Recording
        The data.
    start : Predictor
        The linear model without them.
    delays : tuple of int
        Dead time of every input, in samples.
    rounds : int
        How often each is found in turn.
    """
    curve = StaticMap(*(tuple(_points(u) for u in recording.u.T) for _ in range(2)))
    predictor = start
    for _ in range(rounds):
        samples = Samples.of(replace(recording, u=curve(recording.u)), delays)
        predictor = refine(predictor, samples, _STEPS)
        curve = _better(curve, recording, predictor, samples)
    samples = Samples.of(replace(recording, u=curve(recording.u)), delays)
    return curve, refine(predictor, samples)


def _better(curve: StaticMap, recording: Recording, predictor: Predictor, samples: Samples) -> StaticMap:
    """Return the input map with values at its points that leave smaller one-step errors."""
    counts = [len(points) for points in curve.points]
    every = [_shares(points, u) for points, u in zip(curve.points, recording.u.T, strict=True)]
    basis = Samples.of(replace(recording, u=np.hstack(every)), np.repeat(samples.delays, counts).tolist())
    units = basis.z[:, : sum(counts)] * basis.sizes[: sum(counts)]
    gain = np.repeat(predictor.g[:, : len(counts)] / samples.sizes[: len(counts)], counts, axis=1)
    states = scan(predictor.a, gain * units[:, np.newaxis, :], samples.stretches)
    errors = predictor.errors(samples)
    noise = errors.T @ errors / len(errors) + _EXACT**2 * np.eye(errors.shape[1])
    whiten = np.linalg.inv(np.linalg.cholesky(noise))
    effect = np.einsum("ij,jn,tnk->tik", whiten, predictor.c, states, optimize=True)
    effect = effect.reshape(errors.size, -1)
    information = effect.T @ effect
    held = _LITTLE * np.trace(information) / len(information) * np.eye(len(information))
    change = np.linalg.solve(information + held, effect.T @ (errors @ whiten.T).ravel())
    parts = np.split(change, np.cumsum(counts)[:-1])
    return StaticMap(curve.points, tuple(old + new for old, new in zip(curve.values, parts, strict=True)))


def output_map_of(recording: Recording, simulated: FloatArray) -> StaticMap:
    """Return rising maps from what a linear model simulates, shape (T, p), to the outputs."""
    maps = list[tuple[FloatArray, FloatArray]]()
    for y, w in zip(recording.y.T, simulated.T, strict=True):
        points = _points(w)
        values, *_ = np.linalg.lstsq(_shares(points, w), y, rcond=_LITTLE)
        least = _FLAT * np.ptp(y) / np.ptp(points) * np.diff(points)
        rises = np.maximum(np.diff(values), least)
        maps.append((points, values[0] + np.concatenate([[0.0], np.cumsum(rises)])))
    return StaticMap(tuple(points for points, _ in maps), tuple(values for _, values in maps))


def inverse(curve: StaticMap) -> StaticMap:
    """Return the map that takes back what a rising one does."""
    return StaticMap(curve.values, curve.points)


def _shares(points: FloatArray, signal: FloatArray) -> FloatArray:
    """Return how much of the value at each point a map has at a signal, shape (T, points)."""
    shares = StaticMap((points,) * len(points), tuple(np.eye(len(points))))
    return shares(np.repeat(signal[:, np.newaxis], len(points), axis=1))


def _points(signal: FloatArray) -> FloatArray:
    """Return where a map bends: evenly over a signal's range, or at its levels where it has few."""
    levels = np.unique(signal)
    if 2 <= len(levels) <= _POINTS:
        return levels
    return np.linspace(levels[0], levels[-1], _POINTS) if len(levels) > 1 else levels[0] + np.arange(2.0)
