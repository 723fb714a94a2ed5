"""MFAPC written down line by line in NumPy, one input and one output: what its step is measured against.

The compact form is equations (16)-(21) of the paper; the partial and the full form are the same steps with a
vector of coefficients. Parameters are those of Table 2.
"""

import numpy as np

from ddpc_cosim import FloatArray


class Transcription:
    """MFAPC-CFDL."""

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


class FullFormTranscription:
    """MFAPC-FFDL, and with no output changes MFAPC-PFDL."""

    def __init__(self, steps: int, limit: float, output_length: int, input_length: int) -> None:
        self.n, self.n_m, self.limit = 5, 4, limit
        self.ly, self.lu = output_length, input_length
        self.lambda_, self.mu, self.eta, self.epsilon = 0.37, 1.0, 1.0, 1e-5
        self.delta, self.theta_limit = 0.5, 2.0
        first = self.n_m + 1 + output_length + input_length
        self.k = first
        self.phi_1 = np.zeros(output_length + input_length)
        self.phi_1[output_length] = 0.1
        self.phi = np.zeros((steps + first + self.n, output_length + input_length))
        self.phi[: first + 1] = self.phi_1
        self.theta = np.full((output_length + input_length, self.n_m), 0.175)
        self.du = np.zeros(steps + first + self.n)
        self.dy = np.zeros(steps + first + self.n + 1)
        self.u, self.y = 0.0, 0.0

    def changes(self, k: int) -> FloatArray:
        """Return H_k: the changes of the output at k, k - 1, ..., then those of the input."""
        return np.concatenate(
            [self.dy[k - self.ly + 1 : k + 1][::-1], self.du[k - self.lu + 1 : k + 1][::-1]]
        )

    def reset(self, phi: FloatArray) -> bool:
        small = np.linalg.norm(phi[self.ly :]) < self.epsilon
        return bool(small or np.sign(phi[self.ly]) != np.sign(self.phi_1[self.ly]))

    def step(self, y: FloatArray, reference: FloatArray) -> FloatArray:
        k, n, n_m, phi = self.k, self.n, self.n_m, self.phi
        self.dy[k] = y[0] - self.y
        self.y = y[0]

        h = self.changes(k - 1)
        phi[k] = phi[k - 1] + self.eta * h / (self.mu + h @ h) * (self.dy[k] - phi[k - 1] @ h)
        if np.linalg.norm(h) <= self.epsilon or self.reset(phi[k]):
            phi[k] = self.phi_1

        for i in range(len(self.theta)):
            past = phi[k - n_m : k, i][::-1]
            error = phi[k, i] - past @ self.theta[i]
            self.theta[i] = self.theta[i] + past / (self.delta + past @ past) * error
            if np.linalg.norm(self.theta[i]) >= self.theta_limit:
                self.theta[i] = 0.175
        for j in range(1, n):
            for i in range(len(self.theta)):
                phi[k + j, i] = self.theta[i] @ phi[k + j - n_m : k + j, i][::-1]
            if self.reset(phi[k + j]):
                phi[k + j] = self.phi_1

        f, a = self.predict(k)
        errors = reference[:, 0] - np.ones(n) * self.y - f
        changes = np.linalg.inv(a.T @ a + self.lambda_ * np.eye(n)) @ a.T @ errors
        u = np.clip(self.u + changes[0], -self.limit, self.limit)
        self.du[k] = u - self.u
        self.u = u
        self.k += 1
        return np.array([u])

    def predict(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Return f and A, from rows over (dU, 1)."""
        n = self.n
        unit = np.eye(n + 1)[n]
        dy = [unit * change for change in self.dy[k - self.ly + 1 : k + 1]]
        du = [*(unit * change for change in self.du[k - self.lu + 1 : k]), *np.eye(n, n + 1)]
        for j in range(n):
            h = dy[j : j + self.ly][::-1] + du[j : j + self.lu][::-1]
            dy.append(self.phi[k + j] @ np.array(h))
        rows = np.cumsum(dy[self.ly :], axis=0)
        return rows[:, n], rows[:, :n]
