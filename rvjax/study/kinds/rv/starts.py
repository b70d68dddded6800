"""New studies of an RV reducer, those of `rvjax init`: of the loaded reducer, and of the four-bar model."""

import re
from collections.abc import Mapping

from rvjax.catalogue import ASSUMED, RV_40E_WHOLE
from rvjax.designs import RollerBearing, RVReducer
from rvjax.life import static_rating
from rvjax.population import it_width
from rvjax.study.kinds.following import number_at
from rvjax.study.kinds.kind import Assumed, Known, Numbers, Start
from rvjax.study.kinds.rv.sizes import ARM, PARTS, arm_force, completed, tolerance_ratios
from rvjax.study.values import in_unit
from rvjax.units import um

MODIFICATIONS = ("cycloid.equidistant_modification", "cycloid.shift_modification")
STIFFNESS = "cranks.bearing_stiffness"
IN_DISC = "bearings.arm."
EQUIDISTANT = "equidistant_modification"
_LINE = re.compile(
    r'(?P<key>\w+)(?P<gap> *= *)"(?P<word>diametral )?(?P<number>-?[\d.]+) (?P<unit>[^"]+)"(?: *# *(?P<said>.*))?'
)
RULE = """# Tolerances, costs and process ranges are assumed. They are those of the study rv-40e-whole in proportion to
# the tolerance unit of ISO 286, i = 0.45 D^(1/3) + 0.001 D, of the size that each belongs to (in brackets).
# Angles and prices stay.

"""
HEAD = """# A study of the loaded reducer to change, with the numbers of the {name}: replace them by those of
# your drawing, then run rvjax check on this file. A line with "assumed" has no published value. It has that
# of the nearest known reducer, by a scaling law of rvjax/study/scaling.toml where sizes differ.

"""
UNREAD = """# The loaded model uses teeth, base circles and pressure angle of the gears, and K1 = e zp / rp = {k1:.4g}.
# It does not use module, centre distance, radius of the sun and a published K1, so that no contradiction remains.
"""


def _of_the_loaded(given: Known, example: RVReducer) -> tuple[Numbers, dict[str, Assumed]]:
    # Modifications that a four-bar study assumes take up its bearing clearance; here they would press the pins.
    own = {
        path: x
        for path, x in given.numbers.items()
        if path not in MODIFICATIONS or not ASSUMED.search(given.said.get(path, ""))
    }
    found = completed(own)
    if not any(own.get(path) for path in MODIFICATIONS):
        ratio, _ = tolerance_ratios({**own, **{path: item.value for path, item in found.items()}})[EQUIDISTANT]
        much = f"{ratio:.3g} times" if ratio != 1 else "as"
        value = ratio * number_at(example, MODIFICATIONS[0])
        found[MODIFICATIONS[0]] = Assumed(value, f"assumed: {much} that of the study rv-40e-whole")
    return own, found


def _of_four_bars(given: Known, example: RVReducer) -> tuple[Numbers, dict[str, Assumed]]:
    """Unpublished values are assumed as in the study of the RV-40E."""
    found = completed(given.numbers) if given.drawing else {}
    lacking = [] if any(given.numbers.get(path) for path in MODIFICATIONS) else [*MODIFICATIONS]
    lacking += [STIFFNESS] if given.numbers.get(STIFFNESS) is None else []
    return given.numbers, found | {path: Assumed(number_at(example, path), "assumed") for path in lacking}


def _with_torque(text: str, numbers: Numbers, torque: Assumed | None) -> str:
    if torque is None:
        return text
    return re.sub(r'output_torque = "[^"]*"', f'output_torque = "{in_unit(torque.value, "N m")}"', text)


def _unread(numbers: Numbers) -> str:
    e, pins, ring = (numbers[f"cycloid.{name}"] for name in ("eccentricity", "pin_count", "pin_circle_radius"))
    return UNREAD.format(k1=float(e * pins / ring))


def _tables(text: str, numbers: Numbers, torque: Assumed | None) -> str:
    """Tables after [design] of a loaded study: those of `rv-40e-whole`, in proportion to the size of the reducer.

    Args:
        text: of `rv-40e-whole`.
        numbers: of the design by path, SI.
        torque: rated torque, N m.
    """
    assert torque is not None
    arm = {path.removeprefix(IN_DISC): x for path, x in numbers.items() if path.startswith(IN_DISC)}
    bearing = RollerBearing(**arm)
    ratios, limit = tolerance_ratios(numbers), arm_force(bearing)
    bore = numbers[ARM] / number_at(RV_40E_WHOLE, ARM)
    similar = all(ratio == 1 for ratio, _ in ratios.values())
    table, made = [""], []
    for line in text.splitlines():
        if header := re.match(r"\[+([\w.]+)\]+", line):
            table = header[1].split(".")
        elif match := _LINE.fullmatch(line):
            line = _line(match, table, ratios, bore, limit, torque)
        elif grade := re.fullmatch(r'grade = "(\w+)".*', line):
            half = it_width(grade[1], _bore(bore)) / 2 / um
            line = f'grade = "{grade[1]}" # +-{half:g} um'
        if line == "# First stage" and not similar:
            made += RULE.splitlines()
        made.append(line)
    capacity = f"C0 = {float(static_rating(bearing)) / 1e3:.3g} kN"
    return "\n".join(made).replace("C0 = 33 kN", capacity) + "\n"


def _bore(ratio: float) -> float:
    return float(f"{25e-3 * ratio:.4g}")


def _line(
    match: re.Match[str],
    table: list[str],
    ratios: Mapping[str, tuple[float, str]],
    bore: float,
    limit: float,
    torque: Assumed,
) -> str:
    """A line of the table with its value for this size."""
    key, number, unit, said = match["key"], float(match["number"]), match["unit"], match["said"] or ""
    head = f"{key}{match['gap']}"
    if key.endswith("_torque"):
        return f'{head}"{in_unit(torque.value, "N m")}" # {torque.why}'
    if table[:2] == ["requirement", "arm_bearing_force"]:
        return f'{head}"{in_unit(limit, "N", 6)}" # {said}'
    if key == "size":
        return (
            match[0] if bore == 1 else f'{head}"{_bore(bore) * 1e3:.6g} mm" # assumed: follows the turning-arm bearing'
        )
    names = [f"{table[1]}.{key}", table[1]] if len(table) == 2 else []
    if (table[0] == "requirement" and table[1] != "misfit") or unit != "um":
        return match[0]
    ratio, size = next((ratios[name] for name in names if name in ratios), (1.0, ""))
    if ratio == 1 or not number:
        return match[0]
    reason = f"assumed: {ratio:g} times that of the RV-40E ({size})"
    return f'{head}"{match["word"] or ""}{number * ratio:.6g} um" # {"; ".join(filter(None, [said, reason]))}'


STARTS = {
    "loaded": Start("rv-40e-whole", PARTS, HEAD, _of_the_loaded, _tables, _unread),
    "four-bar": Start("rv-40e", ("involute", "cycloid", "cranks"), complete=_of_four_bars, tables=_with_torque),
}
