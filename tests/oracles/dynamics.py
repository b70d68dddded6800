"""Independent NumPy model of the reducer: springs as relative motion of material points in the global frame.

Nothing here is shared with rvjax: K is assembled spring by spring from global displacements, the response is a
dense complex solve per harmonic, harmonic balance one dense system of n (2 H + 1) unknowns.
"""

import numpy as np


def layout(base, cranks, discs, **cycloid):
    """A reducer with other numbers of cranks and discs, and 16 sun teeth: not all planets in phase."""
    base = base.replace(involute=base.involute.replace(sun_teeth=16)) if 15 % cranks == 0 else base
    return base.replace(
        cranks=base.cranks.replace(count=cranks), cycloid=base.cycloid.replace(disc_count=discs, **cycloid)
    )


class Oracle:
    """Matrices of one design (an RVReducer of concrete numbers)."""

    def __init__(self, design, force_arm=None):
        g, s, m = design.involute, design.stiffness, design.inertia
        self.design, self.M, self.N = design, design.cranks.count, design.cycloid.disc_count
        M, N, R = self.M, self.N, design.cranks.circle_radius
        self.n = 6 * M + 3 * N + 6
        psi = 2 * np.pi * np.arange(M) / M
        psi_c = design.cycloid.disc_phase + 2 * np.pi * np.arange(N) / N
        e, beta, alpha = design.cycloid.eccentricity, design.cycloid.force_angle, g.pressure_angle
        rc = e * design.cycloid.disc_teeth if force_arm is None else force_arm
        self.springs = []

        def point(first, angle, arm):
            """Global displacement (2, n) of a point at `arm` from the centre of a part with frame `angle`."""
            rows = np.zeros((2, self.n))
            rows[:, first] = np.cos(angle), np.sin(angle)
            rows[:, first + 1] = -np.sin(angle), np.cos(angle)
            rows[:, first + 2] = -arm[1], arm[0]
            return rows

        sun, out = 0, self.n - 3
        planet, crank, disc = 3 + 3 * np.arange(M), 3 + 3 * M + 3 * np.arange(M), 3 + 6 * M + 3 * np.arange(N)
        unit = np.eye(self.n)
        for first, k, kt in ((sun, s.sun_support, s.sun_torsion), (out, s.output_support, s.output_torsion)):
            self.springs += [(k, unit[first]), (k, unit[first + 1]), (kt, unit[first + 2])]
        self.meshes = {"planetary": [], "cycloid": []}

        def each(number, count):
            """A number for every member; an array gives it one by one."""
            return np.broadcast_to(number, (count,))

        planetary, cycloid = each(s.sun_planet_mesh, M), each(s.disc_pin_mesh, N)
        self.mesh_stiffness = {"planetary": planetary, "cycloid": cycloid}
        bending, torsion = each(s.planet_crank_bending, M), each(s.planet_crank_torsion, M)
        support, arm_bearing = each(s.support_bearing, M), np.broadcast_to(s.turning_arm_bearing, (N, M))
        for i in range(M):
            axis = R * np.array([np.cos(psi[i]), np.sin(psi[i])])
            direction = np.array([np.cos(psi[i] + np.pi / 2 - alpha), np.sin(psi[i] + np.pi / 2 - alpha)])
            row = direction @ (point(sun, 0, (0, 0)) - point(planet[i], psi[i], (0, 0)))
            row[sun + 2], row[planet[i] + 2] = g.sun_base_radius, g.planet_base_radius
            self.meshes["planetary"].append(row)
            self.springs.append((planetary[i], row))
            for axis_, k in enumerate((bending[i], bending[i], torsion[i])):
                self.springs.append((k, unit[planet[i] + axis_] - unit[crank[i] + axis_]))
            own = point(crank[i], psi[i], (0, 0))
            self.springs += [(support[i], r) for r in own - point(out, 0, axis)]
            for j in range(N):
                arm = e * np.array([np.cos(psi_c[j]), np.sin(psi_c[j])])
                gap = point(crank[i], psi[i], arm) - point(disc[j], psi_c[j], axis)
                self.springs += [(arm_bearing[j, i], r) for r in gap]
        for j in range(N):
            row = np.zeros(self.n)
            row[disc[j] : disc[j] + 3] = np.sin(beta), np.cos(beta), rc * np.cos(beta)
            self.meshes["cycloid"].append(row)
            self.springs.append((cycloid[j], row))
        self.K = sum(k * np.outer(v, v) for k, v in self.springs)
        pairs = [(m.sun_mass, m.sun_inertia)]
        for part, count in (("planet", M), ("crank", M), ("disc", N)):
            pairs += zip(*(each(getattr(m, f"{part}_{name}"), count) for name in ("mass", "inertia")))
        self.m = np.array([x for a, b in [*pairs, (m.output_mass, m.output_inertia)] for x in (a, a, b)])
        self.ratio = (design.cycloid.disc_teeth * g.planet_base_radius + np.cos(alpha) * R) / g.sun_base_radius

    def load(self, output_torque):
        f = np.zeros(self.n)
        f[2], f[-1] = -output_torque / self.ratio, output_torque
        return f

    def mean(self, output_torque):
        return self.solve(self.K, self.load(output_torque))

    def mesh_rounding(self, name, mean):
        """Deflection of each mesh at `mean` that one relative rounding of every product in K and v.q can make.

        |v K^-1| |K| |q| + |v| |q|, |K| the sum of sizes: the componentwise bound of a linear solve, seen by a mesh.
        """
        rows, size = np.array(self.meshes[name]), sum(k * np.outer(np.abs(v), np.abs(v)) for k, v in self.springs)
        reach = np.abs([self.solve(self.K, row) for row in rows])
        return (reach @ size + np.abs(rows)) @ np.abs(mean)

    def solve(self, matrix, rhs):
        """Dense solve, scaled by the diagonal of K: condition 1e6 in SI, 1e2 so."""
        scale = np.tile(1 / np.sqrt(np.diag(self.K)), len(matrix) // self.n)
        return scale * np.linalg.solve(scale[:, None] * matrix * scale, scale * rhs)

    def stage(self, name, harmonics):
        """Mesh vectors, stiffness, phases and wave coefficients up to `harmonics`."""
        d, v = self.design, self.design.mesh_variation
        rows = np.array(self.meshes[name])
        teeth = d.involute.sun_teeth if name == "planetary" else d.cycloid.pin_count
        phase = 2 * np.pi * teeth * np.arange(len(rows)) / len(rows)
        k = self.mesh_stiffness[name]
        swing, duty, ramp = (getattr(v, f"{name}_{x}") for x in ("swing", "duty", "ramp"))
        order = np.arange(1, harmonics + 1)
        return rows, k, phase, 2 * swing / (order * np.pi) * np.sin(order * np.pi * duty) * np.sinc(order * ramp)

    def frequency(self, name, sun_speed):
        """Angular mesh frequency from the speeds of the shafts, pin ring fixed."""
        d = self.design
        ratio = 1 + d.involute.planet_teeth * d.cycloid.pin_count / d.involute.sun_teeth
        output = sun_speed / ratio
        if name == "planetary":
            return d.involute.sun_teeth * abs(sun_speed - output)
        crank = output - (sun_speed - output) * d.involute.sun_teeth / d.involute.planet_teeth
        return d.cycloid.pin_count * abs(crank)

    def modes(self):
        """Squares of the angular frequencies, ascending, and mass-normalised shapes as columns."""
        root = np.sqrt(self.m)
        squares, vectors = np.linalg.eigh(self.K / np.outer(root, root))
        return squares, vectors / root[:, None]

    def impedance(self, w, order):
        d = self.design.damping
        squares, shapes = self.modes()
        inner = self.m[:, None] * shapes
        c = 2 * d.modal_ratio * (inner * np.sqrt(np.maximum(squares, 0))) @ inner.T
        c = c + d.rayleigh_mass * np.diag(self.m) + d.rayleigh_stiffness * self.K
        return (
            self.K * (1 + 1j * d.loss_factor * np.sign(order)) + 1j * order * w * c - (order * w) ** 2 * np.diag(self.m)
        )

    def first_order(self, name, w, harmonics, output_torque):
        """B_l (harmonics, n)."""
        rows, k, phase, a = self.stage(name, harmonics)
        force = k * (rows @ self.mean(output_torque))
        return np.array(
            [
                self.solve(self.impedance(w, n), -a[n - 1] * (np.exp(1j * n * phase) * force) @ rows)
                for n in range(1, harmonics + 1)
            ]
        )

    def harmonic_balance(self, name, w, harmonics, output_torque):
        """Two-sided Q_l, l = -H .. H, from one dense system."""
        rows, k, phase, a = self.stage(name, 2 * harmonics)
        orders = np.arange(-harmonics, harmonics + 1)
        size = len(orders)
        matrix = np.zeros((size, self.n, size, self.n), complex)
        for p, n in enumerate(orders):
            for q, j in enumerate(orders):
                if p == q:
                    matrix[p, :, q] = self.impedance(w, n)
                else:
                    weight = k * a[abs(n - j) - 1] / 2 * np.exp(1j * (n - j) * phase)
                    matrix[p, :, q] = (rows.T * weight) @ rows
        rhs = np.zeros((size, self.n), complex)
        rhs[harmonics] = self.load(output_torque)
        return self.solve(matrix.reshape(size * self.n, -1), rhs.ravel()).reshape(size, self.n)
