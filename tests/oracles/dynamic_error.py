"""Independent NumPy model of errors as excitation: every spring, turning rows, marched in time over one period.

Nothing is averaged, expanded in orders or taken apart by symmetry: at output angle theta each spring is the relative
motion of two material points (`tests.oracles.dynamics`, discs turned with their eccentrics), each error a displacement
of its material, each mesh as stiff as the teeth that it meets make it. Coordinates turn with their frames and
gyroscopic terms are neglected, as in rvjax. Damping is proportional to mass, the one kind with equal form in time and
frequency.
"""

import numpy as np

from tests.oracles.dynamics import Oracle

STAGES = np.array([0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6])  # Gauss' collocation of order 4
WEIGHTS = np.array([[0.25, 0.25 - 3**0.5 / 6], [0.25 + 3**0.5 / 6, 0.25]])


class Marched:
    """A reducer of concrete numbers and its errors, a dict of full arrays in the frame of RVErrors."""

    def __init__(self, design, errors, *, stage=None, harmonics=0, output_torque=0.0):
        self.design, self.errors, self.stage = design, errors, stage
        phase = design.cycloid.disc_phase
        at = [
            Oracle(design.replace(cycloid=design.cycloid.replace(disc_phase=phase - turn)))
            for turn in (0.0, np.pi / 2, np.pi)
        ]
        rows = [np.array([v for _, v in oracle.springs]) for oracle in at]
        self.middle = (rows[0] + rows[2]) / 2
        self.cosine, self.sine = (rows[0] - rows[2]) / 2, rows[1] - self.middle
        self.k = np.array([k for k, _ in at[0].springs])
        self.m, self.n, self.M, self.N = at[0].m, at[0].n, at[0].M, at[0].N
        self.load = at[0].load(output_torque)
        self.series = at[0].stage(stage, harmonics)[3] if stage else np.zeros(0)
        involute = design.involute
        self.pins, self.teeth = design.cycloid.pin_count, design.cycloid.disc_teeth
        self.sun_turns = involute.planet_teeth * self.pins / involute.sun_teeth  # against the carrier, same sense
        # Places of the springs in the list of `Oracle`: 6 supports, then for each crank its own, then the discs.
        own = 6 + 2 * self.N
        self.first = 6 + own * np.arange(self.M)
        self.psi = 2 * np.pi * np.arange(self.M) / self.M
        self.psi_c = phase + 2 * np.pi * np.arange(self.N) / self.N

    def given(self, name, shape):
        return np.broadcast_to(self.errors.get(name, 0.0), shape)

    def sized(self, name, members):
        value = np.asarray(self.errors.get(name, 0.0))
        return value if value.ndim else np.zeros((*members, 0, 2))

    def displaced(self, theta):
        """delta of every spring (springs,) at an output angle: material that is not where it should be."""
        e = self.design.cycloid.eccentricity
        alpha, beta = self.design.involute.pressure_angle, self.design.cycloid.force_angle
        delta = np.zeros(len(self.k))
        sun, ring = (-(v @ (1, 1j)) for v in (self.given("sun_runout", (2,)), self.given("ring_centre", (2,))))
        sun, ring = sun * np.exp(1j * self.sun_turns * theta), ring * np.exp(-1j * theta)  # seen from the carrier
        planet = self.given("planet_runout", (self.M, 2)) @ (1, 1j)
        planet = planet * np.exp(1j * (self.psi - self.pins * theta))
        normal = np.exp(1j * (self.psi + np.pi / 2 - alpha))
        mesh = -(sun * normal.conj()).real + (planet * normal.conj()).real
        mesh = mesh - fourier(self.sized("sun_flank", ()), self.psi - self.sun_turns * theta)
        inwards = np.full(self.M, np.pi + self.pins * theta)
        mesh = mesh - fourier(self.sized("planet_flank", (self.M,)), inwards)
        delta[self.first] = mesh
        seat = self.given("carrier_bore", (self.M, 2)) @ (1, 1j) * np.exp(1j * self.psi)
        delta[self.first + 4], delta[self.first + 5] = seat.real, seat.imag
        angle = self.psi_c - self.pins * theta  # of the eccentrics, seen from the carrier
        bore = self.given("disc_bore", (self.N, self.M, 2)) @ (1, 1j)
        thrown = self.given("crank_eccentricity", (self.N, self.M)) + 1j * e * self.given("crank_phase", (self.M,))
        arm = bore * np.exp(1j * self.psi) - thrown * np.exp(1j * angle[:, None])
        for j in range(self.N):
            delta[self.first + 6 + 2 * j], delta[self.first + 7 + 2 * j] = arm[j].real, arm[j].imag
        line = np.exp(1j * (angle + np.pi / 2 - beta))  # sin(be) along the eccentric, cos(be) across
        teeth = -(self.given("disc_centre", (self.N, 2)) @ (1, 1j))
        pin = ((ring - teeth) * line.conj()).real + fourier(self.sized("disc_flank", (self.N,)), angle)
        pin = pin + fourier(self.sized("ring_flank", ()), self.psi_c - self.teeth * theta)
        delta[-self.N :] = pin
        return delta

    def stiffness(self, theta):
        """k of every spring: that of the varying stage by the tooth that each member meets."""
        k = self.k.copy()
        order = np.arange(1, len(self.series) + 1)
        if self.stage == "planetary":  # how far the next tooth of the sun is from planet i, in pitches
            met = self.design.involute.sun_teeth * (self.sun_turns * theta - self.psi)
            k[self.first] *= 1 + np.cos(np.outer(met, order)) @ self.series
        elif self.stage == "cycloid":  # how far the eccentric of disc j is from the next pin
            met = self.pins * (self.psi_c - self.psi_c[0] - self.teeth * theta)
            k[-self.N :] *= 1 + np.cos(np.outer(met, order)) @ self.series
        return k

    def periodic(self, speed, period, steps, shown=(-1, 2)):
        """Periodic motion of the coordinates `shown` (steps, shown) at equal angles of `period`; output speed rad/s."""
        h, n, damping = period / speed / steps, self.n, self.design.damping.rayleigh_mass
        double = WEIGHTS @ WEIGHTS
        columns = 2 * n + 1
        state = np.zeros((2, n, columns))
        state[0, :, :n], state[1, :, n : 2 * n] = np.eye(n), np.eye(n)
        path = np.zeros((steps, len(shown), columns))
        for step in range(steps):
            path[step] = state[0][list(shown)]
            matrix, rhs = np.zeros((2, n, 2, n)), np.zeros((2, n, columns))
            for s, c in enumerate(STAGES):
                theta = (step + c) * period / steps
                turn = self.pins * theta
                rows = self.middle + np.cos(turn) * self.cosine + np.sin(turn) * self.sine
                k = self.stiffness(theta)
                K = rows.T @ (k[:, None] * rows) / self.m[:, None]
                for t in range(2):
                    matrix[s, :, t] = (s == t) * np.eye(n) + h * h * double[s, t] * K
                    matrix[s, :, t] += h * WEIGHTS[s, t] * damping * np.eye(n)
                rhs[s] = -K @ (state[0] + c * h * state[1]) - damping * state[1]
                rhs[s, :, -1] += (self.load + rows.T @ (k * self.displaced(theta))) / self.m
            a = np.linalg.solve(matrix.reshape(2 * n, -1), rhs.reshape(2 * n, -1)).reshape(2, n, columns)
            state[0] = state[0] + h * state[1] + h * h * np.tensordot((1 - STAGES) / 2, a, 1)
            state[1] = state[1] + h * a.mean(axis=0)
        last = state.reshape(2 * n, columns)
        start = np.linalg.solve(np.eye(2 * n) - last[:, :-1], last[:, -1])
        return path @ np.append(start, 1.0)

    def lines(self, speed, period, steps, shown=(-1, 2)):
        """{order: amplitudes of the shown coordinates} of the periodic motion, up to an eighth of the steps."""
        spectrum = 2 * np.fft.rfft(self.periodic(speed, period, steps, shown), axis=0) / steps
        return {number * 2 * np.pi / period: spectrum[number] for number in range(1, steps // 8)}


def fourier(series, angle):
    """sum_h a cos(h angle) + b sin(h angle), h = 1 .., for series (..., h, 2) and angles (members,)."""
    h = np.arange(1, series.shape[-2] + 1)
    turn = np.multiply.outer(angle, h)
    return (series[..., 0] * np.cos(turn) + series[..., 1] * np.sin(turn)).sum(axis=-1)
