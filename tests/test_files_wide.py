"""Wide tables of curves, as in ISO 230-2: a row for each target, a column for each run.

Oracle: the long table of the same readings.
"""

import numpy as np
import pytest

from rvjax import measured
from rvjax.units import arcsec

TARGET = np.array([0.0, 90.0, 180.0, 360.0])
FORTH, BACK = np.array([[0.4, 0.5], [0.6, 0.7], [-0.2, -0.1], [0.3, 0.2]]), np.array([[-1.0], [-1.1], [-1.2], [-1.4]])


@pytest.mark.parametrize(
    ("header", "places", "size"),
    [
        ("i,tgt [deg],fwd1 [deg],fwd2 [deg],bwd1 [deg]", True, 3600),
        ("i,Target (deg),Forward 1 (deg),Forward 2 (deg),Backward 1 (deg)", True, 3600),
        ("i,nominal position [deg],run 1 up [deg],run 2 up [deg],run 1 down [deg]", True, 3600),
        ("i,target [deg],fwd1 [arcsec],fwd2 [arcsec],bwd1 [arcsec]", False, 1),
        ("i,angle [deg],error_forward [arcsec],error_forward [arcsec],error_backward [arcsec]", False, 1),
        ("i,target [deg],x1 ↑ [arcmin],x2 ↑ [arcmin],x1 ↓ [arcmin]", False, 60),
        ("i,target,fwd1,fwd2,bwd1\n-,deg,arcsec,arcsec,arcsec", False, 1),
    ],
)
@pytest.mark.parametrize("kind", [None, "curve"])
def test_a_wide_table_is_the_long_one(write, header, places, size, kind):
    """Positions within the turn, or deviations; repeated runs are repeated readings of the same angle."""
    readings = np.hstack([FORTH, BACK]) / size + places * (TARGET % 360)[:, None]
    text = "".join(
        f"{k},{t!r},{','.join(map(repr, r))}\n" for k, (t, r) in enumerate(zip(TARGET.tolist(), readings.tolist()))
    )
    wide = measured.read([write(f"{header}\n{text}")], kind=kind)
    long = [
        (t, e, side)
        for k, t in enumerate(TARGET)
        for own, side in ((FORTH, "forward"), (BACK, "backward"))
        for e in own[k]
    ]
    lines = "".join(f"{float(t)},{float(e)},{side}\n" for t, e, side in long)
    due = measured.read([write(f"angle [deg],error [arcsec],direction\n{lines}", "long.csv")])
    assert [run.at for run in wide.runs] == [run.at for run in due.runs] and wide.kind == "curve"
    for one, other in zip(wide.runs, due.runs):
        np.testing.assert_allclose(one.angle, other.angle, atol=1e-12)
        np.testing.assert_allclose(one.error, other.error, atol=1e-9 * arcsec)
    assert "a wide table is read: forward: " in wide.notes[-1]
    assert ("positions" if places else "deviations") in wide.notes[-1]


def test_a_wide_table_keeps_its_conditions(write):
    text = "unit,soll [deg],fwd [arcsec],bwd [arcsec],torque [N m]\nA,0,1,2,412\nA,90,,4,412\n"
    runs = measured.read([write(text)], {"angle": "soll"}).runs
    assert [(run.at.unit, run.at.torque, run.at.direction) for run in runs] == [
        ("A", 412.0, "forward"),
        ("A", 412.0, "backward"),
    ]
    assert [len(run.angle) for run in runs] == [1, 2]  # an empty cell is no sample


def test_a_wide_table_past_a_turn_with_other_separators(write):
    """Targets of two revolutions, decimal commas, a preamble; positions of an encoder that starts again at 360 deg."""
    rows = "".join(f"{t};{(t + 0.001) % 360:.3f};{(t - 0.001) % 360:.3f}\n" for t in range(0, 721, 90)).replace(
        ".", ","
    )
    path = write("Date: 2026-08-01\nISO 230-2\n\nTarget (deg);Fwd (deg);Bwd (deg)\n" + rows)
    forth, back = measured.read([path]).runs
    np.testing.assert_allclose(forth.error, 3.6 * arcsec, rtol=1e-9)
    np.testing.assert_allclose(back.error, -3.6 * arcsec, rtol=1e-9)


@pytest.mark.parametrize(
    "header",
    ["torque [N m],angle [deg],forward [deg],backward [deg]", "torque [N m],angle [deg],rev [deg],note"],
)
def test_a_loop_with_more_columns_stays_a_loop(write, header):
    torque = np.concatenate([np.linspace(-9, 9, 100), np.linspace(9, -9, 100)])
    rows = "".join(f"{t:.3f},{t / 100:.5f},0,0\n" for t in torque)
    assert measured.read([write(f"{header}\n{rows}")]).kind == "loop"
