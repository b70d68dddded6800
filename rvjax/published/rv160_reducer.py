"""The measured RV reducer of ratio 81: published and assumed numbers, measured curve, and errors of its parts.

Only teeth, cranks and ratio of the measured reducer are known (22, 44, 39, 40; three cranks; a comment in the source
calls it an RV-160N). Everything else of `MACHINE` is assumed: lengths are those of the RV-320E, times the cube root of
the ratio of the rated torques (1/2), rounded; springs are its published ones times the same, torsional ones the cube.
"""

import numpy as np

from rvjax.designs import Contact, CrankStage, CycloidStage, InvoluteStage, RVReducer, Stiffness
from rvjax.errors import RVErrors
from rvjax.units import arcmin, mm, um

RATED = 1600.0  # assumed: torque of an RV-160, N m
MACHINE = RVReducer(
    involute=InvoluteStage.from_teeth(22, 44, module=1.5 * mm),  # teeth: source; module assumed, that of the RV-320E
    cycloid=CycloidStage(
        disc_teeth=39,  # source
        pin_count=40,  # source
        disc_count=2,  # assumed: usual layout
        eccentricity=1.75 * mm,  # assumed: 2.2 mm * 0.794
        pin_circle_radius=90.0 * mm,  # assumed: 114 mm * 0.794
        pin_radius=4.0 * mm,  # assumed: 5 mm * 0.794
    ),
    cranks=CrankStage(count=3, circle_radius=49.5 * mm),  # count: source; circle assumed: 1.5 mm (22 + 44) / 2
    stiffness=Stiffness(  # assumed: RV-320E, Table 2, lengths * 0.794; a fit scales all of them
        sun_support=3.3e7,
        sun_torsion=5.8e3,
        planet_crank_bending=1.85e8,
        planet_crank_torsion=3.5e4,
        support_bearing=7.8e8,
        turning_arm_bearing=7.7e8,
        sun_planet_mesh=2.1e8,
        disc_pin_mesh=6.6e8,
    ),
    contact=Contact(young_modulus=2.06e11, poisson_ratio=0.3, face_width=18 * mm),  # assumed: steel, a fifth of rp
)

# Half of backward less forward transmission error at 100 r/min and 25 C.
TORQUE = np.array([0.0, 100, 200, 300, 400, 500, 700, 900, 1000, 1200, 1300, 1400])
MEASURED = np.array([0.182, 0.599, 0.879, 1.132, 1.368, 1.513, 1.990, 2.436, 2.688, 3.143, 3.371, 3.560]) * arcmin
FITTED = np.arange(len(TORQUE)) % 2 == 0

DISCS, CRANKS, PINS, TEETH = (MACHINE.counts[name] for name in ("discs", "cranks", "pins", "teeth"))
SHAPES: dict[str, tuple[int, ...]] = {
    "pin_offset": (PINS, 2),
    "pin_radii": (PINS,),
    "ring_centre": (2,),
    "disc_pitch": (DISCS, TEETH),
    "disc_centre": (DISCS, 2),
    "crank_eccentricity": (DISCS, CRANKS),
    "crank_phase": (CRANKS,),
    "disc_bore": (DISCS, CRANKS, 2),
    "carrier_bore": (CRANKS, 2),
    "sun_runout": (2,),
    "planet_runout": (CRANKS, 2),
    "disc_profile": (DISCS, 5, 2),
}
NONE = RVErrors(**{name: np.zeros(shape) for name, shape in SHAPES.items()})
"""No error, in the shapes that all units of this module have: one program solves them."""


def pattern(seed: int = 0) -> RVErrors:
    """Scatter of pins, teeth and crank journals of an assumed unit, standard deviation 1 um."""
    draw = np.random.default_rng(seed).normal
    drawn = ("pin_offset", "disc_pitch", "crank_eccentricity")
    return NONE.replace(**{name: um * draw(size=SHAPES[name]) for name in drawn})
