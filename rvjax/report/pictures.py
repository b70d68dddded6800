"""The pictures of an answer, as files: PNG for the results folder, SVG for the page."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from rvjax.render import saved as saved
from rvjax.study.answer import Answer
from rvjax.tolerances import least_yield


@dataclass(frozen=True)
class Picture:
    """One picture.

    Attributes:
        name: of a file, without ending.
        caption: what it shows, for a person who may not see it.
        content: bytes of the file.
    """

    name: str
    caption: str
    content: bytes


def pictures(answer: Answer, form: str = "png") -> Iterator[Picture]:
    """Draw an answer: curves of sample units, a histogram for each requirement, variance shares, cost against yield."""

    from rvjax import plotting
    from rvjax.plotting.style import words

    def picture(axes: Any, name: str, caption: str) -> Picture:
        return Picture(name, caption, saved(axes.figure, form))

    study, certificate = answer.study, answer.allocation.certificate
    with plotting.style():
        if (curve := study.curve) is not None:
            alike = (output for name in study.requirements if (output := study.output(name)).unit == curve.unit)
            read_in = next((output.read_in for output in alike), None)
            axes = plotting.unit_curves(
                answer.after.angle, answer.before.curves, answer.after.curves, curve.title, curve.unit, read_in=read_in
            )
            yield picture(axes, "curves", f"{curve.title} of sample units, before and after")
        for name, requirement in study.requirements.items():
            of_values = requirement.limits_values
            axes = plotting.response_histogram(
                answer.before.values[name],
                answer.after.values[name],
                unit=study.output(name).unit,
                read_in=study.output(name).read_in,
                name=name,
                upper=requirement.upper if of_values else math.inf,
                lower=requirement.lower if of_values else -math.inf,
            )
            caption = f"Distribution of {words(name)} before and after, with its limits"
            values = answer.after.values[name]
            if (valid := values[np.isfinite(values)]).size:
                unit, size = study.output(name).shown
                caption += f"; after: mean {valid.mean() / size:.3g} {unit}, sd {valid.std() / size:.3g} {unit}"
                caption += "".join(
                    f", {label} {found[name].value:.3g}"
                    for label, found in (("Cp", certificate.cp_estimate), ("Cpk", certificate.cpk_estimate))
                    if found and math.isfinite(found[name].value)
                )
            yield picture(axes, f"histogram_{name}", caption)
        axes = plotting.variance_shares(answer.after.shares, title="Who causes the variance, after")
        yield picture(axes, "variance_shares", "Share of each error in the variance of each response, after")
        if answer.cost_curve:
            axes = plotting.cost_against_yield(
                *zip(*answer.cost_curve),
                chosen=(least_yield(answer.allocation.certificate), answer.allocation.cost),
                start=(least_yield(answer.certificate_before), answer.allocation.start_cost),
            )
            ends = [
                f"{cost:.3g} at {100 * share:.5g} %" for share, cost in (answer.cost_curve[0], answer.cost_curve[-1])
            ]
            caption = f"Cheapest cost for each yield, from {' to '.join(ends)}, with this study and the start"
            yield picture(axes, "cost_against_yield", caption)
