"""Published reducers. Every value carries the table it comes from; what nobody printed says "assumed"."""

from rvjax.designs import CrankStage, CycloidStage, InvoluteStage, RVReducer
from rvjax.units import deg, mm

# RV-40E: anonymous web article on the original errors of the second stage as a four-bar linkage.
RV_40E = RVReducer(
    involute=InvoluteStage(
        sun_teeth=10,  # Table 1
        planet_teeth=26,  # Table 1
        module=2.0 * mm,  # derived: 2 * 36 mm / (10 + 26)
        pressure_angle=20 * deg,  # assumed: standard
        centre_distance=36.0 * mm,  # inferred: half of the 72 mm crank spacing
        sun_radius=10.0 * mm,  # derived: module * 10 / 2
        sun_base_radius=9.396926207859084 * mm,  # derived: sun_radius * cos 20 deg
        planet_base_radius=24.432008140433617 * mm,  # derived: module * 26 / 2 * cos 20 deg
    ),
    cycloid=CycloidStage(
        disc_teeth=39,  # Table 1
        pin_count=40,  # Table 1
        disc_count=2,  # assumed: usual layout, opposed discs
        eccentricity=1.3 * mm,  # Table 1
        pin_circle_radius=64.0 * mm,  # Table 1, diameter 128 mm
        pin_radius=3.0 * mm,  # Table 1, diameter 6 mm
    ),
    cranks=CrankStage(
        count=2,  # text: "two parallel crankshafts"
        circle_radius=36.0 * mm,  # inferred: the printed rigid ranges admit a spacing of 72.00 mm only
        bearing_stiffness=6e8,  # assumed: right order of magnitude, no maker's datum
    ),
)
