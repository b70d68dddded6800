"""Units of one call of a program: sizes that several packages share."""

CHUNK = 32_768
"""Units of a chunk of Monte Carlo: the temporaries of a revolution of 64 angles stay near the cache."""

AT_ONCE = 256
"""Costly units of one call. Places that are not needed hold units of NaN, which a model does not solve."""

PULLED = 256
"""Units of a call for gradients: few, because a reverse pass keeps all intermediate values of a unit."""
