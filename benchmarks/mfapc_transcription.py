"""Equations (16)-(21) written down line by line in NumPy: what MFAPC's step is measured against."""

import numpy as np

from ddpc_cosim import FloatArray


class Transcription:
    """MFAPC-CFDL for one input and one output, with the parameters of Table 2."""

    def __init__(self, steps: int, limit: float) -> None:
        self.n, self.n_m, self.limit = 5, 4, limit
        self.lambda_, self.mu, self.eta, self.epsilon = 0.37, 1.0, 1.0, 1e-5
        self.delta, self.theta_limit = 0.5, 2.0
        first = self.n_m + 1
        self.k = first
        self.phi = np.zeros(steps + first + self.n)
        self.phi[: first + 1] = 0.1
        self.theta = np.full(self.n_m, 0.175)
        self.theta_1 = self.theta.copy()
        self.u = np.zeros(steps + first + 1)
        self.y = np.zeros(steps + first + 1)

    def step(self, y: FloatArray, reference: FloatArray) -> FloatArray:
        k, n, n_m, phi, phi_1 = self.k, self.n, self.n_m, self.phi, self.phi[0]
        self.y[k] = y[0]
        dy, du = self.y[k] - self.y[k - 1], self.u[k - 1] - self.u[k - 2]

        phi[k] = phi[k - 1] + self.eta * du / (self.mu + du**2) * (dy - phi[k - 1] * du)  # (16)
        if abs(phi[k]) < self.epsilon or abs(du) <= self.epsilon or np.sign(phi[k]) != np.sign(phi_1):
            phi[k] = phi_1  # (17)

        past = phi[k - n_m : k][::-1]
        self.theta = self.theta + past / (self.delta + past @ past) * (phi[k] - past @ self.theta)  # (18)
        if np.linalg.norm(self.theta) >= self.theta_limit:
            self.theta = self.theta_1.copy()
        for j in range(1, n):
            phi[k + j] = self.theta @ phi[k + j - n_m : k + j][::-1]
            if abs(phi[k + j]) < self.epsilon or np.sign(phi[k + j]) != np.sign(phi_1):
                phi[k + j] = phi_1

        a = np.tril(np.tile(phi[k : k + n], (n, 1)))
        error = reference[:, 0] - np.ones(n) * self.y[k]
        changes = np.linalg.inv(a.T @ a + self.lambda_ * np.eye(n)) @ a.T @ error  # (20)
        self.u[k] = np.clip(self.u[k - 1] + changes[0], -self.limit, self.limit)  # (21)
        self.k += 1
        return self.u[k : k + 1]
