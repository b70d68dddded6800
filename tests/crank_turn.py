"""Embedded studies along a crank turn at equal angles, for tests of what such studies have; parts of tests."""

import re

from rvjax import study


def crank_turn(name, samples):
    """The study without choice of angles."""
    text = study.load(name, solve=False).text
    text = re.sub(r'span = "output_turn".*\n', "", text)
    text = re.sub(r"samples = 481.*\nchosen_angles = .*\n", f"samples = {samples}\n", text)
    return study.parse_study(text, name=name, solve=False)
