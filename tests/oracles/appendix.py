"""The stiffness matrix as the appendix of Yang, Chen, Wang 2018 prints it, block by block, with its sign error.

Entry (1, 2) of the crank-disc coupling is published as -sin(psi). With it a translation of the whole reducer strains
the bearings, which no rigid motion can; +sin(psi) makes the published matrices equal to the sum over the springs.
"""

import numpy as np

from rvjax.designs import RVReducer
from rvjax.records import Scalar


def printed_stiffness(design: RVReducer, *, corrected: bool = False) -> np.ndarray:
    """K_b + K_m of the appendix, block by block, (n, n) in SI.

    Args:
        design: a reducer of concrete numbers with two or more cranks and discs.
        corrected: +sin(psi) in place of the published -sin(psi).

    Raises:
        ValueError: a reducer without stiffness.
    """
    s, involute, stage = design.stiffness, design.involute, design.cycloid
    if s is None:
        raise ValueError("RVReducer.stiffness = None: the matrix needs it")
    m, n, e, rh = design.cranks.count, stage.disc_count, stage.eccentricity, design.cranks.circle_radius
    rs, rp, alpha, beta = (
        involute.sun_base_radius,
        involute.planet_base_radius,
        involute.pressure_angle,
        stage.force_angle,
    )
    sun, planet, crank, disc, output = 0, 3, 3 + 3 * m, 3 + 6 * m, 3 + 6 * m + 3 * n
    matrix = np.zeros((output + 3, output + 3))

    def put(row: int, column: int, block: Scalar) -> None:
        block = np.asarray(block)
        matrix[row : row + 3, column : column + 3] += block
        if row != column:
            matrix[column : column + 3, row : row + 3] += block.T

    coupling = np.diag([s.planet_crank_bending, s.planet_crank_bending, s.planet_crank_torsion])  # K_p
    put(sun, sun, np.diag([s.sun_support, s.sun_support, s.sun_torsion]))  # K_11
    put(output, output, m * s.support_bearing * np.diag([1, 1, rh**2]))  # K_55: neither ko nor kot
    for i in range(m):
        psi = 2 * np.pi * i / m
        p, h = planet + 3 * i, crank + 3 * i
        put(p, p, coupling)  # K_22
        put(p, h, -coupling)  # K_23
        put(h, h, n * s.turning_arm_bearing * np.diag([1, 1, e**2]))  # K_H1
        put(h, h, s.support_bearing * np.diag([1.0, 1.0, 0.0]) + coupling)  # K_H2 + K_p
        c, sine = np.cos(psi), np.sin(psi)
        put(output, h, s.support_bearing * np.array([[-c, sine, 0], [-sine, -c, 0], [0, -rh, 0]]))  # K_H2^i
        a = psi + np.pi / 2 - alpha
        c, sine, ca, sa = np.cos(a), np.sin(a), np.cos(alpha), np.sin(alpha)
        at_sun, at_planet = np.array([c, sine, rs]), np.array([-sa, -ca, rp])
        put(sun, sun, s.sun_planet_mesh * np.outer(at_sun, at_sun))  # K_s1
        put(sun, p, s.sun_planet_mesh * np.outer(at_sun, at_planet))  # K_s2
        put(p, p, s.sun_planet_mesh * np.outer(at_planet, at_planet))  # K_pp
        for j in range(n):
            phi = stage.disc_phase + 2 * np.pi * j / n - psi
            c, sine = np.cos(phi), np.sin(phi)
            block = np.array([[-c, sine if corrected else -sine, 0], [-sine, -c, -rh], [0, -e, -rh * e * c]])
            put(h, disc + 3 * j, s.turning_arm_bearing * block)  # K_Hi^cj
    pin = np.array([np.sin(beta), np.cos(beta), e * stage.disc_teeth * np.cos(beta)])
    for j in range(n):
        c = disc + 3 * j
        put(c, c, m * s.turning_arm_bearing * np.diag([1, 1, rh**2]))  # K_c
        put(c, c, s.disc_pin_mesh * np.outer(pin, pin))  # K_cr
    return matrix
