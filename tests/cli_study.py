"""A small study of the RV-40E for the tests of commands, and its answer: computed once, whichever command asks."""

import contextlib
import dataclasses
from collections.abc import Iterator
from importlib import resources

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
FOUND: dict = {}  # answers by the text of their study
MOVED: dict = {}  # and surrogates


@contextlib.contextmanager
def one_start() -> Iterator[None]:
    """Searches begin at the numbers of the study alone; `test_codesign.py` has problems with several valleys."""
    from rvjax.tolerances.allocation import search

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "starts", lambda decisions, x, low, high: [x])
        yield


@contextlib.contextmanager
def answered_once() -> Iterator[dict]:
    """Every study is answered once, whichever command asks, from one start; what follows its sliders is fitted once."""
    import rvjax.commands.allocate.answer
    from rvjax.commands.report import response_surface

    real, fitted = rvjax.commands.allocate.answer.answer, response_surface.surrogate

    def once(question, *, progress=False, memo=None, measure=True, tell=str):
        if question.text not in FOUND:
            FOUND[question.text] = real(question, progress=progress, memo=memo, measure=measure, tell=tell)
        return dataclasses.replace(FOUND[question.text], study=question)

    def few(answer):
        """Few points, and units in blocks of those of the search, for which the response is compiled already."""
        key = answer.study.text, answer.allocation.certificate.samples
        if key not in MOVED:
            MOVED[key] = fitted(answer, points=2, units=1024, chunk=1024, fresh=8192)
        return MOVED[key]

    with pytest.MonkeyPatch.context() as patch, one_start():
        patch.setattr(rvjax.commands.allocate.answer, "answer", once)
        patch.setattr(response_surface, "surrogate", few)
        yield FOUND
