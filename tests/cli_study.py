"""A small study of the RV-40E for the tests of commands, and its answer: computed once, whichever command asks."""

import contextlib
import dataclasses
from collections.abc import Iterator
from importlib import resources

import jax.numpy as jnp
import pytest

TARGET, UNITS = 0.99, 20_000
"""Of a requirement and its certificate: 200 units may fail, so that counts certify and no rare units are sought."""

GOOD = (resources.files("rvjax") / "study" / "embedded" / "rv-40e.toml").read_text("utf-8")
# The fewest angles, a linkage of the first order and one field in grades: half of the time.
SMALL = GOOD.replace("angles = 64 ", 'closure = "first_order"\nangles = 8 ')
SMALL = SMALL.replace("samples = 16384", "samples = 1024")
SMALL = SMALL.replace('grade = "IT6"\nsize = "25 mm"\n', 'half_width = "6.5 um"\n')  # not the field with a comment
SMALL = SMALL.replace("certificate_samples = 1_000_000", "certificate_samples = 20_000").replace("0.9973", "0.99")
MIDDLE = 'lower = "-20 um"\nupper = "20 um"\n'
# The answer pays for a mid-point; at a tenth of the price the search is five times as long.
SMALL = SMALL.replace(MIDDLE, MIDDLE + 'cost = 0.1\nper = "1 um"\n')
HISTOGRAMS = ["histogram_transmission_error", "histogram_misfit", "histogram_lost_motion"]
PICTURES = ["curves", *HISTOGRAMS, "variance_shares", "cost_against_yield"]
DRAWING = """[design]
kind = "rv"
involute.sun_teeth = 14
involute.planet_teeth = 42
involute.module = "1.5 mm"
cycloid.disc_teeth = 39
cycloid.pin_count = 40
cycloid.eccentricity = "1.5 mm"
cycloid.pin_circle_radius = "78 mm"
cycloid.pin_radius = "3.5 mm"
cranks.count = 3
"""
FOUND: dict = {}  # answers by the text of their study
MOVED: dict = {}  # and surrogates


@contextlib.contextmanager
def one_start() -> Iterator[None]:
    """Searches begin at the numbers of the study alone; `test_codesign.py` has problems with several valleys."""
    from rvjax.tolerances.allocation import search

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "starts", lambda decisions, x, low, high: [x])
        yield


def lighter(answer):
    """A certified answer with few single units of its certificates, with which its JSON is a hundred times as long."""
    if not answer.allocation.feasible:
        return answer  # whose shortfall follows from them

    def light(certificate):
        return dataclasses.replace(certificate, values={n: v[:64] for n, v in (certificate.values or {}).items()})

    allocation = dataclasses.replace(answer.allocation, certificate=light(answer.allocation.certificate))
    return dataclasses.replace(answer, allocation=allocation, certificate_before=light(answer.certificate_before))


class Straight:
    """A study with a straight response in the place of its models, with small programs of derivatives.

    For its page: `test_report_live.py` and `test_report_surrogate.py` fit what follows sliders to models.
    """

    def __init__(self, answer):
        self.study, self.answer = answer.study, answer

    def __getattr__(self, name):
        return getattr(self.study, name)

    def response(self):
        mean, influence = self.answer.allocation.certificate.mean, self.answer.after.influence

        def line(errors, name):
            slopes = {field: influence[name].scatter.get(field) or 0.0 for field in self.study.fields}
            return mean[name].value + sum(s * jnp.sum(getattr(errors, field)) for field, s in slopes.items())

        return lambda errors: {name: line(errors, name) for name in self.study.requirements}


@contextlib.contextmanager
def answered_once() -> Iterator[dict]:
    """Every study is answered once, whichever command asks, from one start; what follows its sliders is fitted once."""
    import rvjax.commands.allocate.answer
    from rvjax.commands.report import response_surface

    real, fitted = rvjax.commands.allocate.answer.answer, response_surface.surrogate

    def once(question, *, progress=False, memo=None, measure=True, tell=str):
        if question.text not in FOUND:
            FOUND[question.text] = lighter(real(question, progress=progress, memo=memo, measure=measure, tell=tell))
        return dataclasses.replace(FOUND[question.text], study=question)

    def few(answer):
        """Few points, and units in blocks of those of the search, for which the response is compiled already."""
        key = answer.study.text, answer.allocation.certificate.samples
        if key not in MOVED:
            of = dataclasses.replace(answer, study=Straight(answer)) if answer.study.text == SMALL else answer
            MOVED[key] = fitted(of, points=2, units=1024, chunk=1024, fresh=8192)
        return MOVED[key]

    with pytest.MonkeyPatch.context() as patch, one_start():
        patch.setattr(rvjax.commands.allocate.answer, "answer", once)
        patch.setattr(response_surface, "surrogate", few)
        yield FOUND
