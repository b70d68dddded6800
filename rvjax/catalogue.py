"""Published reducers. Every value carries the table it comes from; what nobody printed says "assumed"."""

from rvjax.designs import (
    CamRollerReducer,
    CrankStage,
    CycloidStage,
    Damping,
    Inertia,
    InvoluteStage,
    MeshVariation,
    RVReducer,
    Stiffness,
)
from rvjax.errors import RVErrors
from rvjax.units import MPa, deg, mm

# Second stage of a compound oscillatory roller reducer: Wei et al. 2021, Chin. J. Mech. Eng. 34:84.
CORR = CamRollerReducer(
    gear_teeth=25,  # Table 1
    cam_radius=135.0 * mm,  # Table 1
    roller_radius=8.0 * mm,  # Table 1
    roller_length=12.0 * mm,  # Table 1
    eccentricity=3.5 * mm,  # Table 1
    young_modulus=2.06e5 * MPa,  # Table 1
    poisson_ratio=0.3,  # Table 1
    cam_share=0.55,  # Eq. 8
)

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

# RV-20E-141: Liu, Fu, Zhao, Ma, Rui, Zhang, Mech. Sci. 13, 855 (2022), doi 10.5194/ms-13-855-2022. Its Table 8
# contradicts itself in three places, each marked "inconsistent"; the values kept are those its totals need.
RV_20E = RVReducer(
    involute=InvoluteStage(
        sun_teeth=12,  # Table 8
        planet_teeth=42,  # Table 8
        module=1.5 * mm,  # Table 8; inconsistent: 1.5 mm (12 + 42) / 2 = 40.5 mm, not 27.5 mm. Not read
        pressure_angle=20 * deg,  # Table 8
        centre_distance=27.5 * mm,  # Table 8
        sun_radius=13.5 * mm,  # Table 8, its symbol misprinted "i16"; inconsistent: 6.11 mm from the centre
        #   distance and the teeth, 9 mm from the module; the printed lost motion needs 13.5 mm
        sun_base_radius=5.7425660159138845 * mm,  # inferred: 27.5 mm * 12 / 54 * cos 20 deg, so that the pair meshes
        planet_base_radius=20.098981055698598 * mm,  # inferred: 27.5 mm * 42 / 54 * cos 20 deg
    ),
    cycloid=CycloidStage(
        disc_teeth=39,  # Table 8
        pin_count=40,  # Table 8
        disc_count=2,  # assumed: usual layout, opposed discs
        eccentricity=0.9 * mm,  # Table 8
        pin_circle_radius=52.0 * mm,  # Table 8
        pin_radius=2.0 * mm,  # Table 8
        equidistant_modification=-0.010 * mm,  # Table 9
        shift_modification=-0.012 * mm,  # Table 9
        shortening=0.72,  # Table 8; inconsistent: 0.9 * 40 / 52 = 0.6923 (0.72 fits a pin circle of 50 mm); the
        #   printed lost motion needs 0.72
    ),
    cranks=CrankStage(
        count=2,  # assumed: usual layout
        circle_radius=27.5 * mm,  # by geometry: the centre distance
        # bearing_stiffness: nobody printed it
    ),
)

# Table 9; of the errors printed with both signs the upper limit.
RV_20E_ERRORS = RVErrors(
    base_tangent_upper=0.0035 * mm,
    base_tangent_lower=-0.0309 * mm,
    pin_circle_radius=0.010 * mm,
    pin_radius=-0.004 * mm,
    pin_hole_clearance=0.005 * mm,  # printed with the symbol of the pin radius error
    disc_runout=0.015 * mm,
    pin_position=0.0,
    disc_cumulative_pitch=0.019 * mm,
    equidistant_modification=0.001 * mm,  # +-0.001 mm
    shift_modification=0.003 * mm,  # +-0.003 mm
    eccentricity=0.005 * mm,
    bearing_clearance=0.001 * mm,  # radial, half of the printed clearance: Eq. 18 is the whole play only for that
)

# RV-320E: Yang, Chen, Wang, Chin. J. Mech. Eng. 31:49 (2018), doi 10.1186/s10033-018-0249-y. Its Table 1 heads the
# radii "base diameter": 15 * 1.5 mm / 2 * cos 20 deg = 10.57 mm. Mesh stiffness variation is not printed at all.
RV_320E = RVReducer(
    involute=InvoluteStage(
        sun_teeth=15,  # derived from the base radii: module 1.5 mm, 20 deg
        planet_teeth=69,  # derived, as above
        module=1.5 * mm,  # derived, as above
        pressure_angle=20 * deg,  # derived, as above
        centre_distance=63.0 * mm,  # derived: 1.5 mm (15 + 69) / 2; the crank circle is printed as 63.50 mm
        sun_radius=11.25 * mm,  # derived: 1.5 mm * 15 / 2
        sun_base_radius=10.57 * mm,  # Table 1, printed as a diameter
        planet_base_radius=48.63 * mm,  # Table 1, printed as a diameter
    ),
    cycloid=CycloidStage(
        disc_teeth=39,  # derived: 85.80 mm / 2.20 mm, Table 1
        pin_count=40,  # derived: one more
        disc_count=3,  # Section 3.3
        eccentricity=2.2 * mm,  # Table 1, "crankshaft"
        pin_circle_radius=114.0 * mm,  # assumed: not read by the dynamic model
        pin_radius=5.0 * mm,  # assumed: not read by the dynamic model
        force_angle=30 * deg,  # assumed: not printed
        disc_phase=0.0,  # free: without influence for three discs or more
    ),
    cranks=CrankStage(count=4, circle_radius=63.5 * mm),  # Section 3.3; Table 1, "carrier"
    inertia=Inertia(  # Table 1
        sun_mass=1.30,
        sun_inertia=4.44e-4,
        planet_mass=0.88,
        planet_inertia=1.01e-3,
        crank_mass=0.40,
        crank_inertia=7.56e-5,
        disc_mass=2.76,
        disc_inertia=2.09e-2,
        output_mass=15.33,
        output_inertia=1.06e-1,
    ),
    stiffness=Stiffness(  # Table 2; the text names an output support and torsion without values: zero
        sun_support=4.19e7,
        sun_torsion=1.16e4,
        planet_crank_bending=2.33e8,  # "crankshaft"
        planet_crank_torsion=6.99e4,  # "crankshaft"
        support_bearing=9.84e8,
        turning_arm_bearing=9.76e8,
        sun_planet_mesh=2.68e8,
        disc_pin_mesh=8.35e8,
    ),
    mesh_variation=MeshVariation(
        planetary_swing=0.3,  # assumed
        planetary_duty=0.643,  # assumed: transverse contact ratio 1.643 of the involute pair
        planetary_ramp=0.0,  # assumed
        cycloid_swing=0.1,  # assumed
        cycloid_duty=0.5,  # assumed
        cycloid_ramp=0.0,  # assumed
    ),
    damping=Damping(),  # the source is undamped
)
