"""Tables after [design] of a loaded study: those of `rv-40e-whole`, in proportion to the size of the reducer."""

import re
from collections.abc import Mapping

from rvjax.commands.init.numbers import in_unit
from rvjax.life import static_rating
from rvjax.population import it_width
from rvjax.records import PyTree
from rvjax.study import EMBEDDED, Assumed, arm_force, tolerance_ratios
from rvjax.units import um

BASE = "rv-40e-whole"
ARM = "bearings.arm.pitch_diameter"
_LINE = re.compile(
    r'(?P<key>\w+)(?P<gap> *= *)"(?P<word>diametral )?(?P<number>-?[\d.]+) (?P<unit>[^"]+)"(?: *# *(?P<said>.*))?'
)
RULE = """# Tolerances, costs and process ranges are assumed. They are those of the study rv-40e-whole in proportion to
# the tolerance unit of ISO 286, i = 0.45 D^(1/3) + 0.001 D, of the size that each belongs to (in brackets).
# Angles and prices stay.

"""


def question(numbers: Mapping[str, PyTree], bearing: PyTree, torque: Assumed, known: Mapping[str, PyTree]) -> str:
    """Text of the tables after [design].

    Args:
        numbers: of the design by path, SI.
        bearing: turning-arm bearing.
        torque: rated torque, N m.
        known: numbers of the design of `rv-40e-whole`.
    """
    text = (EMBEDDED / f"{BASE}.toml").read_text("utf-8")
    ratios, limit = tolerance_ratios(numbers), arm_force(bearing)
    bore = numbers[ARM] / known[ARM]
    similar = all(ratio == 1 for ratio, _ in ratios.values())
    table, made = [""], []
    for line in text[text.index("[conditions]") :].splitlines():
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
